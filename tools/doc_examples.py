"""The examples of a page of docs/, in their order: what the tests and tools/newcomer.py run.

A comment in the line before an example says how it is run:

    <!-- file: NAME -->                       its text is the file NAME, which later examples use
    <!-- small: 2000 to 20, 60 to 5 -->       in a test with these words in place of those, to be quick
    <!-- tested by tools/newcomer.py -->      by that alone
    <!-- not tested here: REASON -->          by nothing that reads this page
Two of them have "; " between them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
KNOWN_MARKS = {"file", "small", "tested by tools/newcomer.py", "not tested here"}
_EXAMPLE = re.compile(
    r"^(?:<!-- (?P<mark>[^\n]*) -->\n)?```(?P<language>[a-z]+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)


@dataclass(frozen=True)
class Example:
    """Of a page: its language, its text, the number of its first line, and what the comment before it says."""

    page: str
    language: str
    text: str
    line: int
    marks: dict[str, str]

    @property
    def file(self) -> str | None:
        """The file that the text is."""
        return self.marks.get("file")

    @property
    def is_for_newcomer(self) -> bool:
        """Whether tools/newcomer.py alone runs it."""
        return "tested by tools/newcomer.py" in self.marks

    @property
    def is_untested(self) -> bool:
        """Whether nothing that reads the page runs it."""
        return "not tested here" in self.marks

    def small(self) -> str:
        """The text with the smaller words of the comment."""
        text = self.text
        for change in filter(None, self.marks.get("small", "").split(", ")):
            word, smaller = change.split(" to ")
            text, count = re.subn(rf"(?<![\w.]){re.escape(word)}(?![\w.])", smaller, text)
            if not count:
                raise ValueError(f"{self.page}:{self.line}: found no {word} to make smaller")
        return text


def examples(page: str) -> list[Example]:
    """Those of a page, like "tutorial.md", that are not for the builder of the site."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = []
    for match in _EXAMPLE.finditer(text):
        line = text[: match.start("text")].count("\n") + 1
        found.append(Example(page, match["language"], match["text"], line, _marks(match["mark"] or "")))
    return found


def _marks(comment: str) -> dict[str, str]:
    marks = dict(part.partition(": ")[::2] for part in comment.split("; "))
    if unknown := marks.keys() - KNOWN_MARKS - {""}:
        raise ValueError(f"found the comment {unknown.pop()!r}; allowed: {', '.join(sorted(KNOWN_MARKS))}")
    return marks
