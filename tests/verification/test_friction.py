"""Friction and spin of the default solver in closed form."""

import fastcollide as fc
import numpy as np
import pytest

G = 9.81


def array_of(array):
    return fc.to_numpy(array).astype(np.float64)


def above_floor(device, **options):
    defaults = {
        "bounds": ((-100, -100, 0), (100, 100, 20)),
        "gravity": (0, 0, -G),
        "drag": 0.0,
        "floor_restitution": 0.0,
    }
    return fc.World(device=device, **{**defaults, **options})


def open_space(device):
    return fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, device=device)


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.5])
def test_slide_to_roll(device, friction):
    """Rolling starts at t = 2 v / 7 μ g, with 5/7 of the speed."""
    world = above_floor(device, wall_friction=friction)
    world.add(position=(0, 0, 0.1), radius=0.1, velocity=(2, 0, 0), friction=friction)
    slip = 2.0
    while slip > 1e-3 and world.time < 5:
        world.step(1, dt=1 / 600)
        slip = array_of(world.velocities)[0, 0] - 0.1 * array_of(world.spins)[0, 1]
    time = 2 * 2 / (7 * friction * G)
    assert world.time == pytest.approx(time, rel=0.01, abs=1 / 600)
    assert array_of(world.velocities)[0] == pytest.approx([10 / 7, 0, 0], rel=0.01, abs=1e-6)
    assert array_of(world.positions)[0, 0] == pytest.approx(12 * 2**2 / (49 * friction * G), rel=0.01)


@pytest.mark.parametrize("axis", [0, 1])
def test_rolling_down_a_slope(device, axis):
    """5/7 g sin 15°, without slip, whichever way the slope runs."""
    slope = np.radians(15)
    gravity = np.zeros(3)
    gravity[axis], gravity[2] = G * np.sin(slope), -G * np.cos(slope)
    world = above_floor(device, gravity=tuple(gravity), wall_friction=0.5)
    world.add(position=(0, 0, 0.1), radius=0.1, friction=0.5)
    world.step(60)
    speed = array_of(world.velocities)[0, axis]
    assert speed == pytest.approx(5 / 7 * G * np.sin(slope), rel=0.005)
    turning = {0: array_of(world.spins)[0, 1], 1: -array_of(world.spins)[0, 0]}[axis]
    assert 0.1 * turning == pytest.approx(speed, rel=0.005)


def test_a_slide_without_rotation_stops(device):
    """A world without spin: v² / 2 μ g."""
    world = above_floor(device, wall_friction=0.2)
    world.add(position=(0, 0, 0.1), radius=0.1, velocity=(2, 0, 0))
    world.step(180)
    assert array_of(world.positions)[0, 0] == pytest.approx(2**2 / (2 * 0.2 * G), rel=0.005)
    assert array_of(world.velocities)[0, 0] == 0


@pytest.mark.parametrize(
    ("degrees", "tangential", "spin"),
    [(40, 0.7829, 544.2), (50, 0.8471, 456.7), (60, 0.8948, 355.2), (70, 0.9337, 243.0), (80, 0.9679, 123.4)],
)
def test_oblique_impact_on_a_plane(device, degrees, tangential, spin):
    """Chung and Ooi, benchmark tests for DEM at the contact level, test 4: r 2.5 mm, 3.9 m/s, e 0.98, μ 0.092."""
    angle, speed, radius = np.radians(degrees), 3.9, 0.0025
    world = above_floor(
        device, bounds=((-1, -1, 0), (1, 1, 1)), gravity=(0, 0, 0), floor_restitution=0.98, wall_friction=0.092
    )
    world.add(
        position=(0, 0, 2 * radius),
        radius=radius,
        velocity=(speed * np.sin(angle), 0, -speed * np.cos(angle)),
        friction=0.092,
    )
    world.step(60, dt=1 / 6000)
    velocity = array_of(world.velocities)[0]
    assert velocity[2] == pytest.approx(0.98 * speed * np.cos(angle), rel=1e-5)
    assert velocity[0] / (speed * np.sin(angle)) == pytest.approx(tangential, rel=0.01)
    assert array_of(world.spins)[0] == pytest.approx([0, spin, 0], rel=0.01)


def test_equal_spheres_with_opposite_spins(device):
    """Chung and Ooi, test 7: surfaces that do not slip feel no friction."""
    world = open_space(device)
    world.add(
        position=[(-0.2, 0, 0), (0.2, 0, 0)],
        radius=0.1,
        velocity=[(1, 0, 0), (-1, 0, 0)],
        spin=[(0, 0, 5), (0, 0, -5)],
        friction=0.4,
        restitution=1.0,
    )
    world.step(30)
    assert array_of(world.velocities) == pytest.approx(np.array([(-1, 0, 0), (1, 0, 0)]), abs=1e-6)
    assert array_of(world.spins) == pytest.approx(np.array([(0, 0, 5), (0, 0, -5)]), abs=1e-6)


def test_equal_spins_rub(device):
    """Gross sliding: the tangential impulse is μ times the normal one, on both, and turns both the same way."""
    friction, restitution = 0.1, 0.5
    world = open_space(device)
    world.add(
        position=[(-0.2, 0, 0), (0.2, 0, 0)],
        radius=0.1,
        velocity=[(1, 0, 0), (-1, 0, 0)],
        spin=[(0, 0, 50), (0, 0, 50)],
        friction=friction,
        restitution=restitution,
    )
    world.step(30)
    normal = (1 + restitution) * 1.0  # velocity change of each
    kick = friction * normal
    assert array_of(world.velocities) == pytest.approx(np.array([(-0.5, -kick, 0), (0.5, kick, 0)]), abs=1e-5)
    assert array_of(world.spins)[:, 2] == pytest.approx(50 - 2.5 * kick / 0.1, rel=1e-5)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rough_impacts_keep_both_momenta(device, seed):
    random = np.random.default_rng(seed)
    world = open_space(device)
    position = random.uniform(-1, 1, (60, 3))
    world.add(
        position=position,
        radius=random.uniform(0.1, 0.25, 60),
        velocity=-position + random.normal(size=(60, 3)) * 0.3,
        spin=random.normal(size=(60, 3)) * 10,
        friction=0.5,
        restitution=0.8,
    )
    size = np.abs(array_of(world.masses)[:, None] * array_of(world.velocities)).sum()
    momentum, angular = world.momentum(), world.angular_momentum()
    energy = world.energy().total
    world.step(30)
    assert np.abs(world.momentum() - momentum).max() <= 1e-6 * size
    assert np.abs(world.angular_momentum() - angular).max() <= 2e-6 * size
    assert world.energy().total < 0.97 * energy


def test_without_friction_spins_stay(device):
    world = open_space(device)
    world.add(position=[(-0.2, 0.05, 0), (0.2, 0, 0)], radius=0.1, velocity=[(1, 0, 0), (-1, 0, 0)], spin=(1, 2, 3))
    world.step(30)
    assert array_of(world.spins).tolist() == [[1, 2, 3], [1, 2, 3]]


def test_the_reference_solver_refuses_friction(device):
    world = fc.World(solver="reference", device=device)
    with pytest.raises(fc.InvalidValue, match="friction") as error:
        world.add(position=[(0, 0, 5)] * 2, radius=0.1, friction=[0, 0.5])
    assert (error.value.field, error.value.index, len(world)) == ("friction", 1, 0)
