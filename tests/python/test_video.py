"""Videos are checked by decoding them: number of pictures, rate, size, and that they show what went in."""

import itertools
import subprocess
import sys
from contextlib import suppress

import fastcollide as fc
import numpy as np
import pytest
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
