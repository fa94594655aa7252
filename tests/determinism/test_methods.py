"""Lists of neighbours give what a new grid for every pass gives, to the last bit."""

from dataclasses import replace

import fastcollide as fc
import numpy as np
import pytest
from determinism import golden

NAMES = [name for name in golden.SCENES if "20,000" not in name]
METHODS = ("cells", "list", "frame", "levels")


def methods_for(count, is_rough=False):
    """One of them is for smooth spheres, as few as fit into the shared memory of a multiprocessor."""
    return METHODS if is_rough or count > 1600 else (*METHODS, "small")


def all_methods(device, solver, spheres, **options):
    is_rough = solver == "substep" and (spheres.friction is not None or spheres.spin is not None)
    methods = methods_for(len(spheres), is_rough)
    worlds = [fc.World(device=device, solver=solver, method=method, **options) for method in methods]
    for world in worlds:
        world.add(spheres)
    return worlds


def assert_equal_steps(worlds, frames, dt=1 / 60):
    for count in frames:
        for world in worlds:
            world.step(count, dt)
        assert len({world.state_hash() for world in worlds}) == 1, f"frame {worlds[0].frame}"


@pytest.mark.parametrize("name", NAMES)
def test_golden_scenes(device, solver, name):
    make, frames, dt = golden.SCENES[name]
    spheres, options = make()
    if solver == "reference" and spheres.friction is not None:
        pytest.skip("the reference solver has no friction of spheres")
    worlds = all_methods(device, solver, spheres, **{key: options[key] for key in options if key != "solver"})
    assert_equal_steps(worlds, (1, 1, 5, frames // 2, 2), dt)


def test_a_pile_that_comes_to_rest(device, solver):
    """Lists live long here, and a few spheres rattle out of their skins again and again."""
    bounds = ((0, 0, 0), (2, 2, 6))
    spheres = fc.random_spheres(400, bounds, seed=3, radius=(0.04, 0.16))
    worlds = all_methods(device, solver, spheres, bounds=bounds, boundary=("periodic", "wall", "wall"))
    assert_equal_steps(worlds, (100, 100, 200))


def assert_equal_memory(worlds):
    """What contacts remember; returns for how many."""
    first, *others = [world._world.save() for world in worlds]
    for name in ("contact_owner", "contact_partner", "contact_slide", "contact_roll"):
        for other in others:
            np.testing.assert_array_equal(other.get(name), first.get(name), err_msg=name)
    return len(first["contact_owner"])


def rough(spheres, friction=0.5):
    return replace(spheres, friction=np.full(len(spheres), friction, np.float32))


@pytest.mark.parametrize("rolling_friction", [0.0, 0.05])
def test_a_rough_pile_that_comes_to_rest(device, rolling_friction):
    """What contacts remember is found again whatever the order of the spheres, in lists and in cells."""
    bounds = ((0, 0, 0), (2, 2, 6))
    spheres = rough(fc.random_spheres(400, bounds, seed=3, radius=(0.04, 0.16)))
    options = {"bounds": bounds, "boundary": ("periodic", "wall", "wall"), "wall_friction": 0.4}
    worlds = all_methods(device, "substep", spheres, rolling_friction=rolling_friction, **options)
    assert_equal_steps(worlds, (100, 1, 1, 100, 200))
    assert assert_equal_memory(worlds) > 400


@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_rough_frames_in_runs_of_any_length(device, iterations):
    """What is remembered before a run, within it and after it: at once or frame by frame, by one method or another, in
    runs shorter and longer than the frames that a GPU is given at once."""
    bounds = ((0, 0, 0), (2, 2, 6))
    spheres = rough(fc.random_spheres(200, bounds, seed=12, radius=(0.08, 0.16)))
    spheres = replace(spheres, spin=np.full((200, 3), 20, np.float32))
    options = {"iterations": iterations, "wall_friction": 0.4, "rolling_friction": 0.05}
    worlds = all_methods(device, "substep", spheres, bounds=bounds, **options)
    for frames in (60, 8, 9, 1, 10, 17, 18, 25, 26, 26, 26, 33, 40, 40, 41, 41):
        for _ in range(frames):
            worlds[0].step(1)
        for world in worlds[1:]:
            world.step(frames)
        assert len({world.state_hash() for world in worlds}) == 1, f"{frames} frames up to {worlds[0].frame}"
    assert assert_equal_memory(worlds) > 200

    for method in METHODS:
        worlds.append(fc.World(bounds, device=device, method=method, **options))
        worlds[-1]._world.restore(**worlds[2]._world.save())
    assert_equal_steps(worlds, (1, 20))
    assert_equal_memory(worlds)


def test_spin_that_the_report_does_not_know(device):
    """Its loop leaves spins as they are."""
    spheres = fc.random_spheres(300, ((0, 0, 0), (2, 2, 2)), seed=13, radius=(0.05, 0.12))
    spin = np.arange(900, dtype=np.float32).reshape(300, 3)
    worlds = all_methods(device, "reference", replace(spheres, spin=spin), bounds=((0, 0, 0), (2, 2, 2)))
    assert_equal_steps(worlds, (1, 20))
    for world in worlds:
        np.testing.assert_array_equal(fc.to_numpy(world.spins), spin)


def test_friction_that_comes_and_goes(device, write):
    """Between two steps: what is remembered grows with the world and is forgotten without friction."""
    bounds = ((0, 0, 0), (2, 2, 3))
    worlds = all_methods(device, "substep", rough(fc.random_spheres(300, bounds, radius=(0.05, 0.12))), bounds=bounds)
    assert_equal_steps(worlds, (60,))
    for friction in (0.0, 0.4):
        for world in worlds:
            write(world.frictions, np.full(len(world), friction, np.float32))
            world.add(fc.random_spheres(20, bounds, seed=len(world), radius=(0.05, 0.12)))
        assert_equal_steps(worlds, (1, 20))
        assert ("contact_owner" in worlds[0]._world.save()) == (friction > 0)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_flight_among_fixed_spheres(device, friction):
    """Where few touch each other, who is near is found out before a contact pass: also a fixed one that all bounce off,
    and walls."""
    bounds = ((0, 0, 0), (5, 5, 5))
    spheres = fc.random_spheres(500, bounds, seed=5, radius=(0.05, 0.15), friction=friction)
    spheres = replace(spheres, mass=np.where(np.arange(500) % 5 == 0, np.inf, spheres.mass))
    worlds = all_methods(device, "substep", spheres, bounds=bounds, gravity=(0, 0, -2))
    assert_equal_steps(worlds, (1, 2, 4, 8, 20, 40))


@pytest.mark.parametrize("fixed", [15, 24])
def test_more_rough_contacts_than_a_row_holds(device, fixed):
    """Spheres in cups of fixed ones, which the free one remembers all; the memory grows after a run or in one."""
    angle = np.arange(fixed) * 2 * np.pi / fixed
    ring = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.full(fixed, -0.15)], axis=-1)
    cups = np.stack(np.meshgrid(range(8), range(8), [0.5]), axis=-1).reshape(-1, 3)
    worlds = [fc.World(((-1, -1, 0), (8, 8, 2)), device=device, method=method) for method in METHODS]
    for world in worlds:
        world.add(position=(cups[:, None] + ring).reshape(-1, 3), radius=0.05, mass=np.inf, friction=0.5)
        world.add(position=cups, radius=0.205, spin=(0.1, 0.2, 0), friction=0.5)
    assert_equal_steps(worlds, (1, 2), 1e-4)
    assert assert_equal_memory(worlds) == fixed * 64
    assert_equal_steps(worlds, (40,), 1e-4)
    assert_equal_memory(worlds)


