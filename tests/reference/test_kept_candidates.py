"""A finder with a skin: whatever the spheres do between two calls, the answer is that of a new search, bit for bit."""

import os

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.gpu_finder import no_gpu

TYPES = [np.float32, np.float64]
each_type = pytest.mark.parametrize("dtype", TYPES, ids=lambda dtype: dtype.__name__)
ONCE, OF_EACH = ("contacts", "pairs", "counts", "total"), ("neighbors",)
FIELDS = {
    "contacts": ("first", "second", "gap", "normal"), "pairs": ("first", "second"), "neighbors": ("offsets", "indices"),
}  # fmt: skip


@pytest.fixture(scope="module", params=["fast", "generic", pytest.param("cuda", marks=no_gpu)])
def form(request):
    """The CPU's own form, the one that a GPU runs, and that on a GPU."""
    return request.param


class Both:
    """Asks a finder with a skin and one without, and compares every byte that they answer."""

    def __init__(self, form, skin):
        self.kept, self.fresh = fc.ContactFinder(2, skin), fc.ContactFinder(2)
        self.put = pytest.importorskip("cupy").asarray if form == "cuda" else np.asarray
        if form != "cuda":
            for finder in (self.kept, self.fresh):
                finder._finder.use_generic_form(form == "generic")

    @property
    def reuses(self):
        return self.kept.reuses

    def contacts(self, position, radius, margin=0.0, outputs=ONCE, **options):
        """The number of contacts that both find."""
        position, radius, *others = (
            value if np.isscalar(value) else self.put(value)
            for value in (position, radius, *(options.pop(name) for name in ("others", "sizes") if name in options))
        )
        if others:
            options |= {"other_positions": others[0], "other_radii": others[1]}
        for output in outputs:
            kept, fresh = (
                finder.find_contacts(position, radius, margin, output=output, **options)
                for finder in (self.kept, self.fresh)
            )
            self.compare(kept, fresh, FIELDS.get(output, ()))
        return self.fresh.find_contacts(position, radius, margin, output="total", **options)

    def neighbors(self, points, radius, **options):
        options = {name: self.put(value) if name == "queries" else value for name, value in options.items()}
        kept, fresh = (finder.find_neighbors(self.put(points), radius, **options) for finder in (self.kept, self.fresh))
        self.compare(kept, fresh, ("offsets", "indices", *(["distances"] if "distances" in options else [])))
        assert kept.shortened_rows == fresh.shortened_rows
        return len(fresh.indices)

    @staticmethod
    def compare(kept, fresh, fields):
        if not fields and isinstance(fresh, int):
            assert kept == fresh
            return
        for name in fields or (None,):
            one, other = (fc.to_numpy(found if name is None else getattr(found, name)) for found in (kept, fresh))
            assert (one.dtype, one.shape) == (other.dtype, other.shape)
            assert one.tobytes() == other.tobytes(), name


def cloud(dtype, count=900, side=6.0, seed=1):
    random = np.random.default_rng(seed)
    radius = (0.05 * 8.0 ** random.uniform(0, 1, count)).astype(dtype)
    return random.uniform(0, side, (count, 3)).astype(dtype), radius, random


@each_type
@pytest.mark.parametrize("outputs", [ONCE, OF_EACH], ids=["once", "of each"])
def test_a_walk(form, dtype, outputs):
    position, radius, random = cloud(dtype)
    both = Both(form, 0.06)
    found = {both.contacts(position, radius, outputs=outputs)}
    for _ in range(25):
        position = (position + 0.002 * random.normal(size=position.shape)).astype(dtype)
        found.add(both.contacts(position, radius, outputs=outputs))
    assert len(found) > 5  # they come and go
    # Each list serves some calls, and then no more: the walk goes farther than the skin.
    assert 2 <= 26 * len(outputs) - both.reuses <= 13


@each_type
def test_one_radius_for_all(form, dtype):
    position, _, random = cloud(dtype)
    both = Both(form, 0.06)
    for step in range(10):
        position = (position + 0.002 * random.normal(size=position.shape)).astype(dtype)
        assert both.contacts(position, 0.2 + 0.001 * step) > 200
    assert both.reuses > 10


