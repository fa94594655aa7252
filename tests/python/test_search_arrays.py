"""find_contacts and find_neighbors take anyone's arrays as they lie, answer in kind, and refuse what is no search."""

import os

import fastcollide as fc
import numpy as np
import pytest

random = np.random.default_rng(1)
POSITION = random.uniform(0, 5, (600, 3))
RADIUS = random.uniform(0.1, 0.3, 600)


def pairs(found):
    return list(zip(fc.to_numpy(found.first).tolist(), fc.to_numpy(found.second).tolist(), strict=True))


@pytest.fixture(scope="module")
def expected():
    found = pairs(fc.find_contacts(POSITION, RADIUS))
    assert len(found) > 300
    return found


def strided(array, step):
    """The same numbers with others between them."""
    room = np.full((len(array) * step, *array.shape[1:]), np.nan, array.dtype)
    room[::step] = array
    return room[::step]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "form",
    [
        np.ascontiguousarray, np.asfortranarray, lambda a: strided(a, 3), lambda a: a[::-1].copy()[::-1],
        lambda a: np.concatenate([a, a], axis=-1)[..., : a.shape[-1]] if a.ndim == 2 else a,
        lambda a: np.lib.stride_tricks.as_strided(a, a.shape, a.strides, writeable=False),
    ],
    ids=["C", "Fortran", "strided", "backwards", "columns of wider rows", "read-only"],
)  # fmt: skip
def test_arrays_of_the_host_are_read_as_they_lie(form, dtype):
    position, radius = POSITION.astype(dtype), RADIUS.astype(dtype)
    plain = fc.find_contacts(position, radius)
    found = fc.find_contacts(form(position), form(radius))
    for name in ("first", "second", "gap", "normal"):
        assert getattr(found, name).tobytes() == getattr(plain, name).tobytes()
    assert len(plain) > 300


def test_positions_and_radii_in_one_array(expected):
    table = np.concatenate([POSITION, RADIUS[:, None]], axis=1)
    assert pairs(fc.find_contacts(table[:, :3], table[:, 3])) == expected


def test_other_numbers_are_converted():
    grid = [[x, y, 0] for x in range(4) for y in range(4)]
    for position in (grid, np.array(grid), np.array(grid, np.uint8), np.array(grid, np.float16), np.array(grid, ">f8")):
        assert len(fc.find_contacts(position, 0.5000001)) == 24
        assert len(fc.find_contacts(position, [0.5000001] * 16)) == 24
    assert fc.find_contacts(np.array(grid, np.float16), 0.51).gap.dtype == np.float32


def test_a_radius_may_be_an_array_of_no_dimensions():
    expected = fc.find_contacts(POSITION, 0.3, output="total")
    assert fc.find_contacts(POSITION, np.array(0.3), output="total") == expected > 0
    torch = pytest.importorskip("torch")
    radius = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    assert fc.find_contacts(POSITION, radius, output="total") == expected


def test_float32_positions_with_float64_radii_are_decided_with_all_digits():
    position = np.array([(0, 0, 0), (1, 0, 0)], np.float32)
    assert len(fc.find_contacts(position, np.full(2, 0.5 + 1e-12))) == 1
    assert len(fc.find_contacts(position, np.full(2, 0.5 - 1e-12))) == 0
    assert len(fc.find_contacts(position, 0.5 + 1e-12)) == 1
    assert len(fc.find_contacts(position, 0.5 - 1e-12)) == 0


def test_nothing_is_written(expected):
    position, radius = POSITION.copy(), RADIUS.copy()
    position.flags.writeable = radius.flags.writeable = False
    assert pairs(fc.find_contacts(position, radius)) == expected


