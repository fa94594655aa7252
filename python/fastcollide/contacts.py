"""Which spheres touch, which points are near: the engine's search for anyone's arrays."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fastcollide import _core
from fastcollide.arrays_in import ArrayIn, array_in, current_stream, is_number_on_host, like
from fastcollide.errors import InvalidValue
from fastcollide.spheres import Bounds, corners
from fastcollide.uncompiled import uncompiled
from fastcollide.world import Contacts

OUTPUTS = ("contacts", "pairs", "neighbors", "counts", "total")
_NO_LIMIT = 2**63 - 1


@dataclass(frozen=True)
class Pairs:
    """Pairs of indices, sorted by (first, second), on the device of the input.

    Within one set first < second; of two sets first counts in the one, second in the other.

    Attributes:
        first: int32, shape (n,).
        second: int32, shape (n,).
    """

    first: Any
    second: Any

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True)
class Neighbors:
    """Compressed rows: the neighbours of i are indices[offsets[i]:offsets[i + 1]], on the device of the input.

    Attributes:
        offsets: int64, shape (n + 1,).
        indices: int32, shape (m,).
        distances: of each, of the input's type, shape (m,), or None where they were not asked for.
        shortened_rows: how many rows had more than max_neighbors and were cut to their nearest.
    """

    offsets: Any
    indices: Any
    distances: Any
    shortened_rows: int

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.offsets) - 1


class ContactFinder:
    """The searches of this module with memory that is kept from call to call: for many calls in a row.

    It searches where the arrays lie. Threads that share a finder take turns.

    With a skin the finder keeps candidates: all pairs whose surfaces are less than the skin beyond the margin. As long
    as no two spheres can have come closer by more than that, which each call checks where the arrays lie, later calls
    look at the candidates alone; else the list is made anew. Positions, radii and margin may change freely: the result
    is that of a new search, bit for bit. The list of one set of spheres (or pair of sets) is kept at a time, and one of
    two kinds: of pairs once (contacts, pairs, counts, total) or of the neighbours of each.

    Args:
        threads: of the CPU. None: all.
        skin: a length, for spheres that move little from call to call. 0 keeps no candidates.

    Raises:
        InvalidValue: for a wrong number of threads or skin.
    """

    def __init__(self, threads: int | None = None, skin: float = 0.0) -> None:
        self._finder = _core.ContactFinder(
            0 if threads is None else _whole("threads", threads, 2**31 - 1), _number("skin", skin)
        )

    @property
    def reuses(self) -> int:
        """How many calls have looked at kept candidates alone."""
        return int(self._finder.reuses)

    @uncompiled
    def find_contacts(
        self,
        positions: Any,
        radii: Any,
        margin: float = 0.0,
        bounds: Bounds | None = None,
        boundary: str | tuple[str, str, str] = "open",
        *,
        other_positions: Any = None,
        other_radii: Any = None,
        output: str = "contacts",
        max_contacts: int | None = None,
    ) -> Any:
        """As :func:`fastcollide.find_contacts`, in the memory that the finder keeps."""
        if output not in OUTPUTS:
            raise InvalidValue(f'output: found "{output}"; allowed: {", ".join(OUTPUTS)}', "output")
        search = _Search(positions, "positions", radii, "radii")
        if other_positions is not None:
            search.against(other_positions, "other_positions", other_radii, "other_radii")
        elif other_radii is not None:
            raise InvalidValue("other_radii: found without other_positions; allowed: both or none", "other_radii")
        arguments = search.arguments(margin, False, bounds, boundary, max_contacts)
        model = search.model
        if output == "total":
            return self._finder.count(*arguments)
        if output == "counts":
            return like(model, self._finder.counts(*arguments))
        if output == "pairs":
            return Pairs(*(like(model, array) for array in self._finder.pairs(*arguments)))
        if output == "neighbors":
            return _neighbors(model, self._finder.neighbors(*arguments, False, False, False, _NO_LIMIT))
        return Contacts(*(like(model, array) for array in self._finder.contacts(*arguments)))

    @uncompiled
    def find_neighbors(
        self,
        points: Any,
        radius: float,
        queries: Any = None,
        bounds: Bounds | None = None,
        boundary: str | tuple[str, str, str] = "open",
        *,
        distances: str | None = None,
        sort: str = "index",
        max_neighbors: int | None = None,
    ) -> Neighbors:
        """As :func:`fastcollide.find_neighbors`, in the memory that the finder keeps."""
        for field, value, allowed in (
            ("distances", distances, (None, "euclidean", "squared")),
            ("sort", sort, ("index", "distance")),
        ):
            if value not in allowed:
                raise InvalidValue(f"{field}: found {value!r}; allowed: {' or '.join(map(repr, allowed))}", field)
        radius = _number("radius", radius)
        if not 0 < radius < float("inf"):
            raise InvalidValue(f"radius: found {radius:g}; allowed: a finite number above 0", "radius")
        if queries is None:
            search = _Search(points, "points", 0.0, "radius")
        else:
            search = _Search(queries, "queries", 0.0, "radius")
            search.against(points, "points", 0.0, "radius")
        arguments = search.arguments(radius, True, bounds, boundary, None)
        try:
            found = self._finder.neighbors(
                *arguments,
                distances is not None,
                distances == "squared",
                sort == "distance",
                _NO_LIMIT if max_neighbors is None else _whole("max_neighbors", max_neighbors),
            )
        except InvalidValue as error:
            raise _renamed(error, queries is not None) from None
        return _neighbors(search.model, found)


@uncompiled
def find_contacts(
    positions: Any,
    radii: Any,
    margin: float = 0.0,
    bounds: Bounds | None = None,
    boundary: str | tuple[str, str, str] = "open",
    *,
    other_positions: Any = None,
    other_radii: Any = None,
    output: str = "contacts",
    max_contacts: int | None = None,
) -> Any:
    """All pairs of spheres whose surfaces are less than `margin` apart: d² < (r₁ + r₂ + margin)².

    Each operation is in double precision, whatever the type of the input. None is missed, at any ratio of sizes;
    spheres that just touch are not in contact.

    Arrays of NumPy, PyTorch, CuPy, JAX, or anything with DLPack or the CUDA array interface, with any strides, are read
    where they lie; on a GPU nothing passes through the host, and the search takes its place on the caller's current
    stream. Lists and integers are converted.

    Coordinates reach up to 2¹⁷ times (radius + margin / 2) from 0 in float32 (2⁴⁶ in float64): beyond, the type cannot
    place the sphere to 1/64 of its radius.

    Args:
        positions: shape (n, 3), float32 or float64, in any unit of length.
        radii: shape (n,), of the same type and unit, or one number for all.
        margin: how far apart two surfaces may be that still count, 0 or more.
        bounds: lower and upper corner, needed where an axis is periodic. Positions lie inside them there, and the
            period is more than twice the largest reach.
        boundary: "open" or "periodic", for all axes or for each; "wall" counts as open.
        other_positions: a second set, shape (m, 3); then pairs of one sphere from each are found.
        other_radii: of the second set.
        output: "contacts" gives `Contacts` (first, second, gap, normal); "pairs" `Pairs`, without the last two;
            "neighbors" `Neighbors`, for each sphere all that it touches; "counts" an array, int64, shape (n,); "total"
            an int.
        max_contacts: a list with more entries is refused.

    Returns:
        What `output` says, of the kind and on the device of `positions`: indices int32, offsets and counts int64, gaps
        and normals of the type of the positions (measured in double precision, rounded once).

    Raises:
        InvalidValue: with field and index, for a wrong number, shape or type.
        OutOfMemory: where the list does not fit.
        DeviceError: where the device fails.
    """
    return ContactFinder().find_contacts(
        positions,
        radii,
        margin,
        bounds,
        boundary,
        other_positions=other_positions,
        other_radii=other_radii,
        output=output,
        max_contacts=max_contacts,
    )


@uncompiled
def find_neighbors(
    points: Any,
    radius: float,
    queries: Any = None,
    bounds: Bounds | None = None,
    boundary: str | tuple[str, str, str] = "open",
    *,
    distances: str | None = None,
    sort: str = "index",
    max_neighbors: int | None = None,
) -> Neighbors:
    """For each point all others with d² ≤ radius², or for each query all points; decided in double precision.

    A point is not its own neighbour; another one at the same place is.

    Args:
        points: shape (n, 3), an array as `find_contacts` takes it.
        radius: more than 0; a neighbour at exactly this distance counts.
        queries: shape (m, 3), an array like points.
        bounds: as for `find_contacts`.
        boundary: as for `find_contacts`.
        distances: "euclidean" or "squared" to get them.
        sort: each row by "index" or by "distance" (ties by index).
        max_neighbors: rows with more keep their nearest (ties by index); `shortened_rows` of the result says how many.

    Returns:
        A row for each point, or for each query.

    Raises:
        InvalidValue: with field and index, for a wrong number, shape or type.
        OutOfMemory: where the list does not fit.
        DeviceError: where the device fails.
    """
    return ContactFinder().find_neighbors(
        points,
        radius,
        queries,
        bounds,
        boundary,
        distances=distances,
        sort=sort,
        max_neighbors=max_neighbors,
    )


class _Search:
    """The arguments of the engine's searches, out of those of a user."""

    def __init__(self, positions: Any, field: str, radii: Any, radii_field: str) -> None:
        self.model, self._radii, self._held = _set_of(positions, field, radii, radii_field)
        self._others: Any = None
        self._other_radii: Any = (None, 0.0)

    def against(self, positions: Any, field: str, radii: Any, radii_field: str) -> None:
        if radii is None:
            raise InvalidValue(f"{radii_field}: found None; allowed: an array or a number", radii_field)
        others, self._other_radii, held = _set_of(positions, field, radii, radii_field)
        self._others = others.described()
        self._held += held

    def arguments(
        self,
        margin: Any,
        is_inclusive: bool,
        bounds: Bounds | None,
        boundary: str | tuple[str, str, str],
        max_contacts: int | None,
    ) -> tuple[Any, ...]:
        names = (boundary,) * 3 if isinstance(boundary, str) else boundary
        if not isinstance(names, (tuple, list)) or len(names) != 3 or not all(isinstance(name, str) for name in names):
            raise InvalidValue(
                f"boundary: found {boundary!r}; allowed: one name for all axes or three names", "boundary"
            )
        if bounds is None and "periodic" in names:
            raise InvalidValue("bounds: found None; allowed: two corners, where an axis is periodic", "bounds")
        lower, upper = corners(bounds) if bounds is not None else ([0.0] * 3, [0.0] * 3)
        limit = _NO_LIMIT if max_contacts is None else _whole("max_contacts", max_contacts)
        options = (
            _number("margin", margin), is_inclusive, tuple(names), lower, upper, limit, current_stream(self.model)
        )  # fmt: skip
        return self.model.described(), self._radii, self._others, self._other_radii, options


