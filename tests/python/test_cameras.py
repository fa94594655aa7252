"""Cameras: one that goes round holds the box all the way; the settings give the camera that they name."""

import math

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli
from fastcollide.cameras import Camera, Orbit, camera_for_box
from fastcollide.parameters import InvalidSetting
from fastcollide.settings import PictureSettings

BOX = ((-4.0, 1.0, 0.0), (2.0, 3.0, 5.0))
MIDDLE = (-1.0, 2.0, 2.5)


def places(camera, aspect):
    """Where the corners of BOX are in the picture: -1 to 1 across and up."""
    forward = np.subtract(camera.target, camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    way = np.array([[BOX[bit][axis] for axis, bit in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]) - camera.eye
    tangent = math.tan(math.radians(camera.field_of_view_degrees) / 2)
    return np.stack([way @ right / aspect, way @ np.cross(right, forward)], axis=1) / (way @ forward)[:, None] / tangent


@pytest.mark.parametrize("aspect", [16 / 9, 1.0, 0.5])
def test_an_orbit_holds_the_whole_box_and_no_more(aspect):
    cameras = [Orbit(8.0).camera_at(time, BOX, aspect) for time in np.arange(0, 8, 8 / 72)]
    reach = np.array([np.abs(places(camera, aspect)).max() for camera in cameras])
    assert reach.max() == pytest.approx(1 - 2 * 0.09)
    distances = [math.dist(camera.eye, MIDDLE) for camera in cameras]
    assert np.ptp(distances) < 1e-9
    assert all(camera.target == pytest.approx(MIDDLE) for camera in cameras)


def test_an_orbit_goes_round_once_in_a_period():
    def heading(time):
        eye = Orbit(8.0).camera_at(time, BOX, 1.5).eye
        return math.degrees(math.atan2(eye[1] - MIDDLE[1], eye[0] - MIDDLE[0])) % 360

    auto = camera_for_box(BOX, 1.5, "auto")
    toward = np.subtract(auto.eye, auto.target)
    assert heading(0) == pytest.approx(math.degrees(math.atan2(toward[1], toward[0])) % 360)
    assert (heading(2) - heading(0)) % 360 == pytest.approx(90)
    assert heading(11) == pytest.approx(heading(3))


def test_the_renderer_follows_the_time():
    renderer = fc.Renderer(BOX, 64, 48, camera=fc.Orbit(4.0))
    eyes = []
    for time in (0.0, 1.0, 4.0):
        renderer.draw(np.empty((0, 3)), [], [], time=time)
        eyes.append(renderer.camera.eye)
    assert math.dist(eyes[0], eyes[1]) > 5
    assert eyes[0] == pytest.approx(eyes[2])
    assert fc.Renderer(BOX, 64, 48, camera="orbit").camera == Orbit().camera_at(0.0, BOX, 64 / 48)


def test_the_settings_give_the_camera():
    assert PictureSettings(camera="front").view(BOX) == "front"
    assert PictureSettings(camera="orbit", orbit_period=3.0).view(BOX) == Orbit(3.0)
    assert PictureSettings(camera_position=(9.0, 0.0, 1.0)).view(BOX) == Camera((9.0, 0.0, 1.0), MIDDLE)
    free = PictureSettings(camera_position=(9.0, 0.0, 1.0), camera_target=(0.0, 0.0, 2.0)).view(BOX)
    assert free == Camera((9.0, 0.0, 1.0), (0.0, 0.0, 2.0))
    assert PictureSettings(camera_position=(-1.0, 2.0, 30.0)).view(BOX).up == (0.0, 1.0, 0.0)  # from above


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"camera": "left"}, "camera"),
        ({"orbit_period": 0.0}, "orbit_period"),
        ({"camera_target": (0.0, 0.0, 0.0)}, "camera_target"),
        ({"camera_target": (1.0, 0.0, 0.0), "camera_position": (1.0, 0.0, 0.0)}, "camera_target"),
        ({"camera": "top", "camera_position": (1.0, 0.0, 0.0)}, "camera_position"),
    ],
)
def test_bad_settings_are_named(settings, name):
    with pytest.raises(InvalidSetting) as error:
        PictureSettings(**settings)
    assert error.value.name == name


def test_bad_cameras_of_the_renderer_are_named():
    with pytest.raises(fc.InvalidValue, match='camera: found left; allowed: "auto", "front", "top", "orbit"'):
        fc.Renderer(BOX, camera="left")
    with pytest.raises(fc.InvalidValue, match=r"camera\.period"):
        fc.Orbit(-1.0)


def test_the_program_has_them(folder):
    run = ["run", "--particles", "20", "--frames", "4", "--no-video", "--width", "64", "--height", "64"]
    pictures = []
    for camera in (["auto"], ["orbit", "--orbit-period", "0.2"], ["auto", "--camera-position", "0", "0", "60"]):
        assert cli.main([*run, "--still", "end.png", "--camera", *camera]) == 0
        pictures.append((folder / "end.png").read_bytes())
    assert len({*pictures}) == 3
