"""The datum: the point of a map's coordinates in which everything compiled has its origin."""

import dataclasses

import numpy as np

from jaxplore import _checks
from jaxplore._types import Rows

NEAR = 1024.0
"""Greatest x and y of a map that needs no datum of its own [m]."""
FARTHEST = 1e9
"""Greatest x and y of a datum [m]: double precision has a ten-thousandth of a millimetre there."""
DECIMALS = 6
"""Decimals to which coordinates far away are rounded [m]."""


@dataclasses.dataclass(frozen=True)
class Datum:
    """Origin of the local frame of a run, in the coordinates of its map; the axes are parallel.

    Everything compiled is in single precision, which resolves half a metre at the 4,600 km of a
    UTM northing. So a map, world or path that is far away is moved where it enters: positions are
    relative to a datum near it, `p_local = p_map - datum`, in double precision. What leaves a run
    is moved back: recordings, run folders, messages. No compiled program depends on the datum.

    Args:
        x: x coordinate [m].
        y: y coordinate [m].

    Raises:
        ValueError: a number that is not finite, or beyond 1e9 m.
    """

    x: float = 0.0
    y: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            value = _checks.number(
                f"{name} of datum", getattr(self, name), at_least=-FARTHEST, at_most=FARTHEST
            )
            object.__setattr__(self, name, value)

    @classmethod
    def near(cls, x: float, y: float, *, name: str = "position") -> "Datum":
        """Return the datum for a map or a path that begins at a position.

        It is (0, 0) where x and y are at most 1024 m, so that ordinary maps stay as they are, and
        else the position in whole metres.

        Args:
            x: x coordinate [m].
            y: y coordinate [m].
            name: what is there, for the message.

        Raises:
            ValueError: a position beyond 1e9 m.
        """
        farthest = max(abs(x), abs(y))
        if farthest <= NEAR:
            return cls()
        # The negated comparison also refuses NaN.
        if not farthest <= FARTHEST:
            raise ValueError(
                f"{name} is [{x:.10g}, {y:.10g}]; accepted: coordinates up to {FARTHEST:g} m"
            )
        return cls(float(round(x)), float(round(y)))

    def __bool__(self) -> bool:
        """Check whether local coordinates differ from those of the map."""
        return self.x != 0.0 or self.y != 0.0

    @property
    def offset(self) -> np.ndarray:
        """The datum as an array (2,) [m]."""
        return np.array([self.x, self.y])

    def to_local(self, points: Rows) -> np.ndarray:
        """Return points, poses or states (..., 2 or more) relative to the datum.

        They stay as they are for the datum (0, 0). Else x and y are rounded to micrometres, so
        that a decimal fraction is the same number as near the origin, where double precision is
        finer.

        Args:
            points: x and y in the coordinates of the map [m], and anything behind them.
        """
        local = move_points(points, -self.offset)
        if self:
            local[..., :2] = np.round(local[..., :2], DECIMALS)
        return local

    def to_map(self, points: Rows) -> np.ndarray:
        """Return points, poses or states (..., 2 or more) in the coordinates of the map.

        The inverse of `to_local`.

        Args:
            points: x and y relative to the datum [m], and anything behind them.
        """
        return move_points(points, self.offset)

    def round_to_map(self, points: Rows) -> np.ndarray:
        """Return `to_map` for a message, far away rounded to micrometres."""
        return np.round(self.to_map(points), DECIMALS) if self else np.asarray(points)


ORIGIN = Datum()
"""The datum of ordinary maps: local coordinates are those of the map."""


def move_points(points: Rows, offset: np.ndarray, columns: tuple[int, int] = (0, 1)) -> np.ndarray:
    """Return points (..., N) in float64 with an offset (x, y) added to the columns of x and y.

    An offset of zero changes nothing, the type included.
    """
    given = np.asarray(points)
    if not offset.any():
        return given
    result = np.array(given, np.float64)
    result[..., list(columns)] += offset
    return result
