"""Every device computes the states that are on file, bit for bit."""

import pytest
from determinism import golden


@pytest.mark.parametrize("name", golden.SCENES)
def test_golden_hashes(device, name):
    assert golden.hashes(name, device=device) == golden.read()[name]


@pytest.mark.parametrize("block_size", [32, 96, 512])
def test_golden_hashes_at_any_block_size(gpu, block_size):
    for name in golden.SCENES:
        found = golden.hashes(name, device=gpu, block_size=block_size, method="cells")
        assert found == golden.read()[name]


@pytest.mark.parametrize("threads", [1, 3, 16])
def test_golden_hashes_at_any_number_of_threads(threads):
    name = "crowd, 3,000 spheres, 100 frames"
    assert golden.hashes(name, device="cpu", threads=threads) == golden.read()[name]
