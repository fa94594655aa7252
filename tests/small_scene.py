"""A small scene for the tests of scenes, and where those of this project are."""

from pathlib import Path

import pytest
from fastcollide.errors import SceneError
from fastcollide.scene import load_scene

SCENES = Path(__file__).parent.parent / "scenes"
SMALL = """
[world]
bounds = [[-2, -2, 0], [2, 2, 3]]

[[spheres]]
kind = "random"
count = 80

[run]
frames = 20
device = "cpu"
threads = 1

[output]
make_video = false
export_every = 0
"""


def load(text=SMALL, *overrides):
    path = Path("small.toml")
    path.write_text(text, encoding="utf-8")
    return load_scene(path, overrides)


def messages(text, *overrides):
    with pytest.raises(SceneError) as error:
        load(text, *overrides).create_world()
    return list(error.value.messages)
