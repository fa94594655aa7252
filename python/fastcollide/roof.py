"""The roof over a frame: the time in which the memory could move the bytes that a frame cannot do without."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

BUILD_BYTES = 150  # histogram, scan and scatter of 32 bytes of state, for each sphere
STATE_BYTES, SPIN_BYTES = 32, 16  # position, radius, velocity, restitution; spin and friction
ENTRY_BYTES = 4  # of a sphere in a list or a cell
_COPIES = 7


def model_bytes(iterations: int, has_spin: bool) -> int:
    """The least that a frame moves between memory and processor, for each sphere [bytes].

    One grid in a frame, and iterations that each read and write the state once and read one entry for each sphere.
    """
    state = STATE_BYTES + (SPIN_BYTES if has_spin else 0)
    build = BUILD_BYTES + (2 * SPIN_BYTES if has_spin else 0)
    return build + iterations * (2 * state + ENTRY_BYTES)


def copy_bandwidth(device: str, threads: int | None = None, size: int | None = None) -> float | None:
    """Bytes read and written in a second by a plain copy, the fastest of some: by NumPy on CPU threads, by CuPy or
    PyTorch on a GPU. None where neither is installed.

    size: bytes to copy; by default far more than caches hold.
    """
    if device == "cpu":
        return _cpu_bandwidth(threads or os.cpu_count() or 1, size or 1 << 28)
    ordinal = int(device.partition(":")[2] or 0)
    for measure in (_cupy_bandwidth, _torch_bandwidth):
        try:
            return measure(ordinal, size or 1 << 30)
        except ImportError:
            continue
    return None


def _cpu_bandwidth(threads: int, size: int) -> float:
    source, target = np.ones(size, np.uint8), np.zeros(size, np.uint8)
    parts = list(zip(np.array_split(source, threads), np.array_split(target, threads), strict=True))

    with ThreadPoolExecutor(threads) as pool:

        def copy() -> float:
            started = time.perf_counter()
            list(pool.map(lambda part: np.copyto(part[1], part[0]), parts))
            return time.perf_counter() - started

        return _fastest(copy, size)


def _cupy_bandwidth(ordinal: int, size: int) -> float:
    import cupy

    def copy(source: Any, target: Any) -> float:
        start, end = cupy.cuda.Event(), cupy.cuda.Event()
        start.record()
        cupy.copyto(target, source)
        end.record()
        end.synchronize()
        return 1e-3 * float(cupy.cuda.get_elapsed_time(start, end))

    with cupy.cuda.Device(ordinal):
        bandwidth = _fastest(partial(copy, cupy.zeros(size, cupy.uint8), cupy.zeros(size, cupy.uint8)), size)
        cupy.get_default_memory_pool().free_all_blocks()  # the worlds may need it
    return bandwidth


def _torch_bandwidth(ordinal: int, size: int) -> float:
    import torch

    if not torch.cuda.is_available():
        raise ImportError("this PyTorch has no CUDA")

    def copy(source: Any, target: Any) -> float:
        start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        start.record()
        target.copy_(source)
        end.record()
        end.synchronize()
        return 1e-3 * float(start.elapsed_time(end))

    with torch.cuda.device(ordinal):
        like = {"dtype": torch.uint8, "device": "cuda"}
        bandwidth = _fastest(partial(copy, torch.ones(size, **like), torch.zeros(size, **like)), size)
        torch.cuda.empty_cache()  # the worlds may need it
    return bandwidth


def _fastest(copy: Callable[[], float], size: int) -> float:
    return 2 * size / min(copy() for _ in range(_COPIES))