def _set_of(positions: Any, field: str, radii: Any, radii_field: str) -> tuple[ArrayIn, Any, list[Any]]:
    """Positions, radii as the engine takes them, and what must be held until it has read them."""
    array = array_in(field, positions, 3)
    if np.isscalar(radii) or is_number_on_host(radii):
        return array, (None, _number(radii_field, radii)), [array]
    radius = array_in(radii_field, radii, 0, array.dtype if array.device < 0 else None)
    if array.device < 0 and radius.device < 0 and radius.dtype != array.dtype:
        array = array_in(field, positions, 3, radius.dtype)
    return array, (radius.described(), 0.0), [array, radius]


def _number(field: str, value: Any) -> float:
    try:
        return float(value.detach() if hasattr(value, "detach") else value)
    except (TypeError, ValueError, RuntimeError):
        raise InvalidValue(f"{field}: found {value!r}; allowed: a number", field) from None


def _whole(field: str, value: Any, most: int = _NO_LIMIT) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number <= most:
        raise InvalidValue(f"{field}: found {value!r}; allowed: a whole number from 0 to {most}", field)
    return number


def _neighbors(model: ArrayIn, found: tuple[Any, Any, Any, int]) -> Neighbors:
    offsets, indices, distances, shortened_rows = found
    return Neighbors(
        like(model, offsets),
        like(model, indices),
        None if distances is None else like(model, distances),
        shortened_rows,
    )


def _renamed(error: InvalidValue, has_queries: bool) -> InvalidValue:
    """The engine's names of arguments as those of find_neighbors."""
    names = {
        "positions": "queries" if has_queries else "points",
        "other_positions": "points",
        "radii": "radius",
        "other_radii": "radius",
        "margin": "radius",
    }
    name = names.get(error.field, error.field)
    return InvalidValue(name + str(error).removeprefix(error.field), name, error.index)
