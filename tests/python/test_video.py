"""Videos are checked by decoding them: number of pictures, rate, size, and that they show what went in."""

import itertools
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli
from fastcollide.frames import FrameError, frame_path, write_frame
from fastcollide.render_frames import render_folder
from fastcollide.video import VideoError, VideoWriter, write_still
from PIL import Image

av = pytest.importorskip("av", reason="the extra [video] is not installed")


def decode(path):
    """All pictures (RGB), and the video stream's rate."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)], stream.average_rate


def plain(width, height, color):
    return np.full((height, width, 3), color, np.uint8)


@pytest.mark.parametrize(("width", "height", "fps"), [(64, 48, 30), (130, 66, 60), (64, 64, 23.976)])
def test_what_goes_in_comes_out(tmp_path, width, height, fps):
    colors = [(230, 40, 40), (40, 200, 60), (50, 60, 220), (240, 240, 245), (20, 20, 20)] * 3
    path = tmp_path / "video.mp4"
    with VideoWriter(path, width, height, fps=fps) as video:
        for color in colors:
            video.add(plain(width, height, color))
    pictures, rate = decode(path)

    assert len(pictures) == len(colors) == video.pictures
    assert float(rate) == pytest.approx(fps, rel=1e-4)
    for picture, color in zip(pictures, colors, strict=True):
        assert picture.shape == (height, width, 3)
        assert np.abs(picture.mean((0, 1)) - color).max() < 4
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]


def test_more_quality_is_closer_to_the_pictures(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (96, 128, 1)).repeat(3, axis=2).astype(np.uint8)

    def error(quality):
        with VideoWriter(tmp_path / "video.mp4", 128, 96, quality=quality) as video:
            video.add(noise)
        return np.abs(decode(tmp_path / "video.mp4")[0][0].astype(int) - noise).mean()

    assert error(100) < error(75) < error(0)


def test_video_can_be_played_while_it_loads(tmp_path):
    with VideoWriter(tmp_path / "video.mp4", 64, 64) as video:
        video.add(plain(64, 64, 100))
    content = (tmp_path / "video.mp4").read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_after_an_error_the_old_file_is_still_there_and_no_other(tmp_path):
    path = tmp_path / "video.mp4"
    path.write_text("old")
    with suppress(ZeroDivisionError), VideoWriter(path, 64, 64) as video:
        video.add(plain(64, 64, 100))
        assert path.read_text() == "old"
        raise ZeroDivisionError
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]
    assert path.read_text() == "old"


def test_a_video_needs_a_picture(tmp_path):
    with pytest.raises(VideoError, match="found no picture"), VideoWriter(tmp_path / "video.mp4", 64, 64):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_error_of_the_encoder_reaches_the_caller(tmp_path, monkeypatch):
    video = VideoWriter(tmp_path / "video.mp4", 64, 64)
    monkeypatch.setattr(video, "_encode", lambda picture: 1 / 0)

    def add_more_than_wait_in_the_queue():
        with video:
            for _ in range(20):
                video.add(plain(64, 64, 100))

    with pytest.raises(VideoError, match="the encoder failed"):
        add_more_than_wait_in_the_queue()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"width": 65}, "width"),
        ({"height": 0}, "height"),
        ({"height": 33}, "height"),
        ({"fps": 0}, "fps"),
        ({"fps": 1000}, "fps"),
        ({"quality": 101}, "quality"),
    ],
)
def test_bad_options_are_named_before_a_file_is_made(tmp_path, changes, field):
    with pytest.raises(fc.InvalidValue, match=r"found .*; allowed: ") as caught:
        VideoWriter(**({"path": tmp_path / "video.mp4", "width": 64, "height": 64} | changes))
    assert caught.value.field == field
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("picture", [plain(64, 62, 0), plain(64, 64, 0).astype(np.float32), plain(64, 64, 0)[..., 0]])
def test_a_picture_that_does_not_fit_is_refused(tmp_path, picture):
    with pytest.raises(fc.InvalidValue, match="picture: found"), VideoWriter(tmp_path / "video.mp4", 64, 64) as video:
        video.add(picture)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "nowhere" / "video.mp4"
    with pytest.raises(FileNotFoundError) as caught:
        VideoWriter(path, 64, 64)
    assert caught.value.filename == str(path)


def test_without_pyav_the_message_says_what_to_install(tmp_path):
    program = (
        "import sys; sys.modules['av'] = None\n"
        "from fastcollide.video import VideoError, VideoWriter\n"
        "try: VideoWriter('video.mp4', 64, 64)\n"
        "except VideoError as error: print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert 'pip install "fastcollide[video]"' in run.stdout
    assert list(tmp_path.iterdir()) == []


def test_still_is_the_picture(tmp_path):
    picture = np.random.default_rng(2).integers(0, 256, (30, 41, 3)).astype(np.uint8)
    write_still(tmp_path / "still.png", picture)

    assert [file.name for file in tmp_path.iterdir()] == ["still.png"]
    assert (np.asarray(Image.open(tmp_path / "still.png")) == picture).all()


def test_a_still_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "still.png").mkdir()
    with pytest.raises(OSError, match=r"still\.png"):
        write_still(tmp_path / "still.png", plain(8, 8, 100))
    assert [path.name for path in tmp_path.iterdir()] == ["still.png"]


# A sphere that rests, and one that falls with 3 m/s through the picture; a picture every 0.05 s.
BOX = ((-2.0, -2.0, 0.0), (2.0, 2.0, 4.0))
SMALL = {"bounds": BOX, "width": 128, "height": 96, "color_range": (0.0, 6.0), "device": "cpu"}


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(1, 13):
        time = 0.05 * number
        write_frame(
            frame_path(folder, 3 * number), 3 * number, time, [[-1, 0, 0.6], [1, 0, 3.2 - 3 * time]], [0.6, 0.7]
        )
    return folder


def test_a_folder_becomes_a_video_in_real_time(folder, tmp_path):
    seen = []
    count = render_folder(
        folder,
        video=tmp_path / "video.mp4",
        still=tmp_path / "still.png",
        quality=100,
        progress=lambda done, total: seen.append((done, total)),
        **SMALL,
    )
    pictures, rate = decode(tmp_path / "video.mp4")

    assert count == len(pictures) == 12
    assert seen == [(done, 12) for done in range(1, 13)]
    assert float(rate) == pytest.approx(20)
    changes = [np.abs(b.astype(int) - a).mean() for a, b in itertools.pairwise(pictures)]
    assert min(changes) > 0.5, "the fall is seen in each picture"
    still = np.asarray(Image.open(tmp_path / "still.png"))
    assert np.abs(still.astype(int) - pictures[-1]).mean() < 4
    # The falling sphere darkens the upper half, then leaves it.
    upper = [picture[:40].mean() for picture in pictures]
    assert upper[0] < upper[-1] - 2


def test_fps_can_be_asked_for(folder, tmp_path):
    render_folder(folder, video=tmp_path / "video.mp4", fps=7, **SMALL)
    pictures, rate = decode(tmp_path / "video.mp4")
    assert len(pictures) == 12
    assert float(rate) == pytest.approx(7)


def drawn_values(folder, monkeypatch, **options):
    """The values that reach the renderer in each picture, and the box."""
    drawn, boxes = [], []
    draw = fc.render.Renderer.draw

    def record(self, positions, radii, values, **more):
        drawn.append(np.array(values))
        boxes.append(self.bounds)
        return draw(self, positions, radii, values, **more)

    monkeypatch.setattr("fastcollide.render.Renderer.draw", record)
    render_folder(folder, video=folder.parent / "video.mp4", **(SMALL | options))
    return np.array(drawn), boxes[0]


def test_speed_comes_from_the_way_between_frames(folder, monkeypatch):
    speeds, _ = drawn_values(folder, monkeypatch)
    assert speeds == pytest.approx(np.tile([0.0, 3.0], (12, 1)), abs=1e-4)


@pytest.mark.parametrize(("color_by", "expected"), [("radius", [0.6, 0.7]), ("id", [0, 1])])
def test_other_values_come_from_the_frame(folder, monkeypatch, color_by, expected):
    values, _ = drawn_values(folder, monkeypatch, color_by=color_by)
    assert values == pytest.approx(np.tile(expected, (12, 1)))


def test_a_sphere_that_joins_later_is_at_rest_first(folder, monkeypatch):
    write_frame(frame_path(folder, 99), 99, 0.65, [[-1, 0, 0.6], [1, 0, 1.4], [0, 0, 3]], [0.6, 0.7, 0.5])
    drawn = []
    monkeypatch.setattr(
        "fastcollide.render.Renderer.draw",
        lambda self, positions, radii, values, **more: drawn.append(values) or plain(128, 96, 100),
    )
    render_folder(folder, video=folder.parent / "video.mp4", **SMALL)
    assert drawn[-1] == pytest.approx([0, (1.4 - 1.4) / 0.05, 0], abs=1e-3)


def test_bounds_are_round_numbers_around_the_spheres(folder, monkeypatch):
    # x −1.6 to 1.7, y −0.7 to 0.7, z 0 to 3.75: to multiples of 0.1.
    _, bounds = drawn_values(folder, monkeypatch, bounds=None)
    assert np.array(bounds) == pytest.approx(np.array([[-1.6, -0.7, 0.0], [1.7, 0.7, 3.8]]), abs=1e-5)


def test_a_folder_without_frames_is_named(tmp_path):
    with pytest.raises(FrameError, match="found no frame file"):
        render_folder(tmp_path, video=tmp_path / "video.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_broken_frame_leaves_no_video(folder, tmp_path):
    frame_path(folder, 18).write_text("nothing")
    with pytest.raises(FrameError, match="frame_00000018"):
        render_folder(folder, video=tmp_path / "video.mp4", **SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]


def test_a_single_frame_becomes_a_still(folder, tmp_path):
    for path in sorted(folder.iterdir())[1:]:
        path.unlink()
    assert render_folder(folder, still=tmp_path / "still.png", **SMALL) == 1
    assert Image.open(tmp_path / "still.png").size == (128, 96)
    assert not (tmp_path / "video.mp4").exists()


# --- Several runs ---


@pytest.fixture
def runs(tmp_path):
    """Two folders: one sphere that rises for 1 s, with 10 frames a second, and one for 0.6 s, with 5."""
    for name, rate, seconds in (("fine", 10, 1.0), ("coarse", 5, 0.6)):
        (tmp_path / name).mkdir()
        for number in range(1, round(rate * seconds) + 1):
            time = number / rate
            write_frame(frame_path(tmp_path / name, number), number, time, [[0, 0, 1 + time]], [0.5])
    return [tmp_path / "fine", tmp_path / "coarse"]


def draws_of(runs, monkeypatch, **options):
    """What reaches the renderers: size, height of the sphere, label and colour range, and the colour bars."""
    drawn = []

    def draw(self, positions, radii, values, title, time):
        drawn.append((self.width, self._has_color_bar, title, time, positions[0][2], self.color_range))
        return plain(self.width, self.height, 100)

    monkeypatch.setattr("fastcollide.render.Renderer.draw", draw)
    video = runs[0].parent / "video.mp4"
    count = render_folder(runs, video=video, width=128, height=96, device="cpu", **options)
    assert len(decode(video)[0]) == count
    assert decode(video)[0][0].shape == (96, 128, 3)
    return drawn, decode(video)[1]


def test_runs_side_by_side_show_equal_times(runs, monkeypatch):
    drawn, rate = draws_of(runs, monkeypatch, labels=["one", "two"])
    assert float(rate) == pytest.approx(10)
    fine = [each for each in drawn if each[2] == "one"]
    coarse = [each for each in drawn if each[2] == "two"]
    assert [round(time, 6) for _, _, _, time, _, _ in fine] == [i / 10 for i in range(1, 11)]
    # Each is drawn once; before the first there is the first, and the last one stays.
    assert [round(time, 6) for _, _, _, time, _, _ in coarse] == [0.2, 0.4, 0.6]
    order = [(title, round(time, 6)) for _, _, title, time, _, _ in drawn]
    assert order.index(("two", 0.4)) == order.index(("one", 0.4)) + 1
    assert {each[:2] for each in fine} == {(64, False)}
    assert {each[:2] for each in coarse} == {(64, True)}
    assert all(height == pytest.approx(1 + time) for _, _, _, time, height, _ in drawn)
    assert len({color_range for *_, color_range in drawn}) == 1


def test_colours_mean_the_same_in_both(runs, monkeypatch):
    for path in sorted(runs[1].iterdir()):
        number = int(path.stem[-8:])
        write_frame(path, number, number / 5, [[0, 0, 1 + 400 * number / 5]], [0.5])
    drawn, _ = draws_of(runs, monkeypatch)
    assert {color_range for *_, color_range in drawn} == {(0.0, 400.0)}


def test_the_program_compares_runs(runs, capsys, monkeypatch):
    monkeypatch.chdir(runs[0].parent)
    small = ["--width", "640", "--height", "200", "--device", "cpu"]
    assert cli.main(["render", "fine", "coarse", "--video", "both.mp4", "--still", "both.png", *small]) == 0
    assert "pictures        10" in capsys.readouterr().out
    both = np.asarray(Image.open("both.png"))
    assert both.shape == (200, 640, 3)
    assert (both[:, 319:321] == [200, 205, 212]).all(), "a line between them"
    assert cli.main(["render", "fine", "coarse", "--label", "one", *small]) == 2
    assert "label: found 1 for 2 runs; allowed: one for each, or none" in capsys.readouterr().err
    assert cli.main(["render", "fine", "nowhere", *small]) == 2


def test_the_box_and_speeds_of_a_run_are_its_own(tmp_path, monkeypatch):
    pytest.importorskip("h5py")
    monkeypatch.chdir(tmp_path)
    run = ["run", "--particles", "30", "--frames", "6", "--bounds", "-3", "-3", "1", "3", "3", "7", "--no-video"]
    assert cli.main([*run, "--output", "run", "--trajectory", "run/run.vtkhdf", "--device", "cpu"]) == 0
    values, bounds = drawn_values(tmp_path / "run", monkeypatch, bounds=None)
    assert bounds == ((-3, -3, 1), (3, 3, 7))
    with fc.open("run") as frames:
        assert values == pytest.approx(np.array([np.linalg.norm(frame.velocities, axis=1) for frame in frames]))


def test_each_scene_gets_its_video(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    tool = Path(__file__).parent.parent.parent / "tools" / "make_videos.py"
    Path("scenes").mkdir()
    for name, count in (("few", 20), ("many", 30_000), ("other", 30)):
        Path(f"scenes/{name}.toml").write_text(
            f'[[spheres]]\nkind = "random"\ncount = {count}\n[run]\nframes = 4\n[expect]\nescaped = {{ max = 0 }}\n'
        )
    command = [sys.executable, tool, "--scenes", "scenes", "--width", "64", "--height", "64", "--most", "20000"]
    assert subprocess.run(command, check=False).returncode == 0
    assert sorted(path.name for path in Path("videos").glob("*.mp4")) == ["few.mp4", "other.mp4"]
    assert len(decode("videos/few.mp4")[0]) == 2
    assert "left out: many.toml, 30,000 spheres" in capfd.readouterr().out
    Path("scenes/few.toml").write_text(Path("scenes/few.toml").read_text().replace("max = 0", "min = 1"))
    failed = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (failed.returncode, failed.stderr.splitlines()[-1]) == (1, "not as expected: few.toml")
