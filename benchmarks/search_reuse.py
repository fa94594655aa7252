"""What a finder with a skin saves on a CPU: a new search beside one that looks at kept candidates, and beside one that
makes the list of candidates.

    python benchmarks/search_reuse.py [--sizes 100000,1000000] [--threads 1] [--repeats 9] [--output FOLDER]
                                      [--note TEXT]

Random spheres of one radius at 30 % of the volume, in no order; the skin in radii. Processor time of whole calls, the
median of interleaved repeats: what else the machine does disturbs it little. Writes search_reuse.csv and
search_reuse.json.
"""

import argparse
import statistics
import time
from itertools import product
from pathlib import Path

import fastcollide as fc
import numpy as np
from fastcollide.bench_report import write_table
from fastcollide.peers import cloud

SKINS = (0.05, 0.1, 0.2, 0.4)
OUTPUTS = ("pairs", "contacts", "neighbors")


def milliseconds(finder: fc.ContactFinder, position, output: str) -> float:
    started = time.process_time()
    finder.find_contacts(position, 1.0, output=output)
    return 1e3 * (time.process_time() - started)


def measure(position, output: str, skin: float, threads: int, repeats: int) -> dict[str, float]:
    """Medians of a call by a finder without a skin, by one whose candidates hold, and by one that makes them."""
    plain, kept = fc.ContactFinder(threads), fc.ContactFinder(threads, skin)
    there, elsewhere = position, position + np.float32(skin)  # so far that the list must be made anew
    times: dict[str, list[float]] = {"new_search_ms": [], "kept_ms": [], "list_ms": []}
    for repeat in range(repeats + 1):
        there, elsewhere = elsewhere, there
        before = kept.reuses
        one = {
            "list_ms": milliseconds(kept, there, output),
            "kept_ms": milliseconds(kept, there, output),
            "new_search_ms": milliseconds(plain, there, output),
        }
        assert kept.reuses == before + 1
        if repeat > 0:  # the first one warms up
            for name, value in one.items():
                times[name].append(value)
    return {name: round(statistics.median(values), 2) for name, values in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="100000,1000000")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--note", default="")
    given = parser.parse_args()
    lines = []
    for count in map(int, given.sizes.split(",")):
        position, _, _ = cloud(count, 1)
        for output, skin in product(OUTPUTS, SKINS):
            found = measure(position, output, skin, given.threads, given.repeats)
            gain = round(found["new_search_ms"] / found["kept_ms"], 2)
            extra = found["list_ms"] - found["new_search_ms"]
            saved = found["new_search_ms"] - found["kept_ms"]
            pays = round(1 + max(0.0, extra) / saved, 1) if saved > 0 else ""
            line = {"spheres": count, "output": output, "skin": skin, **found, "gain": gain, "pays_after_calls": pays}
            print(line, flush=True)
            lines.append({"machine": fc.devices()[0].description, "threads": given.threads, **line, "note": given.note})
    if given.output is not None:
        given.output.mkdir(parents=True, exist_ok=True)
        write_table(given.output, "search_reuse", lines, {"repeats": given.repeats, "searches": lines})


if __name__ == "__main__":
    main()
