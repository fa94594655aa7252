"""Is a GPU's result the CPU's, bit for bit, and is every memory access clean? Run on a machine with a GPU:

    cmake --preset cuda && cmake --build --preset cuda
    python benchmarks/gpu_check.py build/cuda/print_hash RESULTS_FOLDER

Writes gpu_check.csv (a line for each scene and device) and gpu_check.txt (what the sanitizers said); exit code 1 where
two hashes differ or a sanitizer complains.
"""

import csv
import itertools
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Particles, frames; the default solver without and with friction, and with spheres of very different sizes.
SCENES = [
    *itertools.product([(1_000, 600), (20_000, 600), (200_000, 60)], ["reference", "smooth", "rough", "mixed"]),
    *itertools.product([(600_000, 20)], ["reference", "smooth", "rough"]),
    *itertools.product([(40_000, 60), (150_000, 20)], ["packed"]),
]
SANITIZERS = ["memcheck", "racecheck", "initcheck", "synccheck"]
# Particles, frames, solver, method: forms whose lanes share a sphere, and some where each has a lane; of many spheres
# long enough that those that touch nothing are left out of contact passes, or that there are strays; where most touch
# others, the lanes of a warp share the pairs.
SANITIZED = [
    (3_000, 4, "reference", "frame"),
    (3_000, 4, "smooth", "frame"),
    (3_000, 4, "rough", "list"),
    (3_000, 4, "rough", "frame"),
    (3_000, 4, "mixed", "levels"),
    (1_000, 4, "reference", "small"),
    (1_000, 4, "smooth", "small"),
    (150_000, 32, "reference", "frame"),
    (150_000, 32, "smooth", "frame"),
    (420_000, 16, "rough", "frame"),
    (40_000, 6, "packed", "frame"),
    (150_000, 4, "packed", "frame"),
]
AT_ONCE = 6  # sanitizers, which keep a core of the host busy each


def run_scene(
    program: str,
    particles: int,
    frames: int,
    device: str,
    solver: str,
    block_size: int = 128,
    method: str = "list",
) -> dict[str, object]:
    started = time.perf_counter()
    command = [program, str(particles), str(frames), device, "0", str(block_size), solver, method]
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    return {
        "particles": particles,
        "frames": frames,
        "solver": solver,
        "method": method,
        "device": device,
        "block_size": block_size if device != "cpu" else "",
        "start_hash": re.search(r"start (\w+)", output)[1],
        "picture_hash": re.search(r"picture (\w+)", output)[1],
        "end_hash": re.search(r"end (\w+)", output)[1],
        "measured": re.search(r"end \w+ (.*)", output)[1],
        "seconds_with_start_up": round(time.perf_counter() - started, 2),
    }


def compare(program: str) -> tuple[list[dict[str, object]], bool]:
    rows, same = [], True
    for (particles, frames), solver in SCENES:
        expected = run_scene(
            program, particles, frames, "cpu", solver, method="levels" if solver == "mixed" else "list"
        )
        rows.append(expected)
        # The size of a block is that of the plain form.
        ways = [("list", 128), ("frame", 128), ("levels", 128), ("cells", 32), ("cells", 128), ("cells", 512)]
        if solver == "mixed":
            ways = [("levels", 128), ("cells", 128)]  # lists would take minutes
        if particles <= 1_500 and solver != "rough":
            ways.append(("small", 128))
        for method, block_size in ways:
            found = run_scene(program, particles, frames, "cuda", solver, block_size, method)
            rows.append(found)
            same &= all(found[key] == expected[key] for key in ("start_hash", "picture_hash", "end_hash", "measured"))
        print(particles, solver, "same" if same else "DIFFERENT", flush=True)
    return rows, same


def sanitize_scene(program: str, tool: str, scene: tuple[int, int, str, str]) -> tuple[str, bool]:
    particles, frames, solver, method = scene
    options = [str(particles), str(frames), "cuda", "0", "128", solver, method]
    command = ["compute-sanitizer", "--tool", tool, "--error-exitcode", "9", program, *options]
    started = time.perf_counter()
    result = subprocess.run(command, capture_output=True, text=True)
    seconds = round(time.perf_counter() - started)
    print(tool, *options, result.returncode, result.stdout.strip().splitlines()[-1:], f"{seconds} s", flush=True)
    title = f"== {tool}: {' '.join(options)}: exit code {result.returncode}\n"
    return f"{title}{result.stdout}{result.stderr}\n", result.returncode == 0


def sanitize(program: str) -> tuple[str, bool]:
    # The longest first, so that none is left alone at the end.
    runs = sorted(itertools.product(SANITIZERS, SANITIZED), key=lambda run: run[1][0] * run[1][1], reverse=True)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        reports, are_clean = zip(*pool.map(lambda run: sanitize_scene(program, *run), runs), strict=True)
    return "".join(reports), all(are_clean)


def main() -> int:
    program, folder = sys.argv[1], Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    rows, same = compare(program)
    with (folder / "gpu_check.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    report, clean = sanitize(program)
    (folder / "gpu_check.txt").write_text(report)
    print("same bits" if same else "DIFFERENT BITS", "clean" if clean else "NOT CLEAN", sep=", ")
    return 0 if same and clean else 1


if __name__ == "__main__":
    sys.exit(main())
