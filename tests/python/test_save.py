"""Saved worlds: what comes back, what follows, and files that are not as they must be."""

import inspect
import io
import json
import os
import pickle
import struct
import zipfile
import zlib
from contextlib import suppress
from functools import partial

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import files
from hypothesis import given, settings
from hypothesis import strategies as st

SMALL_BOX = ((-2, -2, 0), (2, 2, 3))


def make_world(device="cpu", *, is_rough=False, count=600, **options):
    world = fc.World(**{"bounds": SMALL_BOX, "device": device, **options})
    spheres = fc.random_spheres(count, bounds=SMALL_BOX, radius=(0.05, 0.2), friction=0.4 if is_rough else 0.0, seed=5)
    world.add(spheres)
    return world


def reload(world, path, **where):
    world.save(path)
    return fc.World.load(path, **{"device": "cpu", **where})


def assert_same(found, expected):
    assert found.state_hash() == expected.state_hash()
    assert (len(found), found.frame, found.time) == (len(expected), expected.frame, expected.time)
    for name in ("fast_spheres", "safe_iterations", "safe_dt"):
        assert getattr(found, name) == getattr(expected, name)


OPTIONS = [
    {"bounds": ((-2, -2, -0.1), (2, 2.5, 3))},
    {"bounds": ((-2, -2, 0), (2, 2, float("inf"))), "boundary": ("wall", "wall", "open")},
    {"boundary": "periodic"},
    {"boundary": ("wall", "periodic", "open")},
    {"gravity": (0.1, np.float32(0.2), -3)},
    {"drag": 0.0},
    {"drag": np.float32(0.3)},
    {"floor_restitution": 0.1},
    {"wall_friction": 0.7},
    {"rolling_friction": 0.2},
    {"solver": "reference"},
    {"iterations": 3},
    {"iterations": np.int64(8)},
    {"cell_size": 0.9},
    {"method": "cells"},
    {"method": "list"},
    {"block_size": 64},
]


def test_every_option_is_among_those_that_come_back():
    options = set(inspect.signature(fc.World).parameters) - {"device", "threads"}
    assert {name for change in OPTIONS for name in change} == options


@pytest.mark.parametrize("change", OPTIONS, ids=str)
def test_options_come_back(tmp_path, change):
    world = make_world(is_rough=change.get("solver") != "reference", **change)
    world.step(40)
    loaded = reload(world, tmp_path / "world.fcw")
    assert (loaded.bounds, loaded.solver) == (world.bounds, world.solver)
    as_text = partial(json.dumps, default=lambda number: number.item())
    assert as_text(loaded._options) == as_text(world._options)
    assert_same(loaded, world)
    for one in (world, loaded):
        one.step(40)
    assert_same(loaded, world)


@pytest.mark.parametrize("method", ["cells", "list"])
@pytest.mark.parametrize("is_rough", [False, True])
@pytest.mark.parametrize("boundary", ["wall", ("periodic", "wall", "wall"), "open"])
def test_going_on_is_as_never_stopping(tmp_path, device, solver, method, is_rough, boundary):
    is_rough = is_rough and solver == "substep"
    straight = make_world(is_rough=is_rough, solver=solver, method=method, boundary=boundary, threads=1)
    straight.step(120)
    stopped = make_world(device, is_rough=is_rough, solver=solver, method=method, boundary=boundary)
    for frames, where in ((1, {"threads": 2}), (37, {"device": device}), (22, {"threads": 1}), (60, None)):
        stopped.step(frames)
        if where:
            stopped = reload(stopped, tmp_path / "world.fcw", **where)
    assert_same(stopped, straight)


def test_what_the_solver_remembers_decides_what_follows():
    # Without it the next frames differ: this scene can show its loss.
    world = make_world()
    world.step(60)
    state = world._world.save()
    assert state["crowding"].shape == (len(world),)
    assert (state["crowding"] > 0).any()
    del state["crowding"]
    forgetful = fc.World(bounds=SMALL_BOX, device="cpu")
    forgetful._world.restore(**state)
    assert forgetful.state_hash() == world.state_hash()
    for one in (world, forgetful):
        one.step(5)
    assert forgetful.state_hash() != world.state_hash()


