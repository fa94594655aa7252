"""Bad input: one typed error that names the field, the index and what is allowed, and a world as it was before."""

import pickle

import fastcollide as fc
import numpy as np
import pytest

NAN, INFINITY = float("nan"), float("inf")


def label(value):
    """Name of a case."""
    return " ".join(f"{key}={item}" for key, item in value.items()) if isinstance(value, dict) else str(value)


def assert_readable(error, field, index):
    """The message names the field and says what is allowed."""
    message = str(error.value)
    assert error.value.field == field, message
    assert error.value.index == index, message
    assert field in message
    assert "found" in message
    assert "allowed" in message
    assert "\n" not in message
    assert isinstance(error.value, ValueError)


@pytest.mark.parametrize(
    ("options", "field", "index"),
    [
        ({"gravity": (0, 0)}, "gravity", None),
        ({"gravity": (0, NAN, 0)}, "gravity", 1),
        ({"gravity": (0, 0, 1e39)}, "gravity", 2),
        ({"drag": -0.1}, "drag", None),
        ({"drag": NAN}, "drag", None),
        ({"drag": INFINITY}, "drag", None),
        ({"floor_restitution": -0.01}, "floor_restitution", None),
        ({"floor_restitution": 1.01}, "floor_restitution", None),
        ({"floor_restitution": NAN}, "floor_restitution", None),
        ({"wall_friction": -1}, "wall_friction", None),
        ({"wall_friction": NAN}, "wall_friction", None),
        ({"rolling_friction": -0.1}, "rolling_friction", None),
        ({"rolling_friction": NAN}, "rolling_friction", None),
        ({"rolling_friction": 2e6}, "rolling_friction", None),
        ({"solver": "magic"}, "solver", None),
        ({"iterations": 0}, "iterations", None),
        ({"iterations": 1001}, "iterations", None),
        ({"cell_size": 0}, "cell_size", None),
        ({"cell_size": -1}, "cell_size", None),
        ({"cell_size": NAN}, "cell_size", None),
        ({"cell_size": INFINITY}, "cell_size", None),
        ({"threads": -1}, "threads", None),
        ({"threads": 1025}, "threads", None),
        ({"device": "gpu"}, "device", None),
        ({"device": "cuda:"}, "device", None),
        ({"device": "cuda:one"}, "device", None),
        ({"device": ""}, "device", None),
        ({"block_size": 0}, "block_size", None),
        ({"block_size": 33}, "block_size", None),
        ({"block_size": 1056}, "block_size", None),
        ({"bounds": (0, 1)}, "bounds", None),
        ({"bounds": ((0, 0, 0), (1, 1))}, "bounds", None),
        ({"bounds": ((0, 0, 0), (1, 0, 1))}, "bounds", 1),
        ({"bounds": ((0, 0, 5), (1, 1, 4))}, "bounds", 2),
        ({"bounds": ((NAN, 0, 0), (1, 1, 1))}, "bounds", 0),
        ({"bounds": ((0, 0, 0), (1, 1, INFINITY))}, "bounds", 2),
        ({"bounds": ((-3e38, -1, -1), (3e38, 1, 1))}, "bounds", 0),
    ],
    ids=label,
)
def test_a_world_refuses(options, field, index):
    with pytest.raises(fc.InvalidValue) as error:
        fc.World(**options)
    assert_readable(error, field, index)


@pytest.mark.parametrize(
    "options",
    [{"iterations": 2.5}, {"iterations": "5"}, {"threads": 1.5}, {"drag": "much"}, {"device": 0}, {"gravity": "down"}],
    ids=label,
)
def test_a_world_refuses_other_types(options):
    with pytest.raises((TypeError, ValueError)):
        fc.World(**options)


GOOD = {"position": [(0, 0, 5), (1, 1, 5), (2, 2, 5)], "radius": 0.1}


