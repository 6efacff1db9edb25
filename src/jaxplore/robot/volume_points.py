"""The points of scans of a volume, for the guard."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplore._types import Scalar, StateVector
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.control.guard import ScanPoints
from jaxplore.control.plausibility import share_of_misfits
from jaxplore.dynamics.quadrotor import attitude_upwards, position_upwards
from jaxplore.sensing.volume import VolumeScan, VolumeSensor

MOVER_SPEED = 1.6
"""Speed that what moves in a volume may have at any time [m/s], that of `ObstacleTracker`."""
GROUP = 4
"""Neighbouring rays of a volume of which the shortest stands for all: the time of a check is that
of its points."""


def volume_points(
    belief: VolumeBelief,
    sensors: Sequence[VolumeSensor],
    scans: Sequence[VolumeScan],
    measured: StateVector,
    expected: StateVector,
    time: Scalar,
    interval: Scalar,
) -> ScanPoints:
    """Return end points (x, y, z) of scans of a volume, and how badly they fit the map.

    As `jaxplore.robot.robot.scan_points`, with states (nx,) of a quadrotor in place of poses. Rays
    that end early without a return have met what moves: the sensors tell. Of each `GROUP` of
    neighbouring rays the shortest is a point.
    """

    def place(state: StateVector, ways: Float[Array, "3 R"]) -> Float[Array, "R 3"]:
        return (position_upwards(state)[:, None] + attitude_upwards(state) @ ways).T

    reach = jnp.concatenate(
        [scan.ranges * each.directions for each, scan in zip(sensors, scans, strict=True)], axis=1
    )
    is_return = jnp.concatenate([scan.is_return for scan in scans])
    misfit = share_of_misfits(belief.clearance, place(measured, reach), is_return)
    ends, is_point, is_mover = [], [], []
    for sensor, scan in zip(sensors, scans, strict=True):
        is_shorter = (scan.ranges < sensor.max_range) & ~scan.is_return
        is_met = scan.is_return | is_shorter
        index = _shortest(jnp.where(is_met, scan.ranges, jnp.inf))
        ends.append(scan.ranges[index] * jnp.asarray(sensor.directions)[:, index])
        is_point.append(is_met[index])
        is_mover.append(is_shorter[index])
    speeds = jnp.where(jnp.concatenate(is_mover), MOVER_SPEED, 0.0)
    points = place(expected, jnp.concatenate(ends, axis=1))
    return ScanPoints(points, jnp.concatenate(is_point), misfit, time, interval, speeds)


def num_volume_points(sensors: Sequence[VolumeSensor]) -> int:
    """Return the number of points of `volume_points`."""
    return sum(-(-each.directions.shape[1] // GROUP) for each in sensors)


def _shortest(ranges: Float[Array, " R"]) -> Int[Array, " G"]:
    """Return the index of the shortest of each group of rays."""
    missing = -ranges.shape[0] % GROUP
    groups = jnp.pad(ranges, (0, missing), constant_values=jnp.inf).reshape(-1, GROUP)
    own = jnp.argmin(groups, axis=1).astype(jnp.int32)
    return own + GROUP * jnp.arange(groups.shape[0], dtype=jnp.int32)
