"""Free flight in closed form."""

import fastcollide as fc
import numpy as np
import pytest

# Starts at the origin, so that float32 resolves the fall as finely as it can.
BOUNDS = ((-4, -4, -30), (4, 4, 30))
FALL = {"bounds": BOUNDS, "gravity": (0, 0, -9.81)}
# Relative, of 120 frames: each of the five substeps of a frame rounds as much as the one step of the reference.
ROUNDING = {"substep": 1e-5, "reference": 1e-6}


def flown(device, solver, dt, duration=2.0, velocity=(0, 0, 0), **options):
    world = fc.World(device=device, solver=solver, **{**FALL, **options})
    world.add(position=(0, 0, 0), radius=0.25, velocity=velocity)
    world.step(round(duration / dt), dt)
    return fc.to_numpy(world.positions)[0].astype(float), fc.to_numpy(world.velocities)[0].astype(float)


@pytest.mark.parametrize("dt", [1 / 30, 1 / 50, 1 / 60, 1 / 64])
def test_free_fall_in_one_substep_a_frame(device, dt):
    position, velocity = flown(device, "substep", dt, drag=0.0, iterations=1)

    assert velocity[2] == pytest.approx(-19.62, rel=1e-6)
    assert position[2] == pytest.approx(-19.62, rel=1e-6)


@pytest.mark.parametrize("dt", [1 / 30, 1 / 60, 1 / 64])
def test_free_fall(device, solver, dt):
    """The parabola is exact under constant gravity, whatever dt: v = g t, Δz = g t² / 2."""
    position, velocity = flown(device, solver, dt, drag=0.0)

    assert velocity[2] == pytest.approx(-19.62, rel=ROUNDING[solver])
    assert position[2] == pytest.approx(-19.62, rel=ROUNDING[solver])
    assert tuple(position[:2]) == tuple(velocity[:2]) == (0, 0)


def test_gravity_acts_along_its_vector(device, solver):
    """In numbers that need no rounding."""
    position, velocity = flown(
        device, solver, 1 / 64, drag=0.0, gravity=(0.5, -1.0, 1.5), velocity=(-0.25, 1.0, 2.0), iterations=4
    )

    np.testing.assert_allclose(velocity, (0.75, -1.0, 5.0), rtol=1e-6)
    np.testing.assert_allclose(position, (0.5, 0.0, 7.0), rtol=1e-6, atol=1e-6)


def test_drag_step_by_step(device):
    """The discrete formula of the reference: x ← x + v dt + g dt² / 2, then v ← (v + g dt) exp(-γ dt)."""
    dt, gamma, gravity = 1 / 60, 0.5, -9.81
    z, v = 0.0, 0.0
    for _ in range(120):
        z += v * dt + gravity * dt**2 / 2
        v = (v + gravity * dt) * np.exp(-gamma * dt)

    position, velocity = flown(device, "reference", dt, drag=gamma)

    assert velocity[2] == pytest.approx(v, rel=1e-6)
    assert position[2] == pytest.approx(z, rel=1e-6)


def test_drag_converges(device):
    """To v = g / γ (1 - exp(-γ t)) = 12.4022 and Δz = g / γ (t - (1 - exp(-γ t)) / γ) = 14.4356: the velocity with
    first order in dt, the position with second, as what it lacks cancels what the velocity lacks."""
    exact_speed = 9.81 / 0.5 * (1 - np.exp(-1))
    exact_fall = 9.81 / 0.5 * (2 - (1 - np.exp(-1)) / 0.5)
    assert (round(exact_speed, 4), round(exact_fall, 4)) == (12.4022, 14.4356)

    speed_errors, fall_errors = [], []
    for dt in (1 / 8, 1 / 16):
        position, velocity = flown(device, "reference", dt, drag=0.5)
        speed_errors.append(-velocity[2] - exact_speed)
        fall_errors.append(-position[2] - exact_fall)

    assert max(map(abs, speed_errors)) < 0.04 * exact_speed
    assert speed_errors[0] / speed_errors[1] == pytest.approx(2, abs=0.05)
    assert fall_errors[0] / fall_errors[1] == pytest.approx(4, abs=0.1)


def test_damping_of_a_frame_becomes_drag(device, solver):
    """0.999 a frame at 60 frames a second."""
    drag = fc.drag_from_damping(0.999, 60)
    _, velocity = flown(device, solver, 1 / 60, 1.0, (3, 0, 0), gravity=(0, 0, 0), drag=drag)

    assert velocity[0] == pytest.approx(3 * 0.999**60, rel=ROUNDING[solver])
