"""The program `fastcollide`: its commands. What they do lies in the modules that they call."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

import click

import fastcollide as fc
from fastcollide.bench_settings import BENCH_PARAMETERS, WITH_PEERS, BenchSettings
from fastcollide.console import (
    EXIT_BAD_USAGE,
    EXIT_FINE,
    EXIT_INTERRUPTED,
    fail,
    guard,
    plot_and_report,
    render_and_report,
    run_and_report,
)
from fastcollide.info import print_info
from fastcollide.menu import show_menu
from fastcollide.parameters import ChoicePerAxis, Parameter, Several, Switch
from fastcollide.positional import ORDER, is_positional, parse_positional
from fastcollide.report_table import test_and_report
from fastcollide.selftest import selftest as run_selftest
from fastcollide.settings import PARAMETERS, QUICK_DEMO, RENDER_PARAMETERS, PictureSettings, RunSettings
from fastcollide.view import HOST, PORT


def _positional_usage() -> str:
    example = " ".join(PARAMETERS[name].default_text for name in ORDER)
    names = ", ".join(name.replace("_", " ") for name in ORDER)
    return f"""\b
Without a command:
  fastcollide            the menu, at a terminal
  fastcollide --test     the performance table
  fastcollide {example}
                         a run from values alone

The values are {names} (1 or 0); trailing ones can be left out.