@pytest.mark.parametrize("method", METHODS)
def test_each_of_many_partners_is_remembered(device, method, tmp_path):
    """A sphere slips over a ring of fixed ones, over all alike: what it remembers of each is the same, whether in its
    row or beyond it, and before and after it was saved."""
    angle = np.arange(24) * 2 * np.pi / 24
    world = fc.World(((-1, -1, 0), (1, 1, 2)), device=device, method=method)
    ring = np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.full(24, 0.35)], axis=-1)
    world.add(position=ring, radius=0.05, mass=np.inf, friction=0.5)
    world.add(position=(0, 0, 0.5), radius=0.205, spin=(0, 0, 0.2), friction=0.5)
    worlds = [world]
    for _ in range(3):
        for world in worlds:
            world.step(1, 1e-4)
        assert assert_equal_memory(worlds) == 24
        slides = np.linalg.norm(worlds[-1]._world.save()["contact_slide"].reshape(-1, 3), axis=1)
        np.testing.assert_allclose(slides, slides.max(), rtol=1e-4)
        worlds[0].save(tmp_path / "ring.fc")
        worlds = [worlds[0], fc.World.load(tmp_path / "ring.fc", device=device)]


def test_open_space_far_from_the_origin(device, solver):
    bounds = ((5000, -7000, 900), (5004, -6996, 904))
    spheres = fc.random_spheres(800, bounds, seed=4, radius=(0.1, 0.3), speed=(20, 20, 20))
    assert_equal_steps(all_methods(device, solver, spheres, boundary="open"), (5, 20, 40))


