"""Check the entries of a world file.

Each check takes the name and the value of an entry, and returns the value in its final type or
raises a `ValueError` of one line.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks
from jaxplore._text import short_repr
from jaxplore.maps.ground import HIGHEST
from jaxplore.maps.rasterise import TOLERANCE

Row = tuple[float, ...]

SHAPES = ("walls", "rectangles", "discs")
OPTIONAL_LISTS = ("hills", "targets", "objects", "movers", "forbidden")
WORLD_ENTRIES = (
    *("origin", "size", "resolution", "wall_reach", "zones", "start", "goal"),
    *OPTIONAL_LISTS,
)
MOVER_ENTRIES = ("path", "speed", "radius")
OBJECT_ENTRIES = ("position", "label")


@dataclass(frozen=True)
class MovingObstacle:
    """Disc that moves along a closed polyline at constant speed, starting at its first point.

    After the last point it returns to the first in a straight line. With two points it moves back
    and forth, with one it stands still.

    Args:
        path: corners (x, y) of the polyline, at least one [m].
        speed: speed of the disc, at least 0 [m/s].
        radius: radius of the disc [m].

    Raises:
        ValueError: a path without points, a point that is not two finite numbers, a speed that is
            negative or not finite, a radius that is not positive.
    """

    path: tuple[Row, ...]
    speed: float
    radius: float

    def __post_init__(self) -> None:
        for name in MOVER_ENTRIES:
            object.__setattr__(self, name, CHECKS[name](name, getattr(self, name)))


@dataclass(frozen=True)
class LabelledObject:
    """Object of a class, too small to stop a robot or a beam.

    Args:
        position: position (x, y) [m].
        label: name of its class.

    Raises:
        ValueError: a position that is not two finite numbers, a label that is no text.
    """

    position: Row
    label: str

    def __post_init__(self) -> None:
        for name in OBJECT_ENTRIES:
            object.__setattr__(self, name, CHECKS[name](name, getattr(self, name)))


def _number(name: str, value: object, **bounds: float) -> float:
    # `float()` would accept strings and booleans, which in a file are mistakes.
    try:
        if isinstance(value, bool) or not isinstance(value, Real):
            raise ValueError
        value = float(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{name} is {short_repr(value)}; accepted: a finite number") from None
    return _checks.number(name, value, **bounds)


def _numbers(name: str, value: object, counts: Collection[int], accepted: str) -> Row:
    if isinstance(value, (list, tuple)) and len(value) in counts:
        try:
            return tuple(_number(name, entry) for entry in value)
        except ValueError:
            pass  # the message below shows the whole entry instead
    raise ValueError(f"{name} is {short_repr(value)}; accepted: {accepted}")


def _rows(
    name: str, value: object, count: int, accepted: str, is_accepted: Callable[[Row], bool]
) -> tuple[Row, ...]:
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"{name} is {short_repr(value)}; accepted: a list of {accepted}")
    rows = tuple(
        _numbers(f"{name}[{index}]", row, (count,), accepted) for index, row in enumerate(value)
    )
    for index, row in enumerate(rows):
        if not is_accepted(row):
            raise ValueError(f"{name}[{index}] is {list(row)}; accepted: {accepted}")
    return rows


def _walls(name: str, value: object) -> tuple[Row, ...]:
    accepted = "4 finite numbers [x1, y1, x2, y2], two different points"
    return _rows(name, value, 4, accepted, lambda row: row[:2] != row[2:])


def _rectangles(name: str, value: object) -> tuple[Row, ...]:
    accepted = "4 finite numbers [x_min, y_min, x_max, y_max], min < max"
    return _rows(name, value, 4, accepted, lambda row: row[0] < row[2] and row[1] < row[3])


def _discs(name: str, value: object) -> tuple[Row, ...]:
    accepted = "3 finite numbers [x, y, radius], radius > 0"
    return _rows(name, value, 3, accepted, lambda row: row[2] > 0.0)


def _size(name: str, value: object) -> Row:
    accepted = "2 finite numbers > 0 [width, height]"
    size = _numbers(name, value, (2,), accepted)
    if min(size) <= 0.0:
        raise ValueError(f"{name} is {list(size)}; accepted: {accepted}")
    return size


def _goal(name: str, value: object) -> Row | None:
    accepted = "2 or 3 finite numbers [x, y] or [x, y, z], or nothing"
    return None if value is None else _numbers(name, value, (2, 3), accepted)


def _hills(name: str, value: object) -> tuple[Row, ...]:
    accepted = "4 finite numbers [x, y, height, radius], radius > 0"
    rows = _rows(name, value, 4, accepted, lambda row: row[3] > 0.0)
    total = sum(abs(row[2]) for row in rows)
    if total > HIGHEST:
        raise ValueError(
            f"{name} have heights of {total:.6g} m in all; accepted: at most {HIGHEST:g} m"
        )
    return rows


def _points(name: str, value: object) -> tuple[Row, ...]:
    return _rows(name, value, 2, "2 finite numbers [x, y]", lambda row: True)


def _path(name: str, value: object) -> tuple[Row, ...]:
    path = _points(name, value)
    if not path:
        raise ValueError(f"{name} is {value!r}; accepted: at least one point [x, y]")
    return path


def _make_all[T](name: str, value: object, kind: type[T], keys: Collection[str]) -> tuple[T, ...]:
    """Check a list of mappings, or of what is made of them, and return it made."""
    if not isinstance(value, (list, tuple)):
        raise ValueError(
            f"{name} is {short_repr(value)}; accepted: a list of mappings with " + ", ".join(keys)
        )
    return tuple(_one(f"{name}[{index}]", entry, kind, keys) for index, entry in enumerate(value))


def _one[T](name: str, value: object, kind: type[T], keys: Collection[str]) -> T:
    if isinstance(value, kind):
        return value
    accepted = f"accepted: a mapping with {', '.join(keys)}"
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} is {short_repr(value)}; {accepted}")
    refuse_unknown(f"{name}: ", value, keys)
    for key in keys:
        if key not in value:
            raise ValueError(f"{name}.{key} is missing; {accepted}")
    try:
        return kind(**check_entries(value, keys))
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None


def _label(name: str, value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{name} is {short_repr(value)}; accepted: the name of a class")
    return value


CHECKS: Mapping[str, Callable[[str, object], Any]] = {
    "walls": _walls,
    "rectangles": _rectangles,
    "discs": _discs,
    "zones": _rectangles,
    "forbidden": _rectangles,
    "origin": lambda name, value: _numbers(name, value, (2,), "2 finite numbers [x, y]"),
    "size": _size,
    "resolution": lambda name, value: _number(name, value, above=0.0),
    "wall_reach": lambda name, value: _number(name, value, above=0.0),
    "start": lambda name, value: _numbers(name, value, (3,), "3 finite numbers [x, y, yaw]"),
    "goal": _goal,
    "hills": _hills,
    "targets": _points,
    "movers": lambda name, value: _make_all(name, value, MovingObstacle, MOVER_ENTRIES),
    "objects": lambda name, value: _make_all(name, value, LabelledObject, OBJECT_ENTRIES),
    "position": lambda name, value: _numbers(name, value, (2,), "2 finite numbers [x, y]"),
    "label": _label,
    "path": _path,
    "speed": lambda name, value: _number(name, value, at_least=0.0),
    "radius": lambda name, value: _number(name, value, above=0.0),
}


def check_entries(entries: Mapping[Any, Any], names: Collection[str]) -> dict[str, Any]:
    """Return the checked values of those entries that are among `names`."""
    return {name: CHECKS[name](name, entries[name]) for name in names if name in entries}


def refuse_unknown(where: str, entries: Mapping[Any, Any], accepted: Collection[str]) -> None:
    """Raise a `ValueError` if a key of `entries` is not accepted; `where` begins the message."""
    unknown = [key for key in entries if key not in accepted]
    if unknown:
        names = ", ".join(short_repr(key) for key in unknown[:5])
        raise ValueError(f"{where}unknown entry {names}; accepted: {', '.join(accepted)}")


def touches_solid(
    solid: NDArray[np.bool_], ends: NDArray[np.float64], radius: float, resolution: float
) -> bool:
    """Return whether a disc that moves between the `ends` (2, 2), (x, y) from the lower corner of
    the map [m], touches a solid cell. Off the map nothing is solid.

    The test is exact. A segment and a square intersect unless an axis of the square or the normal
    of the segment separates them. If they do not, their distance is that of an end of the segment
    from the square or of a corner of the square from the segment.
    """
    limits = np.array(solid.shape)
    (left, bottom), (right, top) = ends.min(axis=0) - radius, ends.max(axis=0) + radius
    # Search one more cell on each side: a disc that only touches a cell counts.
    first = np.clip(np.floor(np.array([bottom, left]) / resolution) - 1, 0, limits).astype(int)
    last = np.clip(np.floor(np.array([top, right]) / resolution) + 2, 0, limits).astype(int)
    found = np.argwhere(solid[first[0] : last[0], first[1] : last[1]]) + first
    centres = (found[:, ::-1] + 0.5) * resolution
    half, along = resolution / 2, ends[1] - ends[0]
    middle = ends.mean(axis=0) - centres
    # Separating axes: the two axes of the square, then the normal of the segment.
    is_beside = np.abs(middle) > half + np.abs(along) / 2
    is_across = np.abs(middle @ [-along[1], along[0]]) > half * np.abs(along).sum()
    if not (is_beside.any(axis=-1) | is_across).all():
        return True
    # Nothing intersects, so the distances of ends and corners decide.
    from_end = np.maximum(np.abs(ends[:, None] - centres) - half, 0.0)
    corners = centres[:, None] + half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    # The ends of an obstacle that stands still coincide: keep the division finite.
    squared = max(float(along @ along), np.finfo(np.float64).tiny)
    share = np.clip((corners - ends[0]) @ along / squared, 0.0, 1.0)
    from_corner = corners - ends[0] - share[..., None] * along
    gaps = (np.hypot(gap[..., 0], gap[..., 1]) for gap in (from_end, from_corner))
    return any(bool((gap <= radius + TOLERANCE).any()) for gap in gaps)
