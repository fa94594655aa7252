"""Impacts on each of the six walls in closed form."""

import fastcollide as fc
import numpy as np
import pytest

BOUNDS = ((-3.0, -2.0, -1.0), (2.0, 3.0, 4.0))
STILL = {"bounds": BOUNDS, "gravity": (0, 0, 0), "drag": 0.0}
WALLS = [(axis, side) for axis in range(3) for side in (0, 1)]
WALL_NAMES = [f"{'xyz'[axis]} {('lower', 'upper')[side]}" for axis, side in WALLS]
RADIUS, RESTITUTION, FLOOR_RESTITUTION = 0.25, 0.9, 0.5
DT = 1 / 64

each_wall = pytest.mark.parametrize(("axis", "side"), WALLS, ids=WALL_NAMES)


def restitution_of(axis, side):
    return FLOOR_RESTITUTION if (axis, side) == (2, 0) else RESTITUTION


def impact(device, solver, axis, side, speed, tangential, friction=0.0, frames=1):
    """A sphere that reaches into a wall in the middle of the first frame."""
    outwards = 1 if side else -1
    limit = BOUNDS[side][axis] - outwards * RADIUS
    position, velocity = np.zeros(3), np.zeros(3)
    position[axis] = limit - outwards * speed * DT / 2
    velocity[axis] = outwards * speed
    velocity[np.delete(np.arange(3), axis)] = tangential
    world = fc.World(device=device, solver=solver, floor_restitution=FLOOR_RESTITUTION, wall_friction=friction, **STILL)
    world.add(position=position, velocity=velocity, radius=RADIUS, restitution=RESTITUTION)
    world.step(frames, DT)
    after = fc.to_numpy(world.velocities)[0]
    return fc.to_numpy(world.positions)[0][axis], limit, -outwards * after[axis], np.delete(after, axis)


@each_wall
def test_the_normal_velocity_is_reversed(device, solver, axis, side):
    """By the floor's restitution at the floor and by the sphere's own at the other five walls."""
    position, limit, rebound, tangential = impact(device, solver, axis, side, 2.0, (0.75, -1.25))
    # The reference solver leaves it at the wall, the default one where it is half a frame after the impact.
    left = rebound * DT / 2 if solver == "substep" else 0
    outwards = 1 if side else -1

    assert -outwards * (position - limit) == pytest.approx(left, abs=2e-6)
    assert rebound == pytest.approx(2.0 * restitution_of(axis, side), rel=1e-6)
    assert tuple(tangential) == (0.75, -1.25)


@each_wall
def test_a_sphere_leaves_the_wall_it_has_hit(device, solver, axis, side):
    """Once reversed it is not reversed again."""
    position, limit, rebound, _ = impact(device, solver, axis, side, 2.0, (0, 0), frames=9)
    outwards = 1 if side else -1

    assert rebound == pytest.approx(2.0 * restitution_of(axis, side), rel=1e-6)
    assert -outwards * (position - limit) == pytest.approx((8.5 if solver == "substep" else 8) * DT * rebound, rel=1e-5)


@each_wall
def test_friction_takes_its_share_of_the_normal_impulse(device, solver, axis, side):
    """Gross sliding: |Δv_t| = μ (1 + e) v_n against the slip, whose direction stays."""
    tangential = np.array((3.0, -1.0))
    _, _, rebound, after = impact(device, solver, axis, side, 2.0, tangential, friction=0.3)

    speed = np.linalg.norm(tangential)
    slowed = speed - 0.3 * (1 + restitution_of(axis, side)) * 2.0
    assert rebound == pytest.approx(2.0 * restitution_of(axis, side), rel=1e-6)
    np.testing.assert_allclose(after, tangential * slowed / speed, rtol=1e-6)


@each_wall
def test_friction_stops_a_slow_slip_and_never_reverses_it(device, solver, axis, side):
    *_, after = impact(device, solver, axis, side, 2.0, (0.5, -0.25), friction=0.3)

    assert tuple(np.abs(after)) == (0, 0)


@pytest.mark.parametrize("restitution", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_restitution_of_the_floor(device, solver, restitution):
    world = fc.World(device=device, solver=solver, floor_restitution=restitution, **STILL)
    world.add(position=(0, 0, -0.74), velocity=(0, 0, -1), radius=RADIUS, restitution=0.4)
    world.step(1, DT)

    assert fc.to_numpy(world.velocities)[0, 2] == pytest.approx(restitution, abs=1e-6)


def test_a_corner_reverses_all_three(device, solver):
    world = fc.World(device=device, solver=solver, floor_restitution=0.5, **STILL)
    world.add(position=(-2.74, 2.74, -0.74), velocity=(-1, 2, -4), radius=RADIUS, restitution=0.75)
    world.step(1, DT)

    np.testing.assert_allclose(fc.to_numpy(world.velocities)[0], (0.75, -1.5, 2.0), rtol=1e-6)


def test_heights_of_bounces(device, solver):
    """h e², h e⁴, h e⁶ for e = 0.8 from 1 m."""
    world = fc.World(
        bounds=((-1, -1, 0), (1, 1, 3)), gravity=(0, 0, -9.81), drag=0.0, floor_restitution=0.8, iterations=1,
        device=device, solver=solver,
    )  # fmt: skip
    world.add(position=(0, 0, 1.25), radius=0.25)
    heights = []
    for _ in range(1150):
        world.step(4, 1 / 2000)
        heights.append(float(fc.to_numpy(world.positions)[0, 2]) - 0.25)
    heights = np.array(heights)

    tops = heights[1:-1][(heights[1:-1] >= heights[:-2]) & (heights[1:-1] > heights[2:])]
    np.testing.assert_allclose(tops, (0.64, 0.4096, 0.262144), rtol=0.01)


def test_friction_stops_a_slide(device, solver):
    """Without rotation after v² / (2 μ g), at the time v / (μ g)."""
    friction, speed, gravity, dt = 0.2, 2.0, 9.81, 1 / 1000
    world = fc.World(
        bounds=((-4, -4, 0), (4, 4, 2)), gravity=(0, 0, -gravity), drag=0.0, floor_restitution=0.0,
        wall_friction=friction, solver=solver, device=device,
    )  # fmt: skip
    world.add(position=(-1, -1, 0.25), radius=0.25, velocity=(speed * 0.6, speed * 0.8, 0))
    stop = speed / (friction * gravity)
    start = fc.to_numpy(world.positions)[0].copy()

    world.step(int(0.99 * stop / dt), dt)
    assert 0 < np.linalg.norm(fc.to_numpy(world.velocities)[0]) < 0.02 * speed
    world.step(int(0.03 * stop / dt), dt)

    np.testing.assert_array_equal(fc.to_numpy(world.velocities)[0, :2], 0)
    assert abs(fc.to_numpy(world.velocities)[0, 2]) < 1e-6
    way = fc.to_numpy(world.positions)[0] - start
    np.testing.assert_allclose(way, np.array((0.6, 0.8, 0)) * speed**2 / (2 * friction * gravity), rtol=5e-3, atol=1e-6)