@pytest.mark.parametrize("is_rough", [False, True])
def test_arrays_that_the_user_writes(device, solver, is_rough, write):
    """Spheres that are moved, blown up, fixed and let loose, sped up and added between two steps."""
    if is_rough and solver == "reference":
        pytest.skip("the reference solver has no friction of spheres")
    bounds = ((0, 0, 0), (4, 4, 4))
    spheres = fc.random_spheres(900, bounds, seed=5, radius=(0.05, 0.12))
    worlds = all_methods(device, solver, rough(spheres) if is_rough else spheres, bounds=bounds)
    random = np.random.default_rng(6)
    assert_equal_steps(worlds, (20,))

    def change(name, spheres, values):
        for world in worlds:
            array = getattr(world, name)
            changed = fc.to_numpy(array).copy()
            changed[spheres] = values
            write(array, changed)
        assert_equal_steps(worlds, (1, 2))

    some = random.choice(900, 40, replace=False)
    change("positions", some, random.uniform(0.3, 3.7, (40, 3)))
    change("radii", some, 0.2)
    change("radii", some[:20], 0.3)
    mass = fc.to_numpy(worlds[0].masses)[some]
    change("masses", some, np.inf)
    change("masses", some, mass)
    change("velocities", some, random.uniform(-30, 30, (40, 3)))
    for world in worlds:
        world.add(position=np.linspace((0.5, 0.5, 0.5), (3.5, 3.5, 3.5), 30), radius=0.1)
    assert_equal_steps(worlds, (1, 10))


@pytest.mark.parametrize("is_rough", [False, True])
def test_spheres_that_leave_their_skins(device, solver, is_rough):
    """So fast in so little room that many meet others that no list of theirs knows, and two such meet each other; more
    than there is room for at first, so that frames are done once more."""
    if is_rough and solver == "reference":
        pytest.skip("the reference solver has no friction of spheres")
    bounds = ((0, 0, 0), (8, 8, 8))
    spheres = fc.random_spheres(1200, bounds, seed=1, speed=(40, 40, 40))
    if is_rough:
        spheres = rough(spheres)
    for boundary in ("wall", "periodic"):
        assert_equal_steps(all_methods(device, solver, spheres, bounds=bounds, boundary=boundary), (1, 9, 30), 0.03)


