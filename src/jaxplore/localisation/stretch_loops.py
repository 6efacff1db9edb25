"""Close loops with whole stretches of the way, where single scans tell too little.

A single scan in a corridor looks like many others. The scans of a stretch together, with corners,
doors and junctions, seldom do. The search is exhaustive, and runs on the host.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int
from numpy.typing import NDArray

from jaxplore._types import Count, Pose
from jaxplore.geometry.motion import Matrix, between, motions_between, rotation
from jaxplore.localisation.correlation import Grid, blur_walls
from jaxplore.localisation.localiser import Localiser, LocaliserState, floor
from jaxplore.localisation.pose_graph import Graph, motion_covariances, spread_evenly
from jaxplore.localisation.scan_matching import ScanMatch, ScanMatcher
from jaxplore.localisation.surface import EndPoints
from jaxplore.sensing.beams import Beams

CELL = 0.25
"""Side of a cell of the grids that are compared [m]."""
RADIUS = 30.0
"""Distance from the end of a stretch beyond which its points are not used [m]."""
TURN_SPACING = 0.02
"""Spacing of the yaws that are tried [rad]: a cell at 12 m."""
APART = 1.0
"""Distance from the best position from which on another one is a rival [m]."""
_Floats = NDArray[np.float64]
LENGTH, SPACING, NEIGHBOURS = 15.0, 5.0, 15.0
"""Length of a stretch, way between the ends of two, and that within which they must agree [m]."""
LEAST_REACH, LEAST_TURN, MOST_TURN = 3.0, 0.1, 0.4
"""Least distance from the estimated position within which a stretch is looked for [m], least and
greatest turn [rad]."""
STDS = 3.5
"""Standard deviations of the pose graph within which it is looked for."""
LEAST_SCORE, LEAST_LEAD = 0.2, 0.12
"""Least score of a stretch, and how much greater it is than that of another position."""
MOST_DIFFERENCE, MOST_TURNED = 0.75, 0.06
"""Greatest difference of what two stretches say, in position [m] and in yaw [rad]: three cells of
the search, and three of its yaws."""
TELLING = 0.1
"""Standard deviation of the position from which on a stretch would tell something [m]."""
NUM_NODES = 48
"""Number of old scans whose uncertainty is computed, evenly spread over the way."""
NUM_SCANS, NUM_PLACES = 16, 64
"""Greatest numbers of scans of a stretch, and of the old place, that are matched to each other."""
MOST_OLD = 192
"""Greatest number of old scans in which a stretch is looked for."""
NEAR = 10.0
"""Distance within which old scans make up the place that a stretch is matched to [m]."""
COARSE = (0.3, 0.3, 0.03)
"""Standard deviations of what the search finds [m, m, rad]."""
BENT = (0.06, 0.06, 0.006)
"""Standard deviations by which a stretch and its place are bent, where all of it agrees
[m, m, rad]."""
_Indices = NDArray[np.int64]


class Patch(NamedTuple):
    """What scans say of their surroundings, in one frame.

    Args:
        occupied: (P, 2) ends of their beams [m].
        free: (F, 2) points that beams have passed [m].
    """

    occupied: _Floats
    free: _Floats

    @classmethod
    def of(
        cls, ranges: np.ndarray, is_return: np.ndarray, angles: np.ndarray, poses: np.ndarray
    ) -> "Patch":
        """Return the patch of S scans of B beams.

        Beams without a return are not used. Free points are two cells apart along a beam, and none
        is within two cells of its end.

        Args:
            ranges: (S, B) ranges [m].
            is_return: (S, B) which beams returned.
            angles: (B,) directions of the beams relative to the heading [rad].
            poses: (S, 3) poses of the scans in the frame of the patch.
        """
        directions = poses[:, 2:] + np.asarray(angles, float)
        along = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        ranges = np.where(is_return, ranges, 0.0).astype(float)
        begins = np.broadcast_to(poses[:, None, :2], along.shape)
        ends = (begins + ranges[..., None] * along)[np.asarray(is_return)]
        free = [np.zeros((0, 2))]
        for away in np.arange(CELL, max(float(ranges.max(initial=0.0)), CELL), 2.0 * CELL):
            is_passed = ranges > away + 2.0 * CELL
            free.append(begins[is_passed] + away * along[is_passed])
        return cls(ends, np.concatenate(free))


class PlaceOfPatch(NamedTuple):
    """Where a patch lies in another one.

    Args:
        pose: most likely pose (x, y, yaw) of its frame [m, m, rad].
        score: share of its cells that agree there, less those that are contradicted.
        rival: greatest score at a position more than a metre away.
        is_inside: whether the pose is inside of the poses that were tried, not at their edge.
    """

    pose: _Floats
    score: float
    rival: float
    is_inside: bool


def find_patch(
    patch: Patch, place: Patch, guess: np.ndarray, reach: float, most_turn: float
) -> PlaceOfPatch:
    """Return where a patch lies in an old map, the best of all poses around a guess.

    Both are drawn into grids: O and F are the occupied and the free cells of the patch, turned, and
    P and G those of the place. With B the blurred P, at most 1, the score of a shift s is

        sum over c of O(c) (B - G)(c + s) - F(c) P(c + s), divided by the number of cells of O

    for all shifts at once by the Fourier transform. Where walls are, B counts for it. A wall of
    the one where the other has seen free space counts against it. What only one has seen does not
    count. A free cell beside an occupied one is not free.

    Source: Olson, "Real-time correlative scan matching", ICRA 2009, for the exhaustive search;
    Konolige and Chou, "Markov localization using correlation", IJCAI 1999.

    Args:
        patch: the patch, in the frame whose pose is looked for.
        place: the old map, in the world.
        guess: pose (x, y, yaw) around which is searched [m, m, rad].
        reach: greatest shift along x and y [m].
        most_turn: greatest turn [rad].
    """
    import scipy.fft  # slow to import, and few need it

    number = 2 * int(np.ceil((RADIUS + reach) / CELL))
    size = scipy.fft.next_fast_len(number, real=True)
    walls, free = _draw(place, guess[:2], number)
    value = scipy.fft.rfft2(np.minimum(blur_walls(walls), 1.0) - free, (size, size))
    occupied = scipy.fft.rfft2(walls, (size, size))
    steps, turns = int(np.ceil(reach / CELL)), int(np.ceil(most_turn / TURN_SPACING))
    shifts = np.arange(-steps, steps + 1)
    yaws = guess[2] + TURN_SPACING * np.arange(-turns, turns + 1)
    scores = np.zeros((len(yaws), len(shifts), len(shifts)), np.float32)
    for at, yaw in enumerate(yaws):
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, sin], [-sin, cos]])
        own, own_free = _draw(Patch(*(each @ turn for each in patch)), np.zeros(2), number)
        product = value * np.conj(scipy.fft.rfft2(own, (size, size)))
        product -= occupied * np.conj(scipy.fft.rfft2(own_free, (size, size)))
        found = scipy.fft.irfft2(product, (size, size))[np.ix_(shifts, shifts)]
        scores[at] = found / max(float(own.sum()), 1.0)
    best = np.unravel_index(int(scores.argmax()), scores.shape)
    yaw, right, up = (int(each) for each in best)
    away = CELL * np.hypot(shifts[:, None] - shifts[right], shifts - shifts[up])
    others = scores.max(axis=0)[away > APART]
    pose = np.array([*(guess[:2] + CELL * shifts[[right, up]]), yaws[yaw]])
    is_inside = bool(0 < yaw < len(yaws) - 1 and max(abs(shifts[right]), abs(shifts[up])) < steps)
    return PlaceOfPatch(pose, float(scores[best]), float(others.max(initial=0.0)), is_inside)


def _draw(patch: Patch, middle: np.ndarray, number: int) -> tuple[Grid, Grid]:
    """Return the occupied and the free cells of a patch, in grids around a point."""
    from scipy.ndimage import maximum_filter  # slow to import, and few need it

    grids = []
    for points in patch:
        cells = np.floor((points - middle) / CELL).astype(int) + number // 2
        cells = cells[((cells >= 0) & (cells < number)).all(axis=1)]
        grid = np.zeros((number, number), np.float32)
        grid[cells[:, 0], cells[:, 1]] = 1.0
        grids.append(grid)
    walls, free = grids
    return walls, free * (maximum_filter(walls, 3) == 0.0)


class StretchLoop(NamedTuple):
    """A closed loop: indices of two stored scans and the motion between them, in the older frame.

    Args:
        older: index of the older scan.
        newer: index of the newer one.
        motion: motion from the one to the other (3,) [m, m, rad].
        covariance: its covariance (3, 3), in the frame of the older scan.
    """

    older: int
    newer: int
    motion: np.ndarray
    covariance: np.ndarray


class _Stretch(NamedTuple):
    """A stretch that was found: its scans, the one in its middle, the pose of that, the score."""

    scans: _Indices
    middle: int
    pose: np.ndarray
    score: float


class _Uncertainty(NamedTuple):
    """How exactly the newest scan is known as seen from old ones.

    Args:
        nodes: (M,) indices of old scans.
        position: (M,) standard deviation of the position in its worst direction [m].
        yaw: (M,) standard deviation of the yaw [rad].
    """

    nodes: _Indices
    position: np.ndarray
    yaw: np.ndarray

    @classmethod
    def of(cls, graph: Graph, number_of_old: int) -> "_Uncertainty":
        """Return that of the last scan of a graph, as seen from some of the first ones."""
        nodes = spread_evenly(number_of_old, NUM_NODES)
        covariances = motion_covariances(graph, nodes.tolist(), len(graph.poses) - 1)
        greatest = np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]
        return cls(nodes, np.sqrt(np.maximum(greatest, 0.0)), np.sqrt(covariances[:, 2, 2]))

    def at(self, indices: _Indices) -> tuple[np.ndarray, np.ndarray]:
        """Return the deviations of the position and of the yaw as seen from any old scans."""
        return (
            np.interp(indices, self.nodes, self.position),
            np.interp(indices, self.nodes, self.yaw),
        )


def find_stretch_loops(
    localiser: Localiser,
    state: LocaliserState,
    sensors: Sequence[Beams],
    graph: Graph,
    matcher: ScanMatcher,
    reach: float,
    farthest: float,
) -> list[StretchLoop]:
    """Return the loops that the newest stretches of the way close; none of one alone.

    A stretch is 15 m of the way; one ends every 5 m. Where it lies among the old scans, is searched
    for around its estimated pose, as far as the pose graph allows (`find_patch`). It must agree
    well there, and at no other position nearly as well. Another stretch near it must say the same,
    and no more of them may contradict than agree. Then it is matched exactly, to the surfaces of
    the old scans around it. What the pose graph knows to 0.1 m is not looked for.

    Source: Olson, "Recognizing places using spectrally clustered local matches", Robotics and
    Autonomous Systems 2009, for sets of consistent hypotheses; Mangelson et al., "Pairwise
    consistent measurement set maximization for robust multi-robot map merging", ICRA 2018.

    Args:
        localiser: the localiser.
        state: its state.
        sensors: the sensors; scans of the first one are matched.
        graph: pose graph of the state.
        matcher: matches a stretch exactly.
        reach: distance up to which two scans see the same walls [m].
        farthest: greatest distance from the estimated position that is searched [m].
    """
    number = int(state.scans.number)
    way = np.asarray(state.scans.way, float)[:number]
    begin = way[min(int(state.closures.examined), number - 1)]
    old = np.flatnonzero(way < way[-1] - LENGTH - float(localiser.memory))
    if len(old) < 2:
        return []
    away = np.hypot(*(graph.poses[old, :2] - graph.poses[-1, :2]).T)
    if away.min() > farthest + reach + way[-1] - begin:
        return []
    uncertainty = _Uncertainty.of(graph, len(old))
    # Backwards from the newest one, and one of those before: it may confirm the first new one.
    ends = np.arange(way[-1], max(begin - SPACING, LENGTH), -SPACING)
    found = []
    for end in np.unique(np.searchsorted(way, ends, side="right") - 1):
        scans = np.flatnonzero((way > way[end] - LENGTH) & (way <= way[end]))
        old = np.flatnonzero(way < way[scans[0]] - float(localiser.memory))
        away = np.hypot(*(graph.poses[old, :2] - graph.poses[end, :2]).T)
        spread, turn = uncertainty.at(old)
        is_near = away <= reach + np.minimum(STDS * spread, farthest)
        is_near &= spread >= TELLING
        if not is_near.any():
            continue
        shift = float(np.clip(STDS * spread[is_near].max(), LEAST_REACH, farthest))
        most_turn = float(np.clip(STDS * turn[is_near].max(), LEAST_TURN, MOST_TURN))
        stretch = _find_stretch(state, sensors[0], graph, scans, old[is_near], shift, most_turn)
        if stretch is not None:
            found.append(stretch)
    known = set(np.asarray(graph.pairs)[:, 1].tolist())
    return [
        _match_stretch(localiser, state, sensors, graph, matcher, each)
        for each in _select_confirmed(graph, way, found)
        if each.middle not in known
    ]


def _select_confirmed(graph: Graph, way: np.ndarray, found: Sequence[_Stretch]) -> list[_Stretch]:
    """Return the stretches with which another one agrees, most of all that are near.

    Of those that end within `NEIGHBOURS` of it, at least as many must agree with it as do not.
    """
    kept = []
    for one in found:
        votes = [
            1 if _agree(graph, one, other) else -1
            for other in found
            if other is not one and abs(way[one.middle] - way[other.middle]) <= NEIGHBOURS
        ]
        if 1 in votes and sum(votes) >= 0:
            kept.append(one)
    return kept


def greatest_difference(graph: Graph, loops: Sequence[StretchLoop]) -> float:
    """Return the greatest distance of loops from the present poses of a graph [m]."""
    pairs = np.array([(each.older, each.newer) for each in loops])
    now = motions_between(graph.poses[pairs[:, 0]], graph.poses[pairs[:, 1]])
    wanted = np.stack([each.motion for each in loops])
    return float(np.hypot(*(now - wanted)[:, :2].T).max())


def _thin(indices: _Indices, most: int) -> _Indices:
    """Return at most so many of the indices, evenly spread."""
    chosen: _Indices = indices[spread_evenly(len(indices), most)]
    return chosen


def _find_stretch(
    state: LocaliserState,
    sensor: Beams,
    graph: Graph,
    scans: _Indices,
    old: _Indices,
    shift: float,
    most_turn: float,
) -> _Stretch | None:
    """Return where a stretch of the way lies among old scans; None where that is not known."""
    scans = _thin(scans, NUM_SCANS)
    old = _thin(old, MOST_OLD)
    middle = int(scans[len(scans) // 2])
    ranges, is_return = (
        np.asarray(each)[:, : sensor.num_beams]
        for each in (state.scans.ranges, state.scans.is_return)
    )
    own = motions_between(np.repeat(graph.poses[[middle]], len(scans), axis=0), graph.poses[scans])
    patch, place = (
        Patch.of(ranges[index], is_return[index], sensor.beam_angles, poses)
        for index, poses in ((scans, own), (old, graph.poses[old]))
    )
    found: PlaceOfPatch = find_patch(patch, place, graph.poses[middle], shift, most_turn)
    is_clear = found.score >= max(LEAST_SCORE, found.rival + LEAST_LEAD)
    return (
        _Stretch(scans, middle, found.pose, found.score) if is_clear and found.is_inside else None
    )


def _agree(graph: Graph, one: _Stretch, other: _Stretch) -> bool:
    """Check whether two stretches were found as far from each other as they are by the graph."""
    before = motions_between(graph.poses[[one.middle]], graph.poses[[other.middle]])[0]
    after = motions_between(one.pose[None], other.pose[None])[0]
    turned = math.remainder(float(after[2] - before[2]), math.tau)
    return math.hypot(*(after - before)[:2]) <= MOST_DIFFERENCE and abs(turned) <= MOST_TURNED


def _match_stretch(
    localiser: Localiser,
    state: LocaliserState,
    sensors: Sequence[Beams],
    graph: Graph,
    matcher: ScanMatcher,
    stretch: _Stretch,
) -> StretchLoop:
    """Return the loop of a stretch that was found, after an exact match."""
    way = np.asarray(state.scans.way, float)[: len(graph.poses)]
    first = int(stretch.scans[0])
    old = np.flatnonzero(way < way[first] - float(localiser.memory))
    away = np.hypot(*(graph.poses[old, :2] - stretch.pose[:2]).T)
    older = int(old[away.argmin()])
    near = old[away <= max(NEAR, float(away.min()) + NEAR)]
    found = _match(
        (matcher, localiser, tuple(sensors)),
        state,
        *_fill(_thin(near, NUM_PLACES), NUM_PLACES),
        *_fill(stretch.scans, NUM_SCANS),
        jnp.asarray(older, jnp.int32),
        jnp.asarray(stretch.middle, jnp.int32),
        jnp.asarray(stretch.pose, jnp.float32),
    )
    motion, covariance = (np.asarray(each, float) for each in found)
    bent = np.diag(BENT) ** 2 / min(stretch.score, 1.0)
    return StretchLoop(older, stretch.middle, motion, covariance + bent)


def _fill(indices: _Indices, number: int) -> tuple[Int[Array, " N"], Count]:
    """Return indices in an array of a fixed length, and how many they are."""
    filled = np.zeros(number, np.int32)
    filled[: len(indices)] = indices
    return jnp.asarray(filled), jnp.asarray(len(indices), jnp.int32)


@eqx.filter_jit
def _match(
    given: tuple[ScanMatcher, Localiser, tuple[Beams, ...]],
    state: LocaliserState,
    places: Int[Array, " P"],
    num_places: Count,
    scans: Int[Array, " S"],
    num_scans: Count,
    older: Count,
    middle: Count,
    guess: Pose,
) -> tuple[Pose, Matrix]:
    """Match the points of several scans together to the surfaces of others."""
    matcher, localiser, sensors = given
    place = localiser.surface_of_scans(state, places, num_places, sensors)
    poses = state.scans.poses

    def add(index: Count, is_used: Bool[Array, ""]) -> EndPoints:
        ends = localiser.end_points(state.scans.scan(index, sensors)[0], sensors[0])
        return ends.move(between(poses[middle], poses[index]), is_used)

    every = jax.vmap(add)(scans, jnp.arange(scans.shape[0]) < num_scans)
    ends: EndPoints = jax.tree.map(lambda rows: rows.reshape(-1, *rows.shape[2:]), every)
    loose = jnp.diag(jnp.array(COARSE) ** 2)
    match: ScanMatch = matcher(place, ends, guess, loose, jnp.zeros(()))
    back = rotation(poses[older, 2]).T
    # The scans meet the same walls, whose errors they share: together they tell what one would.
    covariance = num_scans.astype(jnp.float32) * match.covariance + floor()
    return between(poses[older], match.pose), back @ covariance @ back.T
