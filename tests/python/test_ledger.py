"""The ledger: its columns, its rows, that its numbers come back unchanged and that a killed run leaves it readable."""

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli
from fastcollide.ledger import COLUMNS
from fastcollide.run import create_world, simulate
from fastcollide.settings import RunSettings

SMALL = RunSettings(particles=60, frames=30, bounds=(-2, -2, 0, 2, 2, 3), make_video=False, export_every=0, threads=1)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rough_world(device="cpu"):
    """A world in which no column is zero."""
    world = fc.World(((0, 0, 0), (3, 3, 3)), gravity=(1.0, 0.0, -9.8), wall_friction=0.3, device=device)
    world.add(fc.random_spheres(300, bounds=world.bounds, friction=0.4))
    return world


def ledger_of(world, path):
    with fc.LedgerWriter(path) as ledger:
        for _ in range(8):
            ledger.add(world)
            world.step(5)
    return path.read_bytes()


def test_every_number_is_that_of_the_world_to_the_last_bit(folder, device):
    world = rough_world(device)
    rows = []
    with fc.LedgerWriter(folder / "ledger.csv") as ledger:
        for _ in range(5):
            world.step(4)
            ledger.add(world)
            energy = world.energy()
            rows.append(
                [world.frame, world.time, *energy, energy.kinetic + energy.rotational + energy.potential]
                + [*world.momentum(), *world.angular_momentum(), world.contact_count()]
                + [world.max_overlap(), world.mean_overlap()]
            )
    read = fc.read_ledger(folder)

    assert list(read) == [column.name for column in COLUMNS]
    for column, expected in zip(COLUMNS, np.transpose(rows), strict=True):
        assert read[column.name].dtype == column.dtype
        assert read[column.name].tolist() == expected.tolist(), column.name
        assert np.unique(read[column.name]).size > 1, column.name


def test_two_devices_and_any_number_of_threads_write_the_same_bytes(folder, device):
    one = ledger_of(rough_world(device), folder / "one.csv")
    world = fc.World(((0, 0, 0), (3, 3, 3)), gravity=(1.0, 0.0, -9.8), wall_friction=0.3, device="cpu", threads=1)
    world.add(fc.random_spheres(300, bounds=world.bounds, friction=0.4))

    assert ledger_of(world, folder / "other.csv") == one


def test_pandas_and_polars_read_it_as_it_is(folder):
    pandas = pytest.importorskip("pandas")
    polars = pytest.importorskip("polars")
    ledger_of(rough_world(), folder / "ledger.csv")
    ours = fc.read_ledger(folder)

    for theirs in (pandas.read_csv("ledger.csv"), polars.read_csv("ledger.csv")):
        for name, values in ours.items():
            assert theirs[name].to_numpy().dtype == values.dtype
            assert theirs[name].to_numpy().tolist() == values.tolist()
    assert pandas.DataFrame(ours).shape == (8, len(COLUMNS))


@pytest.mark.parametrize(
    ("frames", "every", "interval"),
    [(12, None, 1), (59, None, 1), (60, None, 2), (240, None, 8), (600, None, 10), (6000, None, 10)]
    + [(6001, None, 11), (600_000, None, 1000), (600, 7, 7), (600, 0, 0)],
)
def test_how_often_a_row_is_due(frames, every, interval):
    settings = RunSettings(frames=frames, ledger_every=every)

    assert settings.ledger_interval == interval
    if interval:
        due = [frame for frame in range(frames + 1) if settings.is_ledger_due(frame)]
        assert due == sorted({*range(0, frames + 1, interval), frames})
        assert every or min(30, frames) <= len(due) - 1 <= 601


def test_a_run_measures_the_start_each_interval_and_the_end():
    settings = replace(SMALL, ledger_every=8)
    world = create_world(settings)
    start = world.energy()

    summary = simulate(world, settings)

    read = fc.read_ledger("output")
    assert read["frame"].tolist() == [0, 8, 16, 24, 30]
    assert summary.ledger_rows == 5
    assert (read["kinetic_J"][0], read["potential_J"][0]) == (start.kinetic, start.potential)
    assert read["total_J"][-1] == summary.energy.total
    assert read["contacts"][-1] == summary.contacts
    assert read["max_overlap_m"][-1] == summary.max_overlap
    assert read["mean_overlap"][-1] == summary.mean_overlap


def test_measuring_changes_no_state():
    hashes = {simulate(create_world(s), s).state_hash for s in (replace(SMALL, ledger_every=k) for k in (0, 1, 7))}

    assert len(hashes) == 1


def test_none_is_written_where_none_is_asked_for(folder):
    simulate(create_world(SMALL), replace(SMALL, ledger_every=0))

    assert list(folder.iterdir()) == []