@pytest.mark.parametrize("is_rough", [False, True])
def test_a_pile_that_is_shaken(device, solver, is_rough, write):
    """What rests has lists for several frames: a shake makes strays of many spheres while those lists last, and the
    reference solver flies between two frames with the same lists. All of it moves sideways, and so do skins."""
    if is_rough and solver == "reference":
        pytest.skip("the reference solver has no friction of spheres")
    bounds = ((0, 0, 0), (3, 3, 4))
    spheres = fc.random_spheres(500, bounds, seed=9, radius=(0.06, 0.18), speed=(1, 1, 1))
    if is_rough:
        spheres = rough(spheres)
    boundary = ("periodic", "wall", "wall")
    worlds = all_methods(device, solver, spheres, bounds=bounds, boundary=boundary, drag=3.0)
    assert_equal_steps(worlds, (120, 40))
    velocity = np.random.default_rng(10).uniform(-2, 2, (500, 3)) + (8, 0, 0)
    velocity[::3] *= 3
    for world in worlds:
        world.drag = 0
        write(world.velocities, velocity.astype(np.float32))
    assert_equal_steps(worlds, (16, 3, 21))


def test_the_way_that_a_world_takes_by_itself(device, solver):
    """Fast spheres in little room that slow down: a GPU searches in each pass for a spell, and goes back to lists."""
    bounds = ((0, 0, 0), (10, 10, 10))
    spheres = fc.random_spheres(2400, bounds, seed=1, speed=(40, 40, 40))
    worlds = [fc.World(bounds, device=device, solver=solver, method=method) for method in ("cells", "auto")]
    for world in worlds:
        world.add(spheres)
    assert_equal_steps(worlds, (1, 9, 30), 0.03)
    for world in worlds:
        world.drag = 20
    assert_equal_steps(worlds, (150, 30), 0.01)


def test_more_neighbours_than_a_list_holds(device, solver):
    bounds = ((0, 0, 0), (4, 4, 4))
    worlds = all_methods(
        device, solver, fc.random_spheres(3000, bounds, seed=7, radius=(0.03, 0.06), speed=(3, 3, 3)), bounds=bounds
    )
    for world in worlds:
        world.add(position=[[1.5, 1.5, 2.0], [3.0, 3.0, 1.5]], radius=[1.0, 0.7])
    assert_equal_steps(worlds, (1, 20))


def test_other_lengths_of_a_frame(device, solver):
    worlds = all_methods(device, solver, fc.random_spheres(2000, seed=8))
    for dt in (1 / 60, 1 / 15, 1 / 600, 1 / 60):
        assert_equal_steps(worlds, (3,), dt)


@pytest.mark.parametrize("ratio", [8, 64])
def test_spheres_of_very_different_sizes(device, solver, ratio):
    """The large ones have far more neighbours than a list has room for at first."""
    bounds = ((0, 0, 0), (2, 2, 2))
    small = fc.random_spheres(3000, bounds, seed=9, radius=(0.4 / ratio, 0.4 / ratio))
    worlds = all_methods(device, solver, small, bounds=bounds)
    for world in worlds:
        world.add(position=[(0.5, 0.5, 0.5), (1.5, 1.5, 1.2)], radius=0.4)
    assert_equal_steps(worlds, (1, 10, 20), 1 / 240)


def test_lists_that_are_too_long_for_their_rows(device, solver):
    """Between 96 and 192 neighbours, and strays among them, with the lists of method "frame"."""
    bounds = ((0, 0, 0), (3, 3, 3))
    spheres = fc.random_spheres(9000, bounds, seed=11, radius=(0.03, 0.05), speed=(2, 2, 2))
    worlds = all_methods(device, solver, spheres, bounds=bounds)
    for world in worlds:
        world.add(position=[(0.4, 0.4, 0.4), (1.5, 1.5, 1.2), (2.5, 0.6, 2.0)], radius=0.14)
    assert_equal_steps(worlds, (1, 10, 20), 1 / 60)


