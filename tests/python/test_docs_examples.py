"""What the pages of docs/ show runs as it stands."""

import re
from pathlib import Path

import fastcollide as fc
import pytest
from fastcollide.settings import PARAMETERS
from run_examples import DOCS, ROOT, Example, examples, run_example, run_page

PAGES = sorted(path.name for path in DOCS.glob("*.md"))
# Pages whose examples have a test of their own, which knows what comes out of each.
ELSEWHERE = {"checkpoints.md", "contact_search.md"}
NEEDED = {
    "tutorial.md": ("av", "gsd", "h5py", "matplotlib"),
    "files.md": ("av", "gsd", "h5py", "pyarrow"),
    "ledger.md": ("matplotlib", "pandas", "pyarrow"),
    "scenes.md": ("av",),
    "video.md": ("av",),
}

pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture(autouse=True)
def no_window(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")


def needs(page):
    for library in NEEDED.get(page, ()):
        pytest.importorskip(library)


def tutorial():
    for name in ("first.mp4", "crater.mp4", "orbit.mp4", "crater.svg", "height.png"):
        assert Path(name).stat().st_size > 500
    with fc.open("crater/run.gsd") as run:
        assert len(run) == 10
        assert len(run[-1].positions) == 201


def files():
    assert {path.name for path in Path("pile").iterdir()} >= {"run.gsd", "run.vtkhdf", "ledger.parquet", "run.json"}
    assert Path("pile.mp4").is_file()
    with fc.open("pile") as run:
        assert (len(run), run.times[-1], run.settings["fps"]) == (60, 2.0, 60)


def ledger():
    assert Path("curves.pdf").read_bytes().startswith(b"%PDF")


def video():
    assert Path("compare.mp4").stat().st_size > 500
    assert Path("start.png").is_file()


LEFT_BY = {"tutorial.md": tutorial, "files.md": files, "ledger.md": ledger, "video.md": video}


@pytest.mark.parametrize("page", [page for page in PAGES if page not in ELSEWHERE and examples(page)])
def test_the_examples_of(page):
    needs(page)
    run_page(page)
    if page in LEFT_BY:
        LEFT_BY[page]()


@pytest.mark.parametrize("page", PAGES)
def test_every_example_is_seen(page):
    """None hides from the tests: not in a block without a language, not behind a comment that says nothing."""
    text = (DOCS / page).read_text(encoding="utf-8")
    fences = re.findall(r"^```(.*)$", text, flags=re.MULTILINE)
    for_builder = [fence for fence in fences[::2] if fence.startswith("{")]
    assert not any(fences[1::2])
    assert len(examples(page)) == len(fences) / 2 - len(for_builder)
    assert not re.findall(r"\n\n    (?:pip|make|python|fastcollide|git|cmake) .*", text)


def test_the_tutorial_says_the_same_in_python_and_in_its_scene(capsys):
    needs("tutorial.md")
    scene, python = (next(e for e in examples("tutorial.md") if test(e)) for test in (_is_scene, _is_world))
    run_example(scene, {})
    capsys.readouterr()
    run_example(Example("tutorial.md", "sh", "fastcollide run crater.toml --no-video\n", 0, {}), {})
    shown = capsys.readouterr().out
    run_example(python, {})
    assert f"state hash      {capsys.readouterr().out.splitlines()[-1]}\n" in shown


def _is_scene(example):
    return example.file == "crater.toml"


def _is_world(example):
    return "fc.World(" in example.text


def test_one_result_is_asked_of_more_than_one_way():
    names = {}
    (example,) = examples("determinism.md")
    run_example(example, names)
    assert len(names["hashes"]) == 1
    names["hashes"].add(names["final_hash"](device="cpu", drag=0.07))
    assert len(names["hashes"]) == 2


@pytest.mark.parametrize("page", PAGES)
def test_options_are_those_of_the_program(page):
    """In tables and sentences, where no example would find them wrong."""
    from fastcollide.cli import commands

    known = {parameter.option for parameter in PARAMETERS.values()} | {"--help", "--test", "--build", "--install"}
    known |= {option for command in commands.commands.values() for p in command.params for option in p.opts}
    known |= {"--preset", "--component", "--prefix"}  # of CMake
    text = (DOCS / page).read_text(encoding="utf-8")
    programs = [*ROOT.glob("tools/*.py"), *ROOT.glob("benchmarks/*.py")]
    tools = "".join(path.read_text(encoding="utf-8") for path in programs)
    for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text):
        assert option in known or f'"{option}"' in tools, option
