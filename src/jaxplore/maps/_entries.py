"""Checks of a world file's entries: each says in one line what is wrong and what is accepted."""

from collections.abc import Callable, Collection, Mapping
from numbers import Real
from typing import Any

from jaxplore import _checks
from jaxplore.maps import _files

Row = tuple[float, ...]

SHAPES = ("walls", "rectangles", "discs")
OTHERS = ("origin", "size", "resolution", "wall_reach", "zones", "start", "goal")


def _number(name: str, value: object, **bounds: float) -> float:
    try:
        if isinstance(value, bool) or not isinstance(value, Real):
            raise ValueError
        value = float(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{name} is {_files.show(value)}; accepted: a finite number") from None
    return _checks.number(name, value, **bounds)


def _numbers(name: str, value: object, counts: Collection[int], accepted: str) -> Row:
    if isinstance(value, (list, tuple)) and len(value) in counts:
        try:
            return tuple(_number(name, entry) for entry in value)
        except ValueError:
            pass  # the whole entry is shown instead
    raise ValueError(f"{name} is {_files.show(value)}; accepted: {accepted}")


def _rows(
    name: str, value: object, count: int, accepted: str, is_accepted: Callable[[Row], bool]
) -> tuple[Row, ...]:
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"{name} is {_files.show(value)}; accepted: a list of {accepted}")
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


CHECKS: Mapping[str, Callable[[str, object], Any]] = {
    "walls": _walls,
    "rectangles": _rectangles,
    "discs": _discs,
    "zones": _rectangles,
    "origin": lambda name, value: _numbers(name, value, (2,), "2 finite numbers [x, y]"),
    "size": _size,
    "resolution": lambda name, value: _number(name, value, above=0.0),
    "wall_reach": lambda name, value: _number(name, value, above=0.0),
    "start": lambda name, value: _numbers(name, value, (3,), "3 finite numbers [x, y, yaw]"),
    "goal": _goal,
}


def checked(entries: Mapping[Any, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: CHECKS[name](name, entries[name]) for name in names if name in entries}


def refuse_unknown(where: str, entries: Mapping[Any, Any], accepted: Collection[str]) -> None:
    unknown = [key for key in entries if key not in accepted]
    if unknown:
        names = ", ".join(_files.show(key) for key in unknown[:5])
        raise ValueError(f"{where}unknown entry {names}; accepted: {', '.join(accepted)}")
