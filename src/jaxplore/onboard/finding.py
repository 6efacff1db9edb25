"""A robot that stands on a map that it knows, and finds out where."""

import math
from collections.abc import Sequence

import jax
import numpy as np

from jaxplore import _kinds
from jaxplore._types import Key
from jaxplore._xla import on_device
from jaxplore.localisation.particle_localiser import ParticleLocaliser, ParticleState
from jaxplore.localisation.place_search import LEAST_SHARE, Places
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.onboard import steps
from jaxplore.onboard.localisation import scan_room
from jaxplore.onboard.odometry import wrap_angle
from jaxplore.robot.localisation import Localisation, Motions
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan

SEARCH_SECONDS = 2.0
"""Time between two searches of the whole map [s]. What moves may be gone by then."""
CONFIRMED = 8
"""Number of scans in a row that must fit at a place before the robot drives by it."""
MOST_FAILED = 4
"""Number of scans in a row that do not fit, after which the place is given up."""
FOUND_STDS = (0.1, 0.05)
"""Standard deviations of a place by the search, along x and y [m], and of its yaw [rad]."""
TOLD_STDS = (0.5, 0.3)
"""Those of a place that somebody tells."""
MOST_EXPECTED = 2
"""Number of poses near which the robot may be expected."""
EXPECTED_RATIO = 0.7
"""Logarithm of the ratio of the likelihoods by which the best place may be better than one at which
the robot is expected. A robot that is carried to a place that looks like its own is that rare."""
SAME = (1.0, 0.5)
"""Distance [m] and angle [rad] within which two of them are one place."""
MOST_CONTRADICTED = 0.1
"""Share of beams that may contradict the map where the robot may be."""
LOOKING = "finding itself on the map"
"""Beginning of each reason why the robot stands."""