def approaching(dtype, gap, count=300):
    """Pairs far from each other pair, in all directions, whose surfaces are `gap` apart; and the directions."""
    random = np.random.default_rng(2)
    site = 4.0 * np.stack(np.unravel_index(np.arange(count), (7, 7, 7)), axis=1)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    position = np.concatenate([site, site + (0.5 + 0.25 + gap) * direction]).astype(dtype)
    return position, np.repeat([0.5, 0.25], count).astype(dtype), direction


@each_type
@pytest.mark.parametrize("share", [(0.5, 0.5), (1.0, 0.0), (0.0, 1.0), (0.25, 0.75)])
def test_those_that_come_from_beyond_the_skin_are_found(form, dtype, share):
    """No candidate at first; a move of the skin altogether makes them meet."""
    skin = 0.1
    position, radius, direction = approaching(dtype, 1.0001 * skin)
    both = Both(form, skin)
    assert both.contacts(position, radius) == 0
    move = 1.0002 * skin * np.concatenate([share[0] * direction, -share[1] * direction])
    assert both.contacts((position + move).astype(dtype), radius) == len(direction)


@each_type
@pytest.mark.parametrize("what", ["radii", "margin", "radius for all", "radii and places"])
def test_those_that_grow_beyond_the_skin_are_found(form, dtype, what):
    skin = 0.1
    position, radius, direction = approaching(dtype, 1.0001 * skin)
    more = 1.0002 * skin
    both = Both(form, skin)
    if what == "radius for all":
        assert both.contacts(position, 0.375) == 0
        assert both.contacts(position, 0.375 + 0.5 * more) == len(direction)
        return
    assert both.contacts(position, radius) == 0
    if what == "radii":
        assert both.contacts(position, (radius + 0.5 * more).astype(dtype)) == len(direction)
    elif what == "margin":
        assert both.contacts(position, radius, margin=more) == len(direction)
    else:
        move = 0.25 * more * np.concatenate([direction, -direction])
        assert both.contacts((position + move).astype(dtype), (radius + 0.25 * more).astype(dtype)) == len(direction)


@each_type
def test_candidates_are_kept_up_to_the_skin(form, dtype):
    skin = 0.1
    position, radius, direction = approaching(dtype, 0.99 * skin)
    both = Both(form, skin)
    assert both.contacts(position, radius, outputs=["pairs"]) == 0
    move = 0.499 * skin * np.concatenate([direction, -direction])
    assert both.contacts((position + move).astype(dtype), radius, outputs=["pairs"]) == len(direction)
    assert both.contacts(position, radius, margin=0.995 * skin, outputs=["pairs"]) == len(direction)
    assert both.contacts(position, radius + dtype(0.499 * skin), outputs=["pairs"]) == len(direction)
    assert both.contacts(position, radius - dtype(0.01), outputs=["pairs"]) == 0  # to shrink costs nothing
    assert both.reuses == 4
    # What counts is the way from where the list was made, not that of the last call.
    assert both.contacts((position - move).astype(dtype), radius, outputs=["pairs"]) == 0
    assert both.reuses == 5
    assert both.contacts((position - 1.1 * move).astype(dtype), radius, outputs=["pairs"]) == 0
    assert both.reuses == 5


@each_type
def test_one_that_jumps_makes_the_list_anew(form, dtype):
    position, radius, random = cloud(dtype)
    both = Both(form, 0.05)
    both.contacts(position, radius, outputs=["contacts"])
    for one in (0, 449, 899):
        position = position.copy()
        position[one] = random.uniform(0, 6, 3)
        radius = radius.copy()
        radius[one] = 0.8
        assert both.contacts(position, radius, outputs=["contacts"]) > 300
    assert both.reuses == 0
    assert both.contacts(position, radius, outputs=["contacts"]) > 300
    assert both.reuses == 1


