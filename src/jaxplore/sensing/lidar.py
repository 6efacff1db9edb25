"""A planar lidar: level beams all around, or over a sector."""

import math

import equinox as eqx
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.geometry.rays import RayCells
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.fan import first_entry

NEAR_GROUND = 3.0
"""A reading this many standard deviations before higher ground, or less, is taken for the ground.
At two of them one reading in fifty would be taken for an obstacle, and a hill has many cells."""


class Lidar(Sensor):
    """A planar lidar at the robot's centre.

    On a `Ground` its beams are level, at

        z = elevation of the robot's cell + height

    A beam also ends where it enters a cell whose elevation is above z, and comes back from there.
    The robot knows its ground: in `sight` such a cell, and all behind it, is neither hit nor
    passed, and a reading 3 sigma before it or less is no obstacle. So hills are not marked.

    Args:
        num_beams: beams per scan, B.
        max_range: reach of a beam [m]; static, as the number of cells that it crosses.
        field_of_view: in (0, 2 pi] [rad], centred on the heading. Over a full circle the beams are
            2 pi / B apart and none comes twice; over less, the first and last lie on the edges.
        range_noise: standard deviation of a returned range [m].
        height: of the beams above the ground on which the robot stands [m]; matters where a ground
            is given.

    Raises:
        ValueError: no beams, a range or a height that is not positive, a field of view outside
            (0, 2 pi], a negative noise.
    """

    num_beams: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    range_noise: Scalar
    height: Scalar

    def __init__(
        self,
        num_beams: int = 360,
        max_range: float = 30.0,
        field_of_view: float = 2.0 * math.pi,
        range_noise: ArrayLike = 0.05,
        height: ArrayLike = 0.5,
    ) -> None:
        self.num_beams = _checks.positive_int("num_beams", num_beams)
        self.max_range = _checks.number("max_range", max_range, above=0.0)
        self.field_of_view = _checks.number(
            "field_of_view", field_of_view, above=0.0, at_most=2.0 * math.pi + 1e-6
        )
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)
        self.height = _checks.scalar("height", height, above=0.0)

    def _stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        if rise is None:
            return solid, solid
        stops = solid | _is_higher(cells, rise)
        return stops, stops

    def _shown(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        stops, _ = self._stops(cells, solid, rise, resolution)
        return cells.entry <= first_entry(cells, stops)[:, None]

    def _believed(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        if rise is None:
            return is_hit, is_passed
        slope = first_entry(cells, _is_higher(cells, rise))[:, None]
        is_before = cells.entry < slope
        near = NEAR_GROUND * self.range_noise / resolution + 1e-3
        return is_hit & is_before & (reading + near < slope), is_passed & is_before


def _is_higher(cells: RayCells, rise: Float[Array, "B N"]) -> Bool[Array, "B N"]:
    return cells.is_crossed & (rise > 0.0)
