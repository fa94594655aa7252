"""Draws the picture of docs/tutorial.md: the page's own scene at three times, side by side.

python tools/draw_tutorial.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import fastcollide as fc
import numpy as np
from doc_examples import DOCS, examples
from fastcollide.scene import load_scene
from PIL import Image

FRAMES = (24, 97, 240)  # on its way up, at the impact, at rest
WIDTH, HEIGHT = 440, 520  # pixels, of each


def main() -> None:
    (text,) = (example.text for example in examples("tutorial.md") if example.file)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crater.toml"
        path.write_text(text, encoding="utf-8")
        scene = load_scene(path)
    world = scene.create_world()
    renderer = fc.Renderer(world.bounds, WIDTH, HEIGHT, camera="front", color_range=(0, 6), has_color_bar=False)
    pictures = []
    for frame in FRAMES:
        world.step(frame - world.frame, 1 / scene.settings.fps)
        speed = np.linalg.norm(fc.to_numpy(world.velocities), axis=1)
        pictures.append(renderer.draw(fc.to_numpy(world.positions), fc.to_numpy(world.radii), speed))
    path = DOCS / "pictures" / "tutorial.png"
    Image.fromarray(np.concatenate(pictures, axis=1)).save(path, optimize=True)
    print(path, f"{path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
