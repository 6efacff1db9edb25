"""Solid shapes of a world: walls, rectangles and discs."""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxplore import _text
from jaxplore.maps.files.world_entries import CHECKS, SHAPES, Row, check_entries, refuse_unknown


@dataclass(frozen=True)
class Shapes:
    """Solid obstacles: walls, rectangles and discs.

    Args:
        walls: segments (x1, y1, x2, y2) [m], whose half thickness is the world's `wall_reach`.
        rectangles: rectangles (x_min, y_min, x_max, y_max) [m].
        discs: discs (x, y, radius) [m].

    Raises:
        ValueError: an entry with a wrong count of numbers, a number that is not finite, a wall of
            length 0, a rectangle with a minimum that is not below its maximum, a radius that is not
            positive.
    """

    walls: tuple[Row, ...] = ()
    rectangles: tuple[Row, ...] = ()
    discs: tuple[Row, ...] = ()

    def __post_init__(self) -> None:
        for name in SHAPES:
            object.__setattr__(self, name, CHECKS[name](name, getattr(self, name)))


def shapes_under(name: str, entries: object) -> Shapes:
    """Return the shapes under an entry of a world.

    No mapping, or a shape that `Shapes` refuses, raises a `ValueError` that names the entry.
    """
    if not isinstance(entries, Mapping):
        raise ValueError(
            f"{name} is {_text.short_repr(entries)}; accepted: a mapping with " + ", ".join(SHAPES)
        )
    refuse_unknown(f"{name}: ", entries, SHAPES)
    try:
        return Shapes(**check_entries(entries, SHAPES))
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None


def shape_lists(shapes: Shapes) -> dict[str, list[list[float]]]:
    """Return shapes as plain lists, by kind."""
    return {kind: [list(row) for row in getattr(shapes, kind)] for kind in SHAPES}