@each_type
def test_two_sets(form, dtype):
    position, radius, random = cloud(dtype)
    others, sizes, _ = cloud(dtype, count=700, seed=3)
    both = Both(form, 0.08)
    for step in range(12):
        # First one set moves, then the other, then both.
        if step % 3 != 1:
            position = (position + 0.003 * random.normal(size=position.shape)).astype(dtype)
        if step % 3 != 0:
            others = (others + 0.003 * random.normal(size=others.shape)).astype(dtype)
        assert both.contacts(position, radius, others=others, sizes=sizes, outputs=[*ONCE, *OF_EACH]) > 300
    assert 30 < both.reuses < 60
    # One that jumps, in either set.
    for array in (position, others):
        before = both.reuses
        array[5] = (3, 3, 3)
        both.contacts(position, radius, others=others, sizes=sizes, outputs=["pairs"])
        assert both.reuses == before
    # The same arrays as one set, and the sets exchanged.
    both.contacts(position, radius)
    both.contacts(others, sizes, others=position, sizes=radius)


@each_type
def test_the_end_of_a_period_is_no_jump(form, dtype):
    position, radius, random = cloud(dtype)
    both = Both(form, 0.08)
    box = {"bounds": ((0, 0, 0), (6, 6, 6)), "boundary": ("periodic", "open", "periodic")}
    found, crossed = set(), 0
    for _ in range(12):
        moved = position + [0.003, 0, -0.003] + 0.001 * random.normal(size=position.shape)
        moved[:, [0, 2]] %= 6
        moved = np.minimum(moved, dtype(6)).astype(dtype)
        crossed += np.count_nonzero(np.abs(moved - position) > 3)
        position = moved
        found.add(both.contacts(position, radius, outputs=["contacts"], **box))
    assert crossed > 5
    assert len(found) > 3
    assert 5 < both.reuses < 11


@each_type
def test_another_period_is_another_problem_though_nothing_moves(form, dtype):
    position, radius, _ = cloud(dtype)
    both = Both(form, 0.05)
    found = [
        both.contacts(position, radius, outputs=["pairs"], bounds=((0, 0, 0), (length, 7, 7)), boundary="periodic")
        for length in (7, 6.1, 6, 7)
    ]
    both.contacts(position, radius, outputs=["pairs"])
    assert found[0] < found[1] < found[2]
    assert both.reuses == 0


def test_a_period_too_short_for_the_skin_is_searched_anew(form):
    position, _, _ = cloud(np.float64, side=1.5)
    both = Both(form, 0.3)
    box = {"bounds": ((0, 0, 0), (1.5, 1.5, 1.5)), "boundary": "periodic"}
    assert both.contacts(position, 0.25, **box) > 1000
    assert both.contacts(position, 0.25, **box) > 1000
    assert both.reuses == 0


def test_neighbors(form):
    points, _, random = cloud(np.float32)
    both = Both(form, 0.05)
    options = ({}, {"sort": "distance", "distances": "squared"}, {"max_neighbors": 3, "distances": "euclidean"})
    for _ in range(6):
        points = (points + 0.002 * random.normal(size=points.shape)).astype(np.float32)
        for one in options:
            assert both.neighbors(points, 0.5, **one) > 1000
        assert both.neighbors(points, 0.49, queries=points[:50] + np.float32(0.1)) > 50
    assert both.reuses > 5


def test_what_else_may_change(form):
    """Numbers of spheres, types, kinds of answers and lists, none at all: never a stale answer."""
    position, radius, _ = cloud(np.float64)
    both = Both(form, 0.1)
    for _ in range(2):
        assert both.contacts(position, radius, outputs=[*ONCE, *OF_EACH, *ONCE]) > 300
        both.contacts(position[:500], radius[:500])
        both.contacts(position.astype(np.float32), radius.astype(np.float32))
        both.contacts(position, 0.3)
        assert both.contacts(position, 0.0) == 0
        assert both.contacts(position[:0], radius[:0]) == 0
        both.contacts(position[::-1].copy(), radius[::-1].copy())
        with pytest.raises(fc.InvalidValue, match=r"positions\[3\]"):
            both.kept.find_contacts(both.put(np.where(np.arange(900)[:, None] == 3, np.nan, position)), 0.3)
        with pytest.raises(fc.OutOfMemory, match="max_contacts"):
            both.kept.find_contacts(both.put(position), both.put(radius), max_contacts=10)