@pytest.mark.parametrize(
    ("change", "field", "index"),
    [
        ({"position": [(0, 0, 5), (0, 0, NAN), (0, 0, INFINITY)]}, "position", 1),
        ({"position": [(0, 0, 5), (1, 0, 5), (0, INFINITY, 5)]}, "position", 2),
        ({"position": [(0, 0, 5), (0, 0, 20.001), (0, 0, 5)]}, "position", 1),
        ({"position": [(-10.001, 0, 5), (0, 0, 5), (0, 0, 5)]}, "position", 0),
        ({"position": [(0, 0), (1, 1), (2, 2)]}, "position", None),
        ({"position": [(0, 0, 5), (1, 1)]}, "position", None),
        ({"position": "here"}, "position", None),
        ({"position": None}, "position", None),
        ({"position": (1j, 0, 5)}, "position", None),
        ({"radius": None}, "radius", None),
        ({"radius": [0.1, 0.1]}, "radius", None),
        ({"radius": [0.1, 0.1, 0.0]}, "radius", 2),
        ({"radius": [0.1, -0.1, 0.1]}, "radius", 1),
        ({"radius": [NAN, 0.1, 0.1]}, "radius", 0),
        ({"radius": [0.1, 10.001, 0.1]}, "radius", 1),
        ({"radius": [0.1, 0.1, 1e-5]}, "radius", 2),
        ({"radius": 1e39}, "radius", 0),
        ({"velocity": [(0, 0, 0), (0, 0, 0), (0, NAN, 0)]}, "velocity", 2),
        ({"velocity": (0, 0, 1e39)}, "velocity", 0),
        ({"velocity": (0, 0)}, "velocity", None),
        ({"density": [1, 1, 0]}, "density", 2),
        ({"density": -1.0}, "density", 0),
        ({"density": NAN}, "density", 0),
        ({"mass": [1, 0, 1]}, "mass", 1),
        ({"mass": [1, 1, NAN]}, "mass", 2),
        ({"mass": [1, -INFINITY, 1]}, "mass", 1),
        ({"mass": [1, 1, 1.1e38]}, "mass", 2),
        ({"mass": 1e39}, "mass", 0),
        ({"density": [1, 1e38, 1], "radius": 5.0}, "mass", 1),
        ({"mass": -1}, "mass", 0),
        ({"restitution": [0.5, 0.5, 1.001]}, "restitution", 2),
        ({"restitution": -0.001}, "restitution", 0),
        ({"restitution": NAN}, "restitution", 0),
        ({"restitution": True}, "restitution", None),
    ],
    ids=label,
)
def test_add_refuses_and_adds_nothing(device, change, field, index):
    world = fc.World(device=device)
    world.add(fc.random_spheres(100))
    before = world.state_hash()

    with pytest.raises(fc.InvalidValue) as error:
        world.add(**{**GOOD, **change})

    assert_readable(error, field, index)
    assert (len(world), world.state_hash()) == (100, before)
    world.add(**GOOD)  # and the world is as usable as before
    world.step(1)


def test_spheres_of_unequal_lengths_are_refused(device):
    spheres = fc.random_spheres(5)
    world = fc.World(device=device)
    for field in ("position", "velocity", "mass", "restitution"):
        arrays = dict(vars(spheres))
        arrays[field] = arrays[field][:4]
        with pytest.raises(fc.InvalidValue) as error:
            world.add(fc.Spheres(**arrays))
        assert error.value.field == field
    assert len(world) == 0


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"frames": -1}, "frames"),
        ({"dt": 0}, "dt"),
        ({"dt": -1 / 60}, "dt"),
        ({"dt": NAN}, "dt"),
        ({"dt": INFINITY}, "dt"),
        ({"dt": 1e-10}, "dt"),
    ],
    ids=label,
)
@pytest.mark.parametrize("count", [0, 10])
def test_step_refuses(device, arguments, field, count):
    world = fc.World(device=device)
    world.add(fc.random_spheres(count))
    before = world.state_hash()
    with pytest.raises(fc.InvalidValue) as error:
        world.step(**arguments)
    assert_readable(error, field, None)
    assert (world.frame, world.time, world.state_hash()) == (0, 0, before)


