"""Map a log of a real lidar: put drift on its motions, localise, and draw the map.

The localisation runs in compiled chunks of scans; loops are closed between them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._limits import FINEST, LONGEST_RANGE, MOST_BEAMS
from jaxplore._optional import import_optional
from jaxplore._types import Count, Key
from jaxplore.geometry.motion import between, compose
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.localisation.odometry import Odometry
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Beams, Scan
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.laser_log import LaserLog
from jaxplore.sensing.lidar import Lidar

MOST_CELLS = 40_000_000
"""Greatest number of cells of a map: 10 ha have that many of 0.05 m."""
MARGIN = 5.0
"""Width of the map around the scans at dead-reckoned poses [m]."""
WHOLE = 128
"""The sides of maps are multiples of so many cells, so that few shapes are compiled."""
SCANS_PER_SEARCH = 32
"""Number of scans between two searches for closed loops."""
CERTAIN = 4.0
"""Greatest log-odds of a cell of the map."""
COARSEST = 1.0
"""Largest side of a cell [m]."""
MAX_RANGE = 25.0
"""Range beyond which readings are not used by default [m]."""
_Floats = NDArray[np.float64]


class LogMap(NamedTuple):
    """What came of mapping a log. Poses are (x, y, yaw) [m, m, rad] in double precision.

    All coordinates are those of the log relative to `start`.

    Args:
        start: position (x, y) of the first scan in the log [m].
        times: times (N,) of the scans [s].
        true: poses (N, 3) of the log, which are taken for the truth.
        dead_reckoned: poses (N, 3) by the odometry with drift alone.
        estimated: poses (N, 3) by scans and closed loops.
        map: occupancy grid of the scans at the estimated poses.
        reference: that of the scans at the true poses.
        loops: (C, 2) indices of the scans of each closed loop, the older one first.
    """

    start: _Floats
    times: _Floats
    true: _Floats
    dead_reckoned: _Floats
    estimated: _Floats
    map: OccupancyGrid
    reference: OccupancyGrid
    loops: NDArray[np.int64]

    @property
    def num_loops(self) -> int:
        """Number of closed loops."""
        return len(self.loops)


def log_sensor(log: LaserLog, max_range: float) -> Lidar:
    """Return a lidar whose beams are those of a log.

    The beams of a `Lidar` are symmetric to the heading. Where those of the log are not, as 180
    beams from -90 degrees, it has one more, which never has a reading.

    Args:
        log: the log.
        max_range: range beyond which readings are not used [m].
    """
    step, number = log.angle_increment, log.ranges.shape[1]
    if abs(step * number - math.tau) < 1e-6:
        return Lidar(number, max_range, math.tau)
    widest = max(abs(log.angle_min), abs(log.angle_min + log.field_of_view))
    number = min(round(2.0 * widest / step) + 1, MOST_BEAMS) if number > 1 else 1
    return Lidar(number, max_range, 2.0 * widest if number > 1 else step or math.pi)


def drifted_motions(
    log: LaserLog, odometry: Odometry, key: Key
) -> tuple[Float[Array, "N 3"], Float[Array, " N"]]:
    """Return the motions between the scans of a log as an odometry measures them, and their times.

    Args:
        log: the log, whose poses are taken for the truth.
        odometry: its errors.
        key: random key of the errors.

    Returns:
        Motions (N, 3) to each scan from the one before it, zero for the first one, in the frame of
        that one [m, m, rad]; times (N,) that they took [s].
    """
    true = _steps(log.poses)
    elapsed = np.diff(log.times, prepend=log.times[:1])
    of_run, of_noise = jax.random.split(key)
    keys = jax.random.split(of_noise, len(true))
    bias = odometry.draw(of_run)
    taken = jnp.asarray(elapsed, jnp.float32)
    measured, _ = jax.vmap(odometry.measure, (0, 0, None, 0))(
        jnp.asarray(true, jnp.float32), taken, bias, keys
    )
    return measured.at[0].set(0.0), taken


def default_drift() -> Odometry:
    """Return an odometry that is wrong by 2 % of the distance and by a degree in each metre."""
    return Odometry(distance_noise=0.02, turn_per_distance=math.radians(1.0))


def map_log(
    log: LaserLog,
    *,
    key: Key,
    odometry: Odometry | None = None,
    resolution: float = 0.05,
    max_range: float = MAX_RANGE,
    localiser: Localiser | None = None,
    closer: LoopCloser | None = None,
    on_progress: Callable[[int, int], object] = lambda scans, loops: None,
) -> LogMap:
    """Localise along a log with drift on its motions, and map it.

    The poses of the log are taken for the truth. Their motions get the errors of the odometry, and
    are all that the localiser is given beside the scans and the first pose. Every 32 scans loops
    are closed. At the end all scans are drawn at their poses, as estimated then.

    Args:
        log: the log.
        key: random key of the drift.
        odometry: errors of the odometry; those of `default_drift` when absent.
        resolution: side of a cell [m].
        max_range: range beyond which readings are not used [m].
        localiser: localiser; by default one for this odometry that stores a scan every 0.25 m. It
            must have room for all scans.
        closer: closes loops; with the default numbers when absent.
        on_progress: called with the number of scans and of closed loops so far; first with 0, after
            all checks.

    Raises:
        ValueError: an argument of another class, a resolution outside [0.001, 1] m, a range that is
            not positive, a map of more than 40 million cells, a localiser without room for all
            scans; GTSAM is not installed.
    """
    _kinds.instance("log", log, LaserLog)
    _kinds.key("key", key)
    _kinds.instance("odometry", odometry, Odometry, may_be_none=True)
    _kinds.instance("localiser", localiser, Localiser, may_be_none=True)
    _kinds.instance("closer", closer, LoopCloser, may_be_none=True)
    _kinds.function("on_progress", on_progress, "a function of two numbers")
    resolution = _checks.number("resolution", resolution, at_least=FINEST, at_most=COARSEST)
    max_range = _checks.number("max_range", max_range, above=0.0, at_most=LONGEST_RANGE)
    # It is needed when the first loop is closed, after minutes.
    import_optional("gtsam", "slam")
    odometry = default_drift() if odometry is None else odometry
    sensor = log_sensor(log, max_range)
    scans = _all_scans(log, sensor)
    number = len(log.times)
    if localiser is None:
        localiser = Localiser(odometry, capacity=-(-number // WHOLE) * WHOLE)
    if localiser.capacity < number:
        raise ValueError(
            f"localiser has room for {localiser.capacity} scans; accepted: at least {number}"
        )
    closer = LoopCloser() if closer is None else closer
    start = log.poses[0, :2].copy()
    # Single precision resolves the neighbourhood of the start, wherever the log has it.
    true = log.poses - np.append(start, 0.0)
    motions, elapsed = drifted_motions(log, odometry, key)
    dead_reckoned = _accumulated(true[0], np.asarray(motions, np.float64))
    frame, shape = frame_around(sensor, scans, dead_reckoned, resolution, MARGIN)
    on_progress(0, 0)
    sensors = (sensor,)
    state = localiser.init(jnp.asarray(true[0], jnp.float32), frame, shape, sensors)
    track = _Track(jnp.zeros((number, 3)), jnp.zeros(number, jnp.int32))
    for begin in range(0, number, SCANS_PER_SEARCH):
        end = min(begin + SCANS_PER_SEARCH, number)
        first, behind = (jnp.asarray(each, jnp.int32) for each in (begin, end))
        state, track = _localised(
            (localiser, sensors), state, track, motions, elapsed, scans, first, behind
        )
        state = closer.examined(localiser, state, sensors)
        settled = closer.settled(localiser, state, sensors)
        state = state if settled is None else settled
        on_progress(end, int(state.closures.number))
    estimated = np.asarray(_poses(track, state.scans.poses), np.float64)
    drawn, reference = (_map_of(sensor, scans, poses, resolution) for poses in (estimated, true))
    loops = np.asarray(state.closures.pairs)[: int(state.closures.number)].astype(np.int64)
    # Of the stored scans; those of the log at which they were stored.
    at = np.searchsorted(np.asarray(track.stored), loops)
    return LogMap(start, log.times, true, dead_reckoned, estimated, drawn, reference, at)


class _Track(NamedTuple):
    """For each scan the motion to it from the newest stored scan, and the index of that one."""

    since: Float[Array, "N 3"]
    stored: Int[Array, " N"]


@eqx.filter_jit
def _localised(
    given: tuple[Localiser, tuple[Beams, ...]],
    state: LocaliserState,
    track: _Track,
    motions: Float[Array, "N 3"],
    elapsed: Float[Array, " N"],
    scans: Scan,
    first: Count,
    end: Count,
) -> tuple[LocaliserState, _Track]:
    """Return the state and the track after the scans from `first` to before `end`."""
    localiser, sensors = given

    def step(index: Count, carry: tuple[LocaliserState, _Track]) -> tuple[LocaliserState, _Track]:
        before, track = carry
        moved = localiser.predicted(before, motions[index], elapsed[index])
        scan = Scan(scans.ranges[index], scans.is_return[index])
        after = localiser.corrected(moved, [scan], sensors)
        last = after.scans.last
        since = between(after.scans.poses[last], after.pose)
        return after, _Track(track.since.at[index].set(since), track.stored.at[index].set(last))

    result: tuple[LocaliserState, _Track] = jax.lax.fori_loop(first, end, step, (state, track))
    return result


@eqx.filter_jit
def _poses(track: _Track, stored: Float[Array, "K 3"]) -> Float[Array, "N 3"]:
    """Return the poses of all scans, given those of the stored ones."""
    return jax.vmap(compose)(stored[track.stored], track.since)


@eqx.filter_jit
def _drawn(
    sensor: Sensor,
    model: InverseSensorModel,
    grid: OccupancyGrid,
    scans: Scan,
    poses: Float[Array, "N 3"],
) -> OccupancyGrid:
    """Return a grid after scans."""

    def add(index: Count, grid: OccupancyGrid) -> OccupancyGrid:
        scan = Scan(scans.ranges[index], scans.is_return[index])
        return sensor.update(grid, scan, poses[index], model)

    drawn: OccupancyGrid = jax.lax.fori_loop(0, poses.shape[0], add, grid)
    return drawn


def _map_of(sensor: Sensor, scans: Scan, poses: _Floats, resolution: float) -> OccupancyGrid:
    """Return the occupancy grid of scans at poses."""
    frame, shape = frame_around(sensor, scans, poses, resolution, resolution)
    blank = OccupancyGrid.unknown(shape, frame)
    # Beams without an echo often met glass or something black: they say nothing of what is free.
    returned = Scan(jnp.where(scans.is_return, scans.ranges, 0.0), scans.is_return)
    model = InverseSensorModel.from_odds(clamp=(-CERTAIN, CERTAIN))
    return _drawn(sensor, model, blank, returned, jnp.asarray(poses, jnp.float32))


def frame_around(
    sensor: Beams, scans: Scan, poses: _Floats, resolution: float, margin: float
) -> tuple[GridFrame, tuple[int, int]]:
    """Return the frame and the shape of a map along the axes that holds all points of scans.

    Args:
        sensor: sensor of the scans.
        scans: scans of N poses, arrays (N, B).
        poses: poses (N, 3) [m, m, rad].
        resolution: side of a cell [m].
        margin: width of the map around the points [m].

    Raises:
        ValueError: a map of more than 40 million cells.
    """
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    for pose, ranges, is_return in zip(
        poses, np.asarray(scans.ranges), np.asarray(scans.is_return), strict=True
    ):
        angles = pose[2] + sensor.beam_angles[is_return]
        ends = pose[:2] + ranges[is_return, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
        if len(ends):
            low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))
    low = np.floor((low - margin) / resolution) * resolution
    cells = np.ceil((high + margin - low) / (resolution * WHOLE)) * WHOLE
    if cells.prod() > MOST_CELLS:
        raise ValueError(
            f"resolution is {resolution:g}, which makes a map of {cells.prod():.3g} cells; "
            f"accepted: a resolution that makes at most {MOST_CELLS}"
        )
    return GridFrame(resolution, (*low.tolist(), 0.0)), (int(cells[1]), int(cells[0]))


def _all_scans(log: LaserLog, sensor: Beams) -> Scan:
    """Return all scans of a log, in arrays (N, B)."""
    scans = [log.scan(index, sensor) for index in range(len(log.times))]
    return Scan(
        jnp.asarray(np.stack([np.asarray(each.ranges) for each in scans])),
        jnp.asarray(np.stack([np.asarray(each.is_return) for each in scans])),
    )


def _steps(poses: _Floats) -> _Floats:
    """Return the motion to each pose from the one before it, (N, 3), zero for the first one."""
    before = np.concatenate([poses[:1], poses[:-1]])
    cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
    dx, dy, turn = (poses - before).T
    turn = turn - math.tau * np.round(turn / math.tau)
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def _accumulated(first: _Floats, motions: _Floats) -> _Floats:
    """Return the poses (N, 3) after motions, the first of which is not made."""
    yaw = first[2] + np.concatenate([[0.0], np.cumsum(motions[1:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    dx, dy = motions[1:, 0], motions[1:, 1]
    steps = np.stack([cos * dx - sin * dy, sin * dx + cos * dy], axis=1)
    places = first[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([places, yaw])
