"""The documentation builds without a warning, and its reference leaves nothing public out."""

import dataclasses
import inspect
import re
import subprocess
import sys

import click
import fastcollide as fc
import pytest
from fastcollide.cli import commands
from run_examples import DOCS, ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of a built site."""
    for library in ("sphinx", "myst_parser", "furo", "sphinx_click"):
        pytest.importorskip(library)
    folder = tmp_path_factory.mktemp("site")
    options = ["--builder", "html", "--fail-on-warning", "--keep-going", "--nitpicky", "--quiet"]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, str(DOCS), str(folder)], capture_output=True, text=True, check=False
    )
    assert (built.returncode, built.stderr) == (0, "")
    return folder


def text_of(page):
    return re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))


def test_links_inside_pages_lead_to_places_that_are_there(site):
    """Sphinx looks at links between pages as they are written; this at what came out."""
    places = {page.name: page.read_text(encoding="utf-8") for page in site.glob("*.html")}
    checked = 0
    for name, text in places.items():
        for link in re.findall(r'(?:href|src)="([^":]+)"', text):
            target, _, place = link.partition("?")[0].partition("#")
            assert not target or (site / target).exists(), (name, link)
            if place and (target or name) in places:
                checked += 1
                assert f'id="{place}"' in places[target or name], (name, link)
    assert checked > 100


def test_no_page_has_the_name_of_one_that_the_builder_makes():
    assert not {"search", "genindex", "py-modindex"} & {page.stem for page in DOCS.glob("*.md")}


def test_every_public_name_is_in_the_reference():
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\.\. auto\w+:: (\w+)", text, flags=re.MULTILINE)) == sorted(fc.__all__)


def test_every_public_method_says_what_it_does(site):
    """What has no docstring is not in the reference at all."""
    reference = (site / "api.html").read_text(encoding="utf-8")
    for name in fc.__all__:
        thing = getattr(fc, name)
        assert inspect.getdoc(thing), name
        if not inspect.isclass(thing):
            continue
        fields = {field.name for field in dataclasses.fields(thing)} if dataclasses.is_dataclass(thing) else set()
        for member in vars(thing).keys() - fields - set(getattr(thing, "_fields", ())):
            if not member.startswith("_"):
                assert getattr(thing, member).__doc__, f"{name}.{member}"
                assert f'id="fastcollide.{name}.{member}"' in reference, f"{name}.{member}"


def test_every_argument_is_explained():
    for name in fc.__all__:
        thing = getattr(fc, name)
        if name in ("Recording", "DeviceArray", "CheckpointError", "InvalidValue", "lattice_spheres"):
            continue  # nobody makes the first four; the last refers to random_spheres
        try:
            arguments = inspect.signature(thing).parameters
        except ValueError:
            continue  # an exception without arguments of its own
        doc = inspect.getdoc(thing)
        for argument in arguments:
            if argument not in ("args", "kwargs"):
                assert re.search(rf"^    {argument}: \S", doc, flags=re.MULTILINE), f"{name}: {argument}"


def test_every_command_and_option_is_in_the_reference(site):
    text = text_of(site / "commandline.html")

    def look_at(command, path):
        if isinstance(command, click.Group):
            for name, inner in command.commands.items():
                if not inner.hidden:
                    look_at(inner, f"{path} {name}")
        assert path in text, path
        for parameter in command.params:
            for option in parameter.opts if isinstance(parameter, click.Option) else ():
                assert option in text, f"{path} {option}"

    look_at(commands, "fastcollide")


def test_every_public_header_is_in_the_reference():
    text = (DOCS / "cpp.md").read_text(encoding="utf-8")
    headers = {header.name for header in (ROOT / "include" / "fastcollide").glob("*.hpp")}
    assert set(re.findall(r"include/fastcollide/(\w+\.hpp)", text)) == headers