@pytest.mark.parametrize(
    ("name", "value", "field"),
    [
        ("positions", NAN, "position"),
        ("positions", INFINITY, "position"),
        ("velocities", NAN, "velocity"),
        ("velocities", -INFINITY, "velocity"),
        ("radii", NAN, "radius"),
        ("radii", 0, "radius"),
        ("radii", 10.5, "radius"),
        ("masses", 0, "mass"),
        ("masses", NAN, "mass"),
        ("masses", -INFINITY, "mass"),
        ("masses", 1.1e38, "mass"),
        ("restitutions", 1.5, "restitution"),
        ("restitutions", NAN, "restitution"),
    ],
    ids=label,
)
def test_numbers_written_out_of_range_are_refused(device, write, name, value, field):
    world = fc.World(device=device)
    world.add(fc.random_spheres(1000))
    good = fc.to_numpy(getattr(world, name)).copy()
    bad = good.copy()
    bad.reshape(1000, -1)[[421, 900], -1] = value
    write(getattr(world, name), bad)
    before = world.state_hash()

    for use in (world.step, world.contacts, world.contact_count, world.max_overlap):
        with pytest.raises(fc.InvalidValue) as error:
            use()
        assert_readable(error, field, 421)

    assert (world.frame, world.state_hash()) == (0, before)
    write(getattr(world, name), good)
    world.step(1)
    assert world.frame == 1


@pytest.mark.parametrize(
    ("arguments", "field", "index"),
    [
        ({"count": -1}, "count", None),
        ({"seed": -1}, "seed", None),
        ({"seed": 2**64}, "seed", None),
        ({"radius": (0.0, 0.4)}, "radius", 0),
        ({"radius": (0.4, 0.3)}, "radius", 1),
        ({"radius": (0.4, 11.0)}, "radius", 1),
        ({"radius": (0.1, NAN)}, "radius", 1),
        ({"speed": (1, -1, 1)}, "speed", 1),
        ({"restitution": (-0.1, 0.5)}, "restitution", 0),
        ({"restitution": (0.5, 0.4)}, "restitution", 1),
        ({"restitution": (0.5, 1.1)}, "restitution", 1),
        ({"density": 0}, "density", None),
        ({"density": NAN}, "density", None),
        ({"bounds": ((0, 0, 0), (1, 1, -1))}, "bounds", 2),
        ({"device": "tpu"}, "device", None),
    ],
    ids=label,
)
def test_random_spheres_refuses(arguments, field, index):
    with pytest.raises(fc.InvalidValue) as error:
        fc.random_spheres(**{"count": 10, **arguments})
    assert_readable(error, field, index)


@pytest.mark.parametrize(
    ("damping", "fps"), [(0, 60), (1.5, 60), (-0.1, 60), (NAN, 60), (0.9, 0), (0.9, -1), (0.9, NAN)]
)
def test_drag_from_damping_refuses(damping, fps):
    with pytest.raises(fc.InvalidValue):
        fc.drag_from_damping(damping, fps)


# --- Devices ---


@pytest.mark.skipif(len(fc.devices()) > 1, reason="there is a GPU")
@pytest.mark.parametrize("name", ["cuda", "cuda:0"])
def test_a_gpu_that_is_not_there(name):
    for use in (lambda: fc.World(device=name), lambda: fc.random_spheres(5, device=name)):
        with pytest.raises(fc.DeviceError, match=f'device "{name}" is not there.*found "cpu"'):
            use()


def test_a_device_number_that_is_not_there():
    with pytest.raises(fc.DeviceError, match=r'"cuda:99" is not there.*found "cpu"'):
        fc.World(device="cuda:99")


def test_more_memory_than_a_gpu_has(gpu):
    world = fc.World(device=gpu)
    world.add(position=np.zeros((2**18, 3)) + (0, 0, 5), radius=0.1)
    with pytest.raises(fc.OutOfMemory, match="out of memory on cuda:0"):
        world.contacts()  # 2³⁵ pairs
    assert world.contact_count() == 2**18 * (2**18 - 1) // 2
    fc.World(device=gpu).add(fc.random_spheres(10))


# --- Simulations that leave their range ---


def too_fast(device, arrival):
    """A light sphere that waits at a wall, and a heavy one so fast that its rebound off that wall in frame `arrival`
    changes the speed of the light one by more than the reference solver's range, 512 radii a frame."""
    bounds = ((-5000,) * 3, (5000,) * 3)
    world = fc.World(bounds=bounds, gravity=(0, 0, 0), drag=0.0, solver="reference", device=device)
    speed = 1e5
    start = 5000 - 0.4 - speed / 60 * (arrival - 0.5)
    world.add(
        position=[(start, 0, 0), (0, 50, 0), (4999.2, 0, 0)], velocity=[(speed, 0, 0), (0, 0, 0), (0, 0, 0)],
        radius=[0.4, 0.4, 0.4], mass=[1e6, 1, 1], restitution=1.0,
    )  # fmt: skip
    return world


