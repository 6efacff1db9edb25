"""The beams of a sensor, and one scan of them."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import Vector
from jaxplore._xla import on_device

ROUNDING = 1e-6
"""Tolerance of distances [m], and of bearings at the edge of the field of view [rad]."""


def covers_circle(view: float) -> bool:
    """Return whether a field of view [rad] is 2 pi."""
    return view >= 2.0 * math.pi - 1e-6


def angle_between(number: int, view: float) -> float:
    """Return the angle between neighbours among evenly spaced beams [rad].

    `view` is the angle between the outermost beams [rad]; 2 pi for a full circle.
    """
    # On a full circle the last beam is followed by the first: there are as many gaps as beams.
    return view / (number if covers_circle(view) else max(1, number - 1))


def fan_angles(number: int, view: float) -> np.ndarray:
    """Return the directions (number,) of such beams, symmetric to the heading [rad]."""
    # A single beam has no edges to lie on: it points along the heading.
    if number == 1:
        return np.zeros(1)
    first = -math.pi if covers_circle(view) else -view / 2.0
    angles: np.ndarray = first + angle_between(number, view) * np.arange(number)
    return angles


class Beams(eqx.Module):
    """Fan of beams with equal angles between them, symmetric to the heading; abstract.

    `max_range` is in metres. `field_of_view` is the angle between the outermost beams [rad], 2 pi
    for a full circle.
    """

    num_beams: eqx.AbstractVar[int]
    max_range: eqx.AbstractVar[float]
    field_of_view: eqx.AbstractVar[float]

    @property
    def is_full_circle(self) -> bool:
        """Whether the field of view is 2 pi."""
        return covers_circle(self.field_of_view)

    @property
    def beam_spacing(self) -> float:
        """Angle between neighbouring beams [rad]."""
        return angle_between(self.num_beams, self.field_of_view)

    @property
    def beam_angles(self) -> np.ndarray:
        """Direction of each beam (B,) relative to the heading [rad]."""
        return fan_angles(self.num_beams, self.field_of_view).astype(np.float32)


class Scan(NamedTuple):
    """One scan: `ranges` (B,) [m], and a mask `is_return` (B,) of the beams that returned.

    A beam that met nothing within the sensor's range has the maximum range and no return. A beam
    that is known to have ended at a moving obstacle has its range and no return: the cells before
    it are free, and the cell in which it ended must not be marked in the map.
    """

    ranges: Float[Array, " B"]
    is_return: Bool[Array, " B"]

    def points(self, sensor: Beams) -> Float[Array, "B 2"]:
        """Return the ends (B, 2) of the beams in the frame of the sensor [m].

        Args:
            sensor: sensor that the scan is of.
        """
        angles = sensor.beam_angles
        ends = [self.ranges * np.cos(angles), self.ranges * np.sin(angles)]
        return jnp.stack(ends, axis=1)

    @classmethod
    def from_ranges(
        cls,
        ranges: Vector,
        angle_min: float,
        angle_increment: float,
        sensor: Beams,
        *,
        range_min: float = 0.0,
        range_max: float = math.inf,
    ) -> "Scan":
        """Make a scan from the readings of a real lidar, such as a ROS `LaserScan`.

        Each beam of the sensor gets the reading whose direction is nearest, if one is within half
        a beam spacing of the sensor or half an increment. An infinite reading, one beyond the
        sensor's range, and one of `range_max` or more met nothing up to the lesser of the two
        ranges. A reading that is NaN, zero, negative or below `range_min` is no measurement, as is
        a beam without a reading: its range is 0, so it changes no cell. These are the rules of
        `LaserScan` and of REP 117, but that many drivers report `range_max` where a beam met
        nothing. `sensing.no_echo.NoEcho` has other conventions.

        Args:
            ranges: (R,) readings [m].
            angle_min: direction of the first reading relative to the heading [rad].
            angle_increment: angle between two readings [rad]; negative for a reversed scan.
            sensor: sensor that the scan is for; its beams are filled.
            range_min: shortest valid reading [m].
            range_max: greatest range of the lidar [m].

        Raises:
            ValueError: readings of another shape, an increment that is 0, an angle that is not
                finite, a negative range.
        """
        given = np.asarray(ranges, np.float64)
        if given.ndim != 1 or given.size == 0:
            raise ValueError(f"ranges has shape {given.shape}; accepted: (R,) with R >= 1")
        first = _checks.number("angle_min", angle_min)
        step = _checks.number("angle_increment", angle_increment)
        if step == 0.0:
            raise ValueError("angle_increment is 0.0; accepted: an angle that is not 0 [rad]")
        least = _checks.number("range_min", range_min, at_least=0.0)
        if not range_max > least:
            raise ValueError(f"range_max is {range_max!r}; accepted: more than range_min, {least}")
        # A full circle of readings may begin anywhere, so the differences are taken modulo 2 pi.
        readings = first + step * np.arange(given.size)
        away = sensor.beam_angles.astype(np.float64)[:, None] - readings
        away = np.abs(away - 2.0 * math.pi * np.round(away / (2.0 * math.pi)))
        nearest = away.argmin(axis=1)
        half = 0.5 * max(abs(step), sensor.beam_spacing) + ROUNDING
        is_near = away[np.arange(len(nearest)), nearest] <= half
        found = given[nearest]
        # NaN fails every comparison, so it is no measurement.
        is_valid = is_near & (found > 0.0) & (found >= least)
        is_return = is_valid & (found <= sensor.max_range) & (found < range_max)
        longest = min(sensor.max_range, range_max)
        distance = np.where(is_return, found, np.where(is_valid, longest, 0.0))
        return cls(on_device(distance.astype(np.float32)), on_device(is_return))