@pytest.mark.parametrize("boundary", ["wall", "periodic", "open"])
def test_more_neighbours_than_a_small_world_lists(device, solver, boundary):
    """Two large spheres in a swarm look at all others; lists hold for many frames until the swarm comes down."""
    bounds = ((0, 0, 0), (3, 3, 3))
    spheres = fc.random_spheres(1500, bounds, seed=14, radius=(0.03, 0.05), speed=(0.5, 0.5, 0))
    worlds = all_methods(device, solver, spheres, bounds=bounds, boundary=boundary)
    for world in worlds:
        world.add(position=[(0.9, 0.9, 0.9), (2.2, 2.0, 1.2)], radius=0.7)
    assert_equal_steps(worlds, (1, 10, 40, 60), 1 / 120)


def mixed_spheres(n, ratio, largest_radius, seed=1, fill=0.15):
    """Equal volume in each octave of sizes and one of the largest, in a box that they fill to a part."""
    random = np.random.default_rng(seed)
    radius = largest_radius / ratio * (1 - random.random(n) * (1 - ratio**-3.0)) ** (-1 / 3)
    radius[0] = largest_radius
    edge = (4 / 3 * np.pi * (radius**3).sum() / fill) ** (1 / 3)
    position = random.random((n, 3)) * edge
    velocity = random.normal(0, 1, (n, 3)).astype(np.float32)
    mass = 1000 * 4 / 3 * np.pi * radius**3
    arrays = (position, velocity, radius, mass, np.full(n, 0.8))
    return fc.Spheres(*(array.astype(np.float32) for array in arrays)), edge


@pytest.mark.parametrize("boundary", ["wall", "periodic", "open", ("periodic", "open", "wall")])
@pytest.mark.parametrize("ratio", [16, 100])
def test_levels_of_sizes(device, solver, ratio, boundary):
    """Small spheres in a few of many cells, so that cells far apart share a number; large ones full of small cells."""
    spheres, edge = mixed_spheres(4000, ratio, 0.4)
    bounds = ((-edge, -edge, -edge), (3 * edge, 3 * edge, 3 * edge))
    worlds = all_methods(device, solver, spheres, bounds=bounds, boundary=boundary)
    # One grid for all sizes, whatever the levels of the others.
    worlds.append(fc.World(bounds, boundary, device=device, solver=solver, method="cells", cell_size=1.0))
    worlds[-1].add(spheres)
    counts = {world.contact_count() for world in worlds}
    assert len(counts) == 1
    assert min(counts) > 500
    assert_equal_steps(worlds, (1, 3), 1 / 600)


def test_more_neighbors_than_lists_can_hold(device, solver):
    """Then every pass has a grid of its own again, or one of levels, and nothing is lost."""
    worlds = [fc.World(device=device, solver=solver, method=method) for method in (*METHODS, "auto")]
    centre = np.broadcast_to(np.float32((0, 0, 5)), (5000, 3))
    for world in worlds:
        world.add(position=centre, radius=0.125, mass=np.inf)
        world.add(position=[(0.25 + 0.0003 * i, 0, 5) for i in range(300)], radius=0.25)
    assert_equal_steps(worlds, (1, 1), 1e-4)


@pytest.mark.parametrize("iterations", [4, 5])
def test_spheres_that_pile_up_within_a_call(device, iterations):
    """A run of frames with lists of their own ends as soon as most spheres leave their skins, after an odd or an even
    number of passes; what rough contacts remember goes on."""
    count = 140_000 if device == "cuda" else 1500  # on a GPU, so many that a sphere has one lane
    edge = 4 * (count / 1500) ** 0.5
    bounds = ((0, 0, 0), (edge, edge, 40))
    spheres = rough(fc.random_spheres(count, ((0, 0, 20), (edge, edge, 40)), seed=21, radius=(0.09, 0.18)))
    spheres.velocity[:] = (0, 0, -18)
    worlds = [
        fc.World(bounds, device=device, method=method, iterations=iterations) for method in ("cells", "frame", "auto")
    ]
    for world in worlds:
        world.add(spheres)
    assert_equal_steps(worlds, (40, 71, 50))
    assert assert_equal_memory(worlds) > count // 2


