"""Pressure, collisions, velocities and cooling of a gas of hard spheres.

Kolafa's equation of state as given by A. Mulero et al., "Equations of state for hard spheres" (2008), ch. 3; N. F.
Carnahan and K. E. Starling, J. Chem. Phys. 51, 635 (1969); P. K. Haff, J. Fluid Mech. 134, 401 (1983).
"""

import fastcollide as fc
import numpy as np
import pytest
from validation import boltzmann, gas
from validation.event_driven import EventDrivenGas
from validation.figures import Figure, line_through, mean_and_error, within


@pytest.mark.parametrize(
    ("fraction", "steps", "duration"),
    [
        (0.1, (0.01, 0.005, 0.0025), 120),
        (0.2, (0.01, 0.005, 0.0025), 45),
        (0.3, (0.005, 0.0025, 0.00125), 20),
        (0.4, (0.005, 0.0025, 0.00125), 12),
    ],
)
def test_pressure_and_collision_rate(device, publish, fraction, steps, duration):
    """About 200 collisions of each of 6,912 spheres for each step."""
    pressure, rate = [], []
    for seed, dt in enumerate(steps, start=1):
        world = gas.new_gas(4 * 12**3, fraction, device, seed)
        gas.equilibrate(world, fraction, dt)
        statistics = gas.collision_statistics(world, duration, dt)
        pressure.append(mean_and_error(statistics.pressure))
        rate.append(mean_and_error(statistics.rate))

    at = steps.index(0.0025)
    expected, expected_rate = gas.kolafa(fraction), gas.enskog_rate(fraction)
    (limit, slope), (rate_limit, rate_slope) = (
        line_through(steps, *np.transpose(values)) for values in (pressure, rate)
    )
    found = [
        within("Z, dt → 0", limit, expected, 0.005, "Kolafa"),
        within("collision rate, dt 0.0025", rate[at], expected_rate, 0.01, "Enskog"),
        within("collision rate, dt → 0", rate_limit, expected_rate, 0.01, "Enskog"),
    ]
    if fraction <= 0.2:
        found.insert(0, within("Z, dt 0.0025", pressure[at], expected, 0.01, "Kolafa"))
    curves = {
        "fraction": fraction, "steps": steps, "pressure": pressure, "pressure_limit": limit, "pressure_slope": slope,
        "rate": rate, "rate_limit": rate_limit, "rate_slope": rate_slope,
        "expected_pressure": expected, "expected_rate": expected_rate,
    }  # fmt: skip
    publish(f"gas_{round(100 * fraction)}", f"Gas of hard spheres, φ {fraction}", found, curves)


def equal_speeds(count, seed):
    """In random directions; without momentum, kT 1."""
    velocity = np.random.default_rng(seed).normal(size=(count, 3))
    velocity /= np.linalg.norm(velocity, axis=1)[:, None]
    velocity -= velocity.mean(axis=0)
    return velocity / np.sqrt((velocity**2).mean())


def test_velocities_become_maxwellian(device, publish):
    """From equal speeds, kurtosis 1.8, to 3.00 ± 0.03 when every one of 10⁵ spheres has had five collisions.

    After five on average Boltzmann's equation is still at 2.85, so on the way there its solution is the yardstick.
    """
    fraction, dt = 0.2, 0.005
    start = gas.new_gas(4 * 30**3, fraction, device)
    gas.equilibrate(start, fraction, dt, collisions=10)
    count = len(start)
    world = gas.copy_of(start, equal_speeds(count, seed=1))
    velocity = fc.to_numpy(world.velocities)
    hits, rows = np.zeros(count, np.int64), [(0.0, gas.kurtosis(velocity))]
    while hits.min() < 5:
        for change in gas.velocity_changes(world, 10, dt):
            hits += gas.has_collided(change)
        velocity = fc.to_numpy(world.velocities)
        rows.append((float(hits.mean()), gas.kurtosis(velocity)))
    collisions, found = np.transpose(rows)

    relaxed = [(s, gas.kurtosis(v)) for s, v in boltzmann.relax(equal_speeds(400_000, seed=2), until=8, seed=3)]
    on_the_way = collisions < 8
    expected = np.interp(collisions[on_the_way], *np.transpose(relaxed))
    farthest = float(np.abs(found[on_the_way] - expected).max())
    after_five, expected_after_five = np.interp(5, collisions, found), np.interp(5, *np.transpose(relaxed))
    error = np.sqrt(24 / (3 * count))  # of the kurtosis of so many normal numbers

    speeds, edges = np.histogram(np.linalg.norm(velocity.astype(np.float64), axis=1), 40, (0.0, 5.0), density=True)
    source = "Boltzmann"
    figures = [
        Figure("kurtosis when every sphere has had 5 collisions", found[-1], error, 3, 2.97, 3.03, "Maxwell"),
        Figure(
            "kurtosis after 5 collisions on average", after_five, error, expected_after_five,
            expected_after_five - 0.03, expected_after_five + 0.03, source,
        ),
        Figure("the same, largest error from 0 to 8 collisions", farthest, error, 0, 0, 0.03, source),
    ]  # fmt: skip
    curves = {
        "collisions": collisions, "kurtosis": found, "fewest_collisions": int(hits.min()),
        "boltzmann": relaxed[:: len(relaxed) // 40], "speed_edges": edges, "speed_density": speeds,
    }  # fmt: skip
    publish("maxwell", "Maxwell's distribution, φ 0.2, 108,000 spheres", figures, curves)


def test_haff_s_law_of_cooling(device, publish):
    """φ 0.1, e 0.9, from equilibrium, until the temperature is a ninth; 40 gases of 500.

    Enskog's rate leaves out that the velocities of neighbours become alike, which slows the cooling: exact event-driven
    dynamics from the same starts, the second yardstick, is below it too.
    """
    fraction, restitution, dt, sample = 0.1, 0.9, 0.005, 40
    expected = gas.haff_rate(fraction, restitution)
    times = sample * dt * np.arange(1 + round(2 / expected / dt / sample))
    temperatures, exact = [], []
    for seed in range(1, 41):
        start = gas.new_gas(500, fraction, device, seed)
        gas.equilibrate(start, fraction, dt)
        world = gas.copy_of(start, restitution=restitution)
        temperatures.append([gas.temperature(world)])
        for _ in times[1:]:
            world.step(sample, dt)
            temperatures[-1].append(gas.temperature(world))
        twin = EventDrivenGas(
            fc.to_numpy(start.positions), fc.to_numpy(start.velocities), start.bounds[1][0], restitution
        )
        exact.append([])
        for time in times:
            twin.advance_to(time)
            exact[-1].append(twin.temperature())

    def rate_of(kt):
        """1/τ in units of the temperature at the start: √(T₀/T) is a straight line."""
        slope, at_start = np.polyfit(times * np.sqrt(kt[0]), np.sqrt(kt[0] / kt), 1)
        return slope / at_start

    rate = mean_and_error([rate_of(np.array(kt)) for kt in temperatures])
    exact_rate = mean_and_error([rate_of(np.array(kt)) for kt in exact])
    found = [
        within("1/τ", rate, expected, 0.02, "Haff, Enskog"),
        within("1/τ", rate, exact_rate[0], 0.02, "event-driven dynamics"),
    ]
    curves = {
        "time": times, "temperature": np.mean(temperatures, axis=0), "event_driven": np.mean(exact, axis=0),
        "expected_rate": expected, "rate": rate, "event_driven_rate": exact_rate,
    }  # fmt: skip
    publish("haff", "Haff's law of cooling, φ 0.1, e 0.9", found, curves)
