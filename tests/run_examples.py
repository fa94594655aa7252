"""Runs the examples of a page of docs/ in the present folder, as tools/doc_examples.py says, with small pictures."""

import shlex
import sys
from pathlib import Path

from fastcollide import cli

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))
from doc_examples import DOCS, Example, examples  # noqa: E402

__all__ = ["DOCS", "ROOT", "Example", "examples", "run_example", "run_page"]

SMALL_PICTURE = ["--width", "128", "--height", "64"]


def run_page(page: str) -> None:
    """All examples of a page but those that are for somebody else. Those in Python share their names."""
    names: dict[str, object] = {}
    for example in examples(page):
        if not (example.is_for_newcomer or example.is_untested):
            run_example(example, names)


def run_example(example: Example, names: dict[str, object]) -> None:
    text = example.small()
    if example.file:
        Path(example.file).write_text(text, encoding="utf-8")
    elif example.language == "python":
        exec(compile("\n" * (example.line - 1) + text, str(DOCS / example.page), "exec"), names)
    elif example.language == "sh":
        for line in text.splitlines():
            program, *words = shlex.split(line)
            assert program == "fastcollide", f"{example.page}: found {line!r}; a test runs fastcollide alone"
            small = SMALL_PICTURE if words[0] in ("run", "render") else []
            assert cli.main([*words, *small]) == 0, line
    else:
        raise AssertionError(f"{example.page}:{example.line}: found {example.language} without a word of how it is run")
