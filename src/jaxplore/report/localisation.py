"""Measures of localisation and mapping: errors of a trajectory, and of a map made along it.

They compare with the truth, which a robot does not know. All is NumPy in double precision.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Rows
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid

DOUBLED_WITHIN = 0.5
"""Greatest distance of a wall that is drawn twice from its true place [m]."""
_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]
_Cells = NDArray[np.int64]


class Alignment(NamedTuple):
    """A rigid motion of the plane, `R(yaw) (x, y) + translation`.

    Args:
        yaw: angle of the rotation [rad].
        translation: translation (2,) [m].
    """

    yaw: float
    translation: _Floats

    @property
    def rotation(self) -> _Floats:
        """Rotation matrix (2, 2)."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[cos, -sin], [sin, cos]])

    def apply(self, points: ArrayLike) -> _Floats:
        """Return points (N, 2) after the motion [m]."""
        moved: _Floats = np.asarray(points, np.float64) @ self.rotation.T + self.translation
        return moved

    def inverse(self) -> "Alignment":
        """Return the motion that undoes this one."""
        return Alignment(-self.yaw, -(self.translation @ self.rotation))


SAME_FRAME = Alignment(0.0, np.zeros(2))
"""Alignment of poses that are in the frame of the true ones."""


class AbsoluteError(NamedTuple):
    """Error of a whole trajectory after its alignment.

    Args:
        rms: root mean square of the distances of the positions [m].
        median: median of these distances [m].
        greatest: greatest of these distances [m].
        rms_yaw: root mean square of the errors of the yaw [rad].
    """

    rms: float
    median: float
    greatest: float
    rms_yaw: float


class RelativeError(NamedTuple):
    """Drift of a trajectory over pieces of one length.

    Args:
        translation: root mean square of the errors of the position at the end of a piece [m].
        yaw: root mean square of the errors of the yaw there [rad].
        number: number of pieces.
    """

    translation: float
    yaw: float
    number: int


class MapAgreement(NamedTuple):
    """How well the walls of two maps agree.

    Args:
        iou: intersection over union of the occupied cells, to within one cell, in [0, 1].
        double_walls: share of the occupied cells of the belief that draw a wall a second time.
        num_reference: number of occupied cells of the reference.
        num_belief: number of occupied cells of the belief after its alignment.
    """

    iou: float
    double_walls: float
    num_reference: int
    num_belief: int


def align(true: Rows, estimated: Rows) -> Alignment:
    """Return the rigid motion that brings estimated positions closest to the true ones.

    It minimises `sum |p_i - (R q_i + t)|^2` over rotations and translations, without a scale. With
    p and q relative to their means, in the plane

        yaw = atan2(sum q x p, sum q . p),   t = mean p - R mean q

    Positions that all coincide have no rotation: the yaw is 0 then. Of poses only x and y count.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", 1991; Horn, "Closed-form solution of absolute orientation", 1987.

    Args:
        true: true positions (N, 2) or poses (N, 3) [m].
        estimated: estimated ones at the same times.

    Raises:
        ValueError: no positions, another shape, other numbers of them, numbers that are not finite.
    """
    p, q = _pair(true, estimated, (2, 3))
    p, q = p[:, :2], q[:, :2]
    from_p, from_q = p - p.mean(axis=0), q - q.mean(axis=0)
    across = float((from_q[:, 0] * from_p[:, 1] - from_q[:, 1] * from_p[:, 0]).sum())
    along = float((from_q * from_p).sum())
    motion = Alignment(math.atan2(across, along), np.zeros(2))
    return motion._replace(translation=p.mean(axis=0) - motion.apply(q.mean(axis=0)))


@_kinds.check_arguments
def absolute_error(
    true: Rows, estimated: Rows, alignment: Alignment | None = None
) -> AbsoluteError:
    """Return the absolute trajectory error (ATE): of poses after an alignment.

    Yaws are compared modulo 2 pi. The alignment is by positions alone, so the yaw of a robot that
    stood still has any error.

    Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012, section IV.

    Args:
        true: true poses (N, 3) as (x, y, yaw) [m, m, rad].
        estimated: estimated poses (N, 3) at the same times.
        alignment: motion from the frame of the estimated poses to that of the true ones, such as
            `SAME_FRAME`; that of `align` when absent.

    Raises:
        ValueError: as of `align`.
    """
    p, q = _pair(true, estimated, (3,))
    motion = align(p, q) if alignment is None else alignment
    distance = np.hypot(*(motion.apply(q[:, :2]) - p[:, :2]).T)
    turn = _wrap_angle(q[:, 2] + motion.yaw - p[:, 2])
    return AbsoluteError(
        _rms(distance), float(np.median(distance)), float(distance.max()), _rms(turn)
    )


