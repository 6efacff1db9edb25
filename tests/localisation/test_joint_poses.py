"""Poses that are refined together: against the cost itself, and in a room with known walls."""

import itertools
import math

import numpy as np
import pytest

from jaxplore.localisation import Graph, joint_poses
from jaxplore.localisation.joint_poses import Lines, refine_poses
from jaxplore.localisation.pose_graph import error_of_positions

RANDOM = np.random.default_rng(3)


def between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the motion from one pose to another, written without NumPy's broadcasting."""
    cos, sin = math.cos(one[2]), math.sin(one[2])
    dx, dy = other[:2] - one[:2]
    return np.array([cos * dx + sin * dy, cos * dy - sin * dx, other[2] - one[2]])


def walls() -> tuple[np.ndarray, np.ndarray]:
    """Return points 0.1 m apart on the walls of a room of 9 m x 7 m with a slanted one, and the
    normals, which point inside."""
    corners = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 5.0], [6.0, 7.0], [0.0, 7.0]])
    points, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        away = np.arange(0.05, np.linalg.norm(end - start), 0.1)
        points.append(start + away[:, None] * along)
        normals.append(np.tile([-along[1], along[0]], (len(away), 1)))
    return np.concatenate(points), np.concatenate(normals)


def seen_from(pose: np.ndarray, noise: float) -> Lines:
    points, normals = walls()
    points = points + noise * RANDOM.standard_normal((len(points), 1)) * normals
    # Each scan sees other points of the walls.
    kept = RANDOM.random(len(points)) < 0.5
    turn = np.array(
        [[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]]
    )
    return Lines(((points - pose[:2]) @ turn)[kept], (normals @ turn)[kept])


def graph_of(true: np.ndarray, error: tuple[float, ...]) -> Graph:
    """Return a graph whose motions have errors, with a closed loop that is exact."""
    number = len(true)
    motions = np.array([between(a, b) for a, b in itertools.pairwise(true)])
    motions += np.array(error) * RANDOM.standard_normal(motions.shape)
    poses = [true[0]]
    for dx, dy, turn in motions:
        x, y, yaw = poses[-1]
        cos, sin = math.cos(yaw), math.sin(yaw)
        poses.append(np.array([x + cos * dx - sin * dy, y + sin * dx + cos * dy, yaw + turn]))
    covariance = np.diag(np.array(error) ** 2 + 1e-8)
    return Graph(
        np.array(poses),
        motions,
        np.tile(covariance, (number - 1, 1, 1)),
        np.array([[0, number - 1]]),
        between(true[0], true[-1])[None],
        np.tile(np.diag([0.05, 0.05, 0.02]) ** 2, (1, 1, 1)),
    )


TURNS = np.linspace(0.0, 1.5 * math.pi, 10)
TRUE = np.stack([4.0 + 2.0 * np.cos(TURNS), 3.5 + 1.5 * np.sin(TURNS), TURNS + 0.4], axis=1)


def test_poses_with_drift_come_back_to_the_walls() -> None:
    graph = graph_of(TRUE, (0.06, 0.06, 0.03))
    lines = [seen_from(pose, 0.01) for pose in TRUE]
    found = refine_poses(graph, lines)
    before, after = (np.abs(each - TRUE).max(axis=0) for each in (graph.poses, found.poses))
    assert before[:2].max() > 0.1
    assert after[:2].max() < 0.02
    assert after[2] < 0.005
    np.testing.assert_allclose(found.poses[0], TRUE[0], atol=1e-6)
    assert found.expected_error < 0.1


def test_without_lines_the_poses_are_those_of_the_graph() -> None:
    """Against a general minimiser of the errors, with the loss of Huber for the loop."""
    from scipy.optimize import minimize

    graph = graph_of(TRUE, (0.02, 0.02, 0.02))
    nothing = [Lines(np.zeros((0, 2)), np.zeros((0, 2)))] * len(TRUE)
    found = refine_poses(graph, nothing)

    def cost(flat: np.ndarray) -> float:
        poses = np.concatenate([TRUE[:1], flat.reshape(-1, 3)])
        total = 0.0
        for at, (motion, covariance) in enumerate(
            zip(graph.motions, graph.motion_covariances, strict=True)
        ):
            error = between(poses[at], poses[at + 1]) - motion
            total += 0.5 * error @ np.linalg.solve(covariance, error)
        error = between(poses[0], poses[-1]) - graph.loops[0]
        size = math.sqrt(error @ np.linalg.solve(graph.loop_covariances[0], error))
        huber = joint_poses.HUBER
        return total + (0.5 * size**2 if size <= huber else huber * (size - 0.5 * huber))

    best = minimize(cost, graph.poses[1:].reshape(-1), method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(found.poses[1:], best.x.reshape(-1, 3), atol=1e-3)


def test_a_wall_is_not_matched_to_its_other_side() -> None:
    """A thin wall between two rooms: its sides are 0.1 m apart and stay so."""
    x = np.arange(0.0, 6.0, 0.1)
    side, back = np.stack([x, np.full_like(x, 1.0)], 1), np.stack([x, np.full_like(x, -0.9)], 1)
    down = np.tile([0.0, -1.0], (len(x), 1))
    # From (0, 0) the wall is at y = 1, from (0, 2) its other side at y = 1.1.
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    graph = Graph(
        poses,
        np.array([[0.0, 2.0, 0.0]]),
        np.tile(np.diag([0.3, 0.3, 0.1]) ** 2, (1, 1, 1)),
        np.zeros((0, 2), int),
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
    )
    found = refine_poses(graph, [Lines(side, down), Lines(back, -down)])
    np.testing.assert_allclose(found.poses, poses, atol=1e-9)
    same = refine_poses(graph, [Lines(side, down), Lines(back, down)])
    # Against the prior of 0.3 m the points outweigh all but a little.
    assert same.poses[1, 1] == pytest.approx(1.9, abs=0.02)


def test_the_error_of_positions_is_that_of_many_draws() -> None:
    positions = RANDOM.uniform(-5.0, 5.0, (6, 2))
    root = 0.05 * RANDOM.standard_normal((12, 12))
    expected = error_of_positions(positions, root @ root.T)
    squares = []
    for _ in range(4000):
        moved = positions + (root @ RANDOM.standard_normal(12)).reshape(-1, 2)
        one, other = positions - positions.mean(axis=0), moved - moved.mean(axis=0)
        left, _, right = np.linalg.svd(other.T @ one)
        squares.append(((other @ left @ right - one) ** 2).sum(axis=1).mean())
    assert expected == pytest.approx(math.sqrt(np.mean(squares)), rel=0.05)