def test_what_rough_contacts_remember_decides_what_follows(tmp_path, device):
    world = make_world(device, is_rough=True, rolling_friction=0.1)
    world.step(120)
    state = world._world.save()
    known = len(state["contact_owner"])
    assert known > len(world) / 2
    assert state["contact_slide"].shape == state["contact_roll"].shape == (known, 3)
    assert (np.abs(state["contact_slide"]) > 0).any()
    loaded = reload(world, tmp_path / "world.fcw", device=device)
    state["contact_slide"][:] = 0
    forgetful = fc.World(bounds=SMALL_BOX, rolling_friction=0.1, device=device)
    forgetful._world.restore(**state)
    for one in (world, loaded, forgetful):
        one.step(5)
    assert loaded.state_hash() == world.state_hash() != forgetful.state_hash()


def test_the_clock_goes_on(tmp_path, device):
    world = make_world(device)
    world.step(7, dt=1 / 60)
    world.step(3, dt=1 / 90)
    loaded = reload(world, tmp_path / "world.fcw", device=device)
    for one in (world, loaded):
        one.step(5, dt=1 / 90)
        one.step(2, dt=1 / 30)
    assert_same(loaded, world)


def test_fast_spheres_are_still_counted(tmp_path, device):
    world = make_world(device)
    world.add(position=(0, 0, 2.5), radius=0.05, velocity=(0, 0, -100))
    world.step(3)
    loaded = reload(world, tmp_path / "world.fcw", device=device)
    assert loaded.fast_spheres == world.fast_spheres > 0
    assert_same(loaded, world)
    for one in (world, loaded):
        one.step(3)
    assert_same(loaded, world)


@pytest.mark.parametrize("frames", [0, 10])
def test_an_empty_and_a_fresh_world(tmp_path, device, solver, frames):
    empty = fc.World(device=device, solver=solver)
    fresh = make_world(device, solver=solver)
    empty.step(frames)
    for world in (empty, fresh):
        loaded = reload(world, tmp_path / "world.fcw", device=device)
        assert_same(loaded, world)
        for one in (world, loaded):
            assert one.add(position=(0, 0, 2.9), radius=0.1).tolist() == [len(one) - 1]
            one.step(20)
        assert_same(loaded, world)


def test_fixed_spheres_may_have_left_the_box(tmp_path, device, solver):
    world = make_world(device, solver=solver)
    world.add(position=(0, 0, 2.5), radius=0.1, velocity=(0, 0, 5), mass=np.inf)
    world.step(30)
    assert fc.to_numpy(world.positions)[-1, 2] > 3
    loaded = reload(world, tmp_path / "world.fcw", device=device)
    for one in (world, loaded):
        one.step(30)
    assert_same(loaded, world)


def test_arrays_that_were_written_to_are_saved(tmp_path, device, write):
    world = make_world(device)
    world.step(10)
    write(world.velocities, 0.5)
    write(world.spins, 2.0)
    loaded = reload(world, tmp_path / "world.fcw", device=device)
    np.testing.assert_array_equal(fc.to_numpy(loaded.spins), 2.0)
    for one in (world, loaded):
        one.step(10)
    assert_same(loaded, world)


