"""The contact search on a GPU, beside a plain cell list and brute force. Run on a machine with a GPU, CuPy and PyTorch:

    python benchmarks/search_gpu.py [--output benchmarks/results/MACHINE] [--cases 1000000,1000000:8,...]
                                    [--repeats 5] [--seconds 220] [--note TEXT]

Random spheres at 30 % of the volume, of one size or 1:8 with equal volume in each octave (N:8), in CuPy arrays; the
answers are CuPy arrays. Each time is that of the whole call from Python, until the GPU is idle: the median of the
repeats after one to warm up. What the plain cell list answers must be the same: the number at any size, each index to
1,000,000 spheres. Where Warp is installed, its HashGrid is measured, too. A size that does not fit into the memory is
said and left out, and so is what would begin after --seconds. Writes search_gpu.csv and search_gpu.json; exit code 1
where two answers differ.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import fastcollide as fc
import numpy as np
from fastcollide import peers
from fastcollide.bench_report import write_table
from fastcollide.roof import copy_bandwidth
from plain_cell_list import PlainCellList

CASES = "1000000,1000000:8,10000000,10000000:8,100000000"
BRUTE_FORCE = (10_000, 20_000, 30_000)
COMPARED_IN_FULL = 1_000_000
SKIN = 0.1  # of the smallest radius, for the search that keeps candidates


@dataclass(frozen=True)
class Row:
    """One search on one cloud. entries: pairs, or entries of all rows; roof_share: model bytes over the time, as a
    share of the measured copy bandwidth; bytes_a_sphere: memory that the call holds afterwards, its result included."""

    search: str
    output: str
    spheres: int
    sizes: str
    entries: int | None
    ms: float | None
    ms_fastest: float | None
    ms_slowest: float | None
    times_fastcollide: float | None
    model_bytes: int | None
    roof_share: float | None
    bytes_a_sphere: float | None
    remark: str


class DifferentAnswers(RuntimeError):
    """Two searches of the same spheres found different pairs."""


def model_bytes(output: str, spheres: int, entries: int, has_radii: bool) -> int:
    """The least that a search moves between memory and processor [bytes]: the input read once, its copy in cell order
    (with an index) written once and read once, a start for each of as many cells as spheres written and read, and the
    answer written: two indices a pair, gap and normal on request, or an index an entry and an offset a row."""
    radius = 4 if has_radii else 0
    build = (12 + radius) + 2 * (16 + radius) + 2 * 4
    answer = {"pairs": 8 * entries, "contacts": 24 * entries, "neighbors": 4 * entries + 8 * (spheres + 1)}[output]
    return build * spheres + answer


def cloud(cupy: Any, count: int, ratio: int, seed: int = 1) -> tuple[Any, Any, float]:
    """Positions (count, 3) and radii (or the radius of all), float32, on the GPU, and the side of the cube."""
    random = cupy.random.default_rng(seed)
    # Equal volume in each octave: the number falls as r^-3.
    radius = (ratio**3 + (1 - ratio**3) * random.random(count, dtype=cupy.float64)) ** (-1 / 3) if ratio > 1 else 1.0
    volume = float((radius**3).sum()) if ratio > 1 else float(count)
    side = (4 / 3 * 3.141592653589793 * volume / 0.3) ** (1 / 3)
    position = random.random((count, 3), dtype=cupy.float32)
    position *= cupy.float32(side)
    return position, radius.astype(cupy.float32) if ratio > 1 else 1.0, side


class Bench:
    """Measures searches and keeps their rows."""

    def __init__(self, cupy: Any, repeats: int, deadline: float, bandwidth: float | None) -> None:
        self.cupy, self.repeats, self.deadline, self.bandwidth = cupy, repeats, deadline, bandwidth
        self.rows: list[Row] = []
        self.is_out_of_memory = (fc.OutOfMemory, MemoryError, cupy.cuda.memory.OutOfMemoryError)

    def measure(
        self, name: str, output: str, case: tuple[int, int], prepare: Callable[[], Callable[[], Any]],
        ours: Row | None = None, between: Callable[[], None] = lambda: None,
    ) -> tuple[Row, Any]:  # fmt: skip
        """Times what prepare() returns; gives its row and its last answer, or a row that says why there is none."""
        spheres, ratio = case
        remark, answer, seconds, held = "", None, [], None
        free_before = self._free_memory()
        if time.perf_counter() > self.deadline:
            remark = "left out: the time was over"
        else:
            try:
                search = prepare()
                for repeat in range(self.repeats + 1):
                    answer = None  # its memory can serve again
                    between()
                    self.cupy.cuda.Device().synchronize()
                    started = time.perf_counter()
                    answer = search()
                    self.cupy.cuda.Device().synchronize()
                    if repeat > 0:
                        seconds.append(time.perf_counter() - started)
                    if repeat > 0 and time.perf_counter() > self.deadline + 10:
                        remark = f"{repeat} repeats: the time was over"
                        break
                held = free_before - self._free_memory()
                # The search lives until here, with the memory that it keeps.
                del search
            except self.is_out_of_memory as error:
                remark = f"left out: out of memory ({str(error).splitlines()[0]})"
                answer, seconds = None, []
            except RuntimeError as error:  # PyTorch's and Warp's
                if "out of memory" not in str(error):
                    raise
                remark, answer, seconds = "left out: out of memory", None, []
        row = self._row(name, output, spheres, ratio, answer, seconds, held, ours, remark)
        self.rows.append(row)
        print(told(row), flush=True)
        return row, answer

    def _row(
        self, name: str, output: str, spheres: int, ratio: int, answer: Any, seconds: list[float], held: int | None,
        ours: Row | None, remark: str,
    ) -> Row:  # fmt: skip
        if not seconds:
            return Row(name, output, spheres, f"1:{ratio}", *[None] * 8, remark)
        entries = entries_of(answer)
        ms = 1e3 * statistics.median(seconds)
        model = model_bytes(output, spheres, entries, ratio > 1)
        return Row(
            search=name,
            output=output,
            spheres=spheres,
            sizes=f"1:{ratio}",
            entries=entries,
            ms=round(ms, 4),
            ms_fastest=round(1e3 * min(seconds), 4),
            ms_slowest=round(1e3 * max(seconds), 4),
            times_fastcollide=round(ms / ours.ms, 2) if ours and ours.ms else None,
            model_bytes=model,
            roof_share=round(model / (1e-3 * ms) / self.bandwidth, 4) if self.bandwidth else None,
            bytes_a_sphere=round(held / spheres, 1) if held is not None else None,
            remark=remark,
        )

    def _free_memory(self) -> int:
        self.cupy.get_default_memory_pool().free_all_blocks()
        return int(self.cupy.cuda.runtime.memGetInfo()[0])


def entries_of(answer: Any) -> int:
    if isinstance(answer, int):
        return answer
    return len(answer.indices) if hasattr(answer, "indices") else len(answer.first)


def told(row: Row) -> str:
    what = f"{row.spheres:>11,} {row.sizes:>4} {row.search:<36} {row.output:<9}"
    if row.ms is None:
        return f"{what} {row.remark}"
    ratio = f"{row.times_fastcollide:8.2f}x" if row.times_fastcollide else " " * 9
    roof = f"{100 * row.roof_share:5.1f} % of the roof" if row.roof_share else ""
    return (
        f"{what} {row.entries:>12,} {row.ms:10.3f} ms {ratio} {roof} {row.bytes_a_sphere} bytes a sphere {row.remark}"
    )


def check_same(cupy: Any, case: tuple[int, int], name: str, ours: Any, theirs: Any) -> None:
    """Raises DifferentAnswers unless both found the same."""
    if ours is None or theirs is None:
        return
    if entries_of(ours) != entries_of(theirs):
        raise DifferentAnswers(f"{name}, {case}: found {entries_of(theirs):,}; expected: {entries_of(ours):,}")
    if case[0] > COMPARED_IN_FULL:
        return
    for field in ("first", "second", "offsets", "indices"):
        if hasattr(ours, field) and not bool((getattr(ours, field) == getattr(theirs, field)).all()):
            raise DifferentAnswers(f"{name}, {case}: {field} differ from FastCollide's")


def run_case(bench: Bench, case: tuple[int, int]) -> None:
    """All searches of one cloud."""
    cupy = bench.cupy
    try:
        position, radius, side = cloud(cupy, *case)
    except bench.is_out_of_memory as error:
        print(f"{case}: left out, no memory for the spheres themselves: {error}", flush=True)
        return
    largest = float(radius.max()) if case[1] > 1 else radius
    smallest = float(radius.min()) if case[1] > 1 else radius

    def ours_with(**options: Any) -> Callable[[], Callable[[], Any]]:
        def prepare() -> Callable[[], Any]:
            finder = fc.ContactFinder()
            return lambda: finder.find_contacts(position, radius, **options)

        return prepare

    def plain(both: bool) -> Callable[[], Callable[[], Any]]:
        def prepare() -> Callable[[], Any]:
            cells = PlainCellList(cupy, side, largest)
            return lambda: cells.neighbors(position, radius) if both else cells.pairs(position, radius)

        return prepare

    pairs, found = bench.measure("FastCollide", "pairs", case, ours_with(output="pairs"))
    _, plain_found = bench.measure("plain cell list", "pairs", case, plain(False), pairs)
    check_same(cupy, case, "plain cell list", found, plain_found)
    del plain_found
    warp = warp_search(position, radius, side)
    if warp is not None:
        _, warp_found = bench.measure("Warp, HashGrid", "pairs", case, lambda search=warp: search, pairs)
        if found is not None and warp_found is not None and abs(warp_found - len(found)) > 2e-5 * len(found):
            raise DifferentAnswers(f"Warp, {case}: found {warp_found:,}; expected: {len(found):,}")
    del found, warp
    bench.measure("FastCollide", "contacts", case, ours_with())

    def find_neighbors() -> Callable[[], Any]:
        finder = fc.ContactFinder()
        return lambda: finder.find_neighbors(position, 2 * largest)

    if case[1] == 1:  # one radius for all
        rows, found = bench.measure("FastCollide", "neighbors", case, find_neighbors)
        _, plain_found = bench.measure("plain cell list", "neighbors", case, plain(True), rows)
        check_same(cupy, case, "plain cell list", found, plain_found)
        del found, plain_found
    if case[0] > 10_000_000:
        return

    # The same spheres, which walk a hundredth of the skin before each call.
    skin = SKIN * smallest
    random = cupy.random.default_rng(2)
    finder = fc.ContactFinder(skin=skin)

    def walk() -> None:
        steps = random.random(position.shape, dtype=cupy.float32)
        steps -= 0.5
        steps *= 0.01 * skin
        cupy.add(position, steps, out=position)

    bench.measure(
        "FastCollide, kept candidates", "pairs", case,
        lambda: lambda: finder.find_contacts(position, radius, output="pairs"), pairs, walk,
    )  # fmt: skip
    if bench.rows[-1].ms is not None and finder.reuses < bench.repeats:
        raise DifferentAnswers(f"kept candidates, {case}: only {finder.reuses} calls used them")
    kept = finder.find_contacts(position, radius, output="pairs")
    check_same(cupy, case, "kept candidates", fc.find_contacts(position, radius, output="pairs"), kept)


def warp_search(position: Any, radius: Any, side: float) -> Callable[[], int] | None:
    try:
        radii = fc.to_numpy(radius) if hasattr(radius, "shape") else np.full(len(position), radius, np.float32)
        return peers.warp_search(fc.to_numpy(position), radii, side, 1, device="cuda")
    except ImportError:
        return None


def run_brute_force(bench: Bench, count: int) -> None:
    """Every pair compared by PyTorch, in single precision: a distance at the limit itself may turn by rounding."""
    try:
        import torch
    except ImportError:
        print("PyTorch is not installed: no brute force", flush=True)
        return
    position, radius, _ = cloud(bench.cupy, count, 1)
    points = torch.from_dlpack(position)

    def search() -> Any:
        near = torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist") < 2 * radius
        return len(near.triu(diagonal=1).nonzero())

    finder = fc.ContactFinder()
    case = (count, 1)
    ours, found = bench.measure(
        "FastCollide", "pairs", case, lambda: lambda: finder.find_contacts(position, radius, output="pairs")
    )
    _, brute = bench.measure("PyTorch, brute force", "pairs", case, lambda: search, ours)
    torch.cuda.empty_cache()
    if found is not None and brute is not None and abs(brute - len(found)) > max(1, 1e-4 * len(found)):
        raise DifferentAnswers(f"brute force, {count:,}: found {brute:,}; expected: {len(found):,}")


def cases_of(text: str) -> list[tuple[int, int]]:
    """1000000 or 1000000:8, separated by commas."""
    return [(int(count), int(ratio or 1)) for count, _, ratio in (word.partition(":") for word in text.split(","))]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--cases", type=cases_of, default=cases_of(CASES))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=220.0, help="what would begin later is left out")
    parser.add_argument("--note", default="")
    given = parser.parse_args()
    started = time.perf_counter()
    device = next((one for one in fc.devices() if one.name.startswith("cuda")), None)
    if device is None:
        print("no GPU that this build can use", file=sys.stderr)
        return 2
    import cupy

    bandwidth = copy_bandwidth("cuda:0")
    print(f"{device.description}, copies {bandwidth / 1e9 if bandwidth else 0:,.0f} GB/s", flush=True)
    bench = Bench(cupy, given.repeats, started + given.seconds, bandwidth)
    fault = ""
    try:
        for count in BRUTE_FORCE:
            run_brute_force(bench, count)
        for case in given.cases:
            run_case(bench, case)
    except Exception as error:  # what was measured before is written all the same
        fault = f"{type(error).__name__}: {error}"
        traceback.print_exc()
    if given.output is not None and bench.rows:
        given.output.mkdir(parents=True, exist_ok=True)
        common = {"device": device.description, "copy_gb_s": round((bandwidth or 0) / 1e9, 1)}
        lines = [common | asdict(row) | {"version": fc.__version__, "note": given.note} for row in bench.rows]
        content = common | {
            "version": fc.__version__, "note": given.note, "fault": fault,
            "model": " ".join(str(model_bytes.__doc__).split()), "searches": [asdict(row) for row in bench.rows],
        }  # fmt: skip
        write_table(given.output, "search_gpu", lines, content)
    print(f"{time.perf_counter() - started:.0f} s", flush=True)
    return 1 if fault else 0


if __name__ == "__main__":
    sys.exit(main())