def test_rounding_does_not_lose_a_pair(form):
    """A skin of a few last bits: the margin of the check is for such, and then nothing can be reused."""
    position, radius, _ = cloud(np.float64)
    both = Both(form, 4e-16)
    for _ in range(2):
        assert both.contacts(position, radius, outputs=["pairs"]) > 300
    assert both.contacts(np.nextafter(position, 0), radius, outputs=["pairs"]) > 300
    assert both.reuses == 0


memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 0


@pytest.mark.skipif(not 0 < memory < 60e9, reason="the candidates may fit into the memory")
def test_more_candidates_than_the_memory_holds_are_not_kept():
    """2,147,516,416 candidates, of which none touches in the first call and all do in the second."""
    position = np.full((65_537, 3), 1.5)
    position[:, 0] = np.linspace(0, 1, 65_537)
    finder = fc.ContactFinder(skin=3.0)
    assert finder.find_contacts(position, 1e-6, output="total") == 0
    assert finder.find_contacts(position, 0.75, output="total") == 65_537 * 65_536 // 2
    assert finder.reuses == 0


@pytest.mark.parametrize("skin", [-0.1, np.nan, np.inf, "thick", None])
def test_a_wrong_skin_is_refused(skin):
    with pytest.raises(fc.InvalidValue, match=r"skin: found .*; allowed: ") as caught:
        fc.ContactFinder(skin=skin)
    assert caught.value.field == "skin"


steps = st.one_of(
    st.tuples(st.just("walk"), st.floats(0.0, 0.3), st.integers(0, 99)),
    st.tuples(st.just("jump"), st.floats(-2.0, 2.0), st.integers(0, 99)),
    st.tuples(st.just("grow"), st.floats(-0.25, 0.25), st.integers(0, 99)),
    st.tuples(st.just("margin"), st.floats(0.0, 0.5), st.just(0)),
    st.tuples(st.just("fewer"), st.floats(0.0, 0.9), st.just(0)),
    st.tuples(st.just("more"), st.just(0.0), st.integers(0, 99)),
)


@settings(max_examples=60)
@given(
    story=st.lists(steps, min_size=2, max_size=10),
    skin=st.sampled_from([0.01, 0.1, 0.5]),
    periodic=st.booleans(),
    outputs=st.sampled_from([ONCE, OF_EACH]),
    dtype=st.sampled_from(TYPES),
)
def test_any_story(form, story, skin, periodic, outputs, dtype):
    """Spheres walk, jump, grow, shrink, come and go."""
    both = Both(form, skin)
    position, radius, _ = cloud(dtype, count=30, side=2.0)
    margin = 0.0
    options = {"bounds": ((-4, -4, -4), (4, 4, 4)), "boundary": "periodic"} if periodic else {}
    for what, amount, seed in story:
        random = np.random.default_rng(seed)
        if what == "walk":
            position = position + skin * amount * random.normal(size=position.shape)
        elif what == "jump" and len(position):
            position = position.copy()
            position[seed % len(position)] = amount
        elif what == "grow" and len(position):
            radius = radius.copy()
            radius[seed % len(radius)] = max(0, radius[seed % len(radius)] + skin * amount)
        elif what == "margin":
            margin = skin * amount
        elif what == "fewer":
            keep = int(amount * len(position))
            position, radius = position[:keep], radius[:keep]
        elif what == "more":
            position = np.concatenate([position, random.uniform(0, 2, (3, 3))])
            radius = np.concatenate([radius, random.uniform(0.05, 0.4, 3)])
        if periodic:
            position = np.where(np.abs(position) > 4, position - 8 * np.sign(position), position)
        position, radius = position.astype(dtype), radius.astype(dtype)
        both.contacts(position, radius, margin, outputs, **options)