@pytest.mark.parametrize("arrival", [1, 4])
def test_a_collision_too_fast_for_the_solver_names_sphere_and_frame(device, arrival):
    world = too_fast(device, arrival)
    with pytest.raises(fc.SimulationError, match=f"sphere 2 in frame {arrival}: "):
        world.step(10)


@pytest.mark.parametrize("arrival", [1, 3])
def test_a_resting_contact_too_fast_for_the_default_solver(device, arrival):
    """A heavy sphere at 100 km/s, in a light one on the floor at the start of frame `arrival`: an impact of one that is
    held takes the way of resting contacts, whose changes of velocity have a range."""
    world = fc.World(((-5000, -5, 0), (5000, 5, 10)), drag=0.0, device=device)
    start = -0.5 - 1e5 / 60 * (arrival - 1)
    world.add(position=(0, 3, 0.4), radius=0.4)
    world.add(
        position=[(start, 0, 0.625), (0, 0, 0.3999)], velocity=[(1e5, 0, 0), (0, 0, 0)], radius=0.4, mass=[1e6, 1]
    )
    with pytest.raises(fc.SimulationError, match=rf"sphere 2 in frame {arrival}: .* more than 512 radii"):
        world.step(10)
    assert world.frame == arrival - 1


def test_too_many_contacts_on_one_sphere(device, solver):
    """2²¹ are the most whose sum is exact. Fixed spheres in one place, which do not collide with each other."""
    most = 2**21
    for count in (most, most + 1):
        world = fc.World(gravity=(0, 0, -1), solver=solver, iterations=1, device=device)
        world.add(position=(0.25, 0, 5), radius=0.25)
        world.add(position=np.broadcast_to(np.float32((0, 0, 5)), (count, 3)), radius=0.125, mass=INFINITY)
        if count == most:
            world.step(1, 1e-6)
        else:
            with pytest.raises(
                fc.SimulationError, match=f"sphere 0 in frame 1: more than {most} contacts on one sphere"
            ):
                world.step(1, 1e-6)
            assert fc.to_numpy(world.positions)[0].tolist() == [0.25, 0, 5]


def test_the_frame_named_counts_from_the_start_of_the_world(device):
    world = too_fast(device, 4)
    world.step(2)
    with pytest.raises(fc.SimulationError, match="sphere 2 in frame 4: "):
        world.step(10)


def test_after_a_failed_frame_the_world_stands_before_it(device):
    """At the last whole frame, on every device, so that the user can look at it and go on with a smaller dt."""
    world, expected = too_fast(device, 4), too_fast(device, 4)
    expected.step(3)
    with pytest.raises(fc.SimulationError):
        world.step(10)
    assert (world.frame, world.state_hash()) == (3, expected.state_hash())


def test_a_sphere_that_leaves_the_finite_numbers_is_named(device, solver):
    world = fc.World(gravity=(0, 0, 0), drag=0.0, solver=solver, device=device)
    world.add(position=[(0, 0, 5), (0, 0, 9)], radius=0.1, velocity=[(0, 0, 0), (3e38, 0, 0)])
    with pytest.raises(fc.SimulationError, match="sphere 1 in frame 1: position or velocity is no longer a finite"):
        world.step(1, dt=1000.0)


# --- The errors themselves ---


def test_kinds():
    assert issubclass(fc.InvalidValue, ValueError)
    assert issubclass(fc.DeviceError, RuntimeError)
    assert issubclass(fc.SimulationError, RuntimeError)
    assert issubclass(fc.OutOfMemory, MemoryError)


def test_errors_travel_between_processes():
    error = pickle.loads(pickle.dumps(fc.InvalidValue("radius[3]: found -1; allowed: more", "radius", 3)))
    assert (str(error), error.field, error.index) == ("radius[3]: found -1; allowed: more", "radius", 3)
    for kind in (fc.DeviceError, fc.SimulationError, fc.OutOfMemory):
        assert str(pickle.loads(pickle.dumps(kind("what happened")))) == "what happened"