def relative_error(true: Rows, estimated: Rows, length: float) -> RelativeError | None:
    """Return the relative pose error (RPE) over pieces of a travelled length; None without any.

    A piece begins at each pose i and ends at the first pose j that the true robot reached after
    the length. With the true motion between them and the estimated one as transforms, the error is

        E = (T_i^-1 T_j)^-1 (S_i^-1 S_j)

    No alignment is needed. An error in one place counts only in the pieces that hold it.

    Source: Sturm et al., 2012, equation 1, for pieces by time; Geiger, Lenz and Urtasun, "Are we
    ready for autonomous driving?", 2012, for pieces by length, there divided by it.

    Args:
        true: true poses T (N, 3) as (x, y, yaw) [m, m, rad].
        estimated: estimated poses S (N, 3) at the same times.
        length: travelled length of a piece [m].

    Raises:
        ValueError: a length that is not positive, and as of `align`.
    """
    length = _checks.number("length", length, above=0.0)
    p, q = _pair(true, estimated, (3,))
    steps = np.hypot(*np.diff(p[:, :2], axis=0).T)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    # Sums of many steps round: a piece of just the length is not one pose longer for that.
    slack = 1e-9 * max(1.0, float(travelled[-1]))
    end = np.searchsorted(travelled, travelled + length - slack)
    start = np.flatnonzero(end < len(p))
    if start.size == 0:
        return None
    wanted, found = (_between(each[start], each[end[start]]) for each in (p, q))
    # The rotation of a transform does not change the length of its translation.
    distance = np.hypot(*(found[:, :2] - wanted[:, :2]).T)
    turn = _wrap_angle(found[:, 2] - wanted[:, 2])
    return RelativeError(_rms(distance), _rms(turn), int(start.size))


def map_agreement(
    reference: OccupancyGrid,
    belief: OccupancyGrid,
    alignment: Alignment | None = None,
    *,
    doubled_within: float = DOUBLED_WITHIN,
) -> MapAgreement:
    """Compare the occupied cells of a belief with those of a reference map.

    The reference is a map that was made from the same scans at their true poses. The occupied cells
    of the belief are moved by the alignment first: each to the cell that its centre gets into. A
    cell is matched if the other map has an occupied cell there or in one of the 8 cells around.
    With m matched and u unmatched cells of each map,

        IoU = m / (m + u_reference + u_belief),   m = (m_reference + m_belief) / 2

    It is symmetric. With cells matched only in place it would be the usual intersection over union.
    Two maps without occupied cells agree: the IoU is 1.

    A cell of the belief draws a wall a second time if it is not matched, and within
    `doubled_within` of it, from centre to centre, there is a matched cell of the reference: that
    wall is in the belief already. Without occupied cells of the belief the share is 0.

    Args:
        reference: reference map.
        belief: map of the robot, with cells of the same size.
        alignment: motion from the frame of the estimated poses to that of the true ones, of
            `align`; none when absent.
        doubled_within: greatest distance of a wall that is drawn twice from its true place [m].

    Raises:
        ValueError: maps with cells of two sizes, an alignment that is not finite, a distance that
            is not positive.
    """
    _check_maps("reference", reference, belief, alignment)
    reach = _checks.number("doubled_within", doubled_within, above=0.0) / reference.resolution
    walls = reference.crop(reference.probability) > OCCUPIED_THRESHOLD
    cells = np.argwhere(belief.crop(belief.probability) > OCCUPIED_THRESHOLD)
    points = _centres(cells, belief)
    if alignment is not None:
        points = alignment.apply(points)
    # Two cells may get into one.
    moved = np.unique(_cells(points, reference), axis=0)
    # Cells just beside the reference map can match those at its edge.
    walls = np.pad(walls, 1)
    rows, columns = (moved + 1).T
    is_in = (rows >= 0) & (rows < walls.shape[0]) & (columns >= 0) & (columns < walls.shape[1])
    rows, columns = rows[is_in], columns[is_in]
    drawn = np.zeros_like(walls)
    drawn[rows, columns] = True
    found = np.argwhere(walls & _dilate(drawn)) - 1
    is_matched = np.zeros(len(moved), bool)
    is_matched[is_in] = _dilate(walls)[rows, columns]
    num_walls, num_drawn = int(walls.sum()), len(moved)
    total = num_walls + num_drawn
    both = len(found) + int(is_matched.sum())
    matched, unmatched = both / 2, total - both
    doubled = _are_near(moved[~is_matched], found, reach)
    return MapAgreement(
        iou=matched / (matched + unmatched) if total else 1.0,
        double_walls=doubled / num_drawn if num_drawn else 0.0,
        num_reference=num_walls,
        num_belief=num_drawn,
    )


