"""Writes the table of parameters into README.md, from the one table that the program itself is made from."""

from pathlib import Path

from fastcollide.parameters import Switch
from fastcollide.settings import PARAMETERS

BEGIN, END = "<!-- parameters -->\n", "<!-- end of parameters -->\n"
README = Path(__file__).parent.parent / "README.md"


def parameter_table() -> str:
    lines = ["| option | what | default | allowed |", "| --- | --- | --- | --- |"]
    for parameter in PARAMETERS.values():
        if isinstance(parameter.kind, Switch):
            lines.append(f"| `{parameter.option}` | {parameter.help} | | |")
            continue
        option = " ".join((parameter.option, *parameter.value_names))
        lines.append(f"| `{option}` | {parameter.help} | {parameter.default_text} | {parameter.allowed} |")
    return "\n".join(lines) + "\n"


def updated(text: str) -> str:
    """The text of README.md with the table of today between its two marks."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return before + BEGIN + parameter_table() + END + after


if __name__ == "__main__":
    README.write_text(updated(README.read_text(encoding="utf-8")), encoding="utf-8")
