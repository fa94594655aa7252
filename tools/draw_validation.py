"""Draws the pictures of docs/validation.md and writes its table, both from benchmarks/results/validation alone.

python tools/draw_validation.py            # needs matplotlib
"""

import itertools
import json
import math
from pathlib import Path

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "validation"
PAGE = ROOT / "docs" / "validation.md"
PICTURES = ROOT / "docs" / "pictures"
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->\n"
GASES = ("gas_10", "gas_20", "gas_30", "gas_40")
CASES = (*GASES, "maxwell", "haff", "close_packing", "loose_packing", "heap", "hopper")


def read_results() -> dict:
    return {name: json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8")) for name in CASES}


# --- The table ---


def table(results: dict) -> str:
    lines = ["| case | quantity | expected | allowed | found | |", "| --- | --- | --- | --- | --- | --- |"]
    for result in results.values():
        case = result["title"]
        for figure in result["figures"]:
            verdict = "in" if figure["is_good"] else "**missed**"
            allowed = f"{figure['lowest']:.5g} – {figure['highest']:.5g}"
            expected = f"{figure['expected']:.5g} ({figure['source']})"
            lines.append(
                f"| {case} | {figure['quantity']} | {expected} | {allowed} | {with_error(figure)} | {verdict} |"
            )
            case = ""
    return "\n".join(lines) + "\n"


def with_error(figure: dict) -> str:
    """With two digits of the standard error in brackets, in units of the last digit: 1.52220(55)."""
    found, error = figure["found"], figure["standard_error"]
    if not error:
        return f"{found:.4g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{found:.{digits}f}({round(error * 10**digits)})"


def updated(text: str, results: dict) -> str:
    """The text of the page with the table of these results between its two marks."""
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return before + BEGIN + table(results) + END + after


# --- The pictures ---


def draw_gases(axes, results):
    """Pressure and collision rate: difference from theory against dt."""
    for name, colour in zip(GASES, COLOURS, strict=True):
        curves = results[name]["curves"]
        for panel, quantity in zip(axes, ("pressure", "rate"), strict=True):
            expected = curves[f"expected_{quantity}"]
            value, error = zip(*curves[quantity], strict=True)
            limit, limit_error = curves[f"{quantity}_limit"]
            slope = curves[f"{quantity}_slope"][0]

            def percent(value, expected=expected):
                return 100 * (value / expected - 1)

            panel.errorbar(
                curves["steps"], [percent(v) for v in value], [100 * e / expected for e in error],
                fmt="o", color=colour, capsize=2, label=f"φ {curves['fraction']}",
            )  # fmt: skip
            panel.errorbar(0, percent(limit), 100 * limit_error / expected, fmt="s", color=colour, capsize=4)
            last = max(curves["steps"])
            panel.plot([0, last], [percent(limit), percent(limit + slope * last)], color=colour, linewidth=0.8)
    axes[0].axhspan(-0.5, 0.5, color="0.92")
    axes[1].axhspan(-1, 1, color="0.92")
    axes[0].set(title="Pressure Z", ylabel="found − Kolafa [%]")
    axes[1].set(title="Collision rate", ylabel="found − Enskog [%]")
    for panel in axes:
        panel.axhline(0, color="0.5", linewidth=0.8)
        panel.set(xlabel="dt [σ √(m/kT)]", ylim=(-1.5, 1.5))
        panel.legend()


def draw_maxwell(axes, results):
    """Kurtosis against collisions; speeds at the end."""
    curves = results["maxwell"]["curves"]
    axes[0].plot(*zip(*curves["boltzmann"], strict=True), color="0.3", label="Boltzmann's equation")
    axes[0].plot(curves["collisions"], curves["kurtosis"], ".", color=COLOURS[0], label="FastCollide")
    axes[0].axhspan(2.97, 3.03, color="0.92")
    axes[0].set(title="From equal speeds", xlabel="collisions of a sphere", ylabel="kurtosis of the velocity")
    axes[0].legend()
    edges = curves["speed_edges"]
    middle = [(a + b) / 2 for a, b in itertools.pairwise(edges)]
    axes[1].stairs(curves["speed_density"], edges, fill=True, color=COLOURS[0], alpha=0.4, label="FastCollide")
    maxwell = [math.sqrt(2 / math.pi) * v**2 * math.exp(-(v**2) / 2) for v in middle]
    axes[1].plot(middle, maxwell, color="0.3", label="Maxwell")
    axes[1].axvline(math.sqrt(3), color="0.5", linestyle=":", label="at the start")
    axes[1].set(title="At the end", xlabel="speed [√(kT/m)]", ylabel="density")
    axes[1].legend()


def draw_haff(axes, results):
    """Cooling, and the straight line that it makes."""
    curves = results["haff"]["curves"]
    time, rate = curves["time"], curves["expected_rate"]
    axes[0].semilogy(time, curves["temperature"], color=COLOURS[0], label="FastCollide")
    axes[0].semilogy(time, [(1 + rate * t) ** -2 for t in time], "--", color="0.3", label="Haff")
    axes[0].set(title="Cooling, φ 0.1, e 0.9", ylabel="T / T₀")
    for key, style, label in (("temperature", "-", "FastCollide"), ("event_driven", ":", "event-driven")):
        axes[1].plot(
            time, [t_0_over_t**-0.5 / (1 + rate * t) for t, t_0_over_t in zip(time, curves[key], strict=True)],
            style, color=COLOURS[0], label=label,
        )  # fmt: skip
    axes[1].axhline(1, color="0.3", linestyle="--", label="Haff")
    axes[1].set(title="Over Haff's law", ylabel="√(T₀/T) / (1 + t/τ)", ylim=(0.95, 1.05))
    for panel in axes:
        panel.set_xlabel("time [σ √(m/kT₀)]")
        panel.legend()


def draw_packings(axes, results):
    """Contacts of frictionless spheres against overlap; density of rough ones against time."""
    close, loose = results["close_packing"]["curves"], results["loose_packing"]["curves"]
    for substep, bulks in zip(close["substeps"], zip(*close["samples"], strict=True), strict=True):
        overlap, coordination = zip(*[(math.sqrt(b["overlap"]), b["coordination"]) for b in bulks], strict=True)
        axes[0].plot(overlap, coordination, "o", label=f"substep {substep:.2g} √(d/g)")
    axes[0].axhspan(5.8, 6.2, color="0.92")
    axes[0].set(title="Close: contacts of a sphere", xlabel="√(mean overlap / d)", xlim=(0, None), ylim=(5.5, 6.7))
    for substep, rows in zip(loose["substeps"], loose["samples"], strict=True):
        axes[1].plot(
            [r["time"] for r in rows], [r["fraction"] for r in rows], "o-", label=f"substep {substep:.2g} √(d/g)"
        )
    axes[1].axhspan(0.54, 0.60, color="0.92")
    axes[1].set(title="Loose, friction 10: volume fraction", xlabel="time [√(d/g)]", ylim=(0.5, 0.66))
    for panel in axes:
        panel.legend()


def draw_hopper(axes, results):
    """Spheres that have left; flow against the free width of the hole."""
    curves = results["hopper"]["curves"]
    for hole, rows in zip(curves["holes"], curves["fallen"], strict=True):
        axes[0].plot(*zip(*rows, strict=True), label=f"D {hole:g} d")
    axes[0].set(title="Spheres that have fallen through", xlabel="time [√(d/g)]")
    axes[0].legend()
    free = [hole - 1.4 for hole in curves["holes"]]
    flow, error = zip(*curves["flows"], strict=True)
    axes[1].errorbar(free, flow, error, fmt="o", color=COLOURS[0], capsize=2, label="FastCollide")
    exponent = curves["exponent"][0]
    fit = [math.exp(curves["logarithm_of_constant"]) * width**exponent for width in free]
    axes[1].plot(free, fit, color=COLOURS[0], linewidth=0.8, label=f"exponent {exponent:.2f}")
    middle = len(free) // 2
    law = [flow[middle] * (width / free[middle]) ** 2.5 for width in free]
    axes[1].plot(free, law, "--", color="0.3", label="5/2")
    axes[1].set(title="Flow", xlabel="(D − 1.4 d) / d", ylabel="spheres in √(d/g)", xscale="log", yscale="log")
    axes[1].set_xticks(range(4, 8), labels=range(4, 8), minor=True)
    axes[1].set_yticks((20, 50, 100), labels=(20, 50, 100), minor=True)
    axes[1].legend()


DRAWINGS = {
    "gas": draw_gases, "maxwell": draw_maxwell, "haff": draw_haff, "packing": draw_packings, "hopper": draw_hopper,
}  # fmt: skip
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")


def draw_all(results: dict) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    for name, draw in DRAWINGS.items():
        figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")
        draw(axes, results)
        # Without the date and the version, the same results give the same file.
        figure.savefig(PICTURES / f"validation_{name}.png", dpi=110, metadata={"Software": None})
        pyplot.close(figure)


def main() -> None:
    results = read_results()
    draw_all(results)
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8"), results), encoding="utf-8")


if __name__ == "__main__":
    main()
