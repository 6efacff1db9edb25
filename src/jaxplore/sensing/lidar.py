"""Simulate a planar lidar with level beams over a circle or a sector."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_BEAMS
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.geometry.rays import RayCells
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.fan import check_range, check_view, first_entry
from jaxplore.sensing.lidar_errors import LidarErrors
from jaxplore.sensing.mount import LidarMount

NEAR_GROUND = 3.0
"""Standard deviations before higher ground within which a reading is taken for the ground. With
two, one reading in fifty would count as an obstacle, and a hill covers many cells."""
MOST_DRIVE = 0.3
"""Distance that a robot drives at most while its lidar turns [m]."""


class Lidar(Sensor):
    """Planar lidar at the robot's centre, or with a mount.

    The simulation measures where the lidar is by its mount, and hands the robot a scan around its
    centre (`sensing.mount.project_scan`). `scan`, `sight`, and all that predicts scans, take the
    sensor to be at the pose that they are given.

    On a `Ground` its beams are level, at

        z = elevation of the robot's cell + height

    A beam also returns from the first cell whose elevation is above z. The robot knows the ground:
    in `sight`, that cell and all cells behind it are neither hit nor passed, and a reading at most
    3 sigma before it is not taken for an obstacle. So hills are not marked as obstacles.

    Args:
        num_beams: number of beams per scan, B.
        max_range: greatest range [m]; static, like the number of cells that a beam crosses.
        field_of_view: field of view, in (0, 2 pi] [rad], centred on the heading. Over a full circle
            the beams are 2 pi / B apart; over a sector the first and the last are on its edges.
        range_noise: standard deviation of a returned range [m].
        height: height of the beams above the ground on which the robot stands [m]; used only with a
            ground, and for the floor that a tilted lidar sees.
        errors: least range, missing and false returns, and a tilt; none when absent.
        mount: pose of the lidar on the robot, and whether it turns; at the centre, and at once,
            when absent.

    Raises:
        ValueError: no beams, a range or a height that is not positive, a field of view outside
            (0, 2 pi], a negative noise.
    """

    num_beams: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    range_noise: Scalar
    height: Scalar
    errors: LidarErrors | None
    mount: LidarMount | None

    @_kinds.check_arguments
    def __init__(
        self,
        num_beams: int = 360,
        max_range: float = 5.0,
        field_of_view: float = 2.0 * math.pi,
        range_noise: ArrayLike = 0.02,
        height: ArrayLike = 0.5,
        errors: LidarErrors | None = None,
        mount: LidarMount | None = None,
    ) -> None:
        self.num_beams = _checks.positive_int("num_beams", num_beams, at_most=MOST_BEAMS)
        self.max_range = check_range("max_range", max_range)
        self.field_of_view = check_view("field_of_view", field_of_view)
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)
        self.height = _checks.scalar("height", height, above=0.0)
        self.errors, self.mount = errors, mount

    @property
    def clear_range(self) -> float | Scalar:
        """Range from which on a beam without a return met nothing [m]."""
        least = self.max_range - 1e-3
        if self.mount is None:
            return least
        # The end of a beam that met nothing is nearer to the centre than to the lidar.
        drive = MOST_DRIVE if self.mount.is_turning else 0.0
        return least - drive - jnp.hypot(self.mount.x, self.mount.y)

    def degrade(self, scan: Scan, key: Key) -> Scan:
        """Return a simulated scan with the errors of the lidar."""
        if self.errors is None:
            return scan
        angles = jnp.asarray(self.beam_angles)
        if self.mount is not None:
            angles = angles + self.mount.yaw
        return self.errors.apply(scan, angles, self.height, self.max_range, key)

    def stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the masks of the cells that return a beam and of those that end it."""
        if rise is None:
            return solid, solid
        stops = solid | _is_higher(cells, rise)
        return stops, stops

    def visible(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        """Return the mask of the cells that are visible to each beam."""
        stops, _ = self.stops(cells, solid, rise, resolution)
        return cells.entry <= first_entry(cells, stops)[:, None]

    def consistent(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the hits and passes that are consistent with the known ground."""
        if rise is None:
            return is_hit, is_passed
        # A reading just before higher ground is the ground itself, seen through the noise.
        slope = first_entry(cells, _is_higher(cells, rise))[:, None]
        is_before = cells.entry < slope
        near = NEAR_GROUND * self.range_noise / resolution + 1e-3
        return is_hit & is_before & (reading + near < slope), is_passed & is_before


def _is_higher(cells: RayCells, rise: Float[Array, "B N"]) -> Bool[Array, "B N"]:
    return cells.is_crossed & (rise > 0.0)


def is_any_turning(sensors: Sequence[Sensor]) -> bool:
    """Return whether a sensor is a lidar that turns while the robot drives."""
    mounts = [each.mount for each in sensors if isinstance(each, Lidar)]
    return any(each is not None and each.is_turning for each in mounts)
