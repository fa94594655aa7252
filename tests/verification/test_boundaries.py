"""Motion through periodic ends and along open axes."""

import itertools

import fastcollide as fc
import numpy as np
import pytest

LOWER, UPPER, PERIOD = -8.0, 8.0, 16.0
# Four iterations, so that a substep too is a power of two.
FREE = {
    "bounds": ((LOWER,) * 3, (UPPER,) * 3), "boundary": "periodic", "gravity": (0, 0, 0), "drag": 0.0, "iterations": 4,
}  # fmt: skip
DT = 1 / 64
# No two ends alike; from the upper end of x its length, rounded, leads below the lower.
ODD_BOUNDS = ((-0.7, 0.3, -12.7), (7.4, 7.2, -5.3))

each_axis = pytest.mark.parametrize("axis", [0, 1, 2])
both_ways = pytest.mark.parametrize("way", [-1, 1])


def states_of(world):
    return fc.to_numpy(world.positions).astype(np.float64), fc.to_numpy(world.velocities).astype(np.float64)


def assert_inside(world):
    position = fc.to_numpy(world.positions)
    assert (position >= np.float32(world.bounds[0])).all()
    assert (position < np.float32(world.bounds[1])).all()


def wrapped(position, lower=LOWER, period=PERIOD):
    return (position - lower) % period + lower


# --- Periodic axes ---


@each_axis
@both_ways
def test_free_flight_through_the_end(device, solver, axis, way):
    """Numbers chosen so that every step is exact: the straight line, modulo the period, to the last bit."""
    world = fc.World(device=device, solver=solver, **FREE)
    start, velocity = np.array((1.5, -2.25, 3.0)), np.array((0.5, -0.25, 1.0))
    velocity[axis] = 12.0 * way
    world.add(position=start, radius=0.5, velocity=velocity)

    ends = 0
    for frame in range(1, 257):
        before = fc.to_numpy(world.positions)[0, axis].copy()
        world.step(1, DT)
        position, now = states_of(world)
        np.testing.assert_array_equal(position[0], wrapped(start + velocity * frame * DT))
        np.testing.assert_array_equal(now[0], velocity)
        ends += abs(position[0, axis] - before) > 8
    assert ends == 3


@each_axis
def test_fall_through_the_end(device, solver, axis):
    """A parabola under gravity along a periodic axis, exact in these numbers: it falls for ever."""
    gravity = np.zeros(3)
    gravity[axis] = -8.0
    world = fc.World(device=device, solver=solver, **{**FREE, "gravity": gravity})
    world.add(position=(0, 0, 0), radius=0.5)
    world.step(256, DT)

    position, velocity = states_of(world)
    assert velocity[0, axis] == -32
    assert position[0, axis] == wrapped(-4.0 * 4**2 * 1.0)
    assert np.delete(position[0], axis).tolist() == [0, 0]


@pytest.mark.parametrize("speed", [5.25 * PERIOD, -3.5 * PERIOD, 1000 * PERIOD, PERIOD])
def test_several_periods_in_a_frame(device, solver, speed):
    world = fc.World(device=device, solver=solver, **FREE)
    world.add(position=(1, 2, 3), radius=0.5, velocity=(speed, 0, -speed))
    world.step(1, 1.0)

    np.testing.assert_array_equal(states_of(world)[0], [wrapped(np.array((1 + speed, 2, 3 - speed)))])


@pytest.mark.parametrize("speed", [1e-30, 1e-9, 1e-7, 1e-6])
def test_a_hair_beyond_the_end(device, solver, speed):
    """What rounds to the upper end lies at the lower one."""
    bounds = ((0, 0, -4), (8, 8, 0))
    lowest, highest = (0, 0, -4), (*np.nextafter(np.float32((8, 8)), np.float32(0)), -1e-9)
    for start, velocity in ((lowest, -speed), (highest, speed)):
        world = fc.World(device=device, solver=solver, **{**FREE, "bounds": bounds})
        world.add(position=start, radius=0.5, velocity=(velocity,) * 3)
        for _ in range(3):
            world.step(1, 1.0)
            assert_inside(world)
            off = states_of(world)[0] - start
            assert np.abs(off - np.rint(off / (8, 8, 4)) * (8, 8, 4)).max() < 1e-5


