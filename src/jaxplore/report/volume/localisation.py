"""Errors of where a robot in a volume took itself to be. All is NumPy in double precision."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxplore.geometry.motion import motions_between
from jaxplore.report.exploration.localisation import RPE_LENGTH
from jaxplore.report.localisation import align

type _Floats = NDArray[Any]
ERRORS = ("ate", "odometry_ate", "rpe", "greatest_error")
"""Names of the errors of a flight, see `VolumeMetrics`."""


def flight_errors(
    positions: _Floats, headings: _Floats, estimate: _Floats, reckoned: _Floats
) -> dict[str, float | None]:
    """Return the errors of a flight of N > 0 steps, as in `VolumeMetrics`, by its true positions
    (N, 3) and yaws (N,), and by poses (N, 4) as (x, y, z, yaw), z up, as estimated and by the
    odometry alone."""
    true = np.column_stack([positions, headings]).astype(np.float64)
    found, alone = np.asarray(estimate, np.float64), np.asarray(reckoned, np.float64)
    return {
        "ate": absolute_error(true, found),
        "odometry_ate": absolute_error(true, alone),
        "rpe": relative_error(true, found, RPE_LENGTH),
        "greatest_error": float(np.linalg.norm(found[:, :3] - true[:, :3], axis=1).max()),
    }


def absolute_error(true: _Floats, estimated: _Floats) -> float:
    """Return the absolute trajectory error of poses (N, 4) after an alignment [m].

    It is that of `jaxplore.report.absolute_error` in space: the root mean square of the distances
    of the positions after the turn about the vertical and the translation that make it least. Roll
    and pitch do not drift, so that nothing else is aligned.
    """
    p, q = np.asarray(true), np.asarray(estimated)
    level = align(p[:, :2], q[:, :2]).apply(q[:, :2]) - p[:, :2]
    rise = q[:, 2] - p[:, 2]
    away = np.column_stack([level, rise - rise.mean()])
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def relative_error(true: _Floats, estimated: _Floats, length: float) -> float | None:
    """Return the relative pose error over pieces of a flown length [m]; None without any.

    As `jaxplore.report.relative_error` in space: a piece ends at the first pose that the true robot
    reached after the length, and the error is that of the estimated motion along it.
    """
    p, q = np.asarray(true), np.asarray(estimated)
    flown = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(p[:, :3], axis=0), axis=1)))
    end = np.searchsorted(flown, flown + length - 1e-9)
    start = np.flatnonzero(end < len(p))
    if not start.size:
        return None
    ends = end[start]
    flat = [0, 1, 3]
    level = [motions_between(each[start][:, flat], each[ends][:, flat]) for each in (p, q)]
    rises = [each[ends, 2] - each[start, 2] for each in (p, q)]
    away = np.column_stack([level[1][:, :2] - level[0][:, :2], rises[1] - rises[0]])
    return float(np.sqrt((away**2).sum(axis=1).mean()))
