"""docs/physics.md shows tables that compare_solvers.py and many_piles.py make of their committed figures."""

import csv
import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent


RESULTS = ROOT / "benchmarks" / "results"


def benchmark(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def page():
    return (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")


def test_the_table_of_solvers(page):
    compare_solvers = benchmark("compare_solvers")
    results = RESULTS / "amd-epyc-2-threads" / "compare_solvers.json"
    found = json.loads(results.read_text(encoding="utf-8"))
    assert list(found["schemes"]) == list(compare_solvers.SCHEMES)
    assert compare_solvers.table(found["schemes"]) in page


def test_the_table_of_piles(page):
    with (RESULTS / "nvidia-h100" / "many_piles.csv").open(newline="") as file:
        assert benchmark("many_piles").table(list(csv.DictReader(file))) in page
