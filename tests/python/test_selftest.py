"""`fastcollide selftest` passes here, and fails where the mechanics are wrong."""

import fastcollide as fc
import pytest
from fastcollide import cli, selftest
from fastcollide.selftest import Check, run_checks


def test_every_figure_is_within_its_limit(device):
    checks = list(run_checks(device))
    assert len(checks) > 15
    assert [check for check in checks if not check.is_good] == []


def test_the_program_prints_a_row_for_each_figure(capfd):
    assert cli.main(["selftest", "--device", "cpu"]) == 0
    output = capfd.readouterr().out
    assert output.count(" ok ") == len(list(run_checks("cpu")))


@pytest.mark.parametrize("found", [1.02, float("nan")])
def test_one_figure_off_is_a_failure(capfd, monkeypatch, found):
    checks = [Check("good", "x", 1.0, 1.005, 0.01), Check("bad", "x", 1.0, found, 0.01)]
    monkeypatch.setattr(selftest, "run_checks", lambda device, threads: iter(checks))
    assert cli.main(["selftest", "--device", "cpu"]) == 1
    streams = capfd.readouterr()
    assert streams.out.count(" ok ") == 1
    assert streams.out.count(" FAILED ") == 1
    assert streams.err.startswith("fastcollide: 1 of the figures")


def test_wrong_gravity_is_seen(monkeypatch):
    class Moon(fc.World):
        def __init__(self, *, gravity, **options):
            super().__init__(gravity=tuple(g / 6 for g in gravity), **options)

    monkeypatch.setattr(fc, "World", Moon)
    bad = {check.case for check in run_checks("cpu") if not check.is_good}
    assert {"free fall, 2 s", "rolling down 15°"} <= bad