def test_equal_worlds_give_equal_files(tmp_path):
    for name in ("one", "two"):
        world = make_world(is_rough=True)
        world.step(10)
        world.save(tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_saving_changes_nothing(tmp_path, device, write):
    world = make_world(device, boundary="periodic")
    world.step(10)
    outside = fc.to_numpy(world.positions) + np.float32(4.0)  # the next step brings them in
    write(world.positions, outside)
    before = world.state_hash()
    world.save(tmp_path / "world.fcw")
    assert world.state_hash() == before
    assert "spin" not in world._world.save()  # nor does it make room for what the world does not keep


def test_a_world_that_cannot_go_on_is_not_saved(tmp_path, device, write):
    world = make_world(device)
    path = tmp_path / "world.fcw"
    world.save(path)
    good = path.read_bytes()
    write(world.velocities, np.nan)
    with pytest.raises(fc.InvalidValue, match=r"velocity\[0\]"):
        world.save(path)
    assert path.read_bytes() == good


def test_numpy_opens_it(tmp_path):
    world = make_world(is_rough=True)
    world.save(tmp_path / "world.fcw")
    with np.load(tmp_path / "world.fcw") as file:
        for name, array in (("position", world.positions), ("friction", world.frictions), ("mass", world.masses)):
            np.testing.assert_array_equal(file[name], array)


def test_where_it_goes_on_is_the_caller_s(tmp_path):
    make_world().save(tmp_path / "world.fcw")
    with pytest.raises(fc.DeviceError):
        fc.World.load(tmp_path / "world.fcw", device="cuda:99")
    with pytest.raises(fc.InvalidValue, match="threads"):
        fc.World.load(tmp_path / "world.fcw", device="cpu", threads=-1)
    with pytest.raises(FileNotFoundError):
        fc.World.load(tmp_path / "nothing.fcw")


# --- Whole or not there ---


def test_a_write_that_fails_leaves_the_file_before(tmp_path, monkeypatch):
    path = tmp_path / "world.fcw"
    world = make_world()
    world.save(path)
    good = path.read_bytes()

    def fail(*arguments, **names):
        raise OSError(28, "No space left on device")

    for place, name in ((zipfile.ZipFile, "open"), (os, "fsync"), (os, "replace")):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, fail)
            with pytest.raises(OSError, match="No space"):
                world.save(path)
        assert path.read_bytes() == good
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.name != "posix", reason="folders cannot be flushed here")
def test_bytes_are_on_the_disk_before_the_name_and_the_name_before_the_end(tmp_path, monkeypatch):
    steps = []
    kind = lambda number: "folder" if os.path.isdir(f"/proc/self/fd/{number}") else "file"  # noqa: E731
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda number: (steps.append(f"flush {kind(number)}"), fsync(number)))
    monkeypatch.setattr(os, "replace", lambda a, b: (steps.append("rename"), replace(a, b)))
    make_world().save(tmp_path / "world.fcw")
    assert steps == ["flush file", "rename", "flush folder"]


# --- Files that are not as they must be ---


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A file of a world of three spheres: its bytes, and the hash of its world."""
    world = fc.World(bounds=SMALL_BOX, wall_friction=0.4, device="cpu")
    world.add(position=[(0, 0, 0.2), (0.3, 0, 0.2), (0, 0, 0.5)], radius=0.2, friction=0.3)
    world.step(5)
    assert len(world._world.save()["contact_owner"]) > 0
    path = tmp_path_factory.mktemp("tiny") / "world.fcw"
    world.save(path)
    return path.read_bytes(), world.state_hash()


def load_bytes(content, path):
    path.write_bytes(content)
    return fc.World.load(path, device="cpu", threads=1)


def edit(content, change):
    """The file with its manifest and blocks changed by hand, and every length and checksum made right again.

    change(manifest, arrays)."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files if name != "manifest.json"}
        manifest = json.loads(file["manifest.json"])
    change(manifest, arrays)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        blocks = {}
        for name, array in arrays.items():
            block = io.BytesIO()
            np.lib.format.write_array(block, array)
            archive.writestr(f"{name}.npy", block.getvalue())
            blocks[f"{name}.npy"] = {"bytes": len(block.getvalue()), "crc32": zlib.crc32(block.getvalue())}
        if isinstance(manifest, dict) and "blocks" in manifest:
            manifest["blocks"] = blocks
        archive.writestr("manifest.json", json.dumps(manifest))
    return out.getvalue()


def test_an_edit_that_changes_nothing_loads(tiny, tmp_path):
    assert load_bytes(edit(tiny[0], lambda manifest, arrays: None), tmp_path / "x.fcw").state_hash() == tiny[1]


def test_every_truncation_is_refused(tiny, tmp_path):
    content = tiny[0]
    for length in range(0, len(content) - 1, 7):
        with pytest.raises(fc.CheckpointError) as found:
            load_bytes(content[:length], tmp_path / "cut.fcw")
        assert str(tmp_path / "cut.fcw") in str(found.value)


@settings(max_examples=1500)
@given(data=st.data())
def test_flipped_bytes_are_refused_or_change_nothing(tiny, tmp_path_factory, data):
    content = bytearray(tiny[0])
    places = data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=3))
    for place in places:
        content[place] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "flipped.fcw"
    with suppress(fc.CheckpointError):
        assert load_bytes(bytes(content), path).state_hash() == tiny[1]