def aligned_coverage(
    world: OccupancyGrid,
    reachable: ArrayLike,
    belief: OccupancyGrid,
    alignment: Alignment | None = None,
) -> float:
    """Return the share of the reachable cells that the aligned belief knows to be free.

    The centre of each reachable cell of the true map is looked up in the belief, moved back by the
    alignment. Off the belief's map nothing is free.

    Args:
        world: true map, whose probabilities are not read.
        reachable: mask (H, W) of its cells that the robot can reach.
        belief: map of the robot, with cells of the same size.
        alignment: motion from the frame of the estimated poses to that of the true ones, of
            `align`; none when absent.

    Raises:
        ValueError: maps with cells of two sizes, a mask of another shape than the world or without
            a cell, an alignment that is not finite.
    """
    _check_maps("world", world, belief, alignment)
    mask = np.asarray(reachable)
    if mask.dtype != np.bool_ or mask.shape != world.shape:
        raise ValueError(
            f"reachable is {_kinds.describe(reachable)} of {mask.dtype}; accepted: a mask "
            f"{world.shape}, as the world"
        )
    cells = np.argwhere(world.crop(mask))
    if len(cells) == 0:
        raise ValueError("reachable has no cell; accepted: at least one")
    points = _centres(cells, world)
    if alignment is not None:
        points = alignment.inverse().apply(points)
    free = belief.crop(belief.probability) < FREE_THRESHOLD
    rows, columns = _cells(points, belief).T
    is_in = (rows >= 0) & (rows < free.shape[0]) & (columns >= 0) & (columns < free.shape[1])
    return float(free[rows[is_in], columns[is_in]].sum()) / len(cells)


def _pair(true: Rows, estimated: Rows, widths: tuple[int, ...]) -> tuple[_Floats, _Floats]:
    """Return two checked trajectories of one shape, in double precision."""
    names = {2: "(N, 2)", 3: "(N, 3)"}
    accepted = f"finite numbers {' or '.join(names[width] for width in widths)}"
    made = []
    for name, value in (("true", true), ("estimated", estimated)):
        try:
            array = np.asarray(value)
            if array.dtype.kind not in "iuf":
                raise TypeError
            array = array.astype(np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"{name} is {_kinds.describe(value)}; accepted: {accepted}") from None
        if array.ndim != 2 or array.shape[1] not in widths or len(array) == 0:
            raise ValueError(f"{name} has shape {array.shape}; accepted: {accepted}, N >= 1")
        if not np.isfinite(array).all():
            bad = array[~np.isfinite(array)][0]
            raise ValueError(f"{name} has a value {bad}; accepted: {accepted}")
        made.append(array)
    if made[0].shape != made[1].shape:
        raise ValueError(
            f"estimated has shape {made[1].shape}; accepted: that of true, {made[0].shape}"
        )
    return made[0], made[1]


@_kinds.check_arguments
def _check_maps(
    name: str, first: OccupancyGrid, belief: OccupancyGrid, alignment: Alignment | None
) -> None:
    _kinds.instance(name, first, OccupancyGrid)
    if belief.resolution != first.resolution:
        raise ValueError(
            f"belief has cells of {belief.resolution:g} m; accepted: {first.resolution:g} m, as "
            f"{name}"
        )
    if alignment is not None and not np.isfinite([alignment.yaw, *alignment.translation]).all():
        raise ValueError(f"alignment is {alignment}; accepted: finite numbers")


def _wrap_angle(angle: _Floats) -> _Floats:
    wrapped: _Floats = angle - math.tau * np.round(angle / math.tau)
    return wrapped


def _rms(values: _Floats) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _between(first: _Floats, second: _Floats) -> _Floats:
    """Return the motions (N, 3) from poses to other ones, in the frames of the first."""
    cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
    dx, dy, turn = (second - first).T
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def _dilate(mask: _Mask) -> _Mask:
    """Return the cells of a mask and the 8 cells around each."""
    from scipy.ndimage import binary_dilation

    grown: _Mask = binary_dilation(mask, np.ones((3, 3), bool))
    return grown


def _are_near(cells: _Cells, others: _Cells, reach: float) -> int:
    """Return how many cells are within a distance of one of others, between centres [cells]."""
    from scipy.spatial import KDTree

    if len(cells) == 0 or len(others) == 0:
        return 0
    distance, _ = KDTree(others).query(cells)
    # A distance of just the reach counts: 0.5 / 0.1 may round to less than 5.
    return int(np.count_nonzero(distance <= reach * (1.0 + 1e-9)))


def _centres(cells: _Cells, grid: OccupancyGrid) -> _Floats:
    origin = np.asarray(grid.frame.origin, np.float64)
    frame = Alignment(float(origin[2]), origin[:2])
    return frame.apply((cells[:, ::-1] + 0.5) * grid.resolution)


def _cells(points: _Floats, grid: OccupancyGrid) -> _Cells:
    """Return the cells (N, 2) as (row, column) that contain points; they may be off the map."""
    origin = np.asarray(grid.frame.origin, np.float64)
    frame = Alignment(float(origin[2]), origin[:2])
    at = frame.inverse().apply(points) / grid.resolution
    # A point so far away that its cell has no whole number is off the map in any case.
    cells: _Cells = np.floor(np.clip(at, -1e15, 1e15)[:, ::-1]).astype(np.int64)
    return cells
