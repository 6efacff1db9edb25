"""Optimise a pose graph: the most likely poses of scans, given motions and closed loops."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore import _kinds
from jaxplore._optional import import_optional

HUBER = 1.345
"""Residual of a closed loop in standard deviations beyond which its influence no longer grows."""

MOST_NODES = 40
"""Greatest number of nodes whose joint covariance is computed, evenly spread over the way."""


class Graph(NamedTuple):
    """A pose graph. Node 0 is fixed.

    Args:
        poses: (N, 3) poses (x, y, yaw) to start from [m, m, rad].
        motions: (N - 1, 3) measured motion from each node to the next, in the frame of the first.
        motion_covariances: (N - 1, 3, 3) their covariances, in the frame of the first.
        pairs: (C, 2) indices of the nodes of the closed loops.
        loops: (C, 3) measured motion from the first node of a pair to the second.
        loop_covariances: (C, 3, 3) their covariances, in the frame of the first.
    """

    poses: np.ndarray
    motions: np.ndarray
    motion_covariances: np.ndarray
    pairs: np.ndarray
    loops: np.ndarray
    loop_covariances: np.ndarray


class Optimum(NamedTuple):
    """Optimum of a pose graph.

    Args:
        poses: (N, 3) poses of the nodes.
        covariance: (3, 3) covariance of the last node, in the world.
        error: half the sum of the squared errors in standard deviations.
    """

    poses: np.ndarray
    covariance: np.ndarray
    error: float


@_kinds.check_arguments
def optimise(graph: Graph) -> Optimum:
    """Return the poses that minimise the squared errors of all motions and closed loops.

        sum over motions of |e|^2 + sum over loops of huber(|e|),
        e = Sigma^(-1/2) Log(measured^(-1) between(pose_i, pose_j)),
        Log(x, y, theta) = (V^(-1) (x, y), theta),
        V = [[sin(theta), cos(theta) - 1], [1 - cos(theta), sin(theta)]] / theta

    The logarithm of SE(2) is taken in the frame of the measured end, to which the covariances are
    turned. For small errors it is their difference; for a closed loop that is wrong by a radian it
    is not. The Huber loss bounds the influence of a closed loop that is wrong. The minimum is that
    of GTSAM by Levenberg and Marquardt's method.

    Source: Lu and Milios, "Globally consistent range scan alignment for environment mapping",
    Autonomous Robots 1997; Dellaert and Kaess, "Factor graphs for robot perception", 2017.

    Args:
        graph: the graph.

    Raises:
        ValueError: something else than a graph; GTSAM is not installed.
    """
    library: Any = import_optional("gtsam", "slam")
    factors, start = _problem(library, graph, library.noiseModel.Constrained.All(3))
    found = library.LevenbergMarquardtOptimizer(factors, start).optimize()
    poses = np.array([_numbers(found.atPose2(node)) for node in range(len(graph.poses))])
    # The library returns yaws within a turn. Those of the robot count its turns.
    change = poses[:, 2] - graph.poses[:, 2]
    poses[:, 2] -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
    covariance = np.zeros((3, 3))
    if len(poses) > 1:
        local = library.Marginals(factors, found).marginalCovariance(len(poses) - 1)
        turn = _rotation(poses[-1, 2])
        covariance = turn @ local @ turn.T
    return Optimum(poses, covariance, float(factors.error(found)))


@_kinds.check_arguments
def motion_covariances(graph: Graph, nodes: Sequence[int], end: int) -> np.ndarray:
    """Return how exactly the motions b from some nodes to another one are known, (M, 3, 3).

    They are in the frames of the nodes j that the motions begin at, by the joint covariance with
    the node n where they end (`end`), at the poses of the graph:

        Sigma = R_b (J Cov(j, n) J') R_b',  J = [-Ad(b^-1), 1].

    Source: Kaess and Dellaert, "Covariance recovery from a square root information matrix for data
    association", Robotics and Autonomous Systems 2009.

    Raises:
        ValueError: something else than a graph, an index that is not one of another node; GTSAM is
            not installed.
    """
    number = len(graph.poses)
    if not 0 <= end < number:
        raise ValueError(f"end is {end}; accepted: from 0 to {number - 1}")
    if not all(0 <= node < number and node != end for node in nodes):
        raise ValueError(f"nodes is {nodes}; accepted: from 0 to {number - 1} but {end}")
    if not nodes:
        return np.zeros((0, 3, 3))
    library: Any = import_optional("gtsam", "slam")
    # How exactly the first pose is known does not matter to motions; known as good as exactly, the
    # joint covariance would be that of a singular matrix.
    factors, values = _problem(library, graph, library.noiseModel.Isotropic.Sigma(3, 0.01))
    joint = library.Marginals(factors, values).jointMarginalCovariance(
        [*dict.fromkeys((*nodes, end))]
    )
    last, of_end = values.atPose2(end), joint.at(end, end)
    covariances = []
    for node in nodes:
        motion = values.atPose2(node).between(last)
        adjoint = motion.inverse().AdjointMap()
        across = adjoint @ joint.at(node, end)
        covariance = adjoint @ joint.at(node, node) @ adjoint.T - across - across.T + of_end
        turn = _rotation(motion.theta())
        covariances.append(turn @ covariance @ turn.T)
    return np.array(covariances)


@_kinds.check_arguments
def expected_error(graph: Graph) -> float:
    """Return the error of the positions that is to be expected after a rigid alignment [m].

    It is the root mean square over the nodes, at most `MOST_NODES` of them, by the joint covariance
    S of their positions at the poses of the graph:

        sqrt(trace((1 - P) S) / M),   P = A (A' A)^-1 A'

    The columns of A are the displacements of all M positions by a translation and by a turn.
    Without GTSAM, and for something else than a graph, it raises a `ValueError`.
    """
    nodes = spread_evenly(len(graph.poses), MOST_NODES)
    if len(nodes) < 2:
        return 0.0
    library: Any = import_optional("gtsam", "slam")
    factors, values = _problem(library, graph, library.noiseModel.Isotropic.Sigma(3, 0.01))
    joint = library.Marginals(factors, values).jointMarginalCovariance(nodes.tolist())
    turns = [_rotation(float(graph.poses[node, 2]))[:2, :2] for node in nodes]
    covariance = np.block(
        [
            [one @ joint.at(i, j)[:2, :2] @ other.T for j, other in zip(nodes, turns, strict=True)]
            for i, one in zip(nodes, turns, strict=True)
        ]
    )
    return error_of_positions(graph.poses[nodes, :2], covariance)


def spread_evenly(number: int, most: int) -> NDArray[np.int64]:
    """Return at most so many of the indices from 0 to `number - 1`, evenly spread."""
    return np.unique(np.linspace(0, number - 1, min(number, most)).round().astype(np.int64))


def error_of_positions(positions: np.ndarray, covariance: np.ndarray) -> float:
    """Return the error of positions (M, 2) after an alignment, by their covariance (2 M, 2 M)."""
    x, y = (positions - positions.mean(axis=0)).T
    moves = np.zeros((2 * len(positions), 3))
    moves[::2, 0], moves[1::2, 1] = 1.0, 1.0
    moves[::2, 2], moves[1::2, 2] = -y, x
    rigid = moves @ np.linalg.pinv(moves)
    return float(np.sqrt(max(np.trace(covariance - rigid @ covariance), 0.0) / len(positions)))


def _problem(library: Any, graph: Graph, noise_of_first: Any) -> tuple[Any, Any]:
    """Return the factors of a graph and its poses, as the library has them."""
    factors, start = library.NonlinearFactorGraph(), library.Values()
    for node, pose in enumerate(graph.poses.astype(float)):
        start.insert(node, library.Pose2(*pose))
    first = library.Pose2(*graph.poses[0].astype(float))
    factors.add(library.PriorFactorPose2(0, first, noise_of_first))
    for node, (motion, covariance) in enumerate(
        zip(graph.motions, graph.motion_covariances, strict=True)
    ):
        noise = _noise(library, motion, covariance)
        factors.add(_factor(library, node, node + 1, motion, noise))
    for (i, j), motion, covariance in zip(
        graph.pairs.tolist(), graph.loops, graph.loop_covariances, strict=True
    ):
        huber = library.noiseModel.mEstimator.Huber.Create(HUBER)
        noise = library.noiseModel.Robust.Create(huber, _noise(library, motion, covariance))
        factors.add(_factor(library, i, j, motion, noise))
    return factors, start


def _rotation(yaw: float) -> np.ndarray:
    turn = np.eye(3)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    return turn


def _noise(library: Any, motion: np.ndarray, covariance: np.ndarray) -> Any:
    # GTSAM has the error of a motion in the frame of its end.
    back = _rotation(-float(motion[2]))
    return library.noiseModel.Gaussian.Covariance(back @ covariance.astype(float) @ back.T)


def _factor(library: Any, i: int, j: int, motion: np.ndarray, noise: Any) -> Any:
    return library.BetweenFactorPose2(i, j, library.Pose2(*motion.astype(float)), noise)


def _numbers(pose: Any) -> tuple[float, float, float]:
    return pose.x(), pose.y(), pose.theta()
