"""Friction that holds: what stands stays where it is, and what must slide or roll does."""

import fastcollide as fc
import numpy as np
import pytest

G = 9.81


def array_of(array):
    return fc.to_numpy(array).astype(np.float64)


def on_slope(device, degrees, **options):
    """The floor is the slope: gravity leans towards +x."""
    slope = np.radians(degrees)
    defaults = {
        "bounds": ((-20, -20, 0), (20, 20, 10)), "gravity": (G * np.sin(slope), 0, -G * np.cos(slope)), "drag": 0.0,
        "floor_restitution": 0.0, "wall_friction": 0.5, "device": device,
    }  # fmt: skip
    return fc.World(**{**defaults, **options})


def pyramid(radius=0.1):
    """Three spheres on the floor that touch each other, and a fourth one on top."""
    base = radius * np.array([(0, 0, 1), (2, 0, 1), (1, np.sqrt(3), 1)])
    return np.vstack([base, radius * np.array([1, 1 / np.sqrt(3), 1 + np.sqrt(8 / 3)])])


@pytest.mark.parametrize("degrees", [1.0, 2.8])
def test_rolling_resistance_holds_a_sphere_on_a_slope(device, degrees):
    """Up to tan θ = μ_r, here 2.86°: it does not creep."""
    world = on_slope(device, degrees, rolling_friction=0.05)
    world.add(position=(0, 0, 0.1), radius=0.1, friction=0.5)
    world.step(120)
    before = array_of(world.positions)[0]
    assert abs(before[0]) < 0.001
    world.step(600)
    np.testing.assert_allclose(array_of(world.positions)[0], before, atol=1e-8)
    np.testing.assert_allclose(array_of(world.spins)[0], 0, atol=1e-6)


@pytest.mark.parametrize("degrees", [4.0, 10.0])
def test_a_sphere_rolls_down_a_steeper_one(device, degrees):
    """At 5/7 (g sin θ - μ_r g cos θ)."""
    world = on_slope(device, degrees, rolling_friction=0.05)
    world.add(position=(0, 0, 0.1), radius=0.1, friction=0.5)
    world.step(30)
    before = array_of(world.velocities)[0, 0]
    world.step(60)
    slope = np.radians(degrees)
    expected = 5 / 7 * G * (np.sin(slope) - 0.05 * np.cos(slope))
    assert array_of(world.velocities)[0, 0] - before == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("iterations", [1, 5, 20])
def test_a_pyramid_stands(device, iterations):
    """The line from a lower sphere's contact with the floor to that with the upper one leans by 17.6°: friction holds
    it from tan 17.6° = 0.318."""
    world = on_slope(device, 0, iterations=iterations)
    world.add(position=pyramid(), radius=0.1, friction=0.5, restitution=0.0)
    world.step(120)
    before = array_of(world.positions)
    assert np.abs(before - pyramid()).max() < (0.02 if iterations == 1 else 0.001)
    world.step(600)
    np.testing.assert_allclose(array_of(world.positions), before, atol=1e-5)
    assert np.abs(array_of(world.velocities)).max() < 1e-5


@pytest.mark.parametrize("friction", [0.1, 0.25])
def test_a_slippery_pyramid_falls_apart(device, friction):
    world = on_slope(device, 0, wall_friction=friction)
    world.add(position=pyramid(), radius=0.1, friction=friction, restitution=0.0)
    world.step(120)
    assert array_of(world.positions)[3, 2] < 0.15


def test_a_pyramid_rolls_down_a_slope(device):
    """Like one sphere, 5/7 g sin θ: those below turn together, the upper one the other way, and no contact slips."""
    world = on_slope(device, 5)
    world.add(position=pyramid(), radius=0.1, friction=0.5, restitution=0.0)
    world.step(60)
    before = array_of(world.velocities)
    world.step(60)
    gained = 5 / 7 * G * np.sin(np.radians(5))
    np.testing.assert_allclose((array_of(world.velocities) - before)[:, 0], gained, rtol=0.005)
    speed = array_of(world.velocities)[0, 0]
    np.testing.assert_allclose(0.1 * array_of(world.spins)[:, 1], speed * np.array([1, 1, 1, -1]), rtol=0.01)


def rough_bed(device, degrees):
    """Spheres poured on a floor of fixed ones, which then is tilted; sideways periodic."""
    edge, radius = 1.6, 0.1
    site = np.stack(np.meshgrid(*[np.arange(8) * 2 * radius] * 2, [0.1, 0.32, 0.54, 0.76]), axis=-1).reshape(-1, 3)
    position = site + (radius, radius, 0)
    position[:, :2] += np.where(position[:, 2:] > 0.2, np.random.default_rng(1).uniform(-0.02, 0.02, (256, 2)), 0)
    options = {
        "bounds": ((0, 0, 0), (edge, edge, 4)), "boundary": ("periodic", "periodic", "wall"), "drag": 0.0,
        "floor_restitution": 0.0, "device": device,
    }  # fmt: skip
    rough = {"radius": radius, "restitution": 0.1, "friction": 0.5}
    mass = np.where(position[:, 2] < 0.2, np.inf, 1.0)
    world = fc.World(gravity=(0, 0, -G), **options)
    world.add(position=position, mass=mass, **rough)
    world.step(120)
    slope = np.radians(degrees)
    tilted = fc.World(gravity=(G * np.sin(slope), 0, -G * np.cos(slope)), **options)
    tilted.add(position=array_of(world.positions), mass=mass, **rough)
    return tilted, mass < np.inf


@pytest.mark.parametrize("degrees", [5, 12])
def test_a_bed_on_a_slope_stays(device, degrees):
    world, is_free = rough_bed(device, degrees)
    world.step(300)
    before = array_of(world.positions)
    world.step(300)
    moved = np.linalg.norm(array_of(world.positions) - before, axis=1)[is_free]
    assert moved.max() < 0.01  # of a radius: 0.1
    assert np.median(moved) < 2e-4


def test_a_bed_on_a_steep_slope_flows(device):
    world, is_free = rough_bed(device, 35)
    world.step(300)
    assert array_of(world.velocities)[is_free, 0].mean() > 1