class OnlyDlpack:
    """An array of a library that FastCollide has never heard of."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_dlpack_alone_is_enough(expected):
    found = fc.find_contacts(OnlyDlpack(POSITION), OnlyDlpack(RADIUS))
    assert pairs(found) == expected
    assert isinstance(found.first, np.ndarray)


def test_results_outlive_their_finder(expected):
    finder = fc.ContactFinder()
    found = finder.find_contacts(POSITION, RADIUS)
    finder.find_contacts(POSITION[::-1].copy(), RADIUS)
    del finder
    assert pairs(found) == expected


@pytest.mark.parametrize("output", ["contacts", "neighbors", "counts"])
def test_memory_of_results_serves_again_but_never_while_held(device, output):
    finder, to = fc.ContactFinder(), np.asarray if device == "cpu" else pytest.importorskip("cupy").asarray
    fields = {"contacts": ("first", "second", "gap", "normal"), "neighbors": ("offsets", "indices"), "counts": ()}[
        output
    ]

    def arrays_of(found):
        return [getattr(found, field) for field in fields] or [found]

    def search(step):
        return arrays_of(finder.find_contacts(to(POSITION * (1 + 0.01 * step)), to(RADIUS), output=output))

    def address(array):
        return array.ctypes.data if device == "cpu" else array.data.ptr

    held, bytes_of, places = [], [], set()
    for step in range(12):
        found = search(step)
        places |= {address(array) for array in found}
        if step % 2:  # every other result is kept: one whole, one as a part of each array
            held += found if step % 4 == 1 else [array[2:] for array in found]
            bytes_of += [fc.to_numpy(array).tobytes() for array in held[len(bytes_of) :]]
        del found
    assert [fc.to_numpy(array).tobytes() for array in held] == bytes_of
    assert len(places) < 12 * len(search(0))  # the others' memory has served again


def test_a_finder_serves_any_input(expected):
    finder = fc.ContactFinder()
    for _ in range(2):
        assert pairs(finder.find_contacts(POSITION, RADIUS)) == expected
        assert len(finder.find_contacts(POSITION[:10].astype(np.float32), 1e-3)) == 0
        assert finder.find_contacts(POSITION, RADIUS, output="total") == len(expected)
        assert len(finder.find_neighbors(POSITION, 0.5)) == 600


# --- Other libraries ---


def test_torch_on_the_host(expected):
    torch = pytest.importorskip("torch")
    found = fc.find_contacts(torch.tensor(POSITION, requires_grad=True), torch.tensor(RADIUS))
    assert all(isinstance(array, torch.Tensor) for array in (found.first, found.second, found.gap, found.normal))
    assert (found.gap.dtype, found.gap.requires_grad) == (torch.float64, False)
    assert list(zip(found.first.tolist(), found.second.tolist(), strict=True)) == expected


def test_jax_on_the_host(expected):
    jax = pytest.importorskip("jax")
    cpu = jax.devices("cpu")[0]
    position, radius = (jax.device_put(a.astype(np.float32), cpu) for a in (POSITION, RADIUS))
    found = fc.find_contacts(position, radius)
    assert isinstance(found.first, jax.Array)
    assert pairs(found) == pairs(fc.find_contacts(POSITION.astype(np.float32), RADIUS.astype(np.float32)))


def on_gpu(array):
    return pytest.importorskip("cupy").asarray(array)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_cupy(gpu, dtype, order):
    cupy = pytest.importorskip("cupy")
    position, radius = POSITION.astype(dtype), RADIUS.astype(dtype)
    on_host = fc.find_contacts(position, radius)
    found = fc.find_contacts(cupy.asarray(position, order=order), cupy.asarray(radius))
    for name in ("first", "second", "gap", "normal"):
        array = getattr(found, name)
        assert isinstance(array, cupy.ndarray)
        assert cupy.asnumpy(array).tobytes() == getattr(on_host, name).tobytes()  # the same bits
    for output in ("counts", "total"):
        counted = fc.find_contacts(cupy.asarray(position), cupy.asarray(radius), output=output)
        assert np.array_equal(fc.find_contacts(position, radius, output=output), fc.to_numpy(counted))


def test_neighbors_on_a_gpu(gpu):
    for options in ({}, {"sort": "distance", "distances": "squared"}, {"max_neighbors": 2, "distances": "euclidean"}):
        on_host = fc.find_neighbors(POSITION, 0.6, **options)
        found = fc.find_neighbors(on_gpu(POSITION), 0.6, **options)
        assert found.shortened_rows == on_host.shortened_rows
        for name in ("offsets", "indices", "distances"):
            if getattr(on_host, name) is not None:
                assert fc.to_numpy(getattr(found, name)).tobytes() == getattr(on_host, name).tobytes()


def test_the_callers_stream_is_respected(gpu, expected):
    cupy = pytest.importorskip("cupy")
    position, radius = cupy.zeros((600, 3)), cupy.asarray(RADIUS)
    with cupy.cuda.Stream(non_blocking=True):
        large = cupy.ones((4096, 4096), cupy.float32)
        for _ in range(20):
            large = large @ large * 0  # keeps the GPU busy
        position += cupy.asarray(POSITION) + large[0, 0]
        found = fc.find_contacts(position, radius)
        first = found.first + 0
    assert cupy.asnumpy(first).tolist() == [pair[0] for pair in expected]


def test_torch_on_a_gpu(gpu, expected):
    torch = pytest.importorskip("torch")
    found = fc.find_contacts(torch.tensor(POSITION, device="cuda"), torch.tensor(RADIUS, device="cuda"))
    assert found.first.device.type == "cuda"
    assert list(zip(found.first.tolist(), found.second.tolist(), strict=True)) == expected


def test_mixed_devices_are_refused(gpu):
    with pytest.raises(fc.InvalidValue, match="radii: found an array on the host; allowed: one on cuda:0"):
        fc.find_contacts(on_gpu(POSITION), RADIUS)
    with pytest.raises(fc.InvalidValue, match="other_positions: found an array on cuda:0; allowed: one on the host"):
        fc.find_contacts(POSITION, RADIUS, other_positions=on_gpu(POSITION), other_radii=1.0)


# --- Errors ---

CUBE = ((0, 0, 0), (5, 5, 5))


def with_value(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("change", "message", "field", "index"),
    [
        ({"positions": with_value(POSITION, (7, 1), np.nan)}, r"positions\[7\]: .*nan.*finite numbers", "positions", 7),
        ({"positions": with_value(POSITION, (599, 2), -np.inf)}, r"positions\[599\]: .*-inf", "positions", 599),
        ({"radii": with_value(RADIUS, 3, -0.5)}, r"radii\[3\]: found -0\.5; allowed: a finite number, 0", "radii", 3),
        ({"radii": with_value(RADIUS, 3, np.nan)}, r"radii\[3\]: found nan", "radii", 3),
        ({"radii": with_value(RADIUS, 3, np.inf)}, r"radii\[3\]: found inf", "radii", 3),
        ({"radii": -1.0}, "radii: found -1; allowed: a finite number, 0 or more", "radii", None),
        ({"radii": RADIUS[:5]}, "radii: found 5 numbers; allowed: 600, one for each of positions", "radii", None),
        ({"radii": RADIUS[:, None]}, r"radii: found an array of shape \(600, 1\); allowed: .*\(n,\)", "radii", None),
        ({"positions": POSITION[:, :2]}, r"positions: .*\(600, 2\); allowed: shape \(n, 3\)", "positions", None),
        ({"positions": POSITION[0]}, r"positions: found an array of shape \(3,\)", "positions", None),
        ({"margin": -0.1}, "margin: found -0.1; allowed: a finite number, 0 or more", "margin", None),
        ({"margin": np.nan}, "margin: found nan", "margin", None),
        ({"margin": "wide"}, "margin: found 'wide'; allowed: a number", "margin", None),
        ({"boundary": "periodic"}, "bounds: found None; allowed: two corners", "bounds", None),
        ({"boundary": "round"}, 'boundary.*found "round"', "boundary", 0),
        ({"boundary": ("open", "open")}, "boundary: .*three names", "boundary", None),
        ({"boundary": "periodic", "bounds": (0, 1)}, "bounds: .*allowed: ", "bounds", None),
        ({"boundary": "periodic", "bounds": ((0, 0, 0), (5, 0, 5))}, r"bounds\[1\]: found 0; .*above", "bounds", 1),
        ({"boundary": "periodic", "bounds": ((0, 0, 0), (5, 5, 4))}, r"positions.*inside the bounds", "positions", ...),
        ({"boundary": "periodic", "bounds": CUBE, "radii": 1.25}, r"bounds\[0\]: .*twice the largest", "bounds", 0),
        ({"max_contacts": 2.5}, "max_contacts: found 2.5; allowed: a whole number from 0 to", "max_contacts", None),
        ({"max_contacts": -1}, "max_contacts: found -1; allowed: a whole number", "max_contacts", None),
        ({"max_contacts": 2**63}, "max_contacts: found 9223372036854775808; ", "max_contacts", None),
        ({"output": "everything"}, 'output: found "everything"; allowed: contacts, ', "output", None),
        ({"other_radii": RADIUS}, "other_radii: found without other_positions", "other_radii", None),
        ({"other_positions": POSITION}, "other_radii: found None", "other_radii", None),
        (
            {"other_positions": with_value(POSITION, (4, 0), np.nan), "other_radii": 1.0},
            r"other_positions\[4\]: ", "other_positions", 4,
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_searched_is_refused(dtype, change, message, field, index):
    arguments = {
        name: value.astype(dtype) if isinstance(value, np.ndarray) else value
        for name, value in ({"positions": POSITION, "radii": RADIUS} | change).items()
    }
    with pytest.raises(fc.InvalidValue, match=message) as caught:
        fc.find_contacts(**arguments)
    assert caught.value.field == field
    assert index is ... or caught.value.index == index


@pytest.mark.parametrize("value", [["a", "b"], object(), None, "text", [[1, 2, 3], [4]], np.zeros((2, 3), complex)])
def test_what_is_no_array_is_refused(value):
    with pytest.raises(fc.InvalidValue, match="positions: "):
        fc.find_contacts(value, 1.0)


def test_places_that_the_type_cannot_resolve_are_refused():
    """2^17 radii in float32: the spacing of numbers there is 1/64 of the radius."""
    near, far = np.array([[131072 * 0.25, 0, 0]]), np.array([[131072 * 0.25 * 1.0001, 0, 0]])
    for radii in (0.25, np.array([0.25], np.float32)):
        assert len(fc.find_contacts(near.astype(np.float32), radii)) == 0
        with pytest.raises(fc.InvalidValue, match=r"positions\[0\]: .*up to 32768 from 0.*float32.*float64 can"):
            fc.find_contacts(far.astype(np.float32), radii)
        assert len(fc.find_contacts(far, radii)) == 0
    with pytest.raises(fc.InvalidValue, match=r"positions\[0\]: .*2\^46 times"):
        fc.find_contacts(np.array([[2.0**46, 0, 0]]), 0.5)
    with pytest.raises(fc.InvalidValue, match=r"radii\[0\]: found 1\.?\d*e\+?16.*1e-15 to 1e\+15 in float32"):
        fc.find_contacts(near.astype(np.float32), np.array([1e16], np.float32))
    # A margin widens what must be resolved; points of no size have no such limit, as none touches another.
    assert len(fc.find_contacts(far.astype(np.float32), 0.25, margin=0.1)) == 0
    assert len(fc.find_contacts(far.astype(np.float32), 0.0)) == 0


@pytest.mark.parametrize(
    ("change", "message", "field"),
    [
        ({"radius": 0.0}, "radius: found 0; allowed: a finite number above 0", "radius"),
        ({"radius": np.nan}, "radius: found nan", "radius"),
        ({"radius": np.inf}, "radius: found inf; allowed: a finite number above 0", "radius"),
        ({"points": with_value(POSITION, (9, 0), np.nan)}, r"points\[9\]: ", "points"),
        ({"queries": with_value(POSITION, (9, 0), np.nan)}, r"queries\[9\]: ", "queries"),
        ({"queries": POSITION, "points": with_value(POSITION, (9, 0), np.nan)}, r"points\[9\]: ", "points"),
        ({"queries": POSITION.astype(np.float32)}, "points: found float64; allowed: float32", "points"),
        ({"max_neighbors": -1}, "max_neighbors: found -1; allowed: a whole number from 0 to", "max_neighbors"),
        ({"max_neighbors": "few"}, "max_neighbors: found 'few'; allowed: a whole number", "max_neighbors"),
        ({"sort": "size"}, "sort: found 'size'; allowed: 'index' or 'distance'", "sort"),
        ({"distances": True}, "distances: found True", "distances"),
    ],
)
def test_neighbors_refuse_by_their_own_names(change, message, field):
    with pytest.raises(fc.InvalidValue, match=message) as caught:
        fc.find_neighbors(**({"points": POSITION, "radius": 0.5} | change))
    assert caught.value.field == field


@pytest.mark.parametrize("threads", [-1, 2.5, "all", 10**12])
def test_a_wrong_number_of_threads_is_refused(threads):
    with pytest.raises(fc.InvalidValue, match=r"threads: found .*; allowed: ") as caught:
        fc.ContactFinder(threads)
    assert caught.value.field == "threads"


def test_masked_numbers_are_refused():
    """What lies under a mask is not what its owner means."""
    masked = np.ma.masked_greater(POSITION, 4.9)
    with pytest.raises(fc.InvalidValue, match="positions: found an array with masked numbers; allowed: one without"):
        fc.find_contacts(masked, RADIUS)
    unmasked = np.ma.masked_greater(POSITION, 1e9)
    assert len(fc.find_contacts(unmasked, RADIUS)) == len(fc.find_contacts(POSITION, RADIUS))


memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0


@pytest.mark.skipif(not 0 < memory < 60e9, reason="the list may fit into the memory")
def test_a_list_that_does_not_fit_into_the_memory_is_refused():
    """2,147,516,416 contacts need some 90 GB."""
    position = np.full((65_537, 3), 1.5, np.float32)
    with pytest.raises(fc.OutOfMemory, match="found 2147516416; allowed: at most"):
        fc.find_contacts(position, 0.25)
    assert fc.find_contacts(position, 0.25, output="total") == 2_147_516_416


def test_more_pairs_than_32_bits_can_count_on_a_gpu(gpu):
    position = on_gpu(np.full((65_537, 3), 1.5, np.float32))
    assert fc.find_contacts(position, 0.25, output="total") == 2_147_516_416
    assert (fc.to_numpy(fc.find_contacts(position, 0.25, output="counts")) == 65_536).all()


def test_a_list_that_does_not_fit_on_a_gpu_is_refused(gpu):
    cupy = pytest.importorskip("cupy")
    position = on_gpu(np.full((20_000, 3), 1.5, np.float32))
    cupy.get_default_memory_pool().free_all_blocks()
    finder = fc.ContactFinder()
    assert len(finder.find_contacts(position[:4], 0.25)) == 6
    occupied = cupy.cuda.memory.Memory(cupy.cuda.runtime.memGetInfo()[0] - 2**29)
    with pytest.raises(fc.OutOfMemory, match=r"contacts: found 199990000; allowed: .* are free"):
        finder.find_contacts(position, 0.25)
    assert len(finder.find_contacts(position[:4], 0.25)) == 6
    del occupied


def test_a_failed_search_leaves_the_finder_whole(expected):
    finder = fc.ContactFinder()
    for _ in range(3):
        with pytest.raises(fc.InvalidValue):
            finder.find_contacts(with_value(POSITION, (0, 0), np.nan), RADIUS)
        assert pairs(finder.find_contacts(POSITION, RADIUS)) == expected


def test_threads_may_share_a_finder(expected):
    from concurrent.futures import ThreadPoolExecutor

    finder = fc.ContactFinder()
    with ThreadPoolExecutor(4) as pool:
        assert all(
            found == expected for found in pool.map(lambda _: pairs(finder.find_contacts(POSITION, RADIUS)), range(40))
        )
