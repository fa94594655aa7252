"""docs/physics.md shows the table that benchmarks/compare_solvers.py makes of its committed figures."""

import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def compare_solvers():
    spec = importlib.util.spec_from_file_location("compare_solvers", ROOT / "benchmarks" / "compare_solvers.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_is_that_of_the_results(compare_solvers):
    results = ROOT / "benchmarks" / "results" / "amd-epyc-2-threads" / "compare_solvers.json"
    found = json.loads(results.read_text(encoding="utf-8"))
    assert list(found["schemes"]) == list(compare_solvers.SCHEMES)
    assert compare_solvers.table(found["schemes"]) in (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
