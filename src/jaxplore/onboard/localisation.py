"""The pose of a robot in its own map: odometry between scans, scans, and closed loops."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._types import Pose, Scalar
from jaxplore._xla import on_device
from jaxplore.belief import scan_map
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.localisation.thinning import is_nearly_full, thinned
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.onboard.odometry import KEPT_SECONDS, Placed, PoseHistory, moved, wrapped
from jaxplore.robot.localisation import Localisation
from jaxplore.sensing.beams import Beams, Scan


class MapPoses:
    """Turns poses of the odometry into poses relative to the origin of the belief.

    The origin is near the first position. Where the robot localises itself, an odometry that jumps
    is joined to where the robot's velocity led, so that only increments of it count, and a
    correction says where the odometry is in the map.

    Args:
        history: recent poses of the odometry, which says whether it jumps.
        cell: side of a cell of the map [m].
        is_internal: whether the robot localises itself.

    Attributes:
        joint: (3,) what joins the odometry after its jumps to the one before them, another array
            after each jump; None where the odometry is taken as it is.
    """

    def __init__(self, history: PoseHistory, cell: float, *, is_internal: bool) -> None:
        self._history, self._cell = history, cell
        self.joint = np.zeros(3) if is_internal else None
        self._sound: Placed | None = None
        self._has_origin = False
        self.offset = np.zeros(2)

    def add(self, time: float, pose: np.ndarray, twist: np.ndarray | None) -> str | None:
        """Add a pose of the odometry to the history; return what is impossible about it, or None.

        Args:
            time: time of the measurement [s].
            pose: (3,) pose (x, y, yaw) [m, m, rad].
            twist: (3,) velocity in the frame of the robot; estimated from the poses when absent.
        """
        if not self._has_origin:
            self._has_origin = True
            # Whole cells, so that maps of several drives have the same grid lines.
            self.offset = self._cell * np.round(np.asarray(pose[:2], np.float64) / self._cell)
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
        expected = moved(former.pose, former.twist, seconds)
        # Back where it was after some that were not finite, it has not jumped.
        if any(self._history.jump(each, last.pose) is None for each in (expected, former.pose)):
            return
        if self.joint is not None:
            before, after = (self._shifted(each) for each in (expected, last.pose))
            self.joint = composed(composed(self.joint, before), inverse(after))

    def _shifted(self, pose: np.ndarray) -> np.ndarray:
        return np.asarray(pose - np.append(self.offset, 0.0))

    def reckoned(self, pose: np.ndarray) -> np.ndarray:
        """Return a pose (3,) of the odometry relative to the origin, without jumps."""
        local = self._shifted(pose)
        return local if self.joint is None else composed(self.joint, local)

    def placed(self, pose: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return a pose (3,) of the odometry in the map, relative to the origin.

        Args:
            pose: (3,) pose by the odometry [m, m, rad].
            correction: (3,) pose of the odometry in the map; None where they are the same.
        """
        return self.corrected(self.reckoned(pose), correction)

    @staticmethod
    def corrected(reckoned: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return the pose (3,) in the map of one that `reckoned` returned.

        Args:
            reckoned: (3,) pose relative to the origin [m, m, rad].
            correction: as of `placed`.
        """
        return reckoned if correction is None else composed(correction, reckoned)

    def in_map(self, pose: np.ndarray, correction: np.ndarray | None) -> np.ndarray:
        """Return a pose (3,) of the odometry in the frame of the map [m, m, rad].

        That frame is the one of the odometry at the start; the pose 0 gives the transform.

        Args:
            pose: (3,) pose by the odometry [m, m, rad].
            correction: as of `placed`.
        """
        if correction is None:
            return pose
        return np.asarray(self.placed(pose, correction) + np.append(self.offset, 0.0))


class MapLocaliser:
    """Localises the lidar of a robot in its map, for the thread that maps.

    A scan corrects the pose that the odometry led to. It counts only if it then fits the map. At
    the rate of the localisation loops are closed; where they move stored scans, the map is made
    anew from them, and the pose moves along. All times come with the scans.

    Args:
        localisation: localiser, what closes loops, and how often.
        perception: sensors, and what makes the map; that of the start.
        prior: map of the belief before the first scan.
        start: pose of the robot there (x, y, yaw) [m, m, rad].

    Raises:
        ValueError: a localisation on a known map, which a robot has none of here.
    """

    def __init__(
        self, localisation: Localisation, perception: Perception, prior: OccupancyGrid, start: Pose
    ) -> None:
        localiser = localisation.localiser
        if not isinstance(localiser, Localiser):
            raise ValueError(
                f"localisation has a {type(localiser).__name__}; accepted on a robot: a Localiser, "
                "which makes its map"
            )
        self._localiser, self._closer = localiser, localisation.closer
        self._closing_period = 1.0 / localisation.closing_rate
        self._sensors = (perception.sensors[0],)
        self._prior, self._start = prior, start
        self.known: LocaliserState = self._localiser.init(
            start, prior.frame, prior.shape, self._sensors
        )
        # What the newest scan came upon: the state before it, the motion, and the time of it.
        self._tried: tuple[LocaliserState, Pose, Scalar] | None = None
        # The localised pose is that of the lidar, where beams start.
        self._reckoned: np.ndarray | None = None
        self._time = self._closed_at = -math.inf
        self._joint: np.ndarray | None = None
        self.correction = np.zeros(3)

    def prepare(self, perception: Perception, belief: Belief) -> None:
        """Compile everything that the other methods call.

        Raises:
            ValueError: loops are closed, and GTSAM is not installed.
        """
        scan, still = _room(self._sensors[0]), jnp.zeros(3)
        state = _scanned(self._localiser, self.known, still, jnp.ones(()), scan, self._sensors)
        jax.block_until_ready(_predicted(self._localiser, self.known, still, jnp.ones(())))  # type: ignore[no-untyped-call]
        if self._closer is None:
            return
        # A place is seen again where the odometry is a fifth of a metre off, and any match counts:
        # the search, the pose graph and the new map run once.
        way = state.way + self._localiser.memory + 1.0
        state = _scanned(
            self._localiser, state._replace(way=way), still, jnp.ones(()), scan, self._sensors
        )
        poses = np.array(state.scans.poses)
        poses[1] = poses[0] + np.array([0.2, 0.0, 0.0])
        state = state._replace(scans=state.scans._replace(poses=on_device(poses)))
        eager = eqx.tree_at(
            lambda each: (
                *(each.reach, each.least_share, each.most_contradicted),
                *(each.tolerance, each.most_stds),
            ),
            self._closer,
            tuple(on_device(np.array(each, np.float32)) for each in (1.0, 0.0, 1.0, 1e-3, 1e9)),
        )
        found, made = self._revised(eager, state, perception, belief)
        jax.block_until_ready((made, thinned(found)))  # type: ignore[no-untyped-call]

    def corrected(
        self, time: float, scan: Scan, reckoned: np.ndarray, joint: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the pose (3,) of the lidar in the map, corrected by its scan [m, m, rad].

        An odometry that jumps starts anew elsewhere, or it was frozen and tells a true motion. The
        scan says which: where more of it lies on known surfaces.

        Call `reject` after it if the scan contradicts the map.

        Args:
            time: time of the scan [s].
            scan: the scan.
            reckoned: (3,) pose of the lidar by the odometry, without jumps [m, m, rad].
            joint: (3,) what joins the odometry after its jumps, see `MapPoses`.
        """
        self._tried = None
        if not (np.isfinite(reckoned).all() and np.isfinite(np.asarray(scan.ranges)).all()):
            # Nothing is measured, and the motion is a part of the next one.
            return composed(self.correction, reckoned)
        if self._reckoned is None:
            # The first scan says where the map begins.
            self.known = self.known._replace(pose=on_device(reckoned.astype(np.float32)))
            motions, elapsed = [np.zeros(3)], 0.0
        else:
            ends, elapsed = [reckoned], time - self._time
            if joint is not None and self._joint is not None and joint is not self._joint:
                ends.append(composed(composed(self._joint, inverse(joint)), reckoned))
            motions = [difference(self._reckoned, each) for each in ends]
        before, best = self.known, -1.0
        for motion in motions:
            step = on_device(motion.astype(np.float32)), on_device(np.array(elapsed, np.float32))
            after = _scanned(self._localiser, before, *step, scan, self._sensors)
            if len(motions) == 1 or float(after.share) > best:
                best = float(after.share)
                self.known, self._tried = after, (before, *step)
        self._joint = joint
        self._reckoned, self._time = reckoned, time
        self._correct()
        return np.asarray(self.known.pose, np.float64)

    def reject(self) -> None:
        """Take back the newest scan, which contradicts the map: the pose follows the odometry."""
        if self._tried is not None:
            self.known = _predicted(self._localiser, *self._tried)
            self._tried = None
            self._correct()

    def revised(self, perception: Perception, belief: Belief) -> Belief:
        """Close loops if it is time; return the belief, the same if no scan has moved.

        Args:
            perception: perception of the task.
            belief: the belief with the newest scan.
        """
        if self._closer is None or self._time - self._closed_at < self._closing_period - 1e-3:
            return belief
        self._closed_at = self._time
        if is_nearly_full(self.known):
            self.known = thinned(self.known)
        self.known, after = self._revised(self._closer, self.known, perception, belief)
        self._correct()
        return after

    def _revised(
        self, closer: LoopCloser, known: LocaliserState, perception: Perception, belief: Belief
    ) -> tuple[LocaliserState, Belief]:
        return scan_map.revised(
            closer, self._localiser, known, perception, belief, self._prior, self._start
        )

    def _correct(self) -> None:
        """Set the correction: what turns the pose by the odometry into the localised one."""
        if self._reckoned is not None:
            place = np.asarray(self.known.pose, np.float64)
            self.correction = composed(place, inverse(self._reckoned))


@eqx.filter_jit
def _predicted(
    localiser: Localiser, known: LocaliserState, motion: Pose, elapsed: Scalar
) -> LocaliserState:
    return localiser.predicted(known, motion, elapsed)


@eqx.filter_jit
def _scanned(
    localiser: Localiser,
    known: LocaliserState,
    motion: Pose,
    elapsed: Scalar,
    scan: Scan,
    sensors: tuple[Beams, ...],
) -> LocaliserState:
    """Return the state after a motion and a scan."""
    return localiser.corrected(localiser.predicted(known, motion, elapsed), (scan,), sensors)


def _room(sensor: Beams) -> Scan:
    """Return a scan of a room that the sensor sees all of."""
    cos, sin = np.abs(np.cos(sensor.beam_angles)), np.abs(np.sin(sensor.beam_angles))
    sides = 0.6 * sensor.max_range, 0.4 * sensor.max_range
    ranges = np.minimum(sides[0] / np.maximum(cos, 1e-3), sides[1] / np.maximum(sin, 1e-3))
    return Scan(jnp.asarray(ranges, jnp.float32), jnp.ones(sensor.num_beams, bool))


def composed(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
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
    """Return the motion (3,) from a pose to another, in the frame of the first; the turn is in
    [-pi, pi] [rad]."""
    dx, dy, turn = composed(inverse(pose), other)
    return np.array([dx, dy, wrapped(turn)])
