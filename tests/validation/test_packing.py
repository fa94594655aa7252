"""How densely equal spheres lie that have fallen on a floor.

G. D. Scott and D. M. Kilgour, J. Phys. D 2, 863 (1969); C. S. O'Hern et al., Phys. Rev. E 68, 011306 (2003); G. Y.
Onoda and E. G. Liniger, Phys. Rev. Lett. 64, 2727 (1990).
"""

from dataclasses import asdict

import numpy as np
from validation import heap, packing
from validation.figures import Figure, mean_and_error


def test_random_close_packing(device, publish):
    """Without friction; 3,000 spheres, three starts.

    A packing of hard spheres without friction has six contacts a sphere (isostatic), a soft one under load more, in
    proportion to the square root of the overlap (O'Hern et al.). A substep half as long makes the overlap a quarter.
    """
    substeps, durations = (0.004, 0.002), (40, 20)
    samples = []
    for seed in (1, 2, 3):
        world = packing.rain(3000, 10.0, friction=0.0, restitution=0.3, device=device, seed=seed)
        samples.append([])
        for substep, duration in zip(substeps, durations, strict=True):
            packing.settle(world, duration, substep)
            samples[-1].append({**asdict(packing.measure(world)), **asdict(packing.measure_contacts(world))})

    last = [rows[-1] for rows in samples]
    fraction = mean_and_error([row["fraction"] for row in last])
    # The overlaps undone by swelling the space: hard spheres as loosely as these could lie.
    hard = mean_and_error([row["fraction"] * (1 - row["overlap"]) ** 3 for row in last])
    coordination = mean_and_error([row["coordination"] for row in last])
    # A straight line of the square root of the overlap, through the two substeps.
    root, contacts = (np.array([[row[key] for row in rows] for rows in samples]) for key in ("overlap", "coordination"))
    root = np.sqrt(root)
    slope = (contacts[:, 0] - contacts[:, 1]) / (root[:, 0] - root[:, 1])
    limit = mean_and_error(contacts[:, 1] - slope * root[:, 1])
    found = [
        Figure("volume fraction", *fraction, 0.64, 0.62, 0.65, "Scott and Kilgour"),
        Figure("volume fraction, overlap undone", *hard, 0.64, 0.62, 0.65, "Scott and Kilgour"),
        Figure("contacts of a sphere", *coordination, 6.0, 5.8, 6.2, "isostatic"),
        Figure("contacts of a sphere, overlap → 0", *limit, 6.0, 5.8, 6.2, "isostatic"),
    ]
    publish("close_packing", "Random close packing, no friction", found, {"substeps": substeps, "samples": samples})


def test_random_loose_packing(device, publish):
    """With high friction; 1,500 spheres, at several lengths of a substep.

    Friction holds the contacts by springs, so the packing stays as loosely as it came to rest: it breathes, and does
    not sink. With high friction four contacts just hold a sphere (isostatic); a few more are found.
    """
    substeps = (0.008, 0.004, 0.002, 0.001)
    samples = []
    for substep in substeps:
        world = packing.rain(1500, 8.0, friction=10.0, restitution=0.1, device=device, seed=1)
        packing.settle(world, 20, substep)
        samples.append([])
        for _ in range(8):
            packing.settle(world, 1, substep)
            row = asdict(packing.measure(world)) | asdict(packing.measure_contacts(world, fewest=2))
            samples[-1].append({"time": world.time, **row})
    fractions = [np.mean([row["fraction"] for row in rows[-4:]]) for rows in samples]
    sunk = fractions[-1] - np.mean([row["fraction"] for row in samples[-1][:4]])
    found = [
        Figure(f"volume fraction, substep {substep} √(d/g)", fraction, None, 0.55, 0.54, 0.60, "Onoda and Liniger")
        for substep, fraction in zip(substeps, fractions, strict=True)
    ]
    found += [
        Figure("its rise in a time of 4", sunk, None, 0.0, -0.001, 0.001, "at rest"),
        Figure("contacts of a sphere", samples[-1][-1]["coordination"], None, 4.0, 3.8, 5.0, "isostatic"),
    ]
    publish("loose_packing", "Random loose packing, friction 10", found, {"substeps": substeps, "samples": samples})


def test_heap(device, publish):
    """1,500 spheres that fall apart from a column into a heap keep its slope (of the cone with the same moments)."""
    world = heap.column(1500, friction=0.5, rolling_friction=0.1, device=device)
    packing.settle(world, 40, 0.004)
    samples = []
    for _ in range(9):
        samples.append({"time": world.time, **asdict(heap.measure(world))})
        packing.settle(world, 10, 0.004)
    first, last = samples[0]["slope"], samples[-1]["slope"]
    found = [
        Figure("slope [°]", last, None, 11.0, 9.0, 13.0, "this engine"),
        Figure("its loss in a time of 80 [°]", first - last, None, 0.0, -0.01, 0.01, "at rest"),
    ]
    publish("heap", "Heap, friction 0.5, rolling friction 0.1", found, {"samples": samples})