@each_axis
@pytest.mark.parametrize("iterations", [1, 2])
def test_numbers_next_to_the_ends(device, solver, write, axis, iterations):
    """However the length of the box and the way round it are rounded."""
    lower, upper = (np.float32(corner[axis]) for corner in ODD_BOUNDS)
    infinity = np.float32(np.inf)
    outside = [upper, np.nextafter(upper, infinity), upper + np.float32(1e-3), np.nextafter(lower, -infinity)]
    world = fc.World(device=device, solver=solver, **{**FREE, "bounds": ODD_BOUNDS, "iterations": iterations})
    world.add(position=np.mean(ODD_BOUNDS, axis=0), radius=0.25)
    for x in outside:
        position = np.mean(ODD_BOUNDS, axis=0)
        position[axis] = x
        write(world.positions, [position])
        world.step(1, DT)
        assert_inside(world)
        turns = (float(x) - states_of(world)[0][0, axis]) / (float(upper) - float(lower))
        assert turns == pytest.approx(round(turns), abs=1e-6)


@pytest.mark.parametrize("bounds", [ODD_BOUNDS, ((0, 0, 0), (7, 7, 7)), ((-3000.1, -0.1, 99.9), (-2990, 10, 110.2))])
def test_a_crowd_stays_inside(device, solver, bounds):
    """Through flight and through the push apart of overlaps."""
    world = fc.World(bounds=bounds, boundary="periodic", solver=solver, device=device)
    world.add(fc.random_spheres(400, bounds, 41, (0.1, 0.7), (30, 30, 30)))
    contacts = 0
    for _ in range(25):
        world.step(1)
        assert_inside(world)
        contacts += world.contact_count()
    assert contacts > 500


def test_overlaps_are_pushed_apart_across_the_end(device):
    """By mass share, whether or not that carries a sphere through the end."""
    world = fc.World(device=device, solver="reference", **FREE)
    world.add(position=[(7.9375, 7.875, 0), (-7.9375, -7.875, 0)], radius=0.5, mass=[3, 1])
    world.step(1, DT)

    offset = np.array((0.125, 0.25, 0))
    distance = np.linalg.norm(offset)
    push = offset / distance * (1 - distance)
    expected = [(7.9375, 7.875, 0) - push / 4, (-7.9375, -7.875, 0) + push * 3 / 4]
    np.testing.assert_allclose(states_of(world)[0], expected, atol=2e-6)
    assert world.max_overlap() < 2e-6

    world = fc.World(device=device, solver="reference", **FREE)
    world.add(position=[(7.875, 0, 0), (7.9375, 0, 0)], radius=0.5, mass=1)
    world.step(1, DT)

    np.testing.assert_allclose(states_of(world)[0][:, 0], (7.40625, -7.59375), atol=2e-6)
    assert_inside(world)


@pytest.mark.parametrize("shift", [s for s in itertools.product((0, 8), repeat=3) if any(s)])
@pytest.mark.parametrize("restitution", [1.0, 0.5])
def test_an_impact_across_the_end_is_one_in_the_middle(device, solver, shift, restitution):
    """Face, edge and corner: the same velocities, bit for bit, since all offsets are exact."""
    position = np.array([(-0.75, -0.5, -0.25), (0.5, 0.625, 0.375)])
    velocity = np.array([(3.0, 1.5, 2.0), (-2.5, -1.0, -0.75)])

    def impact(moved):
        world = fc.World(device=device, solver=solver, **FREE)
        world.add(
            position=wrapped(position + moved), velocity=velocity, radius=[0.5, 0.625], mass=[1, 2],
            restitution=restitution,
        )  # fmt: skip
        world.step(24, DT)
        return states_of(world)

    middle, across = impact(np.zeros(3)), impact(np.array(shift))

    assert (middle[1] != velocity).all()
    np.testing.assert_array_equal(across[1], middle[1])
    off = across[0] - wrapped(middle[0] + shift)
    assert np.abs(off - PERIOD * np.rint(off / PERIOD)).max() < 3e-5  # each step rounds


