"""The menu: what `fastcollide` alone shows at a terminal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from fastcollide.console import EXIT_FINE, guard, render_and_report, run_and_report
from fastcollide.info import print_info
from fastcollide.parameters import InvalidSetting, Parameter
from fastcollide.positional import ORDER
from fastcollide.report_table import test_and_report
from fastcollide.settings import PARAMETERS, QUICK_DEMO, PictureSettings, RunSettings

# The report's values; whether to make a video is asked before its name.
_FIRST = (*(name for name in ORDER if name != "video"), "video")


def show_menu() -> int:
    """Asks for one thing after the other and does it, until quit, Ctrl-C or Ctrl-D. Returns the exit code."""
    choices: dict[str, tuple[str, Callable[[], int]]] = {
        "1": (f"Quick demo: {QUICK_DEMO.particles:,} spheres, {QUICK_DEMO.seconds:g} s", _demo),
        "2": ("Run with your own parameters", lambda: run_and_report(_ask_all())),
        "3": ("Performance test", lambda: test_and_report(device=None, threads=None, as_json=False)),
        "4": ("Render a folder of frames", _render),
        "5": ("Live view in a browser", _view),
        "6": ("Device information", print_info),
    }
    try:
        while True:
            click.echo("\nFastCollide")
            for key, (title, _) in choices.items():
                click.echo(f"  {key}  {title}")
            click.echo("  q  Quit")
            key = click.prompt("Choice", type=click.Choice([*choices, "q"]), default="1", show_choices=False)
            if key == "q":
                return EXIT_FINE
            guard(choices[key][1])
    except click.Abort:  # Ctrl-C or Ctrl-D at a question
        click.echo()
        return EXIT_FINE


def ask(parameter: Parameter) -> Any:
    """Asks for one setting until the answer is allowed; the return key alone takes the default."""

    def parse(text: str) -> Any:
        if not text and parameter.default is None:
            return None
        try:
            return parameter.parse(text.split() if parameter.value_names else text)
        except InvalidSetting as error:
            raise click.UsageError(str(error)) from None

    label = parameter.name.replace("_", " ").capitalize()
    click.echo(f"\n{parameter.help} Allowed: {parameter.allowed}.")
    if parameter.default is None:
        return click.prompt(f"{label} [{parameter.unset}]", default="", show_default=False, value_proc=parse)
    return click.prompt(label, default=parameter.default_text, value_proc=parse)


def _demo() -> int:
    return run_and_report(QUICK_DEMO)


def _ask_all() -> RunSettings:
    asks_all = click.confirm("\nAsk for device, walls, spheres, solver and picture as well?", default=False)
    answers: dict[str, Any] = {}
    for name in [*_FIRST, *(name for name in PARAMETERS if asks_all and name not in _FIRST)]:
        if name != "video" or answers["make_video"]:
            answers[name] = ask(PARAMETERS[name])
    while True:
        try:
            return RunSettings(**answers)
        except InvalidSetting as error:  # two answers contradict each other
            click.echo(f"Error: {error}")
            answers[error.name] = ask(PARAMETERS[error.name])


def _render() -> int:
    folder = click.prompt(
        "Folder",
        default=PARAMETERS["output"].default_text,
        type=click.Path(exists=True, file_okay=False, path_type=Path),
    )
    return render_and_report([folder], None, PictureSettings(video=ask(PARAMETERS["video"])))


def _view() -> int:
    from fastcollide.view.program import run_to_view, view_and_report

    source = click.prompt(
        "Scene or finished run [quick demo]",
        default="",
        show_default=False,
        value_proc=lambda text: click.Path(exists=True, path_type=Path)(text) if text else None,
    )
    return view_and_report(run_to_view(source), port=0)
