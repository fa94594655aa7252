"""Pictures against closed forms: outline, depth order, shadow, edges, colours, and the same bytes whoever draws."""

import math

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.colormaps import COLOR_MAPS, color_table
from fastcollide.render import Camera, Renderer, camera_for_box

BOUNDS = ((-50.0, -50.0, 0.0), (50.0, 50.0, 100.0))
# Looks up from within a box so wide that neither floor nor edges nor shadows are in the picture.
UPWARD = Camera(eye=(1.0, -12.0, 5.0), target=(0.5, 3.0, 14.0), field_of_view_degrees=40)
TOWARDS_LIGHT = np.array([-0.42, -0.30, 0.86])
SMALL = {"width": 160, "height": 120, "supersampling": 1, "color_range": (0, 1), "device": "cpu"}


def draw(positions, radii, values, bounds=BOUNDS, camera=UPWARD, **options):
    positions = np.reshape(np.asarray(positions, np.float32), (-1, 3))
    return Renderer(bounds, camera=camera, **(SMALL | options)).draw(positions, np.ravel(radii), np.ravel(values))


def rays(camera, width, height):
    """Directions of the rays through the pixels' middles, shape (height, width, 3), of length 1 ahead."""
    forward = np.subtract(camera.target, camera.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    step = 2 * math.tan(math.radians(camera.field_of_view_degrees) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * step
    y = (height / 2 - np.arange(height) - 0.5) * step
    return forward + x[None, :, None] * right + y[:, None, None] * up


def pixel_of(camera, width, height, point):
    """Real pixel coordinates of a point: the middle of pixel (i, j) is at (i + 0.5, j + 0.5)."""
    along = rays(camera, width, height)
    middle = (along[0, 0] + along[-1, -1]) / 2
    to_point = np.subtract(point, camera.eye)
    to_point = to_point / (to_point @ middle)
    right, down = along[0, 1] - along[0, 0], along[1, 0] - along[0, 0]
    off = to_point - along[0, 0]
    return off @ right / (right @ right) + 0.5, off @ down / (down @ down) + 0.5


def hits(camera, width, height, positions, radii):
    """Double precision: depth of each sphere in each pixel (1e9 without a hit), and how far from its rim it is."""
    along = rays(camera, width, height)[..., None, :]
    to_center = np.float64(positions) - camera.eye
    squared = (along**2).sum(-1)
    foot = (along * to_center).sum(-1) / squared
    off = np.linalg.norm(to_center - along * foot[..., None], axis=-1)
    inside = np.float64(radii) ** 2 - off**2
    depth = foot - np.sqrt(np.maximum(inside, 0) / squared)
    return np.where((inside >= 0) & (depth > 0), depth, 1e9), np.abs(off - radii) / foot


def differs(a, b):
    return (a != b).any(axis=-1)


@pytest.mark.parametrize(
    ("center", "radius"), [((0.5, 3, 14), 2.0), ((-3, 2, 11), 1.5), ((4, 8, 19), 0.9), ((1, 400, 252), 60)]
)
def test_outline_is_that_of_the_sphere(center, radius):
    picture = draw([center], [radius], [0.5])
    seen = differs(picture, draw([], [], []))
    depth, from_rim = hits(UPWARD, 160, 120, [center], [radius])
    expected, clear = depth[..., 0] < 1e9, from_rim[..., 0] > 1e-5

    assert 50 < expected.sum() < 160 * 120
    assert (seen == expected)[clear].all()


def test_area_on_the_line_of_sight_is_that_of_a_disc():
    distance, radius = np.linalg.norm(np.subtract(UPWARD.target, UPWARD.eye)), 3.0
    seen = differs(draw([UPWARD.target], [radius], [0.5]), draw([], [], []))
    rim = radius / math.sqrt(distance**2 - radius**2) * 120 / (2 * math.tan(math.radians(20)))

    assert seen.sum() == pytest.approx(math.pi * rim**2, abs=2 * rim)
    rows, columns = np.nonzero(seen)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((80, 60), abs=0.05)


def test_each_pixel_shows_the_nearest_sphere():
    random = np.random.default_rng(5)
    positions = random.uniform((-4, 0, 9), (5, 8, 18), (60, 3)).astype(np.float32)
    radii = random.uniform(0.3, 1.6, 60).astype(np.float32)
    warm = np.arange(60) % 2
    picture = draw(positions, radii, warm).astype(int)
    depth, from_rim = hits(UPWARD, 160, 120, positions, radii)
    nearest = depth.argmin(-1)
    first, second = np.sort(depth, axis=-1)[..., :2].transpose(2, 0, 1)
    clear = (first < 1e9) & (from_rim.min(-1) > 1e-5) & (second - first > 1e-4)

    red_over_blue = picture[..., 0] > picture[..., 2]
    assert clear.sum() > 5000
    assert 0.2 < warm[nearest][clear].mean() < 0.8
    assert (red_over_blue == warm[nearest])[clear].all()


def scattered(count, seed):
    random = np.random.default_rng(seed)
    positions = random.uniform((-9, -9, 0), (9, 9, 19), (count, 3)).astype(np.float32)
    radii = random.uniform(0.05, 0.8, count).astype(np.float32)
    return positions, radii, random.uniform(0, 1, count).astype(np.float32)


ROOM = ((-10.0, -10.0, 0.0), (10.0, 10.0, 20.0))
IN_THE_CLOUD = Camera(eye=(3, -6, 8), target=(0, 2, 4), field_of_view_degrees=60)


@pytest.mark.parametrize("supersampling", [1, 2, 3])
def test_same_bytes_for_any_number_of_threads(supersampling):
    scene = scattered(3000, seed=2)
    options = {"bounds": ROOM, "camera": IN_THE_CLOUD, "width": 322, "height": 201, "supersampling": supersampling}
    one, *others = (draw(*scene, threads=threads, **options).tobytes() for threads in (1, 2, 3, 5))

    assert len(set(one)) > 100
    assert all(other == one for other in others)


def test_same_bytes_in_any_order_of_the_spheres():
    positions, radii, values = scattered(2000, seed=3)
    order = np.random.default_rng(4).permutation(2000)
    options = {"bounds": ROOM, "camera": IN_THE_CLOUD, "supersampling": 2}

    shuffled = draw(positions[order], radii[order], values[order], **options)
    assert shuffled.tobytes() == draw(positions, radii, values, **options).tobytes()


def test_same_bytes_on_the_cpu_and_on_cuda(gpu):
    scene = scattered(3000, seed=2)
    options = {"bounds": ROOM, "camera": IN_THE_CLOUD, "supersampling": 2, "width": 640, "height": 360}

    assert draw(*scene, **options | {"device": gpu}).tobytes() == draw(*scene, **options).tobytes()


def test_a_renderer_forgets_the_picture_before():
    renderer = Renderer(ROOM, width=160, height=120, color_range=(0, 1))
    few, many = scattered(10, seed=6), scattered(500, seed=7)
    first = renderer.draw(*few).tobytes()
    renderer.draw(*many)

    assert renderer.draw(*few).tobytes() == first


AWAY = np.subtract(UPWARD.eye, UPWARD.target)


@pytest.mark.parametrize(
    ("position", "radius"),
    [
        (np.add(UPWARD.eye, AWAY), 2.0),  # behind the eye
        (np.add(UPWARD.eye, 0.02 * AWAY), 0.3),  # just behind it
        (UPWARD.eye, 1.0),  # around it
        ((np.nan, 3, 14), 2.0),
        ((0.5, np.inf, 14), 2.0),
        ((0.5, 3, 14), np.nan),
        ((0.5, 3, 14), 0.0),
        ((0.5, 3, 14), -2.0),
    ],
)
def test_what_cannot_be_seen_leaves_no_trace(position, radius):
    other = [(0.5, 3, 14), 1.0, 0.5]
    with_it = draw([position, other[0]], [radius, other[1]], [0.5, other[2]])

    assert with_it.tobytes() == draw(*other).tobytes()


def test_a_sphere_that_the_near_plane_cuts_is_drawn_where_it_is_in_front():
    # Its middle is ahead of the eye by less than its radius: the eye's plane cuts it.
    ahead = -AWAY / np.linalg.norm(AWAY)
    right = np.cross(ahead, UPWARD.up)
    center = UPWARD.eye + 2.0 * right / np.linalg.norm(right) + 1.0 * ahead
    seen = differs(draw([center], [1.9], [0.5]), draw([], [], []))
    depth, from_rim = hits(UPWARD, 160, 120, [center], [1.9])
    clear = from_rim[..., 0] > 1e-5

    assert (seen == (depth[..., 0] < 1e9))[clear].all()
    assert 1000 < seen.sum() < seen.size - 1000


def test_a_sphere_close_to_the_eye_fills_the_picture():
    center = np.subtract(UPWARD.eye, 0.1 * AWAY)
    assert differs(draw([center], [1.6], [0.5]), draw([], [], [])).all()


DOWNWARD = Camera(eye=(0, -14, 16), target=(0, 0, 0), field_of_view_degrees=40)


def floor_brightness(picture, point):
    x, y = pixel_of(DOWNWARD, 160, 120, point)
    return picture[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2].mean()


def test_shadow_falls_where_the_light_is_blocked():
    center, radius = np.array([-1.0, 1.0, 6.0]), 0.8
    lit, shaded = draw([], [], [], ROOM, DOWNWARD), draw(center, radius, 0.5, ROOM, DOWNWARD)
    shadow = center - TOWARDS_LIGHT * center[2] / TOWARDS_LIGHT[2]
    # The shadow of a sphere on the floor: an ellipse, 1 / cosine of the slant times as long.
    away = -TOWARDS_LIGHT[:2] / np.linalg.norm(TOWARDS_LIGHT[:2])
    long = radius * np.linalg.norm(TOWARDS_LIGHT) / TOWARDS_LIGHT[2]

    def darker(*offset):
        point = shadow + [*(away * offset[0] + np.array([-away[1], away[0]]) * offset[1]), 0]
        return 1 - floor_brightness(shaded, point) / floor_brightness(lit, point)

    assert darker(0, 0) > 0.08
    assert darker(0.75 * long, 0) > 0.08
    assert darker(0, 0.75 * radius) > 0.08
    assert darker(1.4 * long, 0) < 0.02
    assert darker(0, 1.6 * radius) < 0.02


def test_shadow_reaches_the_floor_outside_the_box():
    center = np.array([9.5, 9.5, 10.0])
    camera = Camera(eye=(14, 4, 30), target=(14, 13, 0), field_of_view_degrees=40)
    point = center - TOWARDS_LIGHT * center[2] / TOWARDS_LIGHT[2]
    x, y = (int(c) for c in pixel_of(camera, 160, 120, point))

    assert point[0] > 14
    assert point[1] > 12
    lit, shaded = draw([], [], [], ROOM, camera), draw(center, 0.5, 0.5, ROOM, camera)
    assert shaded[y, x].mean() < 0.92 * lit[y, x].mean()


def test_floor_darkens_towards_a_contact():
    sphere = draw([0, 0, 1], [1], [0.5], ROOM, DOWNWARD)
    empty = draw([], [], [], ROOM, DOWNWARD)
    # Towards the light, where no shadow falls.
    side = TOWARDS_LIGHT[:2] / np.linalg.norm(TOWARDS_LIGHT[:2])
    share = []
    for distance in (1.15, 1.8, 3.5):
        point = [*(side * distance), 0]
        share.append(floor_brightness(sphere, point) / floor_brightness(empty, point))

    assert share[0] < share[1] - 0.04 < share[2] - 0.045
    assert share[2] == pytest.approx(1, abs=0.005)


def test_edges_are_hidden_by_nearer_spheres_only():
    bounds = ((-5.0, -5.0, 0.0), (5.0, 5.0, 10.0))
    camera = Camera(eye=(0, -30, 9), target=(0, 0, 5), field_of_view_degrees=35)
    empty = draw([], [], [], bounds, camera)
    for edge_y, sphere_y, hidden in ((5, 0, True), (-5, 0, False)):
        edge_point = np.array([-5, edge_y, 6.0])
        # On the ray through the edge, nearer or farther than it.
        eye = np.array(camera.eye, float)
        center = eye + (edge_point - eye) * ((sphere_y - eye[1]) / (edge_point[1] - eye[1]))
        x, y = (int(c) for c in pixel_of(camera, 160, 120, edge_point))
        picture = draw(center, 1.0, 1.0, bounds, camera)
        row, plain = picture[y, x - 2 : x + 3].astype(int), empty[y, x - 2 : x + 3].astype(int)

        assert np.abs(np.diff(plain.sum(-1))).max() > 30, "the edge is seen without the sphere"
        assert (np.abs(np.diff(row.sum(-1))).max() < 30) == hidden


def test_edges_of_pixels_are_smooth_with_supersampling():
    def shades(supersampling):
        picture = draw(UPWARD.target, 3.0, 1.0, supersampling=supersampling)
        empty = draw([], [], [])
        reach = (picture.astype(int)[60, :, 2] - empty[60, :, 2]) / (picture.astype(int)[60, 80, 2] - empty[60, 80, 2])
        return ((reach > 0.15) & (reach < 0.6)).sum()

    assert shades(1) == 0
    assert shades(4) >= 1


def test_values_beyond_the_range_take_its_ends():
    at = [UPWARD.target], [2.0]
    for inside, outside in ((2.0, -5.0), (4.0, 9.0)):
        a, b = (draw(*at, [value], color_range=(2, 4)).tobytes() for value in (inside, outside))
        assert a == b
    assert draw(*at, [2.0], color_range=(2, 4)).tobytes() != draw(*at, [4.0], color_range=(2, 4)).tobytes()


@pytest.mark.parametrize(
    ("color_by", "values", "expected"),
    [
        ("speed", [1.0, 3.0], (0, 20)),  # sqrt(2 · 9.80665 · 20) = 19.81
        ("speed", [1.0, 93.0], (0, 100)),
        ("radius", [0.125, 0.5], (0.125, 0.5)),
        ("id", [0, 1], (0, 1)),
        ("radius", [0.5, 0.5], (0.5, 1.5)),
        ("speed", [np.nan, 3.0], (0, 20)),
    ],
)
def test_color_range_is_chosen_once(color_by, values, expected):
    renderer = Renderer(ROOM, width=64, height=64, color_by=color_by)
    spheres = [(0, 0, 5), (0, 0, 10)], [0.5, 0.5]
    renderer.draw(*spheres, values)
    assert renderer.color_range == pytest.approx(expected)
    renderer.draw(*spheres, [-1000, 1000])
    assert renderer.color_range == pytest.approx(expected)


@pytest.mark.parametrize("name", COLOR_MAPS)
def test_color_maps_rise_evenly_in_lightness(name):
    table = color_table(name).astype(float) / 255
    assert table.shape == (256, 3)
    linear = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    smoothed = luminance[4:] - luminance[:-4]
    assert (smoothed > 0).all()
    assert 3 * luminance[0] < luminance[-1] < 0.75, "the background is lighter still"


@pytest.mark.parametrize("name", ["auto", "front", "top"])
@pytest.mark.parametrize(("width", "height"), [(1280, 720), (720, 1280), (500, 500)])
@pytest.mark.parametrize("bounds", [ROOM, ((0, 0, 0), (1, 8, 0.5)), ((100, 5, -3), (101, 6, 90))])
def test_named_cameras_hold_the_box_and_no_more(name, width, height, bounds):
    camera = camera_for_box(bounds, width / height, name, margin=0.1)
    corners = [[bounds[i][0], bounds[j][1], bounds[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    places = np.array([pixel_of(camera, width, height, corner) for corner in corners]) / (width, height)

    assert places.min() > 0.1 - 1e-6
    assert places.max() < 0.9 + 1e-6
    low, high = places.min(0), places.max(0)
    assert max(high - low) == pytest.approx(0.8, abs=1e-6)
    assert (low + high)[np.argmax(high - low)] == pytest.approx(1, abs=1e-6)


def test_text_covers_only_its_corner_and_its_side():
    renderer = Renderer(ROOM, width=640, height=360, color_range=(0, 1))
    scene = scattered(20, seed=8)
    plain, titled = renderer.draw(*scene), renderer.draw(*scene, title="Spheres", time=1.25)
    rows, columns = np.nonzero(differs(plain, titled))

    assert len(rows) > 50
    assert rows.max() < 60
    assert columns.max() < 320
    assert differs(titled, renderer.draw(*scene, title="Spheres", time=1.26)).any()


def test_color_bar_shows_the_table():
    picture = Renderer(ROOM, width=1280, height=720, color_range=(0, 1)).draw(np.empty((0, 3)), [], [])
    column = np.abs(picture.astype(int) - color_table("ember")[128]).sum(-1).min(0).argmin()
    rows = np.nonzero((picture[:, column].max(-1).astype(int) - picture[:, column].min(-1)) > 60)[0]

    assert column > 1100
    assert len(rows) > 200
    assert np.abs(picture[rows[5], column].astype(int) - color_table("ember")[-6]).max() < 12
    assert np.abs(picture[rows[-6], column].astype(int) - color_table("ember")[5]).max() < 12


@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 2), (17, 33), (321, 200)])
@pytest.mark.parametrize("supersampling", [1, 4])
def test_any_size_can_be_drawn(width, height, supersampling):
    picture = draw(*scattered(50, seed=9), ROOM, None, width=width, height=height, supersampling=supersampling)
    assert picture.shape == (height, width, 3)
    assert picture.dtype == np.uint8
    assert picture.min() > 0


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"width": 0}, "width"),
        ({"height": 100_000}, "height"),
        ({"supersampling": 5}, "supersampling"),
        ({"color_by": "mass"}, "color_by"),
        ({"color_map": "jet"}, "color_map"),
        ({"color_range": (1, 1)}, "color_range"),
        ({"color_range": (0, math.inf)}, "color_range"),
        ({"bounds": ((0, 0, 0), (1, 1, 0))}, "bounds"),
        ({"bounds": ((0, 0, 0), (1, math.nan, 1))}, "bounds"),
        ({"camera": "left"}, "camera"),
    ],
)
def test_bad_options_are_named(options, field):
    with pytest.raises(fc.InvalidValue, match=r"found .*; allowed: ") as caught:
        Renderer(**({"bounds": ROOM} | options))
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"eye": (0, 0, math.nan)}, "camera.eye"),
        ({"target": (1, 2, 3)}, "camera.target"),
        ({"up": (0, 0)}, "camera.up"),
        ({"field_of_view_degrees": 180}, "camera.field_of_view_degrees"),
    ],
)
def test_bad_cameras_are_named(changes, field):
    with pytest.raises(fc.InvalidValue) as caught:
        Camera(**({"eye": (1, 2, 3), "target": (0, 0, 0)} | changes))
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("name", "array"), [("positions", np.zeros((2, 2))), ("radii", [1.0]), ("values", [[1.0], [2.0]])]
)
def test_arrays_that_do_not_fit_are_named(name, array):
    arrays = {"positions": np.zeros((2, 3)), "radii": [1.0, 1.0], "values": [0.0, 0.0]} | {name: array}
    with pytest.raises(fc.InvalidValue) as caught:
        Renderer(ROOM, width=64, height=64).draw(**arrays)
    assert caught.value.field == name
