"""Spheres of infinite mass: nothing changes them, and the others meet walls."""

import fastcollide as fc
import numpy as np
import pytest

FIXED = float("inf")
G = 9.81
# Four iterations where numbers must be exact: a substep of 1/64 s is then a power of two as well.


def array_of(array):
    return fc.to_numpy(array).astype(np.float64)


def open_space(device, **options):
    return fc.World(
        **{"boundary": "open", "gravity": (0, 0, 0), "drag": 0.0, "iterations": 4, "device": device, **options}
    )


# --- Nothing changes them ---


def test_a_crowd_does_not_move_a_fixed_sphere(device, solver):
    """Nor gravity, nor drag, nor friction: it goes on with the velocity and the spin that it was given."""
    rough = {"friction": 0.5} if solver == "substep" else {}
    world = fc.World(((-2, -2, 0), (2, 2, 4)), drag=1.0, solver=solver, iterations=4, wall_friction=0.5, device=device)
    world.add(
        position=[(0, 0, 1), (-1, 0, 2), (0.125, 0, 1)], velocity=[(0, 0, 0), (0.5, 0, -0.25), (0, 0, 0)],
        radius=0.5, mass=FIXED, spin=(1, 2, 3), **rough,
    )  # fmt: skip
    crowd = fc.random_spheres(300, world.bounds, radius=(0.1, 0.2))
    world.add(position=crowd.position, velocity=crowd.velocity, radius=crowd.radius, **rough)
    world.step(64, 1 / 64)

    assert np.abs(array_of(world.velocities)[3:]).max() > 0.1
    np.testing.assert_array_equal(array_of(world.positions)[:3], [(0, 0, 1), (-0.5, 0, 1.75), (0.125, 0, 1)])
    np.testing.assert_array_equal(array_of(world.velocities)[:3], [(0, 0, 0), (0.5, 0, -0.25), (0, 0, 0)])
    np.testing.assert_array_equal(array_of(world.spins)[:3], [(1, 2, 3)] * 3)


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_walls_do_not_stop_a_fixed_sphere(device, solver, axis, way):
    world = fc.World(((-2,) * 3, (2,) * 3), solver=solver, iterations=4, device=device)
    velocity = np.zeros(3)
    velocity[axis] = 4 * way
    world.add(position=(0, 0, 0), velocity=velocity, radius=0.5, mass=FIXED)
    world.step(64, 1 / 64)

    np.testing.assert_array_equal(array_of(world.positions), [velocity])
    np.testing.assert_array_equal(array_of(world.velocities), [velocity])


def test_a_fixed_sphere_comes_in_from_outside(device, solver, write):
    """A piston that was outside pushes what it meets; the grid knows it there too."""
    world = fc.World(((-2,) * 3, (2,) * 3), gravity=(0, 0, 0), drag=0.0, solver=solver, iterations=4, device=device)
    world.add(position=[(1.5, 0, 0), (-1, 0, 0)], velocity=[(4, 0, 0), (0, 0, 0)], radius=0.5, mass=[FIXED, 1])
    world.step(64, 1 / 64)
    assert array_of(world.positions)[0, 0] == 5.5
    write(world.velocities, [(-4, 0, 0), array_of(world.velocities)[1]])
    world.step(112, 1 / 64)  # to -1.5; the other one is at the wall since it was hit
    assert array_of(world.positions)[0, 0] == -1.5
    assert array_of(world.velocities)[1].tolist() != [0, 0, 0]


def test_through_the_end_of_a_periodic_axis(device, solver):
    world = fc.World(((-2,) * 3, (2,) * 3), ("periodic", "wall", "open"), solver=solver, iterations=4, device=device)
    world.add(position=(0, 0, 0), velocity=(3, 3, 3), radius=0.5, mass=FIXED)
    world.step(64, 1 / 64)
    np.testing.assert_array_equal(array_of(world.positions), [(-1, 3, 3)])


def test_out_of_reach_along_an_open_axis(device, solver):
    world = open_space(device, solver=solver)
    world.add(position=[(0, 0, 0), (32760, 0, 0)], velocity=(128, 0, 0), radius=0.25, mass=FIXED)
    with pytest.raises(fc.SimulationError, match=r"sphere 1 in frame 5: .* 131072 radii"):
        world.step(60, 1 / 64)


