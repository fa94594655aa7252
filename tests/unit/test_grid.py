"""The grid is a means: no result depends on its cells, and no cells are accepted that would lose a contact."""

import fastcollide as fc
import numpy as np
import pytest
from determinism import golden

CROWD = "crowd, 3,000 spheres, 100 frames"


@pytest.fixture(scope="module")
def by_default(device, solver):
    return hashes_at(device, solver, None)


def hashes_at(device, solver, cell_size):
    world = fc.World(device=device, solver=solver, cell_size=cell_size, method="cells")
    world.add(fc.random_spheres(3000, seed=21))
    contacts = world.contact_count()
    assert contacts > 100
    world.step(15)
    return contacts, world.state_hash()


@pytest.mark.parametrize("cell_size", [0.81, 1.0, 2.0, 5.0, 1000.0])
def test_no_result_depends_on_the_size_of_the_cells(device, solver, by_default, cell_size):
    assert hashes_at(device, solver, cell_size) == by_default


@pytest.mark.parametrize("cell_size", [0.31, 0.7])
def test_nor_in_a_crowd(device, cell_size):
    assert golden.hashes(CROWD, device=device, cell_size=cell_size, method="cells") == golden.read()[CROWD]


def test_cells_smaller_than_a_sphere_are_refused(device):
    world = fc.World(device=device, cell_size=0.6)
    world.add(position=[(0, 0, 5), (3, 0, 5)], radius=[0.1, 0.31])
    before = world.state_hash()
    message = r"cell_size: found 0\.6.*at least the largest diameter, 0\.62"
    for use in (world.step, world.contacts, world.contact_count, world.max_overlap):
        with pytest.raises(fc.InvalidValue, match=message) as error:
            use()
        assert error.value.field == "cell_size"
    assert world.frame == 0
    assert world.state_hash() == before


def test_cells_of_exactly_the_largest_diameter_are_accepted(device):
    world = fc.World(device=device, cell_size=0.625)
    world.add(position=[(0, 0, 5), (0.6, 0, 5)], radius=0.3125)
    assert world.contact_count() == 1


def test_few_small_spheres_in_a_huge_box(device):
    """Cells are no smaller than the memory for them is worth."""
    world = fc.World(bounds=((-1000, -1000, 0), (1000, 1000, 2000)), device=device)
    world.add(position=[(0, 0, 5), (0.015, 0, 5), (999, 999, 1999)], radius=0.01)
    assert world.contact_count() == 1
    world.step(2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_flat_box(device, axis):
    """One cell thick along an axis, with contacts along the two others."""
    upper = np.full(3, 8.0)
    upper[axis] = 0.8
    world = fc.World(bounds=((0, 0, 0), tuple(upper)), device=device)
    other = (axis + 1) % 3
    position = np.full((6, 3), 0.4)
    position[:, other] = 0.5 + 0.75 * np.arange(6)
    world.add(position=position, radius=0.38)
    assert world.contact_count() == 5