@settings(max_examples=300)
@given(content=st.binary(max_size=400), is_zip=st.booleans())
def test_foreign_bytes_are_refused(tmp_path_factory, content, is_zip):
    if is_zip:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            archive.writestr("manifest.json", content)
        content = out.getvalue()
    with pytest.raises(fc.CheckpointError):
        load_bytes(content, tmp_path_factory.getbasetemp() / "foreign.fcw")


def put(table, **values):
    return lambda manifest, arrays: manifest[table].update(values)


def put_array(**values):
    return lambda manifest, arrays: arrays.update({name: np.asarray(value) for name, value in values.items()})


def huge_shape(manifest, arrays):
    arrays["position"] = np.lib.stride_tricks.as_strided(np.zeros(1, "<f4"), (0, 3, 10**6))


three = np.ones(3, "<f4")
three_contacts = {"contact_partner": np.array((1, 2, 1), "<u4"), "contact_slide": np.ones((3, 3), "<f4")}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m, a: m.update(version=3), r"manifest.json: found version 3; allowed: version 1 or 2"),
        (lambda m, a: m.update(format="other"), "another format"),
        (lambda m, a: m.pop("blocks"), "list of blocks"),
        (lambda m, a: m.pop("options"), "no world"),
        (lambda m, a: m.pop("state"), "no world"),
        (lambda m, a: a.pop("mass"), "no world"),
        (put_array(ghost=three), "no world"),
        (put_array(mass=three.astype("<f8")), r"mass.npy: found no such array \(float64"),
        (put_array(mass=three.astype(">f4")), "mass.npy"),
        (put_array(position=np.asfortranarray(np.ones((3, 3), "<f4"))), "Fortran"),
        (put_array(mass=np.ones(2, "<f4")), "mass: found 2 numbers"),
        (put_array(mass=-three), r"mass\[0\]: found -1"),
        (put_array(velocity=np.full((3, 3), np.nan, "<f4")), r"velocity\[0\]"),
        (put_array(crowding=three[:2]), "crowding: found 2"),
        (put_array(crowding=three * np.nan), r"crowding\[0\]"),
        (put_array(crowding=three * np.inf), r"crowding\[0\]"),
        (put_array(contact_owner=np.arange(2, dtype="<u4")), "contact_partner: found"),
        (put_array(contact_owner=np.array((0, 0, 3), "<u4"), **three_contacts), r"contact_owner\[2\]: found 3"),
        (put_array(contact_owner=np.array((0, 0, 1), "<u4"), **three_contacts), r"contact_partner\[2\]: found 1"),
        (put_array(contact_owner=np.array((0, 0, 0), "<u4"), **three_contacts), r"contact_partner\[2\]: found 1"),
        (put_array(contact_owner=np.array((0, 0, 2), "<f4"), **three_contacts), "contact_owner.npy: found no such"),
        (put_array(mass=np.ones(3, "<u4")), r"mass.npy: found no such array \(uint32"),
        (lambda m, a: a["contact_slide"].fill(np.nan), r"contact_slide\[0\]"),
        (lambda m, a: a.update(contact_roll=a["contact_slide"]), "contact_roll: found"),
        (lambda m, a: (a.pop("spin"), a.pop("friction")), "contact_owner: found"),
        (put("options", solver="magic"), 'solver: found "magic"'),
        (put("options", solver="reference"), "crowding"),
        (put("options", gravity=[0, 0]), "gravity"),
        (put("options", iterations=2**70), "no world"),
        (put("options", device="cpu"), "no world"),
        (put("options", drag="much"), "no world"),
        (put("state", frame=-1), "frame: found -1"),
        (put("state", start_frame=6), "start_frame: found 6"),
        (put("state", start_time=float("nan")), "start_time"),
        (put("state", dt=1e9), "dt: found"),
        (put("state", fast_spheres=-1), "fast_spheres"),
        (put("state", fastest_flight=float("inf")), "fastest_flight"),
        (put("state", fastest_dt=0), "fastest_dt"),
        (put("state", frame="one"), "no world"),
        (put("state", frame=2**80), "no world"),
        (huge_shape, "no world"),
    ],
)  # fmt: skip
def test_what_a_hand_has_written_is_checked_too(tiny, tmp_path, change, words):
    with pytest.raises(fc.CheckpointError, match=words):
        load_bytes(edit(tiny[0], change), tmp_path / "edited.fcw")