def test_fixed_spheres_pass_through_each_other(device, solver):
    world = open_space(device, solver=solver, gravity=(0, 0, -G))
    world.add(position=[(-1, 0, 0), (1, 0, 0)], velocity=[(1, 0, 0), (-1, 0, 0)], radius=0.5, mass=FIXED)
    world.step(64, 1 / 64)
    assert world.contact_count() == 1
    assert world.max_overlap() == 0  # of those that a contact could part
    world.step(64, 1 / 64)
    np.testing.assert_array_equal(array_of(world.positions), [(1, 0, 0), (-1, 0, 0)])


def test_they_are_in_no_sum(device, solver):
    world = open_space(device, solver=solver, gravity=(0, 0, -8))
    world.add(position=[(0, 0, 2), (0, 3, 5)], velocity=(1, 2, 0), spin=(0, 0, 4), radius=0.5, mass=[FIXED, 2])
    assert world.energy() == pytest.approx((5, 0.5 * 0.4 * 2 * 0.25 * 16, 80))
    assert world.momentum().tolist() == [2, 4, 0]
    assert world.angular_momentum() == pytest.approx([-2 * 10, 2 * 5, -2 * 3 + 0.4 * 2 * 0.25 * 4])


def test_a_sphere_can_be_let_go(device, solver, write):
    world = open_space(device, solver=solver, gravity=(0, 0, -8), iterations=4)
    world.add(position=(0, 0, 0), radius=0.5, mass=FIXED)
    world.step(64, 1 / 64)
    assert array_of(world.positions)[0, 2] == 0
    write(world.masses, [2.0])
    world.step(64, 1 / 64)
    assert array_of(world.positions)[0, 2] == -4
    write(world.masses, [FIXED])
    world.step(64, 1 / 64)
    assert array_of(world.positions)[0, 2] == -12
    assert array_of(world.velocities)[0, 2] == -8


# --- What they do to others ---


@pytest.mark.parametrize("iterations", [1, 5, 32])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("speed", [0.0, 1.0, -0.75])
def test_a_head_on_impact(device, solver, iterations, restitution, speed):
    """v' = u + e (u - v) to the last places, whatever the mass."""
    for mass in (1e-3, 1.0, 1e30):
        world = open_space(device, solver=solver, iterations=iterations)
        world.add(
            position=[(0, 0, 0), (1.125, 0, 0)], velocity=[(speed, 0, 0), (-2, 0, 0)], radius=0.5,
            mass=[FIXED, mass], restitution=restitution,
        )  # fmt: skip
        world.step(16, 1 / 64)
        expected = speed + restitution * (speed + 2)
        np.testing.assert_allclose(array_of(world.velocities), [(speed, 0, 0), (expected, 0, 0)], atol=2e-6)


def test_many_at_once(device, solver):
    """From six sides in one frame: it has time for all, where a free sphere takes one impact in a substep."""
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    world = open_space(device, solver=solver, iterations=1)
    world.add(position=(0, 0, 0), radius=0.5, mass=FIXED, restitution=1.0)
    world.add(position=1.25 * sides, velocity=-2 * sides, radius=0.5, restitution=1.0)
    world.step(10, 1 / 64)
    np.testing.assert_allclose(array_of(world.velocities)[1:], 2 * sides, atol=1e-6)


def test_bounces_from_a_fixed_sphere(device):
    """From h = 1 m with e = 0.8: h e², h e⁴, h e⁶, as from a floor, then rest."""
    world = open_space(device, gravity=(0, 0, -G))
    world.add(position=[(0, 0, -0.5), (0, 0, 1.1)], radius=[0.5, 0.1], mass=[FIXED, 1], restitution=0.8)
    states = []
    for _ in range(360):
        world.step(1)
        states.append((array_of(world.positions)[1, 2] - 0.1, array_of(world.velocities)[1, 2]))
    height, velocity = np.array(states).T
    top = 1 + np.flatnonzero((velocity[:-1] > 0) & (velocity[1:] <= 0))
    peaks = height[top] + velocity[top] ** 2 / (2 * G)
    np.testing.assert_allclose(peaks[:3], (0.64, 0.4096, 0.262144), rtol=0.01)
    assert np.abs(velocity[-30:]).max() < 1e-3
    assert -0.01 * 0.1 < height[-1] <= 0


def test_a_column_on_a_fixed_sphere(device):
    """Of 28 layers, as on the floor: at rest, with a mean overlap of at most 5 %."""
    world = fc.World(((-0.11, -0.11, -1), (0.11, 0.11, 8)), drag=0.0, device=device)
    world.add(position=[(0, 0, 0.2 * i) for i in range(29)], radius=0.1, mass=[FIXED] + [1.0] * 28, restitution=0.3)
    world.step(1200)
    contacts = world.contacts()
    assert len(contacts) == 28
    assert 0 < -fc.to_numpy(contacts.gap).mean() / 0.1 <= 0.05
    assert np.abs(array_of(world.velocities)).max() < 0.05


