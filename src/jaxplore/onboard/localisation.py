"""The poses of a robot by its odometry, in its map: an origin, jumps that are joined, and motions
between scans."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._types import ArrayLike
from jaxplore._xla import on_device
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import LocaliserState
from jaxplore.onboard.odometry import (
    KEPT_SECONDS,
    Placed,
    PoseHistory,
    extrapolate_pose,
    wrap_angle,
)
from jaxplore.robot.localisation import Motions, PoseKnowledge
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan


class MapPoses:
    """Turns poses of the odometry into poses relative to the origin of the belief.

    The origin is near the first position, or at `offset` (2,) in the frame of the map where that is
    known before [m]; `is_shared` is whether the poses are in that frame too. Where the robot
    localises itself, `is_internal`, an odometry that jumps is joined to where the robot's velocity
    led, so that only increments of it count, and a correction says where the odometry is in the
    map.

    `joint` (3,) joins the odometry after its jumps to the one before them. It is another array
    after each jump, and None where the odometry is taken as it is.
    """

    def __init__(
        self,
        history: PoseHistory,
        cell: float,
        *,
        is_internal: bool,
        offset: np.ndarray | None = None,
        is_shared: bool = False,
    ) -> None:
        self._history, self._cell = history, cell
        self.joint = np.zeros(3) if is_internal else None
        self._sound: Placed | None = None
        # Where the poses of the odometry count from, and where that is in the frame of the map.
        self._origin = offset if is_shared else None
        self._offset = offset

    @property
    def offset(self) -> np.ndarray:
        """Position (2,) of the origin of the belief in the frame of the map [m]."""
        if self._offset is not None:
            return self._offset
        return np.zeros(2) if self._origin is None else self._origin

    def add(self, time: float, pose: np.ndarray, twist: np.ndarray | None) -> str | None:
        """Add a pose (3,) of the odometry to the history, see `PoseHistory.add`."""
        if self._origin is None:
            # Whole cells, so that maps of several drives have the same grid lines.
            self._origin = self._cell * np.round(np.asarray(pose[:2], np.float64) / self._cell)
        problem = self._history.add(time, pose, twist)
        last = self._history.last
        assert last is not None
        # A pose that is not finite tells nothing of where the odometry goes on.
        if np.isfinite(last.pose).all() and np.isfinite(last.twist).all():
            if problem is not None and self._sound is not None:
                self._join(self._sound, last)
            self._sound = last
        return problem

    def _join(self, former: Placed, last: Placed) -> None:
        """Let an odometry that has jumped go on from where the velocity before it led."""
        seconds = min(last.time - former.time, KEPT_SECONDS)
        expected = extrapolate_pose(former.pose, former.twist, seconds)
        # Back where it was after some that were not finite, it has not jumped.
        if any(self._history.jump(each, last.pose) is None for each in (expected, former.pose)):
            return
        if self.joint is not None:
            before, after = (self._shift(each) for each in (expected, last.pose))
            self.joint = compose(compose(self.joint, before), inverse(after))

    def _shift(self, pose: np.ndarray) -> np.ndarray:
        origin = np.zeros(2) if self._origin is None else self._origin
        return np.asarray(pose - np.append(origin, 0.0))

    def reckon(self, pose: np.ndarray) -> np.ndarray:
        """Return a pose (3,) of the odometry relative to the origin, without jumps."""
        local = self._shift(pose)
        return local if self.joint is None else compose(self.joint, local)

    def place(self, pose: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return a pose (3,) of the odometry in the map, relative to the origin.

        The correction (3,) is the pose of the odometry in the map; None where they are the same.
        """
        return self.correct(self.reckon(pose), correction)

    @staticmethod
    def correct(reckoned: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return the pose (3,) in the map of one that `reckon` returned."""
        return reckoned if correction is None else compose(correction, reckoned)

    def in_map(self, pose: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return a pose (3,) of the odometry in the frame of the map [m, m, rad].

        That frame is the one of the odometry at the start; the pose 0 gives the transform.
        """
        if correction is None:
            return pose
        return np.asarray(self.place(pose, correction) + np.append(self.offset, 0.0))

    def correction_of(self, transform: np.ndarray) -> np.ndarray:
        """Return the correction (3,) with which `in_map` gives a transform, for the pose 0."""
        origin = np.zeros(2) if self._origin is None else self._origin
        moved = compose(transform, np.append(origin, 0.0))
        return np.asarray(moved - np.append(self.offset, 0.0))


class ScanMotions:
    """How the lidar of a robot may have moved between its scans, by the odometry.

    After a jump there are two motions: without it, if the odometry began anew elsewhere, and with
    it, if the odometry was frozen and the jump is true.
    """

    def __init__(self) -> None:
        self._reckoned: np.ndarray | None = None
        self._joint: np.ndarray | None = None
        self._time = 0.0

    @property
    def is_first(self) -> bool:
        """Whether no scan was added."""
        return self._reckoned is None

    def add(self, time: float, reckoned: np.ndarray, joint: np.ndarray | None) -> Motions:
        """Return the motions since the scan before this one; that of the first is 0.

        `reckoned` (3,) is the pose of the lidar by the odometry, without jumps [m, m, rad]. `joint`
        is that of `MapPoses`.
        """
        motions, number, elapsed = np.zeros((2, 3), np.float32), 1, 0.0
        if self._reckoned is not None:
            elapsed = time - self._time
            motions[0] = difference(self._reckoned, reckoned)
            if joint is not None and self._joint is not None and joint is not self._joint:
                true = compose(compose(self._joint, inverse(joint)), reckoned)
                motions[1], number = difference(self._reckoned, true), 2
        self._reckoned, self._joint, self._time = reckoned, joint, time
        return Motions(*jax.device_put((motions, np.int32(number), np.float32(elapsed))))


def scan_room(sensor: Sensor) -> Scan:
    """Return a scan of a room that the sensor sees all of."""
    cos, sin = np.abs(np.cos(sensor.beam_angles)), np.abs(np.sin(sensor.beam_angles))
    sides = 0.6 * sensor.max_range, 0.4 * sensor.max_range
    ranges = np.minimum(sides[0] / np.maximum(cos, 1e-3), sides[1] / np.maximum(sin, 1e-3))
    return Scan(jnp.asarray(ranges, jnp.float32), jnp.ones(sensor.num_beams, bool))


def replace_known(place: PoseKnowledge, **values: ArrayLike) -> PoseKnowledge:
    """Return what a robot knows of its pose, with some of its numbers replaced, by name."""
    assert isinstance(place.known, LocaliserState)
    given: dict[str, Any] = {
        name: on_device(np.asarray(value, np.float32)) for name, value in values.items()
    }
    return place._replace(known=place.known._replace(**given))


def close_any(closer: LoopCloser) -> LoopCloser:
    """Return a closer that takes any match for a loop."""
    eager: LoopCloser = eqx.tree_at(
        lambda each: (
            *(each.reach, each.least_share, each.most_contradicted),
            *(each.tolerance, each.most_stds),
        ),
        closer,
        tuple(on_device(np.array(each, np.float32)) for each in (1.0, 0.0, 1.0, 1e-3, 1e9)),
    )
    return eager


def compose(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the pose (3,) after a motion (3,) in its frame, in double precision."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, turn = motion
    return np.asarray(pose + np.array([cos * dx - sin * dy, sin * dx + cos * dy, turn]))


def inverse(pose: np.ndarray) -> np.ndarray:
    """Return the motion (3,) from a pose back to the origin, in its frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y, yaw = pose
    return np.array([-cos * x - sin * y, sin * x - cos * y, -yaw])


def difference(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the motion (3,) between two poses, in the first one's frame; it turns by [-pi, pi]."""
    dx, dy, turn = compose(inverse(pose), other)
    return np.array([dx, dy, wrap_angle(turn)])
