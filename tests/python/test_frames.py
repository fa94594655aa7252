"""Frame files: what is written comes back, and what is not whole is refused."""

import os

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.frames import FrameError, frame_path, frame_paths, read_frame, remove_frames, write_frame


@pytest.fixture
def written(tmp_path):
    path = frame_path(tmp_path, 2)
    write_frame(path, 2, 1 / 30, [[0.5, -1.25, 3.0], [1 / 3, 2e-30, -1e8]], [0.25, 0.1])
    return path


def test_every_bit_comes_back(tmp_path):
    random = np.random.default_rng(3)
    positions = (random.uniform(-1, 1, (2000, 3)) * 10.0 ** random.integers(-30, 8, (2000, 3))).astype(np.float32)
    radii = random.uniform(0.05, 0.4, 2000).astype(np.float32)

    write_frame(tmp_path / "frame.txt", 7, 7 / 60, positions, radii)
    frame = read_frame(tmp_path / "frame.txt")

    assert frame.frame == 7
    assert frame.time == pytest.approx(7 / 60, rel=1e-9)
    assert frame.positions.dtype == frame.radii.dtype == np.float32
    assert frame.positions.tobytes() == positions.tobytes()
    assert frame.radii.tobytes() == radii.tobytes()


def test_the_text_is_as_documented(written):
    lines = written.read_text().splitlines()

    assert lines[0] == "# FastCollide frame, format 1"
    assert lines[1] == "# frame: 2"
    assert lines[2].startswith("# time: 0.0333333")
    assert lines[2].endswith(" s")
    assert lines[3] == "# count: 2"
    assert lines[4] == "# columns: id x[m] y[m] z[m] radius[m]"
    assert lines[5] == "0 0.5 -1.25 3 0.25"
    assert len(lines) == 7


def test_a_frame_of_no_sphere(tmp_path):
    write_frame(tmp_path / "frame.txt", 1, 0.5, np.empty((0, 3)), np.empty(0))

    assert read_frame(tmp_path / "frame.txt").positions.shape == (0, 3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("# FastCollide frame", "# Something", "no frame file"),
        ("# time: ", "# when: ", "expected '# time: '"),
        ("# count: 2", "# count: many", "expected '# count: '"),
        ("# count: 2", "# count: 3", "found 2 whole lines of spheres; the header says 3"),
        ("\n1 ", "\n2 ", "ids out of order"),
        (" 3 0.25", " 3", "id, x, y, z, radius"),
        (" 3 0.25", " three 0.25", "id, x, y, z, radius"),
    ],
)
def test_a_damaged_file_is_refused(written, old, new, message):
    text = written.read_text()
    assert text.count(old) == 1
    written.write_text(text.replace(old, new))

    with pytest.raises(FrameError, match=r"frame_00000002\.txt") as caught:
        read_frame(written)

    assert message in str(caught.value)


def test_a_file_cut_off_is_refused(written):
    content = written.read_bytes()
    for length in range(len(content) - 1):  # without the last line break alone nothing is lost
        written.write_bytes(content[:length])
        try:
            frame = read_frame(written)
        except FrameError:
            continue
        pytest.fail(f"read {len(frame.radii)} spheres from the first {length} of {len(content)} bytes")


def test_a_failed_write_leaves_nothing_new(written, monkeypatch):
    before = written.read_bytes()

    def refuse(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="No space"):
        write_frame(written, 4, 0.1, [[0, 0, 0]], [1])

    assert [path.name for path in written.parent.iterdir()] == [written.name]
    assert written.read_bytes() == before


def test_names_sort_like_numbers(tmp_path):
    numbers = [9, 10, 99_999, 100_000, 10_000_000]
    for number in reversed(numbers):
        write_frame(frame_path(tmp_path, number), number, 0.0, [[0, 0, 0]], [1])

    assert [read_frame(path).frame for path in frame_paths(tmp_path)] == numbers


def test_only_own_files_are_removed(written):
    other = [written.parent / name for name in ("frame_00000003.txt", "notes.txt", "frame_4.txt")]
    for path in other:
        path.write_text("mine")

    assert remove_frames(written.parent) == 1
    assert sorted(written.parent.iterdir()) == sorted(other)


def test_the_package_offers_both():
    assert fc.write_frame is write_frame
    assert fc.read_frame is read_frame
