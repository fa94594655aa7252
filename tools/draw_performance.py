"""Draws the picture of docs/performance.md and writes its tables, all from the CSV files of benchmarks/results alone.

python tools/draw_performance.py            # needs matplotlib

A machine comes onto the page by `fastcollide bench --output benchmarks/results/MACHINE` or `python
benchmarks/mixed_sizes.py --output …` and a call of this.
"""

import csv
from pathlib import Path

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "performance.md"
PICTURE = ROOT / "docs" / "pictures" / "performance.png"
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->\n"
BEGIN_SIZES, END_SIZES = "<!-- sizes -->\n", "<!-- end of sizes -->\n"
# What is drawn and shown: solver, whether by a new grid for every pass or the faster of the ways with lists, words for
# it, colour.
CURVES = (
    ("reference", "cells", "the report's design", "tab:gray"),
    ("reference", "lists", "its loop by lists", "tab:blue"),
    ("substep", "lists", "default solver", "tab:orange"),
    ("friction", "lists", "with friction and spin", "tab:green"),
)


def read_results(results: Path = RESULTS) -> dict:
    """Rows of each machine and device, from one run or several (bench.csv, bench_large.csv):
    {("nvidia-h200", "cuda:0"): [{column: text}, ...]}."""
    found = {}
    for path in sorted(results.glob("*/bench*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                found.setdefault((path.parent.name, row["device"]), []).append(row)
    check_states(found)
    return found


def check_states(results: dict) -> None:
    """Machines that ran the same frames of the same version must have ended in the same states."""
    states = {}
    for (machine, device), rows in results.items():
        for row in rows:
            key = tuple(row[name] for name in ("version", "spheres", "solver", "frames"))
            state, first = states.setdefault(key, (row["state_hash"], machine))
            if row["state_hash"] != state:
                spheres, solver = row["spheres"], row["solver"]
                raise SystemExit(
                    f"{spheres} spheres, {solver}: {machine} ({device}) and {first} ended in different states; "
                    "measure both again with one version"
                )


def row_of(rows: list, spheres: str, solver: str, way: str) -> dict | None:
    """The fastest of the rows that a curve shows at one size."""
    found = [
        row
        for row in rows
        if (row["spheres"], row["solver"]) == (spheres, solver) and (row["method"] == "cells") == (way == "cells")
    ]
    return min(found, key=lambda row: float(row["ms"]), default=None)


# --- The tables ---


def tables(results: dict) -> str:
    return "\n".join(table(machine, rows) for (machine, _), rows in results.items())


def table(machine: str, rows: list) -> str:
    """One device: time of a frame, how often it fits into the yardstick's, share of the roof, for each curve."""
    head = [
        "spheres",
        *(words for *_, words, _ in CURVES),
        "a call each",
        "of the roof",
        "contacts per sphere",
        "lists made",
    ]
    lines = [f"| {' | '.join(head)} |", "| " + " | ".join(["---"] * len(head)) + " |"]
    for spheres in dict.fromkeys(row["spheres"] for row in rows):
        cells = [f"{int(spheres):,}"]
        cells += [time_and_ratio(row_of(rows, spheres, solver, way)) for solver, way, *_ in CURVES]
        default = row_of(rows, spheres, "substep", "lists")
        cells += [
            one_by_one(rows, spheres),
            percent(default, share_of_roof),
            with_default(default, contacts),
            percent(default, share_of_lists),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    first = rows[0]
    repeats = sorted({int(row["repeats"]) for row in rows})
    notes = [
        f"`benchmarks/results/{machine}`",
        f"medians of {repeats[0]} repeats"
        if len(repeats) == 1
        else f"medians of {repeats[0]} to {repeats[-1]} repeats",
        f"copy {float(first['copy_gb_s']):,.0f} GB/s" if first["copy_gb_s"] else "copy not measured",
        *([first["note"]] if first["note"] else []),
    ]
    return f"### {first['device_name']}\n{'; '.join(notes)}.\n\n" + "\n".join(lines) + "\n"


def time_and_ratio(row: dict | None) -> str:
    if row is None:
        return "–"
    ms = milliseconds(float(row["ms"]))
    is_yardstick = (row["solver"], row["method"]) == ("reference", "cells")
    return ms if is_yardstick or not row["times_yardstick"] else f"{ms} ({float(row['times_yardstick']):.2g}×)"


def one_by_one(rows: list, spheres: str) -> str:
    """Milliseconds of a frame of the default solver that is a call of its own, as a world does it by itself."""
    for row in rows:
        if (row["spheres"], row["solver"], row["method"]) == (spheres, "substep", "auto") and row.get("ms_one_by_one"):
            return milliseconds(float(row["ms_one_by_one"]))
    return "–"


def with_default(row: dict | None, figure) -> str:
    return "–" if row is None else figure(row)


def percent(row: dict | None, figure) -> str:
    value = None if row is None else figure(row)
    return "–" if value is None else f"{100 * value:.2g} %"


def share_of_roof(row: dict) -> float | None:
    return float(row["roof_share"]) if row["roof_share"] else None


def contacts(row: dict) -> str:
    return f"{float(row['contacts_per_sphere']):.2g}"


def share_of_lists(row: dict) -> float:
    """Of the time of all stages, that of making and mending lists, with the sort before them."""
    stages = {name: float(value) for name, value in row.items() if name.endswith("_ms") and value}
    return (stages["make_lists_ms"] + stages.get("build_grid_ms", 0.0)) / sum(stages.values())


def milliseconds(ms: float | None) -> str:
    if ms is None:
        return "–"
    return f"{ms:,.0f}" if ms >= 1000 else f"{ms:.3g}"


def tables_of_sizes(results: Path = RESULTS) -> str:
    """For each machine: a row for each ratio of sizes, a column for each number of spheres and way."""
    parts = []
    for path in sorted(results.glob("*/mixed_sizes.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["solver"] == "substep"]
        columns = list(dict.fromkeys((row["spheres"], row["method"]) for row in rows))
        found = {(row["ratio"], row["spheres"], row["method"]): float(row["ms"]) for row in rows}
        head = ["sizes", *(f"{int(spheres):,} by {method}" for spheres, method in columns)]
        lines = [f"| {' | '.join(head)} |", "| " + " | ".join(["---"] * len(head)) + " |"]
        for ratio in dict.fromkeys(row["ratio"] for row in rows):
            figures = (milliseconds(found.get((ratio, *column))) for column in columns)
            lines.append(f"| 1:{float(ratio):g} | {' | '.join(figures)} |")
        parts.append(
            f"\n{rows[0]['device_name']} (`benchmarks/results/{path.parent.name}`):\n\n" + "\n".join(lines) + "\n"
        )
    return "".join(parts) + "\n"


def updated(text: str, results: dict) -> str:
    """The text of the page with the tables of these results between its marks."""
    for begin, end, content in ((BEGIN, END, tables(results)), (BEGIN_SIZES, END_SIZES, tables_of_sizes())):
        before, rest = text.split(begin)
        _, after = rest.split(end)
        text = before + begin + content + end + after
    return text


# --- The picture ---


def draw(results: dict) -> None:
    """Time of a frame against the number of spheres, one panel for each device."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        1, len(results), figsize=(5.6 * len(results), 4.4), layout="constrained", squeeze=False, sharey=True
    )
    for panel, ((machine, _), rows) in zip(axes[0], results.items(), strict=True):
        for solver, way, words, colour in CURVES:
            sizes = dict.fromkeys(row["spheres"] for row in rows)
            points = [row for size in sizes if (row := row_of(rows, size, solver, way)) is not None]
            spheres = [int(row["spheres"]) for row in points]
            ms = [float(row["ms"]) for row in points]
            panel.loglog(spheres, ms, "o-", color=colour, label=words, markersize=4)
        draw_roof(panel, rows)
        panel.set(title=f"{rows[0]['device_name'].partition(' (compute')[0]}\n{machine}", xlabel="spheres")
        panel.grid(color="0.92")
    axes[0][0].set_ylabel("ms a frame")
    axes[0][0].legend()
    # Without the date and the version, the same results give the same file.
    figure.savefig(PICTURE, dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def draw_roof(panel, rows) -> None:
    """The least time that the memory takes for a frame of the loop."""
    points = [row for row in rows if row["solver"] == "reference" and row["copy_gb_s"]]
    spheres = sorted({int(row["spheres"]) for row in points})
    if spheres:
        byte_ms = 1e-6 * float(points[0]["model_bytes"]) / float(points[0]["copy_gb_s"])
        panel.loglog(spheres, [byte_ms * n for n in spheres], ":", color="0.3", label="the memory's least")


def main() -> None:
    results = read_results()
    draw(results)
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8"), results), encoding="utf-8")


if __name__ == "__main__":
    main()