Exit codes: 0 fine, 1 failure, 2 bad usage, 130 stopped by Ctrl-C."""


def _help(parameter: Parameter) -> str:
    return f"{parameter.help}  [{parameter.allowed}; default: {parameter.default_text}]"


def _option(parameter: Parameter) -> Callable[[Any], Any]:
    if isinstance(parameter.kind, Switch):
        return click.option(
            parameter.option,
            parameter.name,
            is_flag=True,
            help="Make no video." if parameter.default else parameter.help,
            callback=lambda context, option, is_given: not parameter.default if is_given else None,
        )
    if isinstance(parameter.kind, Several):
        return click.option(
            parameter.option,
            parameter.name,
            multiple=True,
            metavar=parameter.kind.metavar,
            help=_help(parameter),
            callback=lambda context, option, words: parameter.parse(",".join(words)) if words else None,
        )
    return click.option(
        parameter.option,
        parameter.name,
        nargs=max(1, len(parameter.value_names)),
        metavar=" ".join(parameter.value_names) or parameter.kind.metavar,
        help=_help(parameter),
        callback=lambda context, option, words: None if words is None else parameter.parse(words),
    )


def _options(parameters: dict[str, Parameter]) -> Callable[[Any], Any]:
    """An option for each parameter. One that is not given is None, and left to the default of the table."""

    def add_to(command: Any) -> Any:
        for parameter in reversed(parameters.values()):
            command = _option(parameter)(command)
        return command

    return add_to


def _join_axes(arguments: Sequence[str]) -> list[str]:
    """The arguments with the up to three words after an option per axis as one: to click an option that takes one value
    or three is none."""
    words = list(arguments)
    for parameter in PARAMETERS.values():
        if isinstance(parameter.kind, ChoicePerAxis) and parameter.option in words:
            start = words.index(parameter.option) + 1
            values = list(takewhile(lambda word: not word.startswith("-"), words[start : start + 3]))
            if values:
                words[start : start + len(values)] = [" ".join(values)]
    return words


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


@click.group(epilog=_positional_usage(), context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(fc.__version__, prog_name="fastcollide")
def commands() -> None:
    """Spheres that fall and collide, on the CPU or a GPU, with the same result to the last bit."""


_SCENE = click.Path(exists=True, dir_okay=False, path_type=Path)
_set_option = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a key of the scene, like run.frames=60."
)


@commands.command()
@click.argument("scene", required=False, type=_SCENE)
@_set_option
@_options(PARAMETERS)
def run(scene: Path | None, overrides: tuple[str, ...], **values: Any) -> int:
    """Simulate SCENE, a TOML file, or the spheres of the options; write frame files, ledger, video and a picture.

    Beside a scene the options that say how long, where and what is written go before what it says; the others are
    refused.
    """
    given = _given(values)
    if scene is not None:
        from fastcollide.scene_program import run_scene_and_report

        return run_scene_and_report(scene, overrides, given)
    if overrides:
        raise click.UsageError("--set: found without a scene; allowed: after the name of a scene file")
    return run_and_report(RunSettings(**given))


@commands.group()
def scene() -> None:
    """Make and check scene files."""


@scene.command()
@click.argument("path", type=click.Path(path_type=Path))
def new(path: Path) -> int:
    """Write a commented scene file with every key and its default to PATH."""
    from fastcollide.scene_program import new_scene_and_report

    return new_scene_and_report(path)


@scene.command()
@click.argument("paths", nargs=-1, required=True, type=_SCENE)
@_set_option
def check(paths: tuple[Path, ...], overrides: tuple[str, ...]) -> int:
    """Check scene files down to the last sphere, without running them."""
    from fastcollide.scene_program import check_scenes_and_report

    return check_scenes_and_report(paths, overrides)


@scene.command()
def schema() -> int:
    """Print the JSON schema of scene files, for editors."""
    from fastcollide.scene_text import scene_schema

    click.echo(scene_schema(), nl=False)
    return EXIT_FINE


@commands.command()
def demo() -> int:
    """The quick demo of the menu."""
    return run_and_report(QUICK_DEMO)


@commands.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--label", "labels", multiple=True, help="Caption of a run; can be given once for each.")
@_options(RENDER_PARAMETERS)
def render(runs: tuple[Path, ...], labels: tuple[str, ...], bounds: Any, **values: Any) -> int:
    """Make a video of RUNS, which are output folders or trajectory files; several are shown side by side."""
    corners = (bounds[:3], bounds[3:]) if bounds else None
    return render_and_report(runs, corners, PictureSettings(**_given(values)), labels)


@commands.command()
@click.argument("source", required=False, metavar="[SCENE|RUN]", type=click.Path(exists=True, path_type=Path))
@_set_option
@_options({name: PARAMETERS[name] for name in ("device", "threads")} | {"bounds": RENDER_PARAMETERS["bounds"]})
@click.option(
    "--host", default=HOST, show_default=True, metavar="ADDRESS", help="Listen on; 0.0.0.0 is all of a network."
)
@click.option(
    "--port", default=PORT, show_default=True, type=click.IntRange(0, 65535), help="Port; 0 takes one that is free."
)
@click.option("--no-browser", is_flag=True, help="Only show the address; open no browser.")
def view(source: Path | None, host: str, port: int, no_browser: bool, **values: Any) -> int:
    """Watch spheres in a web browser: those of SCENE, as they are simulated and steered, or those of a finished RUN, an
    output folder or a trajectory file.

    Without either: the spheres of the quick demo. Ends at Ctrl-C.
    """
    from fastcollide.view.program import run_to_view, view_and_report

    run = run_to_view(source, **_given(values))
    return view_and_report(run, host, port, opens_browser=not no_browser)


@commands.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@_options({name: PARAMETERS[name] for name in ("device", "threads")})
def resume(folder: Path, device: str | None, threads: int | None) -> int:
    """Go on with the run in FOLDER, started with --checkpoint-every, from its last good checkpoint.

    The result is that of a run that was never stopped, also on another device. Without options: where it began.
    """
    from fastcollide.resume import resume_and_report

    return resume_and_report(folder, device, threads)


@commands.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Picture file, as PNG, SVG or PDF by its ending.  [default: ledger.png in FOLDER]",
)
def plot(folder: Path, output: Path | None) -> int:
    """Draw the ledger of the run in FOLDER: energy, momentum, contacts and overlap against time."""
    return plot_and_report(folder, output or folder / "ledger.png")


@commands.command()
def info() -> int:
    """Show this build and the devices of this machine."""
    return print_info()


@commands.command()
@_options({name: PARAMETERS[name] for name in ("device", "threads")})
def selftest(device: str | None, threads: int | None) -> int:
    """Check closed forms of mechanics on this machine: expected, found, error, limit."""
    return run_selftest(device or "auto", threads)


@commands.command()
@_options(BENCH_PARAMETERS)
def bench(**values: Any) -> int:
    """Measure the time of a frame: sizes, solvers, ways to find neighbours, devices.

    The scene is the report's; above 40,000 spheres its box grows. Every figure stands beside that of the report's
    design in the same run, and all states are compared: exit code 1 where two differ.
    """
    given = _given(values)
    if given.get("peers"):
        if extra := [BENCH_PARAMETERS[name].option for name in given if name not in WITH_PEERS]:
            raise click.UsageError(f"{extra[0]}: found beside --peers, which has no use for it")
        from fastcollide.peer_report import compare_and_report

        return compare_and_report(BenchSettings(**given))
    from fastcollide.bench_report import bench_and_report

    return bench_and_report(BenchSettings(**given))


@commands.command(hidden=True)
@_options({name: PARAMETERS[name] for name in ("device", "threads")})
@click.option("--json", "as_json", is_flag=True, help="Print JSON in place of tables.")
def test(device: str | None, threads: int | None, as_json: bool) -> int:
    """Measure the report's performance table.

    Without options: on the CPU with one thread and with all, and on each GPU.
    """
    return test_and_report(device, threads, as_json)


def _dispatch(arguments: Sequence[str]) -> int:
    if not arguments:
        if sys.stdin.isatty() and sys.stdout.isatty():
            return show_menu()
        commands.main(["--help"], prog_name="fastcollide", standalone_mode=False)
        return EXIT_BAD_USAGE
    if is_positional(arguments):
        return run_and_report(parse_positional(arguments))
    if "--test" in arguments:
        arguments = ["test", *(word for word in arguments if word != "--test")]
    code: int = commands.main(_join_axes(arguments), prog_name="fastcollide", standalone_mode=False)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program and returns its exit code."""
    try:
        return guard(lambda: _dispatch(sys.argv[1:] if arguments is None else arguments))
    except click.ClickException as error:
        fail(error.format_message())
        return EXIT_BAD_USAGE
    except click.Abort:  # click's word for Ctrl-C
        fail("stopped by Ctrl-C")
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
