"""What `limits()` and `info` say of a world's memory is what its process takes."""

import subprocess
import sys
from pathlib import Path

import fastcollide as fc
import pytest

COUNT = 200_000
# Bytes a sphere that a world takes more than nothing, bodies included, in a process of its own.
PROGRAM = """
import resource
import sys
from pathlib import Path

import fastcollide as fc

count, method, friction = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
edge = 20 * (count / 20_000) ** (1 / 3)
bounds = ((-edge / 2, -edge / 2, 0), (edge / 2, edge / 2, edge))
spheres = fc.random_spheres(count, bounds, friction=friction)


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


before = resident()
world = fc.World(bounds, device="cpu", method=method)
world.add(spheres)
world.step(2)
print((resident() - before) / count)
"""


def bytes_per_sphere(method: str, friction: float) -> float:
    command = [sys.executable, "-c", PROGRAM, str(COUNT), method, str(friction)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize("method", ["auto", "frame", "cells"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_world_takes_as_much_as_limits_say(method, friction):
    limits = fc.limits()
    # There is about a cell for each sphere.
    told = limits.bytes_by_cells if method == "cells" else limits.bytes_per_sphere
    told += limits.bytes_for_spin if friction > 0 else 0
    assert bytes_per_sphere(method, friction) == pytest.approx(told + limits.bytes_per_cell, rel=0.15)