@pytest.mark.parametrize("between", ["look", "add"])
def test_frames_go_on_after_other_work(device, solver, between):
    """On a GPU frames are recorded with the addresses that they use; other work may move them, or need more of them."""
    spheres = fc.random_spheres(34_000, seed=11)
    worlds = [fc.World(device=device, solver=solver, method=method) for method in ("list", "frame")]
    for world in worlds:
        world.add(spheres)
    assert_equal_steps(worlds, (12, 12))  # the first time each frame is started by itself
    for world in worlds:
        if between == "look":
            world.contacts()
        else:
            world.add(fc.random_spheres(20_000, seed=12, radius=(0.05, 0.1)))
    assert_equal_steps(worlds, (12,))


def test_any_number_of_threads_makes_the_same_lists(solver):
    spheres = fc.random_spheres(5000, seed=10)
    hashes = set()
    for threads in (1, 2, 5):
        world = fc.World(solver=solver, device="cpu", threads=threads)
        world.add(spheres)
        world.step(40)
        hashes.add(world.state_hash())
    assert len(hashes) == 1


def test_an_unknown_method_is_refused(device):
    with pytest.raises(
        fc.InvalidValue, match=r'method: found "tree".*"auto", "cells", "list", "frame", "levels" or "small"'
    ):
        fc.World(device=device, method="tree")


def test_too_many_spheres_for_a_small_world(device, solver):
    world = fc.World(device=device, solver=solver, method="small")
    world.add(fc.random_spheres(5000))
    before = world.state_hash()
    with pytest.raises(fc.InvalidValue, match=r'method: found "small" for 5000 spheres; allowed: smooth .*4,096'):
        world.step(1)
    assert (world.frame, world.state_hash()) == (0, before)


def test_rough_spheres_in_a_small_world(device):
    world = fc.World(device=device, method="small")
    world.add(position=[(0, 0, 1)], radius=0.1, friction=0.5)
    with pytest.raises(fc.InvalidValue, match=r'"small" for 1 spheres with friction or spin; allowed: smooth spheres'):
        world.step(1)


@pytest.mark.parametrize("method", methods_for(2))
def test_a_fault_in_the_first_frame_leaves_all_as_it_was(device, solver, method):
    world = fc.World(device=device, solver=solver, method=method, boundary="open", gravity=(0, 0, 0), drag=0)
    world.add(position=[[0, 0, 0], [13000, 0, 0]], radius=0.1, velocity=[[1, 0, 0], [1e6, 0, 0]])
    before = world.state_hash()
    with pytest.raises(fc.SimulationError, match="sphere 1 in frame 1: it is more than 131072 radii"):
        world.step(3)
    assert (world.frame, world.state_hash()) == (0, before)


@pytest.mark.parametrize("method", methods_for(3))
def test_a_fault_tells_its_frame(device, solver, method, write):
    """Also where several frames have the same lists, as those of spheres at rest have."""
    world = fc.World(device=device, solver=solver, method=method, boundary="open", gravity=(0, 0, 0), drag=0)
    world.add(position=[[0, 0, 0], [0, 0, 3], [13000, 0, 0]], radius=0.1)
    for _ in range(8):
        world.step(8)
    write(world.velocities, np.array([[0, 0, 0], [0, 0, 0], [960, 0, 0]], np.float32))  # 16 m a frame, 107.2 m to go
    with pytest.raises(fc.SimulationError, match="sphere 2 in frame 71: it is more than 131072 radii"):
        world.step(10)
    assert world.frame == 70


def test_a_short_period(device, solver):
    """Four largest radii: what is within a list's reach is so in more than one image."""
    bounds = ((-1, 0, 0), (1, 2, 20))
    spheres = fc.random_spheres(120, bounds, seed=5, radius=(0.1, 0.5))
    worlds = all_methods(device, solver, spheres, bounds=bounds, boundary=("periodic", "periodic", "wall"))
    assert_equal_steps(worlds, (1, 9, 50))
