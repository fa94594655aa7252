"""Goes a newcomer's way: all commands of docs/tutorial.md in their order, in a fresh clone, with the seconds of each.

python tools/newcomer.py [--address REPOSITORY] [--folder EMPTY_FOLDER]

The address is that of this clone by default, so what is committed here is tried. One shell does it all, as a reader's
would; the first command that fails ends it. What waits for Ctrl-C is left out.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import click
from doc_examples import Example, examples

ROOT = Path(__file__).parent.parent
SHELL = """
set -e
newcomer_end() { code=$?; [ $code = 0 ] || printf '\\n== failed: %s\\n' "$newcomer_step" >&3; exit $code; }
trap newcomer_end EXIT
newcomer_begin() { newcomer_step=$1; newcomer_since=$EPOCHREALTIME; echo "== $1"; }
newcomer_done() {
  newcomer_took=$(( (${EPOCHREALTIME/[.,]/} - ${newcomer_since/[.,]/}) / 100000 ))
  printf '%6d.%d s  %s\\n' $((newcomer_took / 10)) $((newcomer_took % 10)) "$newcomer_step" >&3
}
"""


def steps(example: Example, address: str) -> Iterator[tuple[str, str]]:
    """What each step is called, and what a shell does for it."""
    if example.file:
        yield f"write {example.file}", _with_text(f"cat > {shlex.quote(example.file)}", example.text)
    elif example.language == "python":
        yield f"Python, line {example.line} of docs/{example.page}", _with_text("python -", example.text)
    else:
        for line in example.text.splitlines():
            yield line, line.replace("ADDRESS", shlex.quote(address))


def _with_text(command: str, text: str) -> str:
    return f"{command} <<'END_OF_EXAMPLE'\n{text}END_OF_EXAMPLE"


@click.command(help=__doc__.splitlines()[0])
@click.option("--address", default=str(ROOT), help="What to clone.  [default: this clone]")
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Where.  [default: it goes away]")
def main(address: str, folder: Path | None) -> None:
    script = [SHELL]
    for example in examples("tutorial.md"):
        if not example.is_untested:
            for name, commands in steps(example, address):
                script += [f"newcomer_begin {shlex.quote(name)}", commands, "newcomer_done"]
    with tempfile.TemporaryDirectory() as temporary:
        place = folder or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        if any(place.iterdir()):
            raise click.BadParameter(f"found files in {place}; allowed: an empty folder")
        (place / "newcomer.sh").write_text("\n".join(script), encoding="utf-8")
        # The environment of a newcomer has nothing of this clone's.
        path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if not part.startswith(str(ROOT)))
        environment = {**os.environ, "PATH": path, "MPLBACKEND": "agg"}
        environment.pop("VIRTUAL_ENV", None)
        command = ["bash", "-c", "exec 3>&1 >newcomer.log 2>&1; . ./newcomer.sh"]
        code = subprocess.run(command, stdin=subprocess.DEVNULL, cwd=place, env=environment, check=False).returncode
        if code:
            print((place / "newcomer.log").read_text(encoding="utf-8")[-4000:], file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
