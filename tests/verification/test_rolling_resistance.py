"""Rolling resistance in closed form: a moment of at most rolling_friction · R · normal force."""

import fastcollide as fc
import numpy as np
import pytest

G = 9.81
FIXED = float("inf")


def array_of(array):
    return fc.to_numpy(array).astype(np.float64)


def above_floor(device, **options):
    defaults = {"bounds": ((-50, -50, 0), (50, 50, 20)), "gravity": (0, 0, -G), "drag": 0.0, "floor_restitution": 0.0}
    return fc.World(device=device, **{**defaults, "wall_friction": 0.5, **options})


def open_space(device, **options):
    return fc.World(**{"boundary": "open", "gravity": (0, 0, 0), "drag": 0.0, "device": device, **options})


@pytest.mark.parametrize("radius", [0.1, 0.4])
@pytest.mark.parametrize("rolling_friction", [0.01, 0.05])
@pytest.mark.parametrize("iterations", [1, 5])
def test_a_rolling_sphere_slows_down(device, radius, rolling_friction, iterations):
    """With f the friction at the floor: m a = f and 2/5 m r² α = -μ_r r m g - f r, a = α r: a = -5/7 μ_r g."""
    world = above_floor(device, rolling_friction=rolling_friction, iterations=iterations)
    world.add(position=(0, 0, radius), velocity=(1.2, 1.6, 0), spin=np.array((-1.6, 1.2, 0)) / radius, radius=radius)
    world.step(30)
    before = array_of(world.velocities)[0]
    world.step(60)
    velocity, spin = array_of(world.velocities)[0], array_of(world.spins)[0]

    deceleration = 5 / 7 * rolling_friction * G
    np.testing.assert_allclose(before - velocity, (0.6 * deceleration, 0.8 * deceleration, 0), rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(radius * spin, (-velocity[1], velocity[0], 0), rtol=0.02, atol=1e-6)


def test_it_stops_a_sphere_and_does_not_turn_it_back(device):
    """After 7 v² / 10 μ_r g."""
    world = above_floor(device, rolling_friction=0.05)
    world.add(position=(0, 0, 0.1), velocity=(1, 0, 0), spin=(0, 10, 0), radius=0.1)
    world.step(60)
    assert array_of(world.velocities)[0, 0] > 0.5
    world.step(240)
    assert np.abs(array_of(world.velocities)).max() < 1e-5
    assert np.abs(array_of(world.spins)).max() < 1e-4
    assert array_of(world.positions)[0, 0] == pytest.approx(7 / (10 * 0.05 * G), rel=0.01)


def test_a_top_on_a_smooth_floor(device):
    """2/5 m r² α = -μ_r r m g about any axis, here the normal: it takes 2 r ω / 5 μ_r g to stop, and a few substeps for
    the spring to ring out."""
    world = above_floor(device, rolling_friction=0.1, wall_friction=0.0)
    world.add(position=(0, 0, 0.1), spin=(0, 0, 20), radius=0.1)
    world.step(12)
    assert array_of(world.spins)[0] == pytest.approx([0, 0, 20 - 2.5 * 0.1 * G / 0.1 * 0.2], rel=0.01)
    world.step(72)
    np.testing.assert_allclose(array_of(world.spins)[0], 0, atol=1e-6)


def test_a_top_on_a_fixed_sphere(device):
    """2/5 m r² α = -μ_r R m g, R = r₁ r₂ / (r₁ + r₂): a third of the radius on one of half the size."""
    world = open_space(device, gravity=(0, 0, -G), rolling_friction=0.1)
    world.add(position=[(0, 0, 0), (0, 0, 0.15)], spin=[(0, 0, 0), (0, 0, 20)], radius=[0.05, 0.1], mass=[FIXED, 1])
    world.step(12)
    before = array_of(world.spins)[1, 2]
    world.step(12)
    assert before - array_of(world.spins)[1, 2] == pytest.approx(2.5 * 0.1 * G / 0.1 / 3 * 0.2, rel=0.01)
    assert array_of(world.spins)[0].tolist() == [0, 0, 0]


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("rolling_friction", [0.05, 10.0])
def test_an_impact_on_a_wall(device, restitution, rolling_friction):
    """It takes 5/2 μ_r (1 + e) v / r from the spin, up to all."""
    world = fc.World(
        ((-1,) * 3, (1,) * 3), gravity=(0, 0, 0), drag=0.0, rolling_friction=rolling_friction, device=device
    )
    world.add(position=(0.5, 0, 0), velocity=(2, 0, 0), spin=(0, 12, -16), radius=0.1, restitution=restitution)
    world.step(30)
    speed = max(0, 20 - 2.5 * rolling_friction * (1 + restitution) * 2 / 0.1)
    np.testing.assert_allclose(array_of(world.spins)[0], (0, 0.6 * speed, -0.8 * speed), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(array_of(world.velocities)[0], (-2 * restitution, 0, 0), atol=1e-6)


@pytest.mark.parametrize(("mass", "radius"), [((1, 1), (0.1, 0.1)), ((1, 5), (0.1, 0.3)), ((1, FIXED), (0.1, 0.3))])
def test_an_impact_of_spinning_spheres(device, mass, radius):
    """Without friction: each loses μ_r R J / I, R = r₁ r₂ / (r₁ + r₂), from its share of the relative spin."""
    rolling_friction, restitution = 0.05, 0.5
    world = open_space(device, rolling_friction=rolling_friction)
    world.add(
        position=[(-0.3, 0, 0), (0.4, 0, 0)], velocity=[(2, 0, 0), (0, 0, 0)], spin=[(3, 20, 0), (3, -30, 0)],
        mass=mass, radius=radius, restitution=restitution,
    )  # fmt: skip
    world.step(30)

    inverse = 1 / np.array(mass)
    impulse = (1 + restitution) * 2 / inverse.sum()
    moment = rolling_friction * radius[0] * radius[1] / sum(radius) * impulse
    turned = moment * inverse / (0.4 * np.array(radius) ** 2)
    assert turned.sum() < 50
    np.testing.assert_allclose(array_of(world.spins), [(3, 20 - turned[0], 0), (3, -30 + turned[1], 0)], rtol=1e-5)


@pytest.mark.parametrize(("mass", "radius"), [((1, 1), (0.1, 0.1)), ((1, 5), (0.1, 0.3))])
def test_no_more_than_the_relative_spin(device, mass, radius):
    """However large the coefficient: both end with the spin that keeps the angular momentum."""
    world = open_space(device, rolling_friction=100.0)
    world.add(
        position=[(-0.3, 0, 0), (0.4, 0, 0)], velocity=[(2, 0, 0), (0, 0, 0)], spin=[(3, 20, 0), (3, -30, 0)],
        mass=mass, radius=radius,
    )  # fmt: skip
    world.step(30)
    inertia = np.array(mass) * np.array(radius) ** 2
    together = (20 * inertia[0] - 30 * inertia[1]) / inertia.sum()
    np.testing.assert_allclose(array_of(world.spins), [(3, together, 0)] * 2, rtol=1e-5)


def test_surfaces_that_turn_together_feel_nothing(device):
    world = open_space(device, rolling_friction=0.5)
    world.add(position=[(-0.2, 0, 0), (0.2, 0, 0)], velocity=[(1, 0, 0), (-1, 0, 0)], spin=(4, 5, 6), radius=0.1)
    world.step(30)
    assert array_of(world.velocities)[0, 0] < 0
    assert array_of(world.spins).tolist() == [[4, 5, 6]] * 2


@pytest.mark.parametrize("gravity", [(0, 0, 0), (0, 0, -G)], ids=["impacts", "resting contacts too"])
def test_a_crowd_keeps_both_momenta(device, gravity):
    """In free fall: of a system that only its weight acts on."""
    random = np.random.default_rng(3)
    world = fc.World(boundary="open", gravity=gravity, drag=0.0, rolling_friction=0.3, device=device)
    position = random.uniform(-0.5, 0.5, (80, 3))
    world.add(
        position=position, radius=random.uniform(0.1, 0.2, 80), velocity=-0.5 * position,
        spin=random.normal(size=(80, 3)) * 10, friction=0.4, restitution=0.5,
    )  # fmt: skip
    masses = array_of(world.masses)
    size = np.abs(masses[:, None] * array_of(world.velocities)).sum() + masses.sum() * 0.5 * np.linalg.norm(gravity)
    angular = world.angular_momentum()
    momentum, center = world.momentum(), masses @ array_of(world.positions) / masses.sum()
    spins = array_of(world.spins)
    world.step(30)

    fallen = masses.sum() * np.array(gravity) * 0.5
    assert np.abs(world.momentum() - momentum - fallen).max() <= 1e-5 * size
    now = masses @ array_of(world.positions) / masses.sum()
    orbital = np.cross(now, world.momentum()) - np.cross(center, momentum)
    assert np.abs(world.angular_momentum() - angular - orbital).max() <= 2e-5 * size
    assert np.linalg.norm(array_of(world.spins) - spins, axis=1).mean() > 1


def test_a_world_that_does_not_turn_does_not_roll(device):
    """Without spins and friction the coefficient changes nothing."""
    hashes = set()
    for rolling_friction in (0.0, 0.5):
        world = above_floor(device, bounds=((-1, -1, 0), (1, 1, 3)), rolling_friction=rolling_friction)
        world.add(fc.random_spheres(100, world.bounds, radius=(0.1, 0.2)))
        world.step(30)
        hashes.add(world.state_hash())
    assert len(hashes) == 1


def test_the_reference_solver_refuses_it(device):
    with pytest.raises(fc.InvalidValue, match=r"found 0\.125; allowed: 0: spheres of the reference solver do not turn"):
        fc.World(solver="reference", rolling_friction=0.125, device=device)
