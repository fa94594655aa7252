"""Kills a run with SIGKILL at random moments and resumes it each time: what comes out is what an undisturbed run gives.

    python tools/kill_and_resume.py --kills 50

After each kill, every frame that is there, in frame files and trajectories, must be whole and to the last bit that of
the undisturbed run; at the end so must be all frames, the ledger, also as Parquet, and the state hash. A run that ends
before as many kills have hit it is compared, and another one begun.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import click
import fastcollide as fc
from fastcollide.checkpoints import checkpoint_paths
from fastcollide.frames import frame_paths

PROGRAM = (sys.executable, "-m", "fastcollide.cli")


def trajectories() -> list[str]:
    """A trajectory of each format whose library is installed."""
    return [f"run.{ending}" for ending, module in (("gsd", "gsd"), ("vtkhdf", "h5py")) if find_spec(module)]


def parquet() -> list[str]:
    return ["ledger.parquet"] if find_spec("pyarrow") else []


class Mismatch(Exception):
    """Something is not as in the undisturbed run."""


def hash_in(output: str) -> str:
    found = re.search(r"^state hash +([0-9a-f]{16})$", output, re.MULTILINE)
    if not found:
        raise Mismatch(f"found no state hash in:\n{output}")
    return found[1]


def run_to_end(arguments: list[str]) -> str:
    done = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Mismatch(f"exit code {done.returncode} of {' '.join(arguments)}:\n{done.stdout}{done.stderr}")
    return done.stdout


def is_killed(arguments: list[str], after: float) -> bool:
    """Starts the program and kills it after this time [s]; False where it had ended before."""
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen([*PROGRAM, *arguments], stdout=output, stderr=subprocess.STDOUT, text=True)
        try:
            code = process.wait(timeout=after)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return True
        output.seek(0)
        if code != 0:
            raise Mismatch(f"exit code {code} of {' '.join(arguments)}:\n{output.read()}")
        return False


def compare_frames(folder: Path, expected: Path) -> None:
    for path in frame_paths(folder):
        if path.read_bytes() != (expected / path.name).read_bytes():
            raise Mismatch(f"{path.name} differs")
    for name in trajectories():
        if (folder / name).exists():
            with fc.open(folder / name) as found, fc.open(expected / name) as wanted:
                if len(found) > len(wanted):
                    raise Mismatch(f"{name}: found {len(found)} frames, expected {len(wanted)}")
                for i, (one, other) in enumerate(zip(found, wanted, strict=False)):
                    if bits_of(one) != bits_of(other):
                        raise Mismatch(f"{name}: frame {i} differs")


def bits_of(frame: fc.Frame) -> tuple[object, ...]:
    arrays = (frame.positions, frame.radii, frame.velocities, frame.spins)
    return frame.frame, frame.time, *(None if array is None else array.tobytes() for array in arrays)


def compare_all(folder: Path, expected: Path) -> None:
    compare_frames(folder, expected)
    names, wanted = ([path.name for path in frame_paths(each)] for each in (folder, expected))
    if names != wanted:
        raise Mismatch(f"found {len(names)} frame files, expected {len(wanted)}")
    for name in trajectories():
        with fc.open(folder / name) as found, fc.open(expected / name) as whole:
            if len(found) != len(whole) or len(whole) != len(wanted):
                raise Mismatch(f"{name}: found {len(found)} frames, expected {len(wanted)}")
    for name in parquet():
        if (folder / name).read_bytes() != (expected / name).read_bytes():
            raise Mismatch(f"{name} differs")
    if (folder / "ledger.csv").read_bytes() != (expected / "ledger.csv").read_bytes():
        raise Mismatch("ledger.csv differs")
    if unfinished := [*folder.glob("*.part")]:
        raise Mismatch(f"found {unfinished[0].name}")


@click.command()
@click.option("--kills", default=50, show_default=True, help="How many.")
@click.option("--particles", default=2000, show_default=True)
@click.option("--frames", default=1500, show_default=True)
@click.option("--every", default=20, show_default=True, help="Frames from one checkpoint to the next.")
@click.option("--solver", default="substep", show_default=True)
@click.option("--device", default="cpu", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the moments.")
def main(kills: int, particles: int, frames: int, every: int, solver: str, device: str, seed: int) -> None:
    """Kill a run at random moments and resume it."""
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        expected, folder = Path(name) / "expected", Path(name) / "killed"
        scene = ["run", "--no-video", "--particles", str(particles), "--frames", str(frames), "--friction"]
        scene += ["0.3" if solver == "substep" else "0", "--solver", solver, "--export-every", "5", "--device", device]
        if parquet():
            scene.append("--parquet")

        def files_in(output: Path) -> list[str]:
            paths = [word for name in trajectories() for word in ("--trajectory", str(output / name))]
            return [*paths, "--output", str(output)]

        run = [*scene, "--checkpoint-every", str(every), *files_in(folder)]
        wanted = hash_in(run_to_end([*scene, *files_in(expected)]))
        started = time.perf_counter()
        run_to_end(["--version"])
        start_seconds = time.perf_counter() - started

        hits = runs = advances = 0
        while hits < kills:
            shutil.rmtree(folder, ignore_errors=True)
            runs += 1
            is_running = True
            while is_running and hits < kills:
                # A run that was killed before its first checkpoint begins anew.
                before = set(checkpoint_paths(folder)) if folder.is_dir() else set()
                threads = ["--threads", str(moments.choice((1, 2)))]
                command = ["resume", str(folder)] if before else run
                is_running = is_killed([*command, *threads], moments.uniform(0, 4 * start_seconds + 0.5))
                hits += is_running
                if folder.is_dir():
                    compare_frames(folder, expected)
                    advances += is_running and bool(set(checkpoint_paths(folder)) - before)
            found = hash_in(
                run_to_end(["resume", str(folder)] if folder.is_dir() and checkpoint_paths(folder) else run)
            )
            compare_all(folder, expected)
            if found != wanted:
                raise Mismatch(f"state hash {found}, expected {wanted}")
        count = len(frame_paths(expected))
    print(f"{hits} kills, {advances} of them after new checkpoints; {runs} runs in all, each like the undisturbed one:")
    print(f"{count} frame files and the ledger byte for byte, state hash {wanted}")
    print(f"as well: {', '.join([*trajectories(), *parquet()]) or 'nothing, as no library for more is installed'}")


if __name__ == "__main__":
    main()
