"""Arrays share the world's memory, and keep it for as long as someone holds them."""

import gc

import fastcollide as fc
import numpy as np
import pytest

NAMES = ["positions", "velocities", "radii", "masses", "restitutions"]
each_array = pytest.mark.parametrize("name", NAMES)


def report_world(device, count=500, seed=41):
    world = fc.World(device=device)
    world.add(fc.random_spheres(count, seed=seed))
    return world


def address_of(array):
    if isinstance(array, np.ndarray):
        return array.__array_interface__["data"][0]
    return array.__cuda_array_interface__["data"][0]


@each_array
def test_shape_and_type(device, name):
    array = getattr(report_world(device), name)
    assert array.shape == ((500, 3) if name in ("positions", "velocities") else (500,))
    assert array.dtype == np.float32
    assert (array.ndim, array.size, array.nbytes) == (len(array.shape), np.prod(array.shape), 4 * np.prod(array.shape))
    assert len(array) == 500
    assert isinstance(array, np.ndarray if device == "cpu" else fc.DeviceArray)


@each_array
def test_arrays_of_no_spheres(device, name):
    array = getattr(fc.World(device=device), name)
    assert array.shape == ((0, 3) if name in ("positions", "velocities") else (0,))
    assert fc.to_numpy(array).shape == array.shape


@each_array
def test_nothing_is_copied(device, name):
    world = report_world(device)
    first = getattr(world, name)
    world.step(3)
    assert address_of(getattr(world, name)) == address_of(first)
    assert fc.to_numpy(getattr(world, name)).tobytes() == fc.to_numpy(first).tobytes()


def test_an_array_held_shows_each_step(device):
    world = report_world(device)
    positions = world.positions
    before = fc.to_numpy(positions).copy()
    world.step(1)
    assert (fc.to_numpy(positions) != before).any()


@each_array
def test_what_is_written_is_what_the_world_works_with(device, write, name):
    world, other = report_world(device), report_world(device)
    values = fc.to_numpy(getattr(world, name)).copy()
    values[0] *= 0.5
    write(getattr(world, name), values)

    assert world.state_hash() != other.state_hash()
    assert fc.to_numpy(getattr(world, name)).tobytes() == values.tobytes()
    world.step(60)
    other.step(60)
    # Its later state is another, and not in the number written alone.
    assert fc.to_numpy(world.positions).tobytes() != fc.to_numpy(other.positions).tobytes()


def test_a_radius_written_changes_the_grid(device, write):
    """The cells follow the largest radius of the moment."""
    world = fc.World(device=device)
    world.add(position=[(0, 0, 10), (3, 0, 10)], radius=0.1, mass=1)
    assert world.contact_count() == 0
    write(world.radii, [2.0, 1.5])
    assert world.contact_count() == 1


@each_array
def test_an_array_outlives_its_world(device, name):
    world = report_world(device)
    array = getattr(world, name)
    expected = fc.to_numpy(array).tobytes()
    del world
    gc.collect()
    others = [report_world(device, 500, seed) for seed in range(20)]  # would take the memory if it were free

    assert fc.to_numpy(array).tobytes() == expected
    assert len(others) == 20


@each_array
def test_an_array_stays_valid_when_its_world_grows(device, name):
    world = report_world(device)
    array = getattr(world, name)
    expected = fc.to_numpy(array).tobytes()
    for _ in range(20):
        world.add(fc.random_spheres(1000, seed=42))
    world.step(2)

    assert fc.to_numpy(array).shape == array.shape
    assert fc.to_numpy(array).tobytes() == expected  # an old copy
    assert len(getattr(world, name)) == 20_500


def test_contacts_outlive_their_world(device):
    world = report_world(device, 20_000)
    contacts = world.contacts()
    expected = [fc.to_numpy(array).tobytes() for array in (contacts.first, contacts.second, contacts.gap)]
    world.step(2)
    world.contacts()
    del world
    gc.collect()
    assert [fc.to_numpy(array).tobytes() for array in (contacts.first, contacts.second, contacts.gap)] == expected
    assert len(contacts) == len(contacts.first) > 500