def repack(content, change):
    """The file with other members of its archive; lengths and checksums in the manifest stay."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        members = {name: old.read(name) for name in old.namelist()}
        change(members)
        for name, block in members.items():
            new.writestr(name, block)
    return out.getvalue()


def swap(members):
    members["mass.npy"], members["radius.npy"] = members["radius.npy"], members["mass.npy"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swap, "radius.npy: found 140 bytes with the CRC-32"),
        (lambda members: members.pop("mass.npy"), "found the blocks"),
        (lambda members: members.update({"more.npy": b""}), "found the blocks"),
        (lambda members: members.pop("manifest.json"), "manifest.json: found no such block"),
        (lambda members: members.update({"mass.npy": members["mass.npy"][:-4]}), "mass.npy: found 136 bytes"),
        (lambda members: members.update({"manifest.json": b"[" * 100_000}), "no JSON"),
    ],
)  # fmt: skip
def test_blocks_are_those_of_the_manifest(tiny, tmp_path, change, words):
    with pytest.raises(fc.CheckpointError, match=words):
        load_bytes(repack(tiny[0], change), tmp_path / "repacked.fcw")


def test_a_header_that_asks_for_more_than_there_is(tiny, tmp_path):
    content = tiny[0]
    with np.load(io.BytesIO(content)) as file:
        manifest = json.loads(file["manifest.json"])
    block = io.BytesIO()
    np.lib.format.write_array_header_1_0(block, {"descr": "<f4", "fortran_order": False, "shape": (10**13, 3)})
    out = repack(content, lambda members: members.update({"position.npy": block.getvalue()}))
    manifest["blocks"]["position.npy"] = {"bytes": len(block.getvalue()), "crc32": zlib.crc32(block.getvalue())}
    out = repack(out, lambda members: members.update({"manifest.json": json.dumps(manifest).encode()}))
    with pytest.raises(fc.CheckpointError, match=r"position\.npy: found no such array"):
        load_bytes(out, tmp_path / "bomb.fcw")


def test_an_entry_that_asks_for_more_than_there_is(tiny, tmp_path):
    content = bytearray(tiny[0])
    entry = content.index(b"PK\x01\x02")  # of the first block in the directory at the end
    struct.pack_into("<II", content, entry + 20, 2**31 - 1, 2**31 - 1)
    with pytest.raises(fc.CheckpointError, match=f"found a block of 2147483647 bytes in a file of {len(content)}"):
        load_bytes(bytes(content), tmp_path / "bomb.fcw")


def test_compressed_blocks_are_refused(tiny, tmp_path):
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(tiny[0])) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with pytest.raises(fc.CheckpointError, match="compressed"):
        load_bytes(out.getvalue(), tmp_path / "packed.fcw")


def test_the_error_says_where_and_pickles(tiny, tmp_path):
    path = tmp_path / "cut.fcw"
    with pytest.raises(fc.CheckpointError) as found:
        load_bytes(tiny[0][:100], path)
    assert (found.value.path, found.value.block) == (str(path), None)
    again = pickle.loads(pickle.dumps(found.value))
    assert (str(again), again.path) == (str(found.value), str(path))


def test_a_folder_is_an_error_of_the_system(tmp_path):
    with pytest.raises(OSError, match=r"."):
        fc.World.load(tmp_path, device="cpu")


def test_new_folders_outlive_a_power_cut(tmp_path, monkeypatch):
    """The name of a folder lies in its parent: each parent of a new one is flushed."""
    flushed = []
    monkeypatch.setattr(files, "flush_folder", lambda folder: flushed.append(folder))
    files.make_folder(tmp_path / "a" / "b" / "c")
    assert (tmp_path / "a" / "b" / "c").is_dir()
    assert {*flushed} == {tmp_path, tmp_path / "a", tmp_path / "a" / "b"}
    flushed.clear()
    files.make_folder(tmp_path / "a" / "b")
    assert flushed == []
