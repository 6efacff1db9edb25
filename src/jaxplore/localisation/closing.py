"""Close loops: find stored scans that see a place again, and move all scans to fit.

It runs on the host, between compiled steps: the search and the new surfaces are compiled, the pose
graph is optimised by a library.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Pose, Scalar
from jaxplore.geometry.motion import (
    Matrix,
    between,
    compose,
    motions_between,
    rotation,
    transform_points,
)
from jaxplore.localisation.localiser import Localiser, LocaliserState, floor
from jaxplore.localisation.pose_graph import Graph, motion_covariances, optimise
from jaxplore.localisation.scan_matching import ScanMatch, ScanMatcher
from jaxplore.localisation.stretch_loops import find_stretch_loops, greatest_difference
from jaxplore.sensing.beams import Beams, Scan

PLACE = 4.0
"""Way before and behind an old scan whose scans make up the place where it was taken [m]."""
MOST_PLACES = 64
"""Number of old places whose uncertainty is computed at a time."""
FAR = 0.5
"""Distance that a stretch moves the robot from which on single scans are matched afterwards [m]."""
CLEAR = 0.3
"""Distance before what a beam met from which on a point contradicts the beam [m]."""


class _Found(NamedTuple):
    """A scan matched to an old place: the motion from the old scan, in its frame."""

    motion: Pose
    covariance: Matrix
    share: Scalar
    contradicted: Scalar


class LoopCloser(eqx.Module):
    """Closes loops.

    For a stored scan an old place is looked for: the nearest older scan within `reach`, more than
    the memory of the localiser ago by way. The scan is matched to the surfaces of the scans around
    it. If at least `least_share` of its points lie on them, at most `most_contradicted` of the
    points of the old scan and of this one lie where a beam of the other passed, and the match is
    within `most_stds` of what the pose graph says, the loop is closed.
    If the closed loops contradict the poses by more than `tolerance`, the pose graph is optimised,
    and the surfaces are made anew.

    Args:
        reach: greatest distance of an old scan [m].
        spacing: way between scans for which places are looked for [m].
        least_share: least share of a scan's points on the surfaces of the old place.
        most_contradicted: greatest share of points in the free space of the other scan.
        tolerance: greatest error of a closed loop that is left as it is [m].
        most_stds: greatest difference of a match from the pose graph, in standard deviations. Right
            matches of dense scans are within 2; between sparse ones covariances are several times
            too small.
        farthest: distance from the estimated position up to which whole stretches of the way are
            looked for in the old map [m], if the pose graph says that the robot may be that far
            off; 0 for no stretches.
        matcher: matches a scan to an old place; it searches 1 m and 0.25 rad by default.

    Raises:
        ValueError: a number that is not positive, a share above 1, a matcher of another class.
    """

    reach: Scalar
    spacing: Scalar
    least_share: Scalar
    most_contradicted: Scalar
    tolerance: Scalar
    most_stds: Scalar
    farthest: Scalar
    matcher: ScanMatcher

    @_kinds.check_arguments
    def __init__(
        self,
        reach: ArrayLike = 4.0,
        *,
        spacing: ArrayLike = 1.0,
        least_share: ArrayLike = 0.5,
        most_contradicted: ArrayLike = 0.1,
        tolerance: ArrayLike = 0.03,
        most_stds: ArrayLike = 7.0,
        farthest: ArrayLike = 0.0,
        matcher: ScanMatcher | None = None,
    ) -> None:
        self.reach = _checks.scalar("reach", reach, above=0.0)
        self.spacing = _checks.scalar("spacing", spacing, above=0.0)
        self.least_share = _checks.scalar("least_share", least_share, above=0.0, at_most=1.0)
        self.most_contradicted = _checks.scalar(
            "most_contradicted", most_contradicted, above=0.0, at_most=1.0
        )
        self.tolerance = _checks.scalar("tolerance", tolerance, above=0.0)
        self.most_stds = _checks.scalar("most_stds", most_stds, above=0.0)
        self.farthest = _checks.scalar("farthest", farthest, at_least=0.0)
        if matcher is None:
            matcher = ScanMatcher(steps=8, spacing=0.125, turn_spacing=0.03, iterations=10)
        self.matcher = matcher

    def close_loops(
        self, localiser: Localiser, state: LocaliserState, sensors: Sequence[Beams]
    ) -> LocaliserState | None:
        """Look for places that the newest scans see again; return the state with moved scans.

        The result has other poses of scans, of the robot and of surfaces. It is None if no scan has
        moved; then `state.closures` may have changed all the same, see `find_loops`.

        Args:
            localiser: the localiser.
            state: its state.
            sensors: the sensors.

        Raises:
            ValueError: an argument of another class; GTSAM is not installed.
        """
        examined = self.find_loops(localiser, state, sensors)
        return self.optimise_poses(localiser, examined, sensors)

    @_kinds.check_arguments
    def find_loops(
        self, localiser: Localiser, state: LocaliserState, sensors: Sequence[Beams]
    ) -> LocaliserState:
        """Return the state with the loops that the newest scans close; nothing has moved yet.

        Arguments and errors are those of `close_loops`.
        """
        number, closures = int(state.scans.number), state.closures
        begin = int(closures.examined)
        if begin >= number:
            return state
        closed = np.asarray(closures.pairs)[: int(closures.number), 1]
        state, is_far = self._find_stretches(localiser, state, sensors)
        closures = state.closures
        if is_far:
            # Single scans are looked for where the robot is, once the poses are right.
            return state
        poses, way = (np.asarray(each)[:number] for each in (state.scans.poses, state.scans.way))
        last = way[closed.max()] if len(closed) else -np.inf
        for newer in range(begin, number):
            if way[newer] - last < float(self.spacing):
                continue
            old = way[newer] - way[:newer] > float(localiser.memory)
            away = np.hypot(*(poses[:newer, :2] - poses[newer, :2]).T)
            away = np.where(old, away, np.inf)
            if not len(away) or away.min() > float(self.reach):
                continue
            older = int(away.argmin())
            near = (np.abs(way - way[older]) <= PLACE) & (
                way[newer] - way > float(localiser.memory)
            )
            place = np.flatnonzero(near)
            found = _match(
                (self.matcher, localiser, tuple(sensors)),
                state,
                *(jnp.asarray(each, jnp.int32) for each in (place[0], place[-1] + 1, older, newer)),
            )
            if float(found.share) < float(self.least_share):
                continue
            if float(found.contradicted) > float(self.most_contradicted):
                continue
            if not self._is_likely(state._replace(closures=closures), older, newer, found):
                continue
            closures = closures.with_loop(
                jnp.asarray(older, jnp.int32),
                jnp.asarray(newer, jnp.int32),
                found.motion,
                found.covariance,
            )
            last = way[newer]
            # What the robot knows of its position is what the old place tells it.
            turned = rotation(jnp.asarray(poses[older, 2]))
            state = state._replace(drift=turned @ found.covariance @ turned.T)
        closures = closures._replace(examined=jnp.asarray(number, jnp.int32))
        return state._replace(closures=closures)

    def _find_stretches(
        self, localiser: Localiser, state: LocaliserState, sensors: Sequence[Beams]
    ) -> tuple[LocaliserState, bool]:
        """Return the state with the loops of stretches, and whether they move the robot far."""
        farthest = float(self.farthest)
        if not farthest:
            return state, False
        graph = pose_graph(state)
        graph = graph._replace(poses=graph.poses.astype(float))
        reach = float(self.reach)
        loops = find_stretch_loops(localiser, state, sensors, graph, self.matcher, reach, farthest)
        closures = state.closures
        for each in loops:
            closures = closures.with_loop(
                jnp.asarray(each.older, jnp.int32),
                jnp.asarray(each.newer, jnp.int32),
                jnp.asarray(each.motion, jnp.float32),
                jnp.asarray(each.covariance, jnp.float32),
            )
        is_far = bool(loops) and greatest_difference(graph, loops) > FAR
        return state._replace(closures=closures), is_far

    def _is_likely(self, state: LocaliserState, older: int, newer: int, found: _Found) -> bool:
        """Check whether a match agrees with the motion by the pose graph (chi-square test).

        Behind a wall, or along a row of shelves, another place looks the same. Within the tolerance
        the graph is not optimised, so that much of a difference is expected. The state has the
        loops that were closed before. Scan `newer` was matched to the place of scan `older`.
        """
        expected = motion_covariances(pose_graph(state), [older], newer)[0]
        expected = expected + np.asarray(found.covariance, float)
        expected[:2, :2] += float(self.tolerance) ** 2 * np.eye(2)
        # In NumPy: JAX would compile the indexing anew for every pair of scans.
        poses = np.asarray(state.scans.poses, float)
        error = motions_between(poses[[older]], poses[[newer]])[0] - np.asarray(found.motion, float)
        error[2] = np.remainder(error[2] + np.pi, 2.0 * np.pi) - np.pi
        return bool(error @ np.linalg.solve(expected, error) <= float(self.most_stds) ** 2)

    @_kinds.check_arguments
    def optimise_poses(
        self, localiser: Localiser, state: LocaliserState, sensors: Sequence[Beams]
    ) -> LocaliserState | None:
        """Return the state whose scans fit the closed loops; None if they fit well enough.

        Arguments and errors are those of `close_loops`.
        """
        scans, closures = state.scans, state.closures
        number, loops = int(scans.number), int(closures.number)
        if not loops:
            return None
        poses = np.asarray(scans.poses, float)[:number]
        pairs = np.asarray(closures.pairs)[:loops]
        wanted = np.asarray(closures.motions)[:loops]
        if _greatest_error(poses, pairs, wanted) <= float(self.tolerance):
            return None
        best = optimise(pose_graph(state))
        moved = np.asarray(scans.poses).copy()
        moved[:number] = best.poses
        if np.abs(best.poses[:, :2] - poses[:, :2]).max() <= 0.5 * float(self.tolerance):
            return None
        return rebuild_surface(
            (localiser, tuple(sensors)),
            state,
            jnp.asarray(moved, jnp.float32),
            jnp.asarray(best.covariance, jnp.float32),
        )

    @_kinds.check_arguments
    def spreads(self, localiser: Localiser, state: LocaliserState) -> Float[Array, " K"]:
        """Return how exactly the robot knows its position as seen from old places (K,) [m].

        These are stored scans within twice the reach, more than the memory of the localiser ago by
        way; with many of them every second, third and so on. It is 0 for all other scans. Where it
        is great, a closed loop would tell much.

        Args:
            localiser: the localiser.
            state: its state.

        Raises:
            ValueError: an argument of another class; GTSAM is not installed.
        """
        scans, number = state.scans, int(state.scans.number)
        spreads = np.zeros(scans.capacity, np.float32)
        if number > 1:
            poses, way = (np.asarray(each)[:number] for each in (scans.poses, scans.way))
            away = np.hypot(*(poses[:, :2] - poses[-1, :2]).T)
            is_old = way[-1] - way > float(localiser.memory)
            places = np.flatnonzero(is_old & (away <= 2.0 * float(self.reach)))
            places = places[:: 1 + len(places) // MOST_PLACES]
            found = motion_covariances(pose_graph(state), places.tolist(), number - 1)
            spreads[places] = np.sqrt(0.5 * np.trace(found[:, :2, :2], axis1=1, axis2=2))
        return jnp.asarray(spreads)


def pose_graph(state: LocaliserState) -> Graph:
    """Return the pose graph of the stored scans and the closed loops."""
    scans, closures = state.scans, state.closures
    number, loops = int(scans.number), int(closures.number)
    return Graph(
        np.asarray(scans.poses)[:number],
        np.asarray(scans.motions)[1:number],
        np.asarray(scans.covariances)[1:number],
        np.asarray(closures.pairs)[:loops],
        np.asarray(closures.motions)[:loops],
        np.asarray(closures.covariances)[:loops],
    )


def _greatest_error(poses: np.ndarray, pairs: np.ndarray, wanted: np.ndarray) -> float:
    """Return the greatest distance between measured and present motions of closed loops [m]."""
    now = motions_between(poses[pairs[:, 0]], poses[pairs[:, 1]])
    return float(np.hypot(*(now - wanted)[:, :2].T).max())


@eqx.filter_jit
def _match(
    given: tuple[ScanMatcher, Localiser, tuple[Beams, ...]],
    state: LocaliserState,
    first: Count,
    end: Count,
    older: Count,
    newer: Count,
) -> _Found:
    """Match a stored scan to the surfaces of others."""
    matcher, localiser, sensors = given
    place = localiser.surface_of(state, first, end, sensors)
    scans = state.scans
    scan, old_scan = (scans.scan(index, sensors)[0] for index in (newer, older))
    ends = localiser.end_points(scan, sensors[0])
    old = scans.poses[older]
    # The search decides; its prior only keeps Gauss-Newton from leaving where nothing holds it.
    loose = jnp.diag(jnp.array([1.0, 1.0, 0.25]) ** 2)
    match: ScanMatch = matcher(place, ends, scans.poses[newer], loose, scans.way[end - 1])
    back = rotation(old[2]).T
    covariance = back @ (match.covariance + floor()) @ back.T
    motion = between(old, match.pose)
    contradicted = jnp.maximum(
        _measure_contradiction(sensors[0], scan, old_scan, motion),
        _measure_contradiction(sensors[0], old_scan, scan, between(match.pose, old)),
    )
    return _Found(motion, covariance, match.share, contradicted)


def _measure_contradiction(sensor: Beams, scan: Scan, other: Scan, motion: Pose) -> Scalar:
    """Return the share of the points of a scan that lie where beams of another scan passed.

    A point contradicts the beam in whose direction it is, and the ones beside it, if it lies more
    than `CLEAR` before what each of them met. `motion` is the pose of the first scan in the frame
    of the other one.
    """
    points = transform_points(motion, scan.points(sensor))
    x, y = jnp.unstack(points, axis=1)
    number = sensor.num_beams
    bearing = (jnp.arctan2(y, x) - float(sensor.beam_angles[0])) % (2.0 * jnp.pi)
    beam = jnp.round(bearing / sensor.beam_spacing).astype(jnp.int32)
    is_seen = scan.is_return
    if sensor.is_full_circle:
        beam = beam % number
    else:
        is_seen &= beam < number
        beam = jnp.minimum(beam, number - 1)
    ranges = other.ranges
    least = jnp.minimum(ranges, jnp.minimum(jnp.roll(ranges, 1), jnp.roll(ranges, -1)))
    is_before = is_seen & (jnp.hypot(x, y) < least[beam] - CLEAR)
    number_of_points = jnp.maximum(jnp.sum(scan.is_return, dtype=jnp.float32), 1.0)
    return jnp.sum(is_before, dtype=jnp.float32) / number_of_points


@eqx.filter_jit
def rebuild_surface(
    given: tuple[Localiser, tuple[Beams, ...]],
    state: LocaliserState,
    poses: Float[Array, "K 3"],
    drift: Matrix,
) -> LocaliserState:
    """Return the state with other poses of the stored scans, and surfaces of these scans alone.

    Args:
        given: the localiser and its sensors.
        state: its state; the surfaces are made in the frame of `state.surface`.
        poses: poses (K, 3) of the stored scans [m, m, rad].
        drift: covariance (3, 3) of the newest one.
    """
    localiser, sensors = given
    last = state.scans.last
    since = between(state.scans.poses[last], state.pose)
    state = state._replace(
        scans=state.scans._replace(poses=poses), pose=compose(poses[last], since), drift=drift
    )
    surface = localiser.surface_of(state, jnp.zeros((), jnp.int32), state.scans.number, sensors)
    return state._replace(surface=surface)
