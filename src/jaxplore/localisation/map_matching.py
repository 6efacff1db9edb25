"""Find where the map of one robot lies on that of another, when nobody knows their frames.

The search is exhaustive over all poses, and runs on the host. A wrong pose would spoil both maps,
so a match says whether it is certain, and why not.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore import _kinds
from jaxplore.localisation.correlation import Grid, blur_walls
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid

CELL = 0.25
"""Side of a cell of the grids that are correlated [m]."""
LEAST_YAWS, MOST_YAWS, RIM = 120, 720, 1.0
"""Least and greatest number of yaws that are tried, and how far the rim of the map moves from one
to the next [m]."""
SECTOR = math.radians(30.0)
"""Yaws of which at each position only the best one is a candidate [rad]."""
LEAST_PEAK = 1.0
"""Least score of a candidate before it is refined [m]."""
NUM_REFINED = 64
"""Greatest number of candidates that are refined."""
NUM_DIRECTIONS, SPREAD = 72, 1
"""Directions in which lengths of walls are counted, and how many of them beside count as equal."""
SPACING = 0.1
"""Side of the cells of which each gives one point of a wall [m]."""
NEIGHBOURHOOD = 0.35
"""Distance within which points say how a wall runs [m]."""
FLAT = 0.5
"""How much points must be on a line for it to say which way a wall faces, from 0 to 1."""
NEAR = 0.12
"""Standard deviation of the distance of a wall from the same one on another map [m]."""
DEEP = 0.3
"""Distance from all that is not free beyond which there is no wall [m]."""
CONTRADICTED = 1.5
"""What a metre of wall in the free space of the other map counts, for one that agrees."""
STEEP = 0.06
"""Least slope of the blurred free space beside a wall that was seen from one side [1 / cell]; it is
0.2 where all before the wall is free and nothing behind it."""
SCALES = (0.4, 0.4, 0.3, 0.3, 0.2, 0.2, NEAR, NEAR, NEAR, NEAR)
"""Standard deviations of distances in the steps of the refinement [m]."""
STEP_STDS = (1.5, 1.5, 0.2)
"""Standard deviations of a step, for the directions in which walls tell nothing [m, m, rad]."""
SAME, SAME_YAW = 0.5, 0.1
"""Differences up to which two candidates are one [m, rad]."""
ERROR, ALIKE = 0.05, 0.5
"""Standard deviation of the position of a wall, and the length along which it errs alike [m]."""
FLOOR = (0.03, 0.03, 0.003)
"""Least standard deviations: maps are bent [m, m, rad]."""
LEAST_SCORE = 15.0
"""Length of walls that must agree, less what is contradicted [m]."""
MOST_RIVAL = 0.6
"""Greatest score of another pose, as a share of the best one."""
MOST_CONTRADICTED = 0.1
"""Greatest length of contradicted walls, as a share of those that agree."""
LEAST_ACROSS = 3.0
"""Length of walls across each direction that must agree [m]; a bare corridor has none along it."""
LEAST_OVERLAP = 15.0
"""Free area that both maps must know [m2]."""
MOST_EXTENT = 300.0
"""Greatest width of the known part of a map [m]."""
MOST_CELLS = 4_000_000
"""Greatest number of cells of the known part of a map; a larger one is coarsened."""
_Floats = NDArray[np.floating]
_Indices = NDArray[np.intp]


class MapMatch(NamedTuple):
    """Where the frame of a map lies in that of another one.

    Args:
        pose: most likely pose (x, y, yaw) of the frame of the other map in that of the one
            [m, m, rad].
        covariance: its covariance (3, 3), in the frame of the one.
        score: length of the walls that agree, less 1.5 times that of those that are contradicted
            [m].
        rival: greatest score of a pose that is another one [m].
        agreeing: length of the walls that agree [m].
        contradicted: length of the walls of either map in the free space of the other [m].
        across: length of the walls that agree across the direction that has least of them [m].
        overlap: free area that both maps know [m2].
        doubt: why the pose is not certain, in a few words; empty if it is.
    """

    pose: np.ndarray
    covariance: np.ndarray
    score: float
    rival: float
    agreeing: float
    contradicted: float
    across: float
    overlap: float
    doubt: str

    @property
    def is_certain(self) -> bool:
        """Whether the maps may be merged by this pose."""
        return not self.doubt


@_kinds.check_arguments
def match_maps(one: OccupancyGrid, other: OccupancyGrid) -> MapMatch:
    """Return where a map lies on another one, of all poses the best, and whether that is certain.

    Each wall has the side from which it was seen. With the points p of the walls of the other map,
    the distance d of a point from the walls of the one, and the cosine c between the sides from
    which both were seen, the length that agrees is, with points 0.1 m apart,

        0.1 m  sum over p of exp(-d(T p)^2 / (2 * 0.12^2)) max(c, 0),

    the mean of this and of the same with the maps exchanged. What one map has not seen counts
    nothing. A wall is contradicted where the other map is free within 0.3 m around.

    1. All yaws and shifts are tried in cells of 0.25 m: for each yaw the correlation over all
       shifts by the Fourier transform. Yaws at which the directions of the walls do not allow 0.6
       of the best score are left out.
    2. The 64 best local maxima are refined by the distances from walls along their normals
       (Gauss-Newton), and scored.
    3. The pose is certain if walls of 15 m agree and few are contradicted, if no other pose has
       more than 0.6 of its score, if there are walls of 3 m across each direction, and if both maps
       know 15 m2 of free space.

    The covariance is that of the refinement with errors of walls of 0.05 m, which are the same
    along 0.5 m. Maps that are bent by more have greater errors.

    Sources: Carpin, "Fast and accurate map merging for multi-robot systems", Autonomous Robots
    2008, for directions of walls and correlation; Olson, "Real-time correlative scan matching",
    ICRA 2009; Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, for the search.
    The sides of walls, the contradictions and the test of uniqueness are ours.

    Args:
        one: map, in whose frame the pose is.
        other: map of which the frame is looked for.

    Raises:
        ValueError: a map whose known part is wider than 300 m.
    """
    sides = _Side.of("one", one), _Side.of("other", other)
    if any(len(side.points) == 0 for side in sides):
        return _no_match("a map has no walls")
    found = _find_candidates(*sides)
    if not found:
        return _no_match("no walls agree")
    best = found[0]
    rival = max((each.score for each in found[1:]), default=0.0)
    return _conclude(*sides, best, max(rival, 0.0))


class _Side(NamedTuple):
    """A map as it is matched, in the axes of its grid.

    Args:
        points: (P, 2) points of walls, about `SPACING` apart [m].
        facing: (P, 2) directions from which they were seen; 0 where from both sides.
        normals: (P, 2) directions across the walls.
        flat: (P,) how much the points around are on a line, from 0 to 1.
        deep: (D, 2) points with free space around [m].
        nearest: (H, W) index of the nearest point.
        away: (H, W) distance from the nearest wall [m].
        depth: (H, W) distance from what is not free [m].
        cell: side of a cell [m].
        corner: (3,) pose of the corner of cell (0, 0) in the frame of the map [m, m, rad].
    """

    points: _Floats
    facing: _Floats
    normals: _Floats
    flat: _Floats
    deep: _Floats
    nearest: NDArray[np.int32]
    away: Grid
    depth: Grid
    cell: float
    corner: _Floats

    @classmethod
    def of(cls, name: str, grid: OccupancyGrid) -> "_Side":
        """Return a map as it is matched; `name` is for the message."""
        from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter

        values, cell, first = _known_part(name, grid)
        # A margin, so that points beside the map find what is near.
        margin = math.ceil(1.0 / cell)
        values = np.pad(values, margin, constant_values=0.5)
        free = values < FREE_THRESHOLD
        walls = (values > OCCUPIED_THRESHOLD) & binary_dilation(free, np.ones((3, 3), bool))
        cells = np.argwhere(walls)
        centres = (cells[:, ::-1] + 0.5) * cell
        which, count = _group(centres, SPACING)
        points = np.stack([np.bincount(which, each) / count for each in centres.T], axis=1)
        slopes = np.gradient(gaussian_filter(free.astype(np.float32), 2.0))
        facing = np.stack(
            [np.bincount(which, each[walls]) / count for each in slopes[::-1]], axis=1
        )
        steep = np.hypot(*facing.T)[:, None]
        facing = np.where(steep > STEEP, facing / np.maximum(steep, STEEP), 0.0)
        normals, flat = _directions_across(points)
        # A line through the points around is more exact than the slope of free space in cells.
        side = np.sign((normals * facing).sum(axis=1))[:, None] * normals
        facing = np.where((flat > FLAT)[:, None], side, facing)
        index = np.zeros(walls.shape, np.int32)
        index[walls] = which
        away, nearest = np.full(walls.shape, np.inf), index
        if len(cells):
            away, at = distance_transform_edt(~walls, return_indices=True)
            nearest = index[tuple(at)]
        depth = distance_transform_edt(free) * cell
        inside = (np.argwhere(depth > DEEP)[:, ::-1] + 0.5) * cell
        _, firsts = np.unique(_keys(inside, 0.5 * CELL), return_index=True)
        corner = np.asarray(grid.frame.origin, np.float64)
        begin = grid.resolution * first[::-1].astype(float) - margin * cell
        return cls(
            points,
            facing,
            normals,
            flat,
            inside[firsts],
            nearest,
            (away * cell).astype(np.float32),
            depth.astype(np.float32),
            cell,
            np.append(corner[:2] + begin @ _turn(corner[2]), corner[2]),
        )

    def cells_at(self, points: _Floats) -> tuple[NDArray[np.bool_], tuple[_Indices, _Indices]]:
        """Return which points are on the map, and their cells; cell (0, 0) for those off it."""
        cells = np.floor(points[:, ::-1] / self.cell).astype(np.intp)
        is_in = ((cells >= 0) & (cells < self.away.shape)).all(axis=1)
        rows, columns = np.where(is_in[:, None], cells, 0).T
        return is_in, (rows, columns)

    @property
    def centre(self) -> _Floats:
        """Mean of the points of walls (2,) [m]."""
        mean: _Floats = self.points.mean(axis=0)
        return mean

    def reach(self) -> float:
        """Return the greatest distance of points from the centre [m]."""
        return max(
            float(np.hypot(*(each - self.centre).T).max(initial=0.0))
            for each in (self.points, self.deep)
        )


class _Candidate(NamedTuple):
    """A pose of the other map: where its centre is in the axes of the one [m], its yaw, scores.

    `information` (3, 3) is that of walls of unit error a metre long, of the centre and the yaw.
    """

    centre: _Floats
    yaw: float
    agreeing: float = 0.0
    contradicted: float = 0.0
    information: _Floats = np.zeros((3, 3))

    @property
    def score(self) -> float:
        """Length of the walls that agree, less what contradictions count [m]."""
        return self.agreeing - CONTRADICTED * self.contradicted


def _no_match(doubt: str) -> MapMatch:
    return MapMatch(np.zeros(3), np.full((3, 3), np.inf), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, doubt)


def _known_part(name: str, grid: OccupancyGrid) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the part of a map that is known, the side of its cells [m], and its first cell."""
    values = grid.crop(grid.probability)
    is_known = (values < FREE_THRESHOLD) | (values > OCCUPIED_THRESHOLD)
    spans = []
    for axis in (1, 0):
        found = np.flatnonzero(is_known.any(axis=axis))
        spans.append((int(found[0]), int(found[-1]) + 1) if len(found) else (0, 1))
    first, last = np.array(spans).T
    part = values[first[0] : last[0], first[1] : last[1]]
    width = grid.resolution * max(part.shape)
    if width > MOST_EXTENT:
        raise ValueError(
            f"{name} is {width:.0f} m wide where it is known; accepted: at most {MOST_EXTENT:g} m"
        )
    cell = grid.resolution
    if part.size > MOST_CELLS:
        cell *= math.sqrt(part.size / MOST_CELLS)
        part = np.asarray(OccupancyGrid(part, grid.resolution).resample(cell).probability)
    return np.asarray(part, np.float32), cell, first


