"""The quick part of tests/validation: each of its instruments on a case small enough for every run of the tests."""

import importlib.util
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from validation import boltzmann, figures, gas, packing
from validation.event_driven import EventDrivenGas

ROOT = Path(__file__).parents[2]
DT = 0.01


def test_a_small_gas_has_the_pressure_and_the_collisions_of_theory(device):
    """To 2 % with 864 spheres, φ 0.2; 1 % and less takes tests/validation."""
    world = gas.new_gas(864, 0.2, device)
    gas.equilibrate(world, 0.2, DT)
    statistics = gas.collision_statistics(world, 15, DT)

    assert statistics.pressure.mean() == pytest.approx(gas.kolafa(0.2), rel=0.02)
    assert statistics.rate.mean() == pytest.approx(gas.enskog_rate(0.2), rel=0.02)


def test_it_loses_energy_as_exact_dynamics_does(device):
    """e 0.8, eight collisions of each: 1 % is three times what the two differ by chance."""
    start = gas.new_gas(500, 0.2, device)
    gas.equilibrate(start, 0.2, DT)
    world = gas.copy_of(start, restitution=0.8)
    twin = EventDrivenGas(fc.to_numpy(start.positions), fc.to_numpy(start.velocities), start.bounds[1][0], 0.8)
    world.step(100, DT / 2)
    twin.advance_to(0.5)

    assert gas.temperature(world) == pytest.approx(twin.temperature(), rel=0.01)


def test_equations_of_state():
    """Figures of Mulero et al. (2008) and of Enskog's rate."""
    np.testing.assert_allclose([gas.kolafa(f) for f in (0.1, 0.2, 0.3, 0.4)], (1.5216, 2.4094, 3.9843, 6.9457), 5e-5)
    np.testing.assert_allclose([gas.enskog_rate(f) for f in (0.1, 0.4)], (1.7646, 20.060), rtol=5e-5)
    assert gas.haff_rate(0.1, 0.9) == pytest.approx(0.05588, abs=1e-5)


def test_boltzmann_keeps_energy_and_momentum_and_ends_with_maxwell():
    velocity = np.sign(np.random.default_rng(1).normal(size=(40_000, 3)))
    *_, (collisions, end) = boltzmann.relax(velocity, until=15, seed=2)

    assert collisions == pytest.approx(15, abs=0.1)
    np.testing.assert_allclose(end.sum(axis=0), velocity.sum(axis=0), atol=1e-8)
    assert (end**2).sum() == pytest.approx((velocity**2).sum(), rel=1e-12)
    assert gas.kurtosis(end) == pytest.approx(3, abs=0.06)


def test_spheres_are_cut_by_the_planes():
    """A whole sphere, a half, a cap of height 1/4, nothing."""
    assert packing.volume_between(np.array([0.5]), 0, 1) == pytest.approx(np.pi / 6)
    assert packing.volume_between(np.array([0.0, 1.0]), 0, 1) == pytest.approx(np.pi / 6)
    assert packing.volume_between(np.array([-0.25]), 0, 1) == pytest.approx(np.pi * (1 / 4) ** 2 * (1.5 - 1 / 4) / 3)
    assert packing.volume_between(np.array([-0.5, 1.75]), 0, 1) == 0


def test_a_lattice_has_its_density_and_its_contacts(device):
    """Face-centred cubic, a little pressed: φ π/√18, twelve contacts."""
    cells, spacing = 6, np.sqrt(2) * 0.9999
    corner = np.stack(np.meshgrid(*[np.arange(cells), np.arange(cells), np.arange(3 * cells)], indexing="ij"), axis=-1)
    basis = np.array([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)]) + 0.25
    edge = cells * spacing
    world = fc.World(
        ((0, 0, 0), (edge, edge, 3 * edge)), ("periodic", "periodic", "wall"), gravity=(0, 0, -1), device=device
    )
    position = (corner.reshape(-1, 1, 3) + basis).reshape(-1, 3) * spacing
    world.add(position=position + (0, 0, 0.25), radius=0.5, mass=1.0, velocity=(0, 0, -0.125))
    bulk, contacts = packing.measure(world), packing.measure_contacts(world)

    # The planes cut layers where they happen to lie: a fiftieth more or less.
    assert bulk.fraction == pytest.approx(np.pi / np.sqrt(18), rel=0.02)
    assert contacts.coordination == 12
    assert contacts.rattlers == 0
    assert contacts.overlap == pytest.approx(1e-4, rel=0.02)
    assert bulk.sinking == pytest.approx(0.125)


def test_a_line_through_points_with_errors():
    """Of the points (0, 1), (1, 2), (2, 9) the last counts for nothing."""
    (intercept, error), (slope, _) = figures.line_through((0, 1, 2), (1, 2, 9), (0.1, 0.1, 1e6))
    assert (intercept, slope) == pytest.approx((1, 1))
    assert error == pytest.approx(0.1)


def test_the_page_shows_what_was_found():
    """docs/validation.md has the table that tools/draw_validation.py makes of the results."""
    spec = importlib.util.spec_from_file_location("draw_validation", ROOT / "tools" / "draw_validation.py")
    draw_validation = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw_validation)
    page = draw_validation.PAGE.read_text(encoding="utf-8")
    assert draw_validation.updated(page, draw_validation.read_results()) == page
