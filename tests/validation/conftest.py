"""Options of `pytest tests/validation`, and how a test hands in its figures."""

from pathlib import Path

import pytest
from validation import figures


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="where to simulate: cpu, cuda or cuda:N (default: cpu)")
    parser.addoption(
        "--results", type=Path, default=figures.RESULTS, help="folder for the results (default: %(default)s)"
    )


@pytest.fixture(scope="session")
def device(request):
    """One device: these runs are long, and the engine gives the same bits on each."""
    return request.config.getoption("device")


@pytest.fixture
def publish(request):
    """publish(name, title, figures, curves): writes what was found, then fails for each figure outside its band."""

    def write_and_assert(name, title, found, curves):
        figures.write(request.config.getoption("results") / f"{name}.json", title, found, curves)
        for figure in found:
            print(figure)
        assert [str(figure) for figure in found if not figure.is_good] == []

    return write_and_assert
