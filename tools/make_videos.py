"""Makes a video of each scene, small by default.

    python tools/make_videos.py --output videos

Scenes with more spheres than --most are left out and named: a CPU would take hours.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import click
import fastcollide as fc
from fastcollide import cli
from fastcollide.scene import load_scene

SCENES = Path(__file__).parent.parent / "scenes"


def has_gpu() -> bool:
    return any(device.name != "cpu" for device in fc.devices())


@click.command()
@click.option("--output", type=click.Path(file_okay=False, path_type=Path), default="videos", show_default=True)
@click.option("--width", default=640, show_default=True)
@click.option("--height", default=360, show_default=True)
@click.option("--camera", help="In place of the scene's own.")
@click.option("--most", type=int, help="Spheres in a scene.  [default: 20,000 on a CPU, no limit on a GPU]")
@click.option("--scenes", type=click.Path(exists=True, file_okay=False, path_type=Path), default=SCENES, help="Folder.")
def main(output: Path, width: int, height: int, camera: str | None, most: int | None, scenes: Path) -> None:
    """Make a video of each scene."""
    if most is None:
        most = sys.maxsize if has_gpu() else 20_000
    counts = {path: count_spheres(path) for path in sorted(scenes.glob("*.toml"))}
    chosen = [path for path, count in counts.items() if count <= most]
    for path in counts.keys() - set(chosen):
        print(f"left out: {path.name}, {counts[path]:,} spheres; --most {counts[path]} takes it in")
    started = time.perf_counter()
    work = [counts[path] * load_scene(path).settings.frames for path in chosen]
    failed = []
    for i, path in enumerate(chosen):
        done, seconds = sum(work[:i]), time.perf_counter() - started
        left = f", about {seconds / done * (sum(work) - done):,.0f} s left" if done else ""
        print(f"\n{i + 1} of {len(chosen)}: {path.name}{left}", flush=True)
        words = ["run", str(path), "--output", str(output / path.stem), "--video", str(output / f"{path.stem}.mp4")]
        words += ["--width", str(width), "--height", str(height), "--no-frame-files"]
        if cli.main(words + (["--camera", camera] if camera else [])) != 0:
            failed.append(path.name)
    if failed:
        sys.exit(f"not as expected: {', '.join(failed)}")
    print(f"\n{len(chosen)} videos in {os.path.abspath(output)}")


def count_spheres(path: Path) -> int:
    tables = load_scene(path).file.spheres
    return sum(table.count if hasattr(table, "count") else len(table.position) for table in tables)


if __name__ == "__main__":
    main()
