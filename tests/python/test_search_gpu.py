"""benchmarks/search_gpu.py, in what needs no GPU: rows of measured, failed and late searches, and its comparison."""

import sys
import time
from pathlib import Path
from types import SimpleNamespace

import fastcollide as fc
import numpy as np
import pytest

CASE = (1000, 1)


class NoMemory(MemoryError):
    pass


class FakeCupy:
    """As much of CuPy as a measurement asks for."""

    def __init__(self):
        device = SimpleNamespace(synchronize=lambda: None)
        self.cuda = SimpleNamespace(
            Device=lambda: device,
            memory=SimpleNamespace(OutOfMemoryError=NoMemory),
            runtime=SimpleNamespace(memGetInfo=lambda: (10**9, 10**10)),
        )

    def get_default_memory_pool(self):
        return SimpleNamespace(free_all_blocks=lambda: None)


@pytest.fixture(scope="module")
def search_gpu():
    folder = str(Path(__file__).parent.parent.parent / "benchmarks")
    sys.path.insert(0, folder)
    try:
        import search_gpu
    finally:
        sys.path.remove(folder)
    return search_gpu


@pytest.fixture
def bench(search_gpu):
    return search_gpu.Bench(FakeCupy(), repeats=3, deadline=time.perf_counter() + 60, bandwidth=1e12)


def pairs(*entries):
    first, second = np.array(entries, np.int32).reshape(-1, 2).T
    return fc.Pairs(first, second)


def test_a_measured_search(search_gpu, bench):
    calls = []

    def search():
        calls.append(time.sleep(0.002))  # so long that the rounding of the figures is far below them
        return pairs((0, 1), (2, 3))

    row, answer = bench.measure("ours", "pairs", CASE, lambda: search)
    assert len(calls) == 4  # one warms up
    assert (row.entries, len(answer), row.remark) == (2, 2, "")
    assert 0 < row.ms_fastest <= row.ms <= row.ms_slowest
    assert row.model_bytes == 1000 * (12 + 32 + 8) + 2 * 8
    assert row.roof_share == pytest.approx(row.model_bytes / (1e-3 * row.ms) / 1e12, abs=1e-4)
    assert search_gpu.model_bytes("neighbors", 10, 7, True) == 10 * (16 + 40 + 8) + 7 * 4 + 11 * 8
    other, _ = bench.measure("theirs", "pairs", CASE, lambda: search, row)
    assert other.times_fastcollide == pytest.approx(other.ms / row.ms, abs=0.01)


@pytest.mark.parametrize(
    "error", [NoMemory("all is used"), fc.OutOfMemory("all is used"), RuntimeError("out of memory")]
)
def test_a_size_that_does_not_fit_is_said_and_the_next_one_measured(bench, capsys, error):
    def fail():
        raise error

    row, answer = bench.measure("ours", "pairs", CASE, lambda: fail)
    assert (row.ms, row.entries, answer) == (None, None, None)
    assert "out of memory" in row.remark
    assert "left out: out of memory" in capsys.readouterr().out
    assert bench.measure("ours", "pairs", CASE, lambda: pairs)[0].ms > 0


def test_what_would_begin_too_late_is_left_out(search_gpu):
    late = search_gpu.Bench(FakeCupy(), repeats=3, deadline=time.perf_counter() - 1, bandwidth=None)
    row, answer = late.measure("ours", "pairs", CASE, lambda: pytest.fail)
    assert (row.remark, answer) == ("left out: the time was over", None)


def test_other_answers_are_a_failure(search_gpu):
    ours = pairs((0, 1), (2, 3))
    search_gpu.check_same(np, CASE, "theirs", ours, pairs((0, 1), (2, 3)))
    search_gpu.check_same(np, CASE, "theirs", ours, None)
    with pytest.raises(search_gpu.DifferentAnswers, match="found 1; expected: 2"):
        search_gpu.check_same(np, CASE, "theirs", ours, pairs((0, 1)))
    with pytest.raises(search_gpu.DifferentAnswers, match="second differ"):
        search_gpu.check_same(np, CASE, "theirs", ours, pairs((0, 1), (2, 4)))


def test_cases(search_gpu):
    assert search_gpu.cases_of("1000000,1000000:8") == [(1_000_000, 1), (1_000_000, 8)]
