"""Map a log of a real lidar: localise by its odometry and its scans, and draw the map.

The localisation runs in compiled chunks of scans; loops are closed between them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._limits import FINEST, LONGEST_RANGE
from jaxplore._optional import import_optional
from jaxplore._types import Count, Key
from jaxplore.geometry.motion import (
    accumulate_motions,
    between,
    compose,
    motions_between,
    steps_along,
)
from jaxplore.localisation.closing import LoopCloser, pose_graph, rebuild_surface
from jaxplore.localisation.joint_poses import JointPoses, Lines, refine_poses
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.localisation.log_drawing import (
    WHOLE,
    Sampling,
    all_scans,
    draw_map,
    frame_around,
    log_sensor,
)
from jaxplore.localisation.log_odometry import (
    fit_odometry,
    measure_motions,
    wide_odometry,
)
from jaxplore.localisation.log_trust import MOST_EXPECTED, Trust, judge_poses
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.localisation.pose_graph import expected_error
from jaxplore.localisation.scan_matching import FARTHEST, ScanMatcher
from jaxplore.localisation.stored_scans import StoredScans
from jaxplore.localisation.surface import EndPoints
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.beams import Beams, Scan
from jaxplore.sensing.laser_log import LaserLog

MARGIN, SHARE, MOST_MARGIN = 5.0, 0.03, 20.0
"""Width of the surfaces around the scans at dead-reckoned poses [m], its growth by a metre of way,
and the most that it grows to [m]: estimated poses may be elsewhere."""
LEAST_STEP, LEAST_TURN = 0.2, 0.2
"""Way [m] and turn [rad] after which a scan is used."""
LEAST_REACH, SEEN = 4.0, 0.75
"""Least distance within which old places are looked for [m], and the quantile of the readings that
it is otherwise: in halls two scans see the same walls from further apart than in corridors."""
FARTHEST_PLACE = 20.0
"""Distance from the estimated position up to which stretches of the way are looked for [m]."""
SCANS_PER_SEARCH = 32
"""Number of scans between two searches for closed loops."""
FEWEST_SCANS = 8
"""Number of scans that are localised at a time where the robot leaves the map of surfaces."""
MOST_OUTSIDE = 0.1
"""Share of the points of a scan off the map of surfaces above which it is moved to the robot."""
SCANS_TO_FIT = 384
"""Number of scans by which the errors of an odometry are fitted."""
TURN_STEPS, MOST_TURN_STEPS, MOST_STEPS = 14, 35, 6
"""Least and most steps of the search in yaw, and most in position. Wheels are often wrong by a
sixth of a radian after a turn, and logs with a scan a metre by half a radian."""
MOST_MOTIONS = 0.95
"""Share of the motions after which the search reaches as far as the odometry errs."""
COARSEST = 1.0
"""Largest side of a cell [m]."""
MAX_RANGE = 25.0
"""Range beyond which readings are not used by default [m]."""
UNSEEN = 2.0
"""Factor on the expected error of poses that were refined together, which knows of no systematic
error: in logs with known poses the error was 1.3 to 3.1 times as large."""
_Floats = NDArray[np.float64]


class LogMap(NamedTuple):
    """What came of mapping a log. Poses are (x, y, yaw) [m, m, rad] in double precision.

    All coordinates are those of the log relative to `start`.

    Args:
        start: position (x, y) of the first scan in the log [m].
        times: times (N,) of the scans [s].
        true: poses (N, 3) of the log, if they are more than its odometry; they are taken for the
            truth. None where the log has no such poses.
        dead_reckoned: poses (N, 3) by the odometry alone.
        estimated: poses (N, 3) by scans and closed loops.
        map: occupancy grid of the scans at the estimated poses.
        reference: that of the scans at the true poses; None without any.
        loops: (C, 2) indices of the scans of each closed loop, the older one first.
        odometry: errors of the odometry as fitted or given.
        trust: how the scans agree at the estimated poses.
    """

    start: _Floats
    times: _Floats
    true: _Floats | None
    dead_reckoned: _Floats
    estimated: _Floats
    map: OccupancyGrid
    reference: OccupancyGrid | None
    loops: NDArray[np.int64]
    odometry: OdometryModel
    trust: Trust

    @property
    def num_loops(self) -> int:
        """Number of closed loops."""
        return len(self.loops)


@_kinds.check_arguments
def map_log(
    log: LaserLog,
    *,
    odometry: Odometry | None = None,
    drift: Odometry | None = None,
    key: Key | None = None,
    resolution: float | None = None,
    max_range: float = MAX_RANGE,
    localiser: Localiser | None = None,
    closer: LoopCloser | None = None,
    on_progress: Callable[[int, int], object] = lambda scans, loops: None,
) -> LogMap:
    """Localise along a log by its odometry and its scans, and map it.

    The localiser is given the motions by the odometry (`LaserLog.measured`), the scans and the
    first pose. How wrong the odometry is, is fitted: the first 384 scans are matched with errors of
    any robot, and the differences of the matched motions from the measured ones say the rest. Scans
    less than 0.2 m and 0.2 rad after the last one that was used are left out; their poses follow by
    the odometry. Every 32 scans loops are closed. At the end all poses are refined together, if
    that makes them known to 0.15 m, and all used scans are drawn at them.

    The map of surfaces is as large as the odometry says. An odometry may be wrong by more: where
    scans leave that map, it is moved to the robot, and the surfaces of late are made anew in it.

    For tests made-up drift is put on the poses of the log in place of its odometry.

    Args:
        log: the log.
        odometry: errors of the odometry; those of the drift, or fitted, when absent.
        drift: errors that are put on the motions of the log's poses; none when absent.
        key: random key of the drift.
        resolution: side of a cell of the map [m]; by the noise and the density of readings, 0.05,
            0.1 or 0.2 m, when absent, as of the surfaces that scans are matched to.
        max_range: range beyond which readings are not used [m].
        localiser: localiser; by default one for this odometry that stores a scan every 0.25 m. It
            must have room for all used scans.
        closer: closes loops; when absent, with the default numbers but for the reach, which is the
            upper quartile of the readings if that is more than 4 m, and with stretches of the way
            that are looked for up to 20 m away.
        on_progress: called with the number of scans and of closed loops so far; first with 0, after
            all checks.

    Raises:
        ValueError: an argument of another class, drift without a key, a resolution outside [0.001,
            1] m, a range that is not positive, a map of more than 40 million cells, a localiser
            without room for all scans; GTSAM is not installed.
    """
    for name, given in (("odometry", odometry), ("drift", drift)):
        _kinds.instance(name, given, Odometry, may_be_none=True)
    if drift is not None or key is not None:
        _kinds.key("key", key)
    _kinds.function("on_progress", on_progress, "a function of two numbers")
    max_range = _checks.number("max_range", max_range, above=0.0, at_most=LONGEST_RANGE)
    sampling = Sampling.of(log, max_range)
    if resolution is None:
        resolution = sampling.side
    resolution = _checks.number("resolution", resolution, at_least=FINEST, at_most=COARSEST)
    # It is needed when the first loop is closed, after minutes.
    import_optional("gtsam", "slam")
    has_truth = log.is_corrected or drift is not None
    origin = log.poses[0] if has_truth else log.measured[0]
    start = origin[:2].copy()
    # Single precision resolves the neighbourhood of the start, wherever the log has it.
    first = origin - np.append(start, 0.0)
    if drift is None:
        motions = steps_along(log.measured)
    else:
        assert key is not None
        motions = np.asarray(measure_motions(log, drift, key)[0], np.float64)
    dead_reckoned = accumulate_motions(first, motions)
    used = _thin_scans(dead_reckoned)
    sensor = log_sensor(log, max_range)
    scans = all_scans(log, sensor, used)
    path = float(np.hypot(*motions[:, :2].T).sum())
    margin = min(MARGIN + SHARE * path, MOST_MARGIN)
    frame, shape = frame_around(sensor, scans, dead_reckoned[used], sampling.side, margin)
    # What is too large is refused before minutes of work.
    frame_around(sensor, scans, dead_reckoned[used], resolution, resolution)
    if localiser is not None and localiser.capacity < len(used):
        raise ValueError(
            f"localiser has room for {localiser.capacity} scans; accepted: at least {len(used)}"
        )
    if closer is None:
        closer = LoopCloser(_find_reach(log, max_range), farthest=FARTHEST_PLACE)
    on_progress(0, 0)
    drive = _Drive(
        (sensor,),
        scans,
        jnp.asarray(steps_along(dead_reckoned[used]), jnp.float32),
        jnp.asarray(np.diff(log.times[used], prepend=log.times[0]), jnp.float32),
        frame,
        shape,
    )
    model: OdometryModel | None = drift if odometry is None else odometry
    model = localiser.odometry if model is None and localiser is not None else model
    if model is None:
        usual = ScanMatcher(turn_steps=TURN_STEPS)
        wide = drive.localiser(wide_odometry(), sampling, usual)
        number = min(SCANS_TO_FIT, len(used))
        state, track = drive.follow(wide, *drive.begin(wide, first), 0, number)
        matched = np.asarray(_poses(track, state.scans.poses), np.float64)[:number]
        model = fit_odometry(np.asarray(drive.motions, np.float64)[1:number], matched)
    if localiser is None:
        localiser = drive.localiser(model, sampling, drive.matcher(model))
    state, track = drive.begin(localiser, first)
    for begin in range(0, len(used), SCANS_PER_SEARCH):
        end = min(begin + SCANS_PER_SEARCH, len(used))
        state, track = drive.follow(localiser, state, track, begin, end)
        # A second time where a stretch has moved the robot far: then single scans are matched.
        for _ in range(2):
            state = closer.find_loops(localiser, state, drive.sensors)
            settled = closer.optimise_poses(localiser, state, drive.sensors)
            state = state if settled is None else settled
            if int(state.closures.examined) == int(state.scans.number):
                break
        on_progress(int(used[end - 1]) + 1, int(state.closures.number))
    graph = pose_graph(state)
    joint = refine_poses(graph, _lines(localiser, state, sensor))
    if joint.expected_error > MOST_EXPECTED:
        # Where walls are bare their lines slide along each other: the graph alone is nearer.
        joint = JointPoses(graph.poses.astype(np.float64), expected_error(graph))
    else:
        joint = joint._replace(expected_error=UNSEEN * joint.expected_error)
    stored = np.asarray(state.scans.poses).copy()
    stored[: len(joint.poses)] = joint.poses
    found = np.asarray(_poses(track, jnp.asarray(stored)), np.float64)
    estimated = _follow_odometry(found, dead_reckoned, used)
    true = log.poses - np.append(start, 0.0) if has_truth else None
    loops = np.asarray(state.closures.pairs)[: int(state.closures.number)].astype(np.int64)
    # Of the stored scans; those of the log at which they were stored.
    at = used[np.searchsorted(np.asarray(track.stored), loops)]
    return LogMap(
        start,
        log.times,
        true,
        dead_reckoned,
        estimated,
        draw_map(sensor, scans, found, resolution),
        None if true is None else draw_map(sensor, scans, true[used], resolution),
        at,
        model,
        judge_poses(_part_of(log, used), found, max_range, joint.expected_error),
    )


def _part_of(log: LaserLog, used: NDArray[np.int64]) -> LaserLog:
    arrays = {name: getattr(log, name)[used] for name in ("times", "ranges", "poses", "odometry")}
    return log._replace(**arrays)


def _find_reach(log: LaserLog, max_range: float) -> float:
    """Return how far apart two scans may be that see the same walls [m]."""
    seen = log.ranges[(log.ranges > 0.0) & (log.ranges < max_range)]
    return max(LEAST_REACH, float(np.quantile(seen, SEEN))) if len(seen) else LEAST_REACH


def _thin_scans(poses: _Floats) -> NDArray[np.int64]:
    """Return the indices of the poses that are far enough from the one before of them."""
    kept = [0]
    for index in range(1, len(poses)):
        motion = motions_between(poses[kept[-1:]], poses[[index]])[0]
        if np.hypot(*motion[:2]) >= LEAST_STEP or abs(motion[2]) >= LEAST_TURN:
            kept.append(index)
    return np.array(kept)


def _follow_odometry(found: _Floats, dead_reckoned: _Floats, used: NDArray[np.int64]) -> _Floats:
    """Return the poses of all scans: those between used ones follow from these by the odometry."""
    before = np.searchsorted(used, np.arange(len(dead_reckoned)), side="right") - 1
    motions = motions_between(dead_reckoned[used[before]], dead_reckoned)
    pairs = np.stack([np.zeros_like(motions), motions], axis=1)
    return np.stack(
        [
            accumulate_motions(pose, pair)[-1]
            for pose, pair in zip(found[before], pairs, strict=True)
        ]
    )


class _Track(NamedTuple):
    """For each scan the motion to it from the newest stored scan, and the index of that one."""

    since: Float[Array, "N 3"]
    stored: Int[Array, " N"]


class _Drive(NamedTuple):
    """What a localiser is given along a log: arrays of its N scans, and the frame of its map."""

    sensors: tuple[Beams, ...]
    scans: Scan
    motions: Float[Array, "N 3"]
    elapsed: Float[Array, " N"]
    frame: GridFrame
    shape: tuple[int, int]

    def localiser(
        self, odometry: OdometryModel, sampling: Sampling, matcher: ScanMatcher
    ) -> Localiser:
        """Return a localiser with room for all scans."""
        return Localiser(
            odometry,
            matcher=matcher,
            capacity=-(-len(self.motions) // WHOLE) * WHOLE,
            filling=sampling.filling,
            noise=sampling.noise,
        )

    def matcher(self, odometry: OdometryModel) -> ScanMatcher:
        """Return what matches scans, and searches as far as an odometry errs in a motion."""
        usual = ScanMatcher(turn_steps=TURN_STEPS)
        errors = np.asarray(jax.vmap(odometry.covariance)(self.motions, self.elapsed))
        variances = np.diagonal(errors, axis1=1, axis2=2)
        reach = FARTHEST * np.sqrt(np.quantile(variances, MOST_MOTIONS, axis=0))
        steps = math.ceil(reach[:2].max() / float(usual.spacing))
        turns = math.ceil(reach[2] / float(usual.turn_spacing))
        # Multiples of half of the least, so that few programs are compiled.
        turns = -(-turns // (TURN_STEPS // 2)) * (TURN_STEPS // 2)
        return ScanMatcher(
            steps=min(max(usual.steps, steps), MOST_STEPS),
            turn_steps=min(max(TURN_STEPS, turns), MOST_TURN_STEPS),
        )

    def begin(self, localiser: Localiser, pose: _Floats) -> tuple[LocaliserState, _Track]:
        """Return the state before the first scan."""
        number = len(self.motions)
        state = localiser.init(jnp.asarray(pose, jnp.float32), self.frame, self.shape, self.sensors)
        return state, _Track(jnp.zeros((number, 3)), jnp.zeros(number, jnp.int32))

    def follow(
        self, localiser: Localiser, state: LocaliserState, track: _Track, begin: int, end: int
    ) -> tuple[LocaliserState, _Track]:
        """Return the state after the scans from `begin` to before `end`, in a map that has room for
        them: where one leaves it, the map is moved before, and fewer scans are taken at a time."""
        after = self.localise(localiser, state, track, begin, end)
        if not self._has_left(*after, begin, end):
            return after
        moved = self._recentre(localiser, state)
        if end - begin <= FEWEST_SCANS:
            return self.localise(localiser, moved, track, begin, end)
        middle = (begin + end) // 2
        half = self.follow(localiser, moved, track, begin, middle)
        return self.follow(localiser, *half, middle, end)

    def _has_left(self, state: LocaliserState, track: _Track, begin: int, end: int) -> bool:
        """Check whether a scan has more points off the map of surfaces than a few."""
        found = np.asarray(_poses(track, state.scans.poses), np.float64)[begin:end, :, None]
        is_point = np.asarray(self.scans.is_return[begin:end])
        ranges = np.where(is_point, np.asarray(self.scans.ranges[begin:end]), 0.0)
        angles = found[:, 2] + np.asarray(self.sensors[0].beam_angles)
        corner = np.asarray(state.surface.frame.origin, np.float64)
        x = found[:, 0] + ranges * np.cos(angles) - corner[0]
        y = found[:, 1] + ranges * np.sin(angles) - corner[1]
        height, width = np.asarray(self.shape) * self.frame.resolution
        is_off = (np.minimum(x, y) < 0.0) | (x > width) | (y > height)
        share = (is_off & is_point).sum(axis=1) / np.maximum(is_point.sum(axis=1), 1)
        return bool(share.max() > MOST_OUTSIDE)

    def _recentre(self, localiser: Localiser, state: LocaliserState) -> LocaliserState:
        """Return the state with a map of surfaces around the robot, of the same size."""
        height, width = np.asarray(self.shape) * self.frame.resolution
        side = self.frame.resolution
        middle = np.asarray(state.pose, np.float64)[:2]
        corner = np.floor((middle - 0.5 * np.array([width, height])) / side) * side
        frame = GridFrame(side, (*corner.tolist(), 0.0))
        state = eqx.tree_at(lambda each: each.surface.frame, state, frame)
        given = (localiser, tuple(self.sensors))
        return rebuild_surface(given, state, state.scans.poses, state.drift)

    def localise(
        self, localiser: Localiser, state: LocaliserState, track: _Track, begin: int, end: int
    ) -> tuple[LocaliserState, _Track]:
        """Return the state after the scans from `begin` to before `end`."""
        first, behind = (jnp.asarray(each, jnp.int32) for each in (begin, end))
        given = (localiser, self.sensors)
        return _localise(given, state, track, self.motions, self.elapsed, self.scans, first, behind)


@eqx.filter_jit
def _localise(
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
        moved = localiser.predict(before, motions[index], elapsed[index])
        scan = Scan(scans.ranges[index], scans.is_return[index])
        after = localiser.correct(moved, [scan], sensors)
        last = after.scans.last
        since = between(after.scans.poses[last], after.pose)
        return after, _Track(track.since.at[index].set(since), track.stored.at[index].set(last))

    result: tuple[LocaliserState, _Track] = jax.lax.fori_loop(first, end, step, (state, track))
    return result


def _lines(localiser: Localiser, state: LocaliserState, sensor: Beams) -> list[Lines]:
    """Return the lines of each stored scan."""
    number = int(state.scans.number)
    found = _end_points(localiser, state.scans, sensor)
    points, normals, is_flat = (np.asarray(each) for each in found)
    return [
        Lines(*(rows[index][is_flat[index]].astype(np.float64) for rows in (points, normals)))
        for index in range(number)
    ]


@eqx.filter_jit
def _end_points(
    localiser: Localiser, scans: StoredScans, sensor: Beams
) -> tuple[Float[Array, "K B 2"], Float[Array, "K B 2"], Bool[Array, "K B"]]:
    """Return the points of stored scans on their lines, the normals, and which are on lines."""

    def of(index: Count) -> EndPoints:
        return localiser.end_points(scans.scan(index, (sensor,))[0], sensor)

    ends = jax.lax.map(of, jnp.arange(scans.capacity))
    away = ((ends.points - ends.anchors) * ends.normals).sum(axis=-1, keepdims=True)
    return ends.points - away * ends.normals, ends.normals, ends.is_flat


@eqx.filter_jit
def _poses(track: _Track, stored: Float[Array, "K 3"]) -> Float[Array, "N 3"]:
    """Return the poses of all scans, given those of the stored ones."""
    return jax.vmap(compose)(stored[track.stored], track.since)
