"""Refine all poses of a log together: the lines of neighbouring scans are to lie on each other."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore.geometry.motion import motions_between
from jaxplore.localisation.pose_graph import (
    HUBER,
    MOST_NODES,
    Graph,
    error_of_positions,
    spread_evenly,
)

NEAR, NEIGHBOURS = 12.0, 40
"""Distance within which scans are compared [m], and with how many others each at most."""
MOST_POINTS = 200
"""Number of points of a scan that are compared with another one."""
ALIGNED = 0.9
"""Cosine of the greatest angle between the normals of two points that are compared."""
WIDEST, NARROWEST, NARROWING = (0.6, 0.3), (0.2, 0.1), 0.7
"""Greatest distance of a point from a line, and that at which it counts a quarter: at first, at
the end, and the factor from one step to the next [m]."""
STEPS = 6
"""Number of steps of Gauss-Newton."""
STD, SHARED = 0.04, 100.0
"""Standard deviation of the distances [m], and number of points that count as one: neighbouring
beams meet one wall, and the scans that are compared share its errors."""
_Floats = NDArray[np.float64]


class Lines(NamedTuple):
    """The points of a scan that are on lines, in the frame of the robot.

    Args:
        points: (P, 2) points [m].
        normals: (P, 2) unit vectors across their lines, towards the sensor.
    """

    points: _Floats
    normals: _Floats


class JointPoses(NamedTuple):
    """Result of a refinement.

    Args:
        poses: (N, 3) poses [m, m, rad].
        expected_error: error of the positions that is to be expected, see
            `pose_graph.expected_error` [m].
    """

    poses: _Floats
    expected_error: float


def refine_poses(graph: Graph, lines: Sequence[Lines]) -> JointPoses:
    """Return the poses at which the lines of all scans fit, and the motions and loops of a graph.

    With x_j a point of scan j in the world, and q its nearest point of scan i, with the normal n,
    Gauss-Newton minimises the errors of the graph and

        sum over i, j and points of  w (n . (x_j - q))^2 / (SHARED STD^2),
        w = (1 + d^2 / sigma^2)^-2

    over all poses at once, with nearest points and weights that are found anew in each step. A
    chain of matches, each to a map of those before, adds up small errors. Here each scan is
    compared with those before it and behind it, and the errors spread.

    Source: Lu and Milios, "Globally consistent range scan alignment for environment mapping",
    Autonomous Robots 1997; Ruhnke et al., "Highly accurate maximum likelihood laser mapping by
    jointly optimizing laser points and robot poses", ICRA 2011.

    Args:
        graph: the pose graph; its poses are the first guess. Node 0 stays.
        lines: for each of the N nodes the lines of its scan.
    """
    from scipy.sparse.linalg import splu  # slow to import, and few need it
    from scipy.spatial import KDTree

    poses = graph.poses.astype(float)
    trees = [KDTree(each.points) if len(each.points) else None for each in lines]
    others = [_neighbours(poses, node) for node in range(len(poses))]
    few = [Lines(*(each[:: 1 + len(each) // MOST_POINTS] for each in one)) for one in lines]
    factor: Any = None
    for step in range(STEPS):
        farthest, sigma = (
            max(wide * NARROWING**step, narrow)
            for wide, narrow in zip(WIDEST, NARROWEST, strict=True)
        )
        system = _System(len(poses))
        for node, tree in enumerate(trees):
            if tree is not None:
                _add_lines(
                    system, poses, node, tree, lines[node], others[node], few, farthest, sigma
                )
        _add_graph(system, poses, graph)
        factor = splu(system.matrix())
        poses = poses - factor.solve(system.slope.reshape(-1)).reshape(-1, 3)
    nodes = spread_evenly(len(poses), MOST_NODES)
    rows = (3 * nodes[:, None] + np.arange(2)).reshape(-1)
    unit = np.zeros((3 * len(poses), len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    covariance = factor.solve(unit)[rows]
    return JointPoses(poses, error_of_positions(poses[nodes, :2], covariance))


class _System:
    """The normal equations of the poses: blocks (3, 3) of the matrix, and the slope (N, 3)."""

    def __init__(self, number: int) -> None:
        self.slope = np.zeros((number, 3))
        self._blocks: list[np.ndarray] = []
        self._at: list[np.ndarray] = []

    def add(self, rows: np.ndarray, columns: np.ndarray, blocks: np.ndarray) -> None:
        """Add blocks (K, 3, 3) for pairs of poses."""
        self._at.append(np.stack([rows, columns]))
        self._blocks.append(blocks)

    def matrix(self) -> Any:
        """Return the sparse matrix; the first pose is held, and all of them a little."""
        from scipy.sparse import csc_matrix, diags

        rows, columns = np.concatenate(self._at, axis=1)
        blocks = np.concatenate(self._blocks)
        down = np.broadcast_to(3 * rows[:, None, None] + np.arange(3)[:, None], blocks.shape)
        across = np.broadcast_to(3 * columns[:, None, None] + np.arange(3), blocks.shape)
        size = self.slope.size
        held = np.full(size, 1e-6)
        held[:3] = 1e9
        places = (down.reshape(-1), across.reshape(-1))
        return csc_matrix((blocks.reshape(-1), places), shape=(size, size)) + diags(held).tocsc()


def _neighbours(poses: _Floats, node: int) -> NDArray[np.int64]:
    """Return the nodes near one, evenly spread over those that are."""
    near = np.flatnonzero(np.hypot(*(poses[:, :2] - poses[node, :2]).T) <= NEAR)
    near = near[near != node]
    chosen: NDArray[np.int64] = near[spread_evenly(len(near), NEIGHBOURS)]
    return chosen


def _turn(points: _Floats, yaw: Any) -> _Floats:
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = points[:, 0], points[:, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def _add_lines(
    system: _System,
    poses: _Floats,
    node: int,
    tree: Any,
    own: Lines,
    others: NDArray[np.int64],
    few: Sequence[Lines],
    farthest: float,
    sigma: float,
) -> None:
    """Add the points of other scans that are near the lines of one."""
    counts = np.array([len(few[each].points) for each in others], dtype=int)
    if not counts.sum():
        return
    which = np.repeat(np.arange(len(others)), counts)
    of = others[which]
    arms = _turn(np.concatenate([few[each].points for each in others]), poses[of, 2])
    normals = _turn(np.concatenate([few[each].normals for each in others]), poses[of, 2])
    points = arms + poses[of, :2]
    # The tree holds the lines of the scan in its own frame, so it is built once and poses may
    # change.
    away, nearest = tree.query(_turn(points - poses[node, :2], -poses[node, 2]))
    across = _turn(own.normals[nearest], poses[node, 2])
    feet = _turn(own.points[nearest], poses[node, 2])
    arms_of_node = points - poses[node, :2]
    error = ((arms_of_node - feet) * across).sum(axis=1)
    is_used = (away < 1.0) & (np.abs(error) < farthest)
    # The two sides of a thin wall are near each other and face away: they are not one line.
    is_used &= (across * normals).sum(axis=1) > ALIGNED
    # Weights of Geman and McClure: a pair that is far off pulls little, where a square would pull
    # most.
    weight = (1.0 + (error / sigma) ** 2) ** -2 / (SHARED * STD**2)
    which, error, weight = which[is_used], error[is_used], weight[is_used]
    if not len(which):
        return
    across, arms, arms_of_node = across[is_used], arms[is_used], arms_of_node[is_used]
    ahead = _rows(across, arms)
    behind = -_rows(across, arms_of_node)
    # The points are in the order of their scans, so a scan's block of the matrix is one sum over a
    # run of rows.
    first = np.flatnonzero(np.diff(which, prepend=-1))
    at = others[which[first]]
    here = np.full(len(at), node)
    weighted = weight[:, None] * ahead
    system.add(at, at, _sum(weighted, ahead, first))
    cross = _sum(weighted, behind, first)
    system.add(at, here, cross)
    system.add(here, at, cross.transpose(0, 2, 1))
    back = weight[:, None] * behind
    system.add(here[:1], here[:1], (back.T @ behind)[None])
    system.slope[at] += np.add.reduceat(weighted * error[:, None], first)
    system.slope[node] += back.T @ error


def _rows(across: _Floats, arms: _Floats) -> _Floats:
    """Return the derivatives (N, 3) of distances along normals by a pose."""
    by_yaw = across[:, 1] * arms[:, 0] - across[:, 0] * arms[:, 1]
    return np.concatenate([across, by_yaw[:, None]], axis=1)


def _sum(one: _Floats, other: _Floats, first: np.ndarray) -> _Floats:
    """Return the sums of outer products (K, 3, 3) of rows, from each of the first ones on."""
    sums: _Floats = np.add.reduceat(one[:, :, None] * other[:, None], first)
    return sums


def _add_graph(system: _System, poses: _Floats, graph: Graph) -> None:
    """Add the motions and the closed loops of a graph, these with the loss of Huber."""
    number = len(poses)
    pairs = np.concatenate(
        [np.stack([np.arange(number - 1), np.arange(1, number)], axis=1), graph.pairs]
    ).astype(int)
    wanted = np.concatenate([graph.motions, graph.loops]).astype(float)
    covariances = np.concatenate([graph.motion_covariances, graph.loop_covariances])
    one, other = poses[pairs[:, 0]], poses[pairs[:, 1]]
    error = motions_between(one, other) - wanted
    error[:, 2] -= math.tau * np.round(error[:, 2] / math.tau)
    information = np.linalg.inv(covariances.astype(float))
    size = np.sqrt(np.einsum("ki,kij,kj->k", error, information, error))
    share = np.minimum(1.0, HUBER / np.maximum(size, 1e-9))
    share[: number - 1] = 1.0
    information *= share[:, None, None]
    apart = other[:, :2] - one[:, :2]
    cos, sin = np.cos(one[:, 2]), np.sin(one[:, 2])
    ahead, behind = np.zeros((2, len(pairs), 3, 3))
    ahead[:, 0, 0], ahead[:, 0, 1], ahead[:, 1, 0], ahead[:, 1, 1] = cos, sin, -sin, cos
    ahead[:, 2, 2] = 1.0
    behind -= ahead
    behind[:, 0, 2] = cos * apart[:, 1] - sin * apart[:, 0]
    behind[:, 1, 2] = -cos * apart[:, 0] - sin * apart[:, 1]
    for i, left in enumerate((behind, ahead)):
        weighted = left.transpose(0, 2, 1) @ information
        for j, right in enumerate((behind, ahead)):
            system.add(pairs[:, i], pairs[:, j], weighted @ right)
        np.add.at(system.slope, pairs[:, i], np.einsum("kij,kj->ki", weighted, error))
