"""What all tests share: the devices that they run on, and the folder that their common modules are found in."""

import signal
import sys
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import settings

# Test files are imported by path; what several of them need (the oracle, the golden scenes) is imported from here.
sys.path.insert(0, str(Path(__file__).parent))

# What a shell without job control runs in the background ignores Ctrl-C, and so would all that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
settings.load_profile("repeatable")

no_gpu = pytest.mark.skipif(len(fc.devices()) == 1, reason="no GPU that this build can use")


@pytest.fixture(scope="session", params=["cpu", pytest.param("cuda", marks=no_gpu)])
def device(request):
    """Each test that asks for it runs once on each backend."""
    return request.param


@pytest.fixture(scope="session", params=[pytest.param("cuda", marks=no_gpu)])
def gpu(request):
    """For tests of what only a GPU has."""
    return request.param


@pytest.fixture(scope="session", params=["substep", "reference"])
def solver(request):
    """Each test that asks for it runs once with each solver."""
    return request.param


@pytest.fixture(scope="session")
def write():
    """write(array, values): values into an array of a world, wherever it lies."""

    def write_values(array, values):
        if isinstance(array, np.ndarray):
            array[...] = values
        else:
            cupy = pytest.importorskip("cupy")
            cupy.asarray(array)[...] = cupy.asarray(values, dtype=cupy.float32)

    return write_values