def test_a_run_stopped_early_ends_with_its_last_state():
    settings = replace(SMALL, ledger_every=20)

    def press(frame):
        if frame == 20 + 3:
            signal.raise_signal(signal.SIGINT)

    settings = replace(settings, export_every=1)  # so that every frame ends a piece of work
    summary = simulate(create_world(settings), settings, on_frame=press)

    read = fc.read_ledger("output")
    assert read["frame"].tolist() == [0, 20, 23]
    assert read["total_J"][-1] == summary.energy.total


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_run_leaves_what_it_has_measured(folder):
    command = [sys.executable, "-m", "fastcollide.cli", "run", "--particles", "30", "--frames", "10000000"]
    process = subprocess.Popen([*command, "--no-video", "--export-every", "0", "--ledger-every", "1"])
    try:
        deadline = time.monotonic() + 30
        ledger = folder / "output" / "ledger.csv"
        while not ledger.exists() or ledger.stat().st_size < 3000:
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.kill()
        process.wait()

    frames = fc.read_ledger(folder / "output")["frame"]
    assert len(frames) > 5
    assert frames.tolist() == list(range(len(frames)))


def test_each_row_is_in_the_file_at_once(folder):
    world = rough_world()
    with fc.LedgerWriter("ledger.csv") as ledger:
        for rows in range(1, 4):
            ledger.add(world)
            assert len(fc.read_ledger("ledger.csv")["frame"]) == ledger.rows == rows


def test_a_last_line_without_its_end_is_left_out(folder):
    whole = ledger_of(rough_world(), folder / "ledger.csv")
    for cut in (1, 5, 60):
        (folder / "ledger.csv").write_bytes(whole[:-cut])
        assert len(fc.read_ledger(folder)["frame"]) == 7


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "found '' in the first line; a ledger starts with 'frame,time_s,"),
        (b"time,energy\n1,2\n", "found 'time,energy' in the first line"),
        (b"\xff\xfe\n", "in the first line"),
    ],
)
def test_what_is_no_ledger_is_refused_by_name(folder, content, message):
    (folder / "ledger.csv").write_bytes(content)

    with pytest.raises(fc.LedgerError, match=r"ledger\.csv: ") as error:
        fc.read_ledger(folder / "ledger.csv")
    assert message in str(error.value)


@pytest.mark.parametrize(
    "change", [lambda row: row + b",1", lambda row: row[: row.rindex(b",")], lambda row: b"x" + row]
)
def test_a_row_that_is_none_is_refused_by_its_line(folder, change):
    lines = ledger_of(rough_world(), folder / "ledger.csv").split(b"\n")
    lines[3] = change(lines[3])
    (folder / "ledger.csv").write_bytes(b"\n".join(lines))

    with pytest.raises(fc.LedgerError, match="in line 4; expected 15 numbers"):
        fc.read_ledger(folder)


def test_a_file_of_that_name_that_no_run_has_written_stays(folder, capfd):
    (folder / "output").mkdir()
    (folder / "output" / "ledger.csv").write_text("rent,400\n")

    code = cli.main(["run", "--particles", "30", "--frames", "4", "--no-video"])

    output, errors = capfd.readouterr()
    assert (code, output) == (1, "")
    assert "ledger.csv: found a file that is no ledger" in errors
    assert (folder / "output" / "ledger.csv").read_text() == "rent,400\n"
    assert os.listdir(folder / "output") == ["ledger.csv"]


def test_the_writer_replaces_no_other_file(folder):
    (folder / "mine.csv").write_text("rent,400\n")

    with pytest.raises(fc.LedgerError, match=r"mine\.csv: found a file that is no ledger"):
        fc.LedgerWriter("mine.csv")
    assert (folder / "mine.csv").read_text() == "rent,400\n"


def test_a_ledger_of_an_earlier_run_is_replaced(folder):
    simulate(create_world(SMALL), replace(SMALL, ledger_every=1))
    simulate(create_world(SMALL), replace(SMALL, ledger_every=10))

    assert len(fc.read_ledger("output")["frame"]) == 4


def test_the_summary_tells_rows_and_cost(folder, capfd):
    code = cli.main(["run", "--particles", "30", "--frames", "20", "--no-video", "--ledger-every", "5"])

    assert code == 0
    (line,) = [line for line in io.StringIO(capfd.readouterr().out) if line.startswith("ledger")]
    assert f"5 rows in {folder / 'output' / 'ledger.csv'}, " in line
    assert line.endswith(" % of the time\n")


def test_the_documentation_has_the_columns():
    text = (Path(__file__).parent.parent.parent / "docs" / "ledger.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| `")]

    assert rows == [f"| `{column.name}` | {column.dtype.__name__} | {column.meaning} |" for column in COLUMNS]
