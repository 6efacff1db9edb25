"""Check without the true poses whether the scans of a log agree at the poses that were found."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore.geometry.motion import motions_between
from jaxplore.localisation.closing import CLEAR
from jaxplore.sensing.laser_log import LaserLog

NEAR = 2.0
"""Greatest distance between two scans of one place [m]."""
APART = 15.0
"""Way after which a scan sees a place again [m]: what is nearer was matched to each other."""
FEWEST_POINTS = 40
"""Number of points that two scans must have in each other's view to be compared."""
MOST_CONTRADICTED, LEAST_AGREED = 0.15, 0.4
"""Shares of the points of two scans before what the other one met, and on it, beyond which the two
are in doubt. At right poses about 3 % are before and 83 % on it."""
FEWEST_PLACES, MOST_DOUBTFUL = 10, 0.1
"""Number of places seen again below which a map is not known to be right, and the greatest share
of them in doubt. Where people walk, 6 % are in doubt at right poses."""
MOST_EXPECTED = 0.15
"""Greatest expected error of positions with which a map is trusted [m]."""
_Floats = NDArray[np.float64]


class Trust(NamedTuple):
    """How the scans of a log agree at the poses that were found.

    Args:
        num_places: number of scans that see a place again.
        doubtful_places: share of them that do not agree with the older scan; 0 without any.
        doubtful_steps: share of the scans that do not agree with the one before.
        contradicted: median share of the points of two scans of a place that are before what the
            other one met; 0 without any.
        expected_error: error of the positions that is to be expected, see
            `pose_graph.expected_error` [m].
        warning: why the map is not to be trusted; empty if it is.
    """

    num_places: int
    doubtful_places: float
    doubtful_steps: float
    contradicted: float
    expected_error: float
    warning: str


def judge_poses(
    log: LaserLog, poses: _Floats, max_range: float, expected_error: float = 0.0
) -> Trust:
    """Compare each scan with an older one of the same place, and with the one before.

    Two scans of one place, taken more than 15 m of way apart and at most 2 m from each other, see
    the same walls. A point of the one that lies well before what a beam of the other one met is
    where that beam has seen free space: one of the two poses is wrong, or something has moved. The
    true poses do not enter. Of what is seen once only the covariances of the motions tell how
    exactly it is known; `expected_error` [m] is by them. Readings beyond `max_range` [m] are not
    used.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    places, steps = [], []
    for index in range(1, len(poses)):
        steps.append(_compare(log, poses, index, index - 1, max_range))
        old = np.flatnonzero(way[index] - way[:index] > APART)
        old = old[np.hypot(*(poses[old, :2] - poses[index, :2]).T) <= NEAR]
        if len(old):
            # Of those that are near the one that looks into the most similar direction.
            turn = np.cos(poses[old, 2] - poses[index, 2])
            places.append(_compare(log, poses, index, int(old[turn.argmax()]), max_range))
    again, doubtful, contradicted = _doubts(places)
    _, doubtful_steps, _ = _doubts(steps)
    warning = ""
    if again < FEWEST_PLACES:
        warning = f"{again} places were seen twice, too few to tell whether the map is right"
    if expected_error > MOST_EXPECTED:
        warning = (
            f"positions are known to {expected_error:.2f} m: too few places were seen twice, or "
            "their walls tell little"
        )
    if max(doubtful, doubtful_steps) > MOST_DOUBTFUL:
        warning = (
            f"the map is not to be trusted: {100.0 * doubtful:.0f} % of {again} places seen twice "
            f"look different, and {100.0 * doubtful_steps:.0f} % of neighbouring scans do not agree"
        )
    return Trust(again, doubtful, doubtful_steps, contradicted, expected_error, warning)


def _doubts(shares: list[tuple[float, float] | None]) -> tuple[int, float, float]:
    """Return the number of comparisons, the share that is in doubt, and what is contradicted."""
    known = np.array([each for each in shares if each is not None]).reshape(-1, 2)
    if not len(known):
        return 0, 0.0, 0.0
    before, agreed = known.T
    is_doubtful = (before > MOST_CONTRADICTED) | (agreed < LEAST_AGREED)
    return len(known), float(is_doubtful.mean()), float(np.median(before))


def _compare(
    log: LaserLog, poses: _Floats, newer: int, older: int, max_range: float
) -> tuple[float, float] | None:
    """Return which shares of the points of two scans are before what the other met, and on it.

    None where too few are in each other's view.
    """
    counts = np.zeros(3)
    for one, other in ((newer, older), (older, newer)):
        motion = motions_between(poses[[other]], poses[[one]])[0]
        counts += _count_seen(log, one, other, motion, max_range)
    before, on, seen = counts
    return (before / seen, on / seen) if seen >= FEWEST_POINTS else None


def _count_seen(
    log: LaserLog, scan: int, other: int, motion: _Floats, max_range: float
) -> tuple[int, int, int]:
    """Return how many points of a scan are before what another one met, on it, and in its view.

    `scan` and `other` are indices. `motion` is the pose of the first in the frame of the other.
    Readings beyond `max_range` [m] are not used.
    """
    is_point = (log.ranges[scan] < max_range) & (log.ranges[scan] > 0.0)
    ranges, angles = log.ranges[scan][is_point], motion[2] + log.beam_angles[is_point]
    x, y = motion[0] + ranges * np.cos(angles), motion[1] + ranges * np.sin(angles)
    bearing = (np.arctan2(y, x) - log.angle_min) % math.tau
    beam = np.rint(bearing / log.angle_increment).astype(int)
    met = np.where(log.ranges[other] < max_range, log.ranges[other], 0.0)
    # A point contradicts the beam in whose direction it is only if it does those beside it too.
    least = np.minimum(met, np.minimum(np.roll(met, 1), np.roll(met, -1)))
    is_seen = beam < len(met)
    beam = np.minimum(beam, len(met) - 1)
    is_seen &= least[beam] > 0.0
    away = np.hypot(x, y)
    is_before = is_seen & (away < least[beam] - CLEAR)
    is_on = is_seen & (np.abs(away - met[beam]) < CLEAR)
    return int(is_before.sum()), int(is_on.sum()), int(is_seen.sum())
