"""The search inside PyTorch programs: gradients, torch.compile, and all that is the caller's own stay as they are."""

import subprocess
import sys

import fastcollide as fc
import numpy as np
import pytest

random = np.random.default_rng(1)
POSITION = random.uniform(0, 5, (300, 3)).astype(np.float32)
RADIUS = 0.3


def test_pytorch_is_not_imported_for_others():
    code = (
        "import sys, numpy as np, fastcollide as fc\n"
        "assert len(fc.find_contacts(np.zeros((2, 3)), 1.0)) == 1\n"
        "assert len(fc.find_neighbors(np.zeros((2, 3)), 1.0).indices) == 2\n"
        "assert not {'torch', 'cupy', 'jax', 'scipy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


@pytest.fixture
def points(torch, device):
    return torch.tensor(POSITION, device=device, requires_grad=True)


def overlap_energy(find):
    """A loss as its author would write it: indices from the search, the rest differentiable."""

    def energy(points):
        scaled = points * 1.01
        found = find(scaled)
        offset = scaled[found.first.long()] - scaled[found.second.long()]
        return ((2 * RADIUS - offset.norm(dim=1)) ** 2).sum()

    return energy


def value_and_gradient(function, points):
    points.grad = None
    value = function(points)
    value.backward()
    return value.item(), points.grad.clone()


def test_tensors_that_require_gradients_are_read_and_the_answer_has_none(torch, points):
    found = fc.find_contacts(points, RADIUS)
    assert len(found) > 50
    for array in (found.first, found.second, found.gap, found.normal):
        assert array.device == points.device
        assert not array.requires_grad
    assert points.requires_grad
    assert points.grad is None
    near = fc.find_neighbors(points, 0.5, distances="euclidean")
    assert not near.distances.requires_grad
    value, gradient = value_and_gradient(overlap_energy(lambda x: fc.find_contacts(x, RADIUS, output="pairs")), points)
    assert value > 0
    assert np.count_nonzero(gradient.cpu()) > 50


FINDER = fc.ContactFinder(skin=0.1)
SEARCHES = {
    "find_contacts": lambda x: fc.find_contacts(x, RADIUS),
    "a finder": lambda x: FINDER.find_contacts(x, RADIUS, output="pairs"),
}


@pytest.mark.parametrize("name", SEARCHES)
def test_a_compiled_function_breaks_once_and_gives_the_same(torch, points, name):
    energy = overlap_energy(SEARCHES[name])
    expected_value, expected_gradient = value_and_gradient(energy, points)
    torch.compiler.reset()
    compiled = torch.compile(energy, backend="eager")
    for _ in range(3):
        value, gradient = value_and_gradient(compiled, points)
        assert value == pytest.approx(expected_value, rel=1e-5)
        torch.testing.assert_close(gradient, expected_gradient)
    explained = torch._dynamo.explain(energy)(points)
    assert explained.graph_break_count == 1
    assert explained.graph_count == 2  # before the search, after it, nothing of ours


def test_neighbors_in_a_compiled_function(torch, points):
    def degree(points):
        return fc.find_neighbors(points, 0.5, max_neighbors=4).offsets.diff().double().mean()

    torch.compiler.reset()
    assert torch.compile(degree, backend="eager")(points).item() == degree(points).item() > 1


def test_errors_pass_through_a_compiled_function(torch, device):
    torch.compiler.reset()
    compiled = torch.compile(lambda x: fc.find_contacts(x * 1, RADIUS).gap.sum(), backend="eager")
    with pytest.raises(fc.InvalidValue, match=r"positions\[1\]") as caught:
        compiled(torch.tensor([[0.0, 0, 0], [float("nan"), 0, 0]], device=device))
    assert (caught.value.field, caught.value.index) == ("positions", 1)


def state_of(torch):
    return (
        torch.is_grad_enabled(), torch.is_inference_mode_enabled(), torch.get_default_device(),
        torch.get_default_dtype(), torch.get_num_threads(), torch.get_rng_state().tolist(), torch.initial_seed(),
        torch.are_deterministic_algorithms_enabled(), torch.is_autocast_enabled("cpu"),
        np.geterr(),
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["plain", "no_grad", "inference_mode", "default device", "default dtype", "autocast"])
def test_what_is_the_callers_stays_as_it_is(torch, points, mode):
    contexts = {
        "no_grad": torch.no_grad, "inference_mode": torch.inference_mode, "plain": torch.enable_grad,
        "default device": lambda: torch.device("meta"), "default dtype": torch.enable_grad,
        "autocast": lambda: torch.autocast("cpu", torch.bfloat16),
    }  # fmt: skip
    expected = fc.find_contacts(POSITION, RADIUS)
    if mode == "default dtype":
        torch.set_default_dtype(torch.float64)
    try:
        with contexts[mode]():
            before = state_of(torch)
            given = points if mode == "default device" else points * 1  # in inference mode: an inference tensor
            found = fc.find_contacts(given, RADIUS)
            near = fc.find_neighbors(given, 0.5)
            assert state_of(torch) == before
            assert found.first.device == near.indices.device == points.device
            assert (found.first.dtype, found.gap.dtype) == (torch.int32, torch.float32)
            assert found.gap.cpu().numpy().tobytes() == expected.gap.tobytes()
    finally:
        torch.set_default_dtype(torch.float32)


def test_what_has_no_numbers_is_refused(torch, device):
    plain = torch.rand(4, 3, device=device)
    for value in (plain.to_sparse(), plain.to("meta"), plain.bfloat16(), plain.to(torch.complex64)):
        with pytest.raises(fc.InvalidValue, match=r"positions: found .*; allowed: ") as caught:
            fc.find_contacts(value, 1.0)
        assert caught.value.field == "positions"


@pytest.mark.parametrize("transform", ["vmap", "grad"])
def test_inside_a_transform_there_are_no_numbers(torch, device, transform):
    def search(x):
        return fc.find_contacts(x, 1.0).gap.sum()

    points = torch.rand((2, 4, 3) if transform == "vmap" else (4, 3), device=device)
    with pytest.raises(fc.InvalidValue, match="positions: found no array of numbers"):
        getattr(torch.func, transform)(search)(points)