def _keys(points: _Floats, side: float) -> NDArray[np.int64]:
    """Return a number for each point, the same in one cell of a grid."""
    cells = np.floor(points / side).astype(np.int64)
    keys: NDArray[np.int64] = cells[:, 0] * 2**32 + cells[:, 1]
    return keys


def _group(points: _Floats, side: float) -> tuple[_Indices, NDArray[np.int64]]:
    """Return the group of each point, those in one cell of a grid, and how many are in each."""
    _, which, count = np.unique(_keys(points, side), return_inverse=True, return_counts=True)
    return which, count


def _turn(yaw: float) -> _Floats:
    """Return the matrix that turns rows (x, y) by an angle, multiplied from the right."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, sin], [-sin, cos]])


def _directions_across(points: _Floats) -> tuple[_Floats, _Floats]:
    """Return for each point the direction across the points around, and how flat they are."""
    from scipy.spatial import cKDTree  # slow to import, and few need it

    number = len(points)
    if number == 0:
        return np.zeros((0, 2)), np.zeros(0)
    pairs = cKDTree(points).query_pairs(NEIGHBOURHOOD, output_type="ndarray")
    own = np.arange(number)[:, None].repeat(2, axis=1)
    first, second = np.concatenate([pairs, pairs[:, ::-1], own]).T
    x, y = (points[second] - points[first]).T
    count = np.bincount(first, minlength=number)

    def mean(values: _Floats) -> _Floats:
        total: _Floats = np.bincount(first, values, number) / count
        return total

    xx, xy, yy = (mean(a * b) - mean(a) * mean(b) for a, b in ((x, x), (x, y), (y, y)))
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    spread = np.hypot(xx - yy, 2.0 * xy)
    thin, thick = 0.5 * (xx + yy - spread), 0.5 * (xx + yy + spread)
    ratio = np.sqrt(np.clip(thin / np.maximum(thick, 1e-9), 0.0, 1.0))
    flat = np.where((count >= 3) & (thick > 1e-9), 1.0 - ratio, 0.0)
    return np.stack([-np.sin(along), np.cos(along)], axis=1), flat


def _wall_lengths(side: _Side) -> tuple[_Floats, float]:
    """Return the lengths of walls that face each direction (D,), and those that face none [m]."""
    is_facing = side.facing.any(axis=1)
    x, y = side.facing[is_facing].T
    at = np.floor(np.arctan2(y, x) / math.tau * NUM_DIRECTIONS).astype(int) % NUM_DIRECTIONS
    lengths = SPACING * np.bincount(at, minlength=NUM_DIRECTIONS)
    return lengths, SPACING * float((~is_facing).sum())


def _most_agreeing(one: _Side, other: _Side, yaws: _Floats) -> _Floats:
    """Return the greatest length of walls that can agree at each yaw, by their directions [m]."""
    (first, first_any), (second, second_any) = _wall_lengths(one), _wall_lengths(other)

    def widen(lengths: _Floats) -> _Floats:
        wide: _Floats = np.sum([np.roll(lengths, by) for by in range(-SPREAD, SPREAD + 1)], axis=0)
        return wide

    steps = np.rint(yaws / math.tau * NUM_DIRECTIONS).astype(int)
    least = [
        min(
            np.minimum(widen(first), np.roll(second, by)).sum(),
            np.minimum(first, np.roll(widen(second), by)).sum(),
        )
        for by in steps
    ]
    return np.array(least) + first_any + second_any


def _draw(points: _Floats, values: _Floats, number: int) -> Grid:
    """Return the means of the values (P, C) of points in the cells of a grid (C, N, N).

    The first axis of the grid is x, and the origin is in its middle.
    """
    cells = np.floor(points / CELL).astype(int) + number // 2
    flat = cells[:, 0] * number + cells[:, 1]
    count = np.maximum(np.bincount(flat, minlength=number**2), 1)
    means = np.stack([np.bincount(flat, each, number**2) / count for each in values.T])
    return means.reshape(-1, number, number).astype(np.float32)


class _Correlation(NamedTuple):
    """Two maps in cells of `CELL`, each around its centre, for the correlation over all shifts.

    Args:
        values: Fourier transforms (4, S, S/2 + 1) of what the one says of walls that face along x
            and y, of any wall, and of free space of the other one.
        centre: centre of the one (2,) [m].
        points: (P, 2) points of walls of the other one, around its centre [m].
        facing: (P, 2) directions from which they were seen.
        deep: (D, 2) points with free space around [m].
        number: cells along a side of a map.
        size: shifts along each axis, S.
    """

    values: NDArray[np.complexfloating]
    centre: _Floats
    points: _Floats
    facing: _Floats
    deep: _Floats
    number: int
    size: int

    @classmethod
    def of(cls, one: _Side, other: _Side) -> "_Correlation":
        """Return that of two maps."""
        import scipy.fft  # slow to import, and few need it

        reaches = one.reach(), other.reach()
        number = 2 * math.ceil(max(reaches) / CELL) + 4
        size = scipy.fft.next_fast_len(2 * math.ceil(sum(reaches) / CELL) + 8, real=True)
        is_any = ~one.facing.any(axis=1)
        rows = np.column_stack([one.facing, is_any, np.ones(len(one.points))])
        x, y, thin, walls = _draw(one.points - one.centre, rows, number)
        (free,) = _draw(one.deep - one.centre, np.ones((len(one.deep), 1)), number)
        x, y, thin = blur_walls(np.stack([x, y, thin]))
        length = np.maximum(np.hypot(x, y), 1.0)
        says = (
            x / length,
            y / length,
            np.minimum(thin, 1.0) - CONTRADICTED * free,
            -CONTRADICTED * walls,
        )
        return cls(
            scipy.fft.rfft2(np.stack(says), (size, size)),
            one.centre,
            other.points - other.centre,
            other.facing,
            other.deep - other.centre,
            number,
            size,
        )

    def scores(self, yaw: float) -> Grid:
        """Return the score of each shift at a yaw (S, S) [m]; negative shifts count from the end.

        With what the other map has in its cells, turned by the yaw: the direction (x, y) that a
        wall faces, w = 1 for a wall and f = 1 for free space, it is

            CELL  sum over c of x(c) X(c + s) + y(c) Y(c + s) + w(c) W(c + s) + f(c) F(c + s).

        X and Y are those directions on the one map, blurred. W is the same of its walls that face
        no side, less 1.5 in free space, and F is -1.5 on its walls.
        """
        import scipy.fft  # slow to import, and few need it

        turn = _turn(yaw)
        rows = np.column_stack([self.facing @ turn, np.ones(len(self.points))])
        free = np.ones((len(self.deep), 1))
        drawn = [
            _draw(self.points @ turn, rows, self.number),
            _draw(self.deep @ turn, free, self.number),
        ]
        own = scipy.fft.rfft2(np.concatenate(drawn), (self.size, self.size))
        product = (self.values * np.conj(own)).sum(axis=0)
        scores = CELL * scipy.fft.irfft2(product, (self.size, self.size))
        return np.asarray(scores, np.float32)

    def place(self, shift: NDArray[np.int64]) -> _Floats:
        """Return where the centre of the other map is after a shift, in the axes of the one [m]."""
        signed = (shift + self.size // 2) % self.size - self.size // 2
        position: _Floats = self.centre + CELL * signed
        return position


def _search(one: _Side, other: _Side) -> list[_Candidate]:
    """Return the poses whose correlation is a local maximum, the greatest first."""
    from scipy.ndimage import maximum_filter  # slow to import, and few need it

    correlation = _Correlation.of(one, other)
    number = min(max(LEAST_YAWS, math.ceil(math.tau * other.reach() / RIM)), MOST_YAWS)
    yaws = np.arange(number) * (math.tau / number)
    bounds = _most_agreeing(one, other, yaws)
    sectors: dict[int, tuple[Grid, NDArray[np.int32]]] = {}
    top = LEAST_SCORE
    for index in np.argsort(-bounds, kind="stable").tolist():
        # Such a yaw is neither certain nor a rival of the best one.
        if bounds[index] < MOST_RIVAL * top:
            break
        scores = correlation.scores(yaws[index])
        top = max(top, float(scores.max()))
        sector = int(yaws[index] / SECTOR)
        if sector not in sectors:
            sectors[sector] = scores, np.full(scores.shape, index, np.int32)
            continue
        best, which = sectors[sector]
        is_better = scores > best
        best[is_better] = scores[is_better]
        which[is_better] = index
    peaks: list[tuple[float, _Indices, int]] = []
    for best, which in sectors.values():
        is_peak = (best == maximum_filter(best, 3, mode="wrap")) & (best > LEAST_PEAK)
        shifts = np.argwhere(is_peak)
        peaks += zip(best[is_peak].tolist(), shifts, which[is_peak].tolist(), strict=True)
    peaks.sort(key=lambda each: -each[0])
    return [
        _Candidate(correlation.place(shift), float(yaws[index]))
        for _, shift, index in peaks[:NUM_REFINED]
    ]


def _likeness(facing: _Floats, there: _Floats) -> _Floats:
    """Return how much two walls were seen from one side, from 0 to 1; 1 if one was from both."""
    is_any = ~facing.any(axis=1) | ~there.any(axis=1)
    likeness: _Floats = np.where(is_any, 1.0, np.clip((facing * there).sum(axis=1), 0.0, 1.0))
    return likeness


def _refine(one: _Side, other: _Side, start: _Candidate) -> _Candidate:
    """Return the pose near a candidate at which distances from walls are least."""
    centre, yaw = start.centre, start.yaw
    points = other.points - other.centre
    information = np.zeros((3, 3))
    damping = np.diag(1.0 / np.square(STEP_STDS))
    for scale in SCALES:
        turn = _turn(yaw)
        turned = points @ turn
        placed = turned + centre
        is_in, cells = one.cells_at(placed)
        nearest = one.nearest[cells]
        off = placed - one.points[nearest]
        weight = np.where(is_in, np.exp(-0.5 * (off**2).sum(axis=1) / scale**2), 0.0)
        weight *= _likeness(other.facing @ turn, one.facing[nearest])
        normals, flat = one.normals[nearest], one.flat[nearest]
        along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
        swing = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
        information, slope = np.zeros((3, 3)), np.zeros(3)
        # Across walls, and where there is none but a thing, such as a pillar, in all directions.
        for direction, share in ((normals, weight), (along, weight * (1.0 - flat))):
            row = np.column_stack([direction, (direction * swing).sum(axis=1)])
            information += (row * share[:, None]).T @ row
            slope += (share * (direction * off).sum(axis=1)) @ row
        step = np.linalg.solve(information + damping, -slope)
        centre, yaw = centre + step[:2], yaw + float(step[2])
    return _Candidate(centre, yaw, information=SPACING * information)


def _evaluate(one: _Side, other: _Side, pose: _Candidate) -> _Candidate:
    """Return a candidate with its scores."""
    turn = _turn(pose.yaw)

    def lengths(side: _Side, points: _Floats, facing: _Floats) -> tuple[float, float]:
        is_in, cells = side.cells_at(points)
        agreeing = np.where(is_in, np.exp(-0.5 * (side.away[cells] / NEAR) ** 2), 0.0)
        agreeing *= _likeness(facing, side.facing[side.nearest[cells]])
        contradicted = is_in & (side.depth[cells] > DEEP)
        return SPACING * float(agreeing.sum()), SPACING * float(contradicted.sum())

    there = lengths(one, (other.points - other.centre) @ turn + pose.centre, other.facing @ turn)
    back = lengths(other, (one.points - pose.centre) @ turn.T + other.centre, one.facing @ turn.T)
    return pose._replace(agreeing=0.5 * (there[0] + back[0]), contradicted=there[1] + back[1])


def _find_candidates(one: _Side, other: _Side) -> list[_Candidate]:
    """Return the poses at which maps agree, all different, that of the greatest score first."""
    scored = [_evaluate(one, other, _refine(one, other, each)) for each in _search(one, other)]
    kept: list[_Candidate] = []
    for each in sorted(scored, key=lambda each: -each.score):
        if not any(_is_same(each, before) for before in kept):
            kept.append(each)
    return kept


def _is_same(one: _Candidate, other: _Candidate) -> bool:
    away = math.dist(one.centre, other.centre)
    return away <= SAME and abs(math.remainder(one.yaw - other.yaw, math.tau)) <= SAME_YAW


def _overlap(one: _Side, other: _Side, pose: _Candidate) -> float:
    """Return the free area that both maps know [m2]."""
    cells = np.argwhere(other.depth > 0.0)
    placed = ((cells[:, ::-1] + 0.5) * other.cell - other.centre) @ _turn(pose.yaw) + pose.centre
    is_in, there = one.cells_at(placed)
    return float((is_in & (one.depth[there] > 0.0)).sum()) * other.cell**2


def _conclude(one: _Side, other: _Side, best: _Candidate, rival: float) -> MapMatch:
    """Return the match of the best candidate, in the frames of the maps, with what is in doubt."""
    # Where the frame of the other map is seen from its centre, and from there by the one.
    origin = -other.corner[:2] @ _turn(-other.corner[2])
    swing = (origin - other.centre) @ _turn(best.yaw)
    yaw = one.corner[2]
    position = one.corner[:2] + (best.centre + swing) @ _turn(yaw)
    turned = math.remainder(yaw + best.yaw - other.corner[2], math.tau)
    jacobian = np.eye(3)
    jacobian[:2, 2] = -swing[1], swing[0]
    jacobian[:2] = _turn(yaw).T @ jacobian[:2]
    # A direction without walls has the errors of what is no wall.
    information = best.information / (ERROR**2 * ALIKE) + np.diag(np.array([0.01, 0.01, 0.1]))
    local = np.linalg.inv(information) + np.diag(np.square(FLOOR))
    covariance = jacobian @ local @ jacobian.T
    across = float(np.linalg.eigvalsh(best.information[:2, :2])[0])
    overlap = _overlap(one, other, best)
    checks: Sequence[tuple[bool, str]] = (
        (
            best.score >= LEAST_SCORE,
            f"{max(best.score, 0.0):.1f} m of wall agree, and {LEAST_SCORE:g} m are needed",
        ),
        (
            rival <= MOST_RIVAL * best.score,
            f"another pose fits as well: {rival:.1f} m of wall agree there, and {best.score:.1f} m "
            "at the best one",
        ),
        (
            best.contradicted <= MOST_CONTRADICTED * best.agreeing,
            f"{best.contradicted:.1f} m of wall are in free space of the other map",
        ),
        (
            across >= LEAST_ACROSS,
            f"along one direction only {across:.1f} m of wall fix the position, and "
            f"{LEAST_ACROSS:g} m are needed",
        ),
        (
            overlap >= LEAST_OVERLAP,
            f"both maps know only {overlap:.1f} m2 of free space, and {LEAST_OVERLAP:g} m2 are "
            "needed",
        ),
    )
    doubt = next((reason for is_met, reason in checks if not is_met), "")
    return MapMatch(
        np.array([*position, turned]),
        covariance,
        best.score,
        rival,
        best.agreeing,
        best.contradicted,
        across,
        overlap,
        doubt,
    )