def test_head_on_across_the_end(device, solver):
    """m 1, v 2 and m 3, v -1, e 1: v₁' = -2.5, v₂' = 0.5."""
    world = fc.World(device=device, solver=solver, **FREE)
    world.add(
        position=[(7, 0, 0), (-7, 0, 0)], velocity=[(2, 0, 0), (-1, 0, 0)], radius=0.5, mass=[1, 3], restitution=1
    )
    world.step(64, DT)

    np.testing.assert_allclose(states_of(world)[1], [(-2.5, 0, 0), (0.5, 0, 0)], atol=1e-6)


@pytest.mark.parametrize("bounds", [((-4,) * 3, (4,) * 3), ODD_BOUNDS])
def test_momentum_is_kept(device, solver, bounds):
    """To 1e-6 of what the spheres carry, in a cloud that has no other end."""
    spheres = fc.random_spheres(600, bounds, 42, (0.1, 0.4), (5, 5, 5), (1, 1))
    world = fc.World(bounds=bounds, boundary="periodic", gravity=(0, 0, 0), drag=0.0, solver=solver, device=device)
    world.add(spheres)
    before = world.momentum()

    world.step(40)

    carried = (spheres.mass.astype(float) * np.linalg.norm(spheres.velocity, axis=1)).sum()
    assert np.abs(world.momentum() - before).max() < 1e-6 * carried
    assert (np.linalg.norm(states_of(world)[1] - spheres.velocity, axis=1) > 0.5).mean() > 0.5


def test_a_periodic_axis_between_walls(device):
    """Friction and restitution of the floor as ever; nothing stops the slide along the periodic axis."""
    bounds = ((-8, -8, -8), (8, 8, 8))
    world = fc.World(
        bounds, ("periodic", "wall", "wall"), (0, 0, 0), 0.0, floor_restitution=0.5, solver="reference", device=device
    )
    world.add(position=(7.75, 7.375, -7.375), radius=0.5, velocity=(16, 16, -16), restitution=0.25)
    world.step(2, DT)

    position, velocity = states_of(world)
    np.testing.assert_array_equal(velocity, [(16, -4, 8)])
    np.testing.assert_array_equal(position, [(-7.75, 7.5 - 4 / 64, -7.5 + 8 / 64)])


# --- Open axes ---


@each_axis
@both_ways
@pytest.mark.parametrize("boundary", ["open", "one open"])
def test_free_fall_along_an_open_axis(device, solver, axis, way, boundary):
    """For 2 s, past the bounds, with their last place in the right; a substep rounds as much as a frame."""
    gravity = np.zeros(3)
    gravity[axis] = 9.81 * way
    names = "open" if boundary == "open" else tuple("open" if i == axis else "wall" for i in range(3))
    world = fc.World(((-1,) * 3, (1,) * 3), names, gravity, 0.0, solver=solver, device=device)
    world.add(position=(0, 0, 0), radius=0.25)
    world.step(120)

    position, velocity = states_of(world)
    tolerance = {"substep": 1e-5, "reference": 1e-6}[solver]
    assert position[0, axis] == pytest.approx(19.62 * way, rel=tolerance)
    assert velocity[0, axis] == pytest.approx(19.62 * way, rel=tolerance)
    assert np.delete(position[0], axis).tolist() == np.delete(velocity[0], axis).tolist() == [0, 0]


def test_a_far_impact_is_one_at_home(device, solver):
    """The same velocities, bit for bit, 4,096 m away and in each direction."""
    position = np.array([(-0.75, -0.5, -0.25), (0.5, 0.625, 0.375)])
    velocity = np.array([(3.0, 1.5, 2.0), (-2.5, -1.0, -0.75)])
    shifts = np.array([(0, 0, 0), *itertools.product((-4096, 4096), repeat=3)])
    world = fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, solver=solver, iterations=4, device=device)
    for shift in shifts:
        world.add(position=position + shift, velocity=velocity, radius=[0.5, 0.625], mass=[1, 2], restitution=1.0)
    world.step(24, DT)

    after = states_of(world)[1].reshape(-1, 2, 3)
    assert (after[0] != velocity).all()
    np.testing.assert_array_equal(after, np.broadcast_to(after[0], after.shape))