def test_a_heap_on_a_floor_of_fixed_spheres(device):
    """A bumpy floor that is no wall of the box carries a heap and lets nothing through."""
    world = fc.World(((-1.5, -1.5, -20), (1.5, 1.5, 5)), drag=0.0, device=device)
    grid = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 16), np.linspace(-1.5, 1.5, 16), 0.0), axis=-1).reshape(-1, 3)
    world.add(position=grid, radius=0.15, mass=FIXED)
    heap = fc.random_spheres(200, ((-1.4, -1.4, 0.4), (1.4, 1.4, 4)), radius=(0.1, 0.2), speed=(1, 1, 1))
    world.add(heap)
    world.step(900)
    position, velocity = array_of(world.positions)[len(grid) :], array_of(world.velocities)[len(grid) :]
    assert position[:, 2].min() > 0.1
    assert np.sqrt((velocity**2).sum(axis=1).mean()) < 0.02


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("iterations", [2, 5])
@pytest.mark.parametrize("velocity", [(0.5, 0, 0), (5, 0, -1), (0, 0, -3), (0.5, 0, -3)])
def test_a_floor_of_many_fixed_spheres_adds_no_energy(device, iterations, friction, velocity):
    """A sphere of 32 times their radius touches dozens of them in one substep, without warning: it never has more
    energy than at the start, and falling straight down it rebounds no higher than e² h."""
    e, gap, small, large = 0.5, 0.02, 0.025, 0.8
    x, y = np.meshgrid(np.arange(-1.8, 1.8, small), np.arange(-0.3, 0.3, small))
    world = fc.World(((-2, -2, -2), (2, 2, 99)), "open", gravity=(0, 0, -G), iterations=iterations, device=device)
    world.add(
        position=np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), radius=small, mass=FIXED, restitution=e,
        friction=friction,
    )  # fmt: skip
    start = (-0.3 * velocity[0], 0.007, large + small + gap)
    world.add(position=start, velocity=velocity, radius=large, mass=1.0, restitution=e, friction=friction)
    energy, rebound, lands = world.energy().total, 0.0, False
    for _ in range(45):
        world.step(1)
        assert world.energy().total <= energy * (1 + 1e-6)
        height = array_of(world.positions)[-1, 2] - large - small
        lands = lands or height < 1e-3
        rebound = max(rebound, height if lands else 0.0)
    assert lands
    if velocity[0] == 0:
        assert rebound <= 1.05 * e**2 * (velocity[2] ** 2 / (2 * G) + gap)


def test_friction_of_a_fixed_sphere(device):
    """Gross sliding on one that turns: μ times the normal impulse on the partner, nothing on the fixed one."""
    friction, restitution = 0.1, 0.5
    world = open_space(device)
    world.add(
        position=[(0, 0, 0), (0.35, 0, 0)], velocity=[(0, 0, 0), (-2, 0, 0)], spin=[(0, 0, 100), (0, 0, 0)],
        radius=[0.2, 0.1], mass=[FIXED, 1], friction=friction, restitution=restitution,
    )  # fmt: skip
    world.step(12)
    normal = (1 + restitution) * 2
    np.testing.assert_allclose(array_of(world.velocities), [(0, 0, 0), (1, friction * normal, 0)], atol=1e-5)
    np.testing.assert_allclose(array_of(world.spins), [(0, 0, 100), (0, 0, -2.5 * friction * normal / 0.1)], rtol=1e-5)


# --- Masses of any size ---


@pytest.mark.parametrize("scale", [4.0**-60, 4.0**-30, 4.0**30, 4.0**62])
def test_only_ratios_of_masses_count(device, solver, scale):
    """To the last bit: no product of two masses leaves the range of float32."""
    hashes = set()
    for mass in (1.0, scale):
        world = fc.World(((-1, -1, 0), (1, 1, 4)), solver=solver, device=device)
        crowd = fc.random_spheres(200, world.bounds, radius=(0.1, 0.2))
        masses = np.where(np.arange(200) % 3, mass, 4 * mass)
        world.add(position=crowd.position, velocity=crowd.velocity, radius=crowd.radius, mass=masses)
        world.step(20)
        hashes.add((fc.to_numpy(world.positions).tobytes(), fc.to_numpy(world.velocities).tobytes()))
    assert len(hashes) == 1