class Finder:
    """Finds the pose of a robot on a known map, while it stands or is moved by somebody.

    A scan is compared with the whole map (`search_places`). Where it fits at one place, and at no
    other nearly as well, particles begin there. They follow the odometry and the next scans. The
    pose is certain once the filter has converged, and `LEAST_SHARE` of the ends of beams are at
    known walls, for `CONFIRMED` scans in a row. Where several places look alike, the one counts at
    which the robot is expected: where it was last, or where an odometry says that went on
    meanwhile. The place where it was last may not be on the map yet. While no scan contradicts it,
    the robot may be there, so another one that looks alike does not count; if the odometry says the
    same, it is there. In all other cases the robot stands, and the map is searched again later: it
    may be moved to where it sees more.

    Args:
        localiser: localiser on known maps.
        sensor: the lidar.
        grid: known map, with a free cell.
        key: random key.

    Attributes:
        reason: why the robot must not drive.
    """

    def __init__(
        self, localiser: ParticleLocaliser, sensor: Sensor, grid: OccupancyGrid, key: Key
    ) -> None:
        _kinds.key("key", key)
        self._given, self._sensor = (localiser, sensor), sensor
        self._localisation = Localisation(localiser=localiser)
        self._blank = localiser.start(on_device(np.zeros(3, np.float32)), grid, (sensor,), key)
        self._told: np.ndarray | None = None
        self.begin()

    def begin(self) -> None:
        """Begin anew: the robot does not know where it is."""
        self._state: ParticleState | None = None
        self._is_told = False
        self._num_fit = self._num_failed = 0
        self._searched_at = -math.inf
        self.reason = LOOKING

    def prepare(self) -> None:
        """Compile what `take` calls."""
        scan = scan_room(self._sensor)
        still = np.zeros((2, 3), np.float32), np.int32(1), np.float32(1.0)
        motions = Motions(*jax.device_put(still))
        found = steps.search_places(self._given, self._blank, scan, _expected([]))
        state = self._start_around(np.zeros(3), FOUND_STDS)
        followed = steps.follow_place((self._localisation, self._sensor), state, motions, scan)
        jax.block_until_ready((found, followed))  # type: ignore[no-untyped-call]

    def tell(self, pose: np.ndarray) -> None:
        """Take a pose (3,) at which somebody says that the robot is, from any thread.

        Scans must fit there, but may fit elsewhere as well.
        """
        self._told = np.asarray(pose, np.float64)

    def take(
        self, time: float, motions: Motions, scan: Scan, expected: Sequence[np.ndarray] = ()
    ) -> ParticleState | None:
        """Take a scan; return what the localiser knows once the pose is certain.

        `time` is that of the scan [s]. `motions` say how the lidar has moved since the one before.
        `expected` are poses (3,) near which it may be [m, m, rad]: where it was last, and where its
        odometry says that it is now if it went on since; empty where nothing tells.
        """
        told, self._told = self._told, None
        if told is not None:
            self.begin()
            self._state, self._is_told = self._start_around(told, TOLD_STDS), True
        if self._state is None:
            if time - self._searched_at >= SEARCH_SECONDS:
                self._searched_at = time
                return self._search(scan, expected)
            return None
        given = self._localisation, self._sensor
        followed = steps.follow_place(given, self._state, motions, scan)
        self._state = followed.state
        _, _, _, share, is_known = np.asarray(followed.numbers).tolist()
        if is_known > 0.5 and share >= LEAST_SHARE:
            self._num_fit, self._num_failed = self._num_fit + 1, 0
        else:
            self._num_fit, self._num_failed = 0, self._num_failed + 1
        if self._num_failed > (CONFIRMED if self._is_told else MOST_FAILED):
            where = "where it was told to be" if self._is_told else "at the place that it found"
            self.begin()
            self.reason = f"{LOOKING}: scans do not fit {where}"
            return None
        return self._state if self._num_fit >= CONFIRMED else None

    def _start_around(self, pose: np.ndarray, stds: tuple[float, float]) -> ParticleState:
        given = jax.device_put((pose.astype(np.float32), np.array(stds, np.float32)))
        return steps.start_around(self._given[0], self._blank, *given)

    def _search(self, scan: Scan, expected: Sequence[np.ndarray]) -> ParticleState | None:
        """Search the map, and begin to follow the place where the robot is; return what it knows
        where only its odometry tells the place."""
        places = steps.search_places(self._given, self._blank, scan, _expected(expected))
        found = jax.tree.map(np.asarray, places)
        assert isinstance(found, Places)
        is_near = np.asarray(found.near_ratios) < EXPECTED_RATIO
        near = np.asarray(found.near, np.float64)[is_near]
        is_one = len(near) > 0 and all(_is_same(each, near[0]) for each in near)
        best = np.asarray(found.pose, np.float64)
        # Where the robot was last may not be mapped yet.
        is_open = len(expected) > 0 and float(found.contradicted[0]) < MOST_CONTRADICTED
        is_open = is_open and not any(_is_same(each, expected[0]) for each in (best, *near))
        if is_open and len(expected) > 1 and _is_same(*expected[:2]):
            return self._start_around(expected[1], FOUND_STDS)
        if not bool(found.is_seen):
            self.reason = (
                f"{LOOKING}: {float(found.share):.0%} of what the lidar meets is on it at the best "
                f"place, {LEAST_SHARE:.0%} are needed; the robot waits to be moved"
            )
        elif is_open:
            self.reason = (
                f"{LOOKING}: where the robot was last is not on it yet, and another place looks "
                "alike; the robot waits to be moved or told its pose"
            )
        elif bool(found.is_unique) or is_one:
            self._state = self._start_around(near[0] if is_one else best, FOUND_STDS)
            self.reason = f"{LOOKING}: it compares a place with the next scans"
        else:
            x, y = (found.rival - found.pose)[:2].tolist()
            turn = math.degrees(wrap_angle(float(found.rival[2] - found.pose[2])))
            self.reason = (
                f"{LOOKING}: another place, {math.hypot(x, y):.1f} m away and turned by "
                f"{turn:.0f} degrees, looks alike; the robot waits to be moved or told its pose"
            )
        return None


def _is_same(pose: np.ndarray, other: np.ndarray) -> bool:
    """Check whether two poses (3,) are one place."""
    x, y, turn = (pose - other).tolist()
    return math.hypot(x, y) < SAME[0] and abs(wrap_angle(turn)) < SAME[1]


def _expected(poses: Sequence[np.ndarray]) -> jax.Array:
    """Return expected poses (MOST_EXPECTED, 3), with NaN where there are none."""
    rows = np.full((MOST_EXPECTED, 3), np.nan, np.float32)
    for row, pose in zip(rows, poses, strict=False):
        row[:] = pose
    return on_device(rows)
