"""What a world may change between two frames, and what it refuses."""

import fastcollide as fc
import numpy as np
import pytest


def falling_world(device, **options):
    world = fc.World(device=device, drag=0.0, **options)
    world.add(position=[(0, 0, 10), (3, 0, 10)], radius=0.2)
    return world


def test_a_changed_world_goes_on_as_one_that_was_made_so(device):
    conditions = {
        "gravity": (1.0, 0.0, -3.0),
        "drag": 0.5,
        "floor_restitution": 0.9,
        "wall_friction": 0.2,
    }
    changed, made = falling_world(device), fc.World(device=device, **conditions)
    made.add(position=[(0, 0, 10), (3, 0, 10)], radius=0.2, restitution=0.9, friction=0.3)
    for name, value in conditions.items():
        setattr(changed, name, value)
    changed.set_restitution(0.9)
    changed.set_friction(0.3)

    changed.step(200)
    made.step(200)

    assert changed.state_hash() == made.state_hash()
    assert {name: getattr(changed, name) for name in conditions} == conditions
    assert changed.energy() == made.energy()


@pytest.mark.parametrize("name", ["gravity", "drag", "floor_restitution", "wall_friction"])
def test_each_change_alone_acts_from_the_next_frame(device, name):
    values = {"gravity": (0, 0, 1), "drag": 2.0, "floor_restitution": 0.1, "wall_friction": 0.8}
    worlds = [falling_world(device), falling_world(device)]
    for world in worlds:
        world.add(position=(0, 3, 0.6), radius=0.3, velocity=(4, 0, -2))
        world.step(1)
    setattr(worlds[1], name, values[name])
    for world in worlds:
        world.step(20)

    assert worlds[0].state_hash() != worlds[1].state_hash()


def test_a_change_is_saved(device, tmp_path):
    world = falling_world(device)
    world.gravity = (0, 0, 2)
    world.drag = 0.25
    world.step(5)
    world.save(tmp_path / "world.fcw")
    loaded = fc.World.load(tmp_path / "world.fcw", device=device)
    for one in (world, loaded):
        one.step(50)

    assert (loaded.gravity, loaded.drag) == ((0, 0, 2), 0.25)
    assert loaded.state_hash() == world.state_hash()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("gravity", (0, 0, float("nan")), r"gravity\[2\]: found nan"),
        ("gravity", (0, 1), "gravity: found an array of shape"),
        ("drag", -1.0, "drag: found -1"),
        ("floor_restitution", 1.5, "floor_restitution: found 1.5"),
        ("wall_friction", -0.1, "wall_friction: found -0.1"),
    ],
)
def test_a_bad_value_is_refused_and_the_old_one_stays(device, name, value, message):
    world, same = falling_world(device), falling_world(device)
    before = getattr(world, name)
    with pytest.raises(fc.InvalidValue, match=message):
        setattr(world, name, value)
    world.step(10)
    same.step(10)

    assert getattr(world, name) == before
    assert world.state_hash() == same.state_hash()


def test_surfaces_out_of_range_are_refused(device):
    world = falling_world(device)
    with pytest.raises(fc.InvalidValue, match=r"restitution: found 1\.5; allowed: 0 to 1"):
        world.set_restitution(1.5)
    with pytest.raises(fc.InvalidValue, match="friction: found -1"):
        world.set_friction(-1)
    assert not world.has_spin
    assert np.all(fc.to_numpy(world.restitutions) == np.float32(0.6))


def test_the_reference_solver_has_no_friction_of_spheres_later_either(device):
    world = falling_world(device, solver="reference")
    with pytest.raises(fc.InvalidValue, match="the reference solver has no friction of spheres"):
        world.set_friction(0.5)
    world.set_friction(0.0)
    world.step(2)


def test_has_spin_tells_whether_there_is_memory_for_it(device):
    world = falling_world(device)
    assert not world.has_spin
    world.add(position=(0, 3, 3), radius=0.3, friction=0.5)
    assert world.has_spin
