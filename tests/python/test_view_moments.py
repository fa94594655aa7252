"""A run at one moment, and its past in bounded memory."""

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.view.moments import Box, Moment, Thinned


def moment_of(world):
    return Moment(
        world.frame,
        world.time,
        Box(world.bounds, world.boundary),
        world.positions.copy(),
        world.velocities.copy(),
        world.radii.copy(),
    )


@pytest.mark.parametrize("boundary", ["wall", "periodic", "open"])
def test_contacts_are_those_of_the_world(boundary):
    world = fc.World(bounds=((0, 0, 0), (4, 4, 4)), boundary=boundary, device="cpu")
    world.add(fc.random_spheres(600, bounds=world.bounds, seed=3, radius=(0.1, 0.3)))
    world.step(5)
    moment, contacts = moment_of(world), world.contacts()
    counts = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=600)

    assert counts.max() > 1
    np.testing.assert_array_equal(moment.contact_counts, counts)
    for sphere in (0, int(counts.argmax()), 599):
        touched = np.concatenate([contacts.second[contacts.first == sphere], contacts.first[contacts.second == sphere]])
        assert moment.touching(sphere) == sorted(touched.tolist())


def test_speeds():
    world = fc.World(device="cpu")
    world.add(position=[(0, 0, 5), (5, 5, 5)], velocity=[(3, 0, 4), (0, 0, 0)], radius=0.5)

    assert moment_of(world).speeds.tolist() == [5.0, 0.0]
    assert moment_of(world).values("radius") is None


def test_the_past_covers_the_whole_run_evenly_in_bounded_memory():
    past = Thinned(8)
    for frame in range(1000):
        past.add(frame, lambda frame=frame: frame)
        assert len(past) <= 8
        assert past[len(past) - 1] == frame  # the present is always there
    assert past.since(0) == [0, 256, 512, 768, 999]
    assert past.version == 8


def test_a_row_that_would_not_stay_is_not_even_made():
    rows = Thinned(4)
    made = []
    for frame in range(64):
        rows.add(frame, lambda frame=frame: made.append(frame) or frame, is_newest_kept=False)
    assert rows.since(0) == [0, 16, 32, 48]
    assert len(made) < 20


def test_rows_that_were_given_out_stay_until_the_version_changes():
    rows = Thinned(3)
    given, version = [], rows.version
    for frame in range(100):
        rows.add(frame, lambda frame=frame: frame, is_newest_kept=False)
        if version != rows.version:
            given, version = [], rows.version
        given += rows.since(len(given))
        assert given == rows.since(0)


def test_the_version_tells_when_rows_have_gone():
    rows = Thinned(4)
    for frame in range(4):
        rows.add(frame, lambda frame=frame: frame, is_newest_kept=False)
    assert (rows.version, len(rows)) == (0, 4)
    rows.add(4, lambda: 4, is_newest_kept=False)
    assert (rows.version, rows.since(0)) == (1, [0, 2, 4])
    rows.clear()
    assert (rows.version, len(rows)) == (2, 0)