def test_potential_energy_along_an_open_axis(device):
    """Counts from 0, as there is no lower end."""
    infinity = float("inf")
    world = fc.World(((-1, -1, -infinity), (1, 1, infinity)), ("wall", "wall", "open"), (0, 0, -8), device=device)
    world.add(position=[(0, 0, 2), (0, 0, -5)], radius=0.25, mass=[1, 3])

    assert (world.energy().kinetic, world.energy().potential) == (0, 8 * 2 - 3 * 8 * 5)


@each_axis
@both_ways
def test_leaving_the_reach_ends_the_run_at_the_last_good_frame(device, solver, axis, way):
    """131,072 radii of 0.25 m are 32,768 m."""
    place, velocity = np.zeros((3, 3)), np.zeros((3, 3))
    place[:, axis] = 0, 32760 * way, 32768 * way
    velocity[:, axis] = -way, 128 * way, 0
    place[:, (axis + 1) % 3] = -5, 0, 5

    def start():
        world = fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, solver=solver, iterations=4, device=device)
        world.add(position=place, velocity=velocity, radius=0.25)
        return world

    world, expected = start(), start()
    expected.step(4, DT)
    for frames in (60, 1):
        with pytest.raises(fc.SimulationError, match=r"sphere 1 in frame 5: .* 131072 radii .* open axis"):
            world.step(frames, DT)
        assert world.frame == 4
        assert world.time == pytest.approx(4 * DT)
        assert world.state_hash() == expected.state_hash()
        assert fc.to_numpy(world.positions)[1, axis] == 32768 * way


@both_ways
def test_pushed_out_of_reach(device, way):
    """By the push apart of an overlap: refused like a flight, and the world can still be read."""
    world = fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, solver="reference", device=device)
    world.add(position=[(0, 0, 0), (32768 * way, 0, 0), (32767.75 * way, 0, 0)], radius=0.25)
    before = world.state_hash()

    with pytest.raises(fc.SimulationError, match=r"sphere 1 in frame 1: .* 131072 radii"):
        world.step(2, DT)

    assert world.frame == 0
    assert world.state_hash() == before
    assert world.contact_count() == 1


# --- The state is a function of the scene alone ---

MIXTURES = ["periodic", "open", ("periodic", "open", "wall"), ("wall", "periodic", "periodic")]


def crowd(device, boundary, **options):
    bounds = ((-3, -3, -3), (3, 3, 3))
    world = fc.World(bounds=bounds, boundary=boundary, device=device, **options)
    world.add(fc.random_spheres(600, bounds, 43, (0.1, 0.4), (2, 2, 2)))
    world.step(12)
    return world.state_hash(), world.contact_count(), world.energy(), world.max_overlap()


@pytest.mark.parametrize("boundary", MIXTURES)
def test_no_result_depends_on_cells_or_threads(device, solver, boundary):
    expected = crowd("cpu", boundary, solver=solver, threads=1)
    assert expected[1] > 5
    for cell_size in (None, 0.9, 1.5, 2.5, 5.9, 1000.0):
        assert crowd(device, boundary, solver=solver, cell_size=cell_size) == expected
    for threads in (2, 3, 5):
        assert crowd("cpu", boundary, solver=solver, threads=threads) == expected


def test_a_crowd_does_not_know_where_the_ends_are(device, solver):
    """Moved by half a period before the first frame, it has the same velocities after one pass."""
    random = np.random.default_rng(44)
    position = random.integers(-(2**9), 2**9, (300, 3)) / 2.0**6
    velocity = random.integers(-(2**6), 2**6, (300, 3)) / 2.0**3
    radius = random.integers(2**4, 2**6 + 2**5, 300) / 2.0**6

    def after(shift):
        world = fc.World(device=device, solver=solver, **{**FREE, "iterations": 1})
        world.add(position=wrapped(position + shift), velocity=velocity, radius=radius, mass=1)
        world.step(1, DT)
        return states_of(world)[1]

    expected = after(np.zeros(3))
    assert (expected != velocity).any(axis=1).sum() > 100
    for shift in ((8, 0, 0), (0, 8, 8), (3, -5, 7.5)):
        np.testing.assert_array_equal(after(np.array(shift)), expected)
