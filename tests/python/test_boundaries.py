"""What boundaries are accepted, and which spheres each lets in."""

import fastcollide as fc
import numpy as np
import pytest

BOUNDS = ((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
OUTSIDE = np.nextafter(np.float32(2), np.float32(3))
each_axis = pytest.mark.parametrize("axis", [0, 1, 2])


def one_of(axis, name, other):
    return tuple(name if i == axis else other for i in range(3))


def place(axis, x):
    position = np.zeros((2, 3), np.float32)
    position[1, axis] = x
    return position


def test_walls_are_the_default(device):
    named, default = (fc.World(bounds=BOUNDS, device=device, **options) for options in ({"boundary": "wall"}, {}))
    for world in (named, default):
        world.add(fc.random_spheres(50, BOUNDS, 51))
        world.step(20)
    assert named.state_hash() == default.state_hash()


def test_one_name_stands_for_three(device):
    for name in ("wall", "periodic", "open"):
        worlds = [fc.World(bounds=BOUNDS, boundary=b, device=device) for b in (name, (name,) * 3, [name] * 3)]
        for world in worlds:
            world.add(fc.random_spheres(50, BOUNDS, 52))
            world.step(20)
        assert len({world.state_hash() for world in worlds}) == 1


@each_axis
@pytest.mark.parametrize("name", ["walls", "Periodic", "", "open "])
def test_an_unknown_name_is_refused(device, axis, name):
    with pytest.raises(fc.InvalidValue, match=f'"{name}".*"wall", "periodic" or "open"') as error:
        fc.World(boundary=one_of(axis, name, "open"), device=device)
    assert (error.value.field, error.value.index) == ("boundary", axis)


def test_an_unknown_name_for_all_axes_is_refused(device):
    with pytest.raises(fc.InvalidValue, match='"closed"') as error:
        fc.World(boundary="closed", device=device)
    assert error.value.field == "boundary"


@pytest.mark.parametrize("boundary", [("wall", "open"), ("wall",) * 4, (), None, 3, ("wall", None, "open")])
def test_anything_but_one_or_three_names_is_refused(device, boundary):
    with pytest.raises(fc.InvalidValue, match="boundary") as error:
        fc.World(boundary=boundary, device=device)
    assert error.value.field == "boundary"


@each_axis
@pytest.mark.parametrize("name", ["wall", "periodic"])
@pytest.mark.parametrize("x", [OUTSIDE, -OUTSIDE, 100])
def test_a_sphere_outside_the_bounds_is_refused(device, axis, name, x):
    world = fc.World(bounds=BOUNDS, boundary=one_of(axis, name, "open"), device=device)
    with pytest.raises(fc.InvalidValue, match="inside the bounds") as error:
        world.add(position=place(axis, x), radius=0.25)
    assert (error.value.field, error.value.index) == ("position", 1)
    assert len(world) == 0


@each_axis
@pytest.mark.parametrize("x", [OUTSIDE, -OUTSIDE, 100, -32768, 32768])
@pytest.mark.parametrize("other", ["wall", "periodic"])
def test_but_not_along_an_open_axis(device, axis, x, other):
    world = fc.World(bounds=BOUNDS, boundary=one_of(axis, "open", other), gravity=(0, 0, 0), device=device)
    world.add(position=place(axis, x), radius=0.25)
    world.step(1)
    assert fc.to_numpy(world.positions).tolist() == place(axis, x).tolist()


@each_axis
def test_the_bounds_themselves_are_inside(device, axis):
    world = fc.World(bounds=BOUNDS, boundary="periodic", gravity=(0, 0, 0), device=device)
    world.add(position=place(axis, 2.0), radius=0.25)
    world.step(1)
    assert fc.to_numpy(world.positions).tolist() == place(axis, -2.0).tolist()


@each_axis
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_sphere_beyond_reach_is_refused(device, write, axis, sign):
    """131,072 of its own radii, whatever the others'."""
    world = fc.World(bounds=BOUNDS, boundary=one_of(axis, "open", "periodic"), gravity=(0, 0, 0), device=device)
    beyond = place(axis, sign * np.nextafter(np.float32(32768), np.float32(40000)))
    with pytest.raises(fc.InvalidValue, match="along an open axis up to 131072 radii") as error:
        world.add(position=beyond, radius=[1.0, 0.25])
    assert (error.value.field, error.value.index) == ("position", 1)

    world.add(position=place(axis, sign * 32768), radius=[1.0, 0.25])
    write(world.positions, beyond)
    for use in (world.step, world.contacts, world.max_overlap):
        with pytest.raises(fc.InvalidValue, match="131072 radii") as error:
            use()
        assert (error.value.field, error.value.index) == ("position", 1)


@each_axis
def test_the_largest_radius_of_each_boundary(device, write, axis):
    """A quarter of the period, half of the distance of two walls; none of an open axis."""
    bounds = ((-8.0, -8.0, -8.0), tuple(-4.0 if i == axis else 8.0 for i in range(3)))
    center = (-6.0,) * 3
    for name, other, largest in (("periodic", "wall", 1.0), ("wall", "periodic", 2.0), ("open", "periodic", 4.0)):
        larger = np.nextafter(np.float32(largest), np.float32(9))
        world = fc.World(bounds=bounds, boundary=one_of(axis, name, other), device=device)
        with pytest.raises(fc.InvalidValue, match=f"to {largest:g} m in this box") as error:
            world.add(position=[center, center], radius=[0.5, larger])
        assert (error.value.field, error.value.index) == ("radius", 1)

        world.add(position=[center, center], radius=[0.5, largest])
        world.step(1)
        write(world.radii, [0.5, larger])
        with pytest.raises(fc.InvalidValue) as error:
            world.step(1)
        assert (error.value.field, error.value.index) == ("radius", 1)


def test_an_open_axis_needs_no_bounds(device):
    nan, inf = float("nan"), float("inf")
    world = fc.World(bounds=((5, nan, -inf), (-5, nan, inf)), boundary="open", gravity=(0, 0, 0), device=device)
    world.add(position=[(-9, 1, 0), (-9, 1.5, 0)], radius=[1e-3, 1])
    assert world.contact_count() == 1
    world.step(1)
    assert np.isfinite(fc.to_numpy(world.positions)).all()

    for name in ("wall", "periodic"):
        with pytest.raises(fc.InvalidValue) as error:
            fc.World(bounds=((5, nan, -1), (-5, nan, 1)), boundary=("open", name, name), device=device)
        assert (error.value.field, error.value.index) == ("bounds", 1)


@pytest.mark.parametrize("boundary", ["periodic", "open", ("wall", "open", "periodic")])
def test_a_random_start(device, boundary):
    world = fc.World(boundary=boundary, device=device)
    ids = world.add(fc.random_spheres(500, seed=53))
    world.step(10)
    assert (len(ids), world.frame) == (500, 10)
    assert np.isfinite(fc.to_numpy(world.positions)).all()