def test_to_numpy_shares_what_is_on_the_host():
    world = report_world("cpu")
    assert np.shares_memory(fc.to_numpy(world.positions), world.positions)
    assert np.shares_memory(np.from_dlpack(world.positions), world.positions)
    values = np.arange(3.0)
    assert fc.to_numpy(values) is values
    assert fc.to_numpy([1, 2]).tolist() == [1, 2]


def test_arrays_of_the_host_are_accepted_in_any_form(device):
    position = np.array([(0, 0, 5), (1, 0, 5), (2, 0, 5), (3, 0, 5)], np.float32)
    for form in (
        position.astype(np.float64),
        position.astype(np.int64),
        np.asfortranarray(position),
        position[::-1][::-1],
        position.tolist(),
    ):
        world = fc.World(device=device)
        world.add(position=form, radius=0.1)
        assert fc.to_numpy(world.positions).tobytes() == position.tobytes()


# --- Other libraries ---


def test_torch_shares_arrays_of_the_cpu():
    torch = pytest.importorskip("torch")
    world = report_world("cpu")
    tensor = torch.from_dlpack(world.positions)
    assert tensor.data_ptr() == address_of(world.positions)
    world.step(1)
    assert tensor.numpy().tobytes() == world.positions.tobytes()


@each_array
def test_cupy_shares(gpu, name):
    cupy = pytest.importorskip("cupy")
    world = report_world(gpu)
    array = getattr(world, name)
    for shared in (cupy.asarray(array), cupy.from_dlpack(array)):
        assert shared.data.ptr == address_of(array)
        assert (shared.shape, shared.dtype) == (array.shape, np.float32)
        assert cupy.asnumpy(shared).tobytes() == fc.to_numpy(array).tobytes()


def test_what_cupy_has_queued_is_done_before_a_step(gpu):
    cupy = pytest.importorskip("cupy")
    world, other = report_world(gpu), report_world(gpu)
    with cupy.cuda.Stream(non_blocking=True):
        large = cupy.ones((4096, 4096), cupy.float32)
        for _ in range(20):
            large = large @ large * 0  # keeps the GPU busy
        velocities = cupy.asarray(world.velocities)
        velocities *= 0.5 + large[0, 0]
        world.step(1)
    cupy.asarray(other.velocities)[...] *= 0.5
    cupy.cuda.Device().synchronize()
    other.step(1)
    assert world.state_hash() == other.state_hash()


@each_array
def test_torch_shares(gpu, name):
    torch = pytest.importorskip("torch")
    world = report_world(gpu)
    array = getattr(world, name)
    for shared in (torch.as_tensor(array, device="cuda"), torch.from_dlpack(array)):
        assert shared.data_ptr() == address_of(array)
        assert tuple(shared.shape) == array.shape
        assert shared.cpu().numpy().tobytes() == fc.to_numpy(array).tobytes()


def test_jax_shares(gpu, monkeypatch):
    monkeypatch.setenv("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # else it takes most of the card
    jax = pytest.importorskip("jax")
    world = report_world(gpu)
    shared = jax.dlpack.from_dlpack(world.positions)
    assert shared.unsafe_buffer_pointer() == address_of(world.positions)
    assert np.asarray(shared).tobytes() == fc.to_numpy(world.positions).tobytes()


def test_arrays_of_a_gpu_are_accepted(gpu):
    cupy = pytest.importorskip("cupy")
    spheres = fc.random_spheres(300, seed=43)
    expected, world, on_cpu = fc.World(device=gpu), fc.World(device=gpu), fc.World(device="cpu")
    expected.add(spheres)
    for one in (world, on_cpu):
        one.add(
            position=cupy.asarray(spheres.position), velocity=cupy.asarray(spheres.velocity),
            radius=cupy.asarray(spheres.radius), mass=cupy.asarray(spheres.mass),
            restitution=cupy.asarray(spheres.restitution),
        )  # fmt: skip
        assert one.state_hash() == expected.state_hash()


def test_contacts_stay_on_the_gpu(gpu):
    cupy = pytest.importorskip("cupy")
    world = report_world(gpu, 20_000)
    contacts = world.contacts()
    first = cupy.asarray(contacts.first)
    assert first.dtype == cupy.int32
    assert first.data.ptr == address_of(contacts.first)
    assert int(first.max()) < 20_000
