"""Pose graphs: optima that are known in closed form, and a general minimiser."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxplore.geometry.motion import compose, propagate_covariance
from jaxplore.localisation import Graph, optimise
from jaxplore.localisation.pose_graph import HUBER, expected_error, motion_covariances

pytest.importorskip("gtsam")
NOTHING = (np.zeros((0, 2), int), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def between_by_hand(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, turn = other - pose
    return np.array([cos * dx + sin * dy, cos * dy - sin * dx, math.remainder(turn, math.tau)])


def compose_by_hand(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    moved = [cos * motion[0] - sin * motion[1], sin * motion[0] + cos * motion[1], motion[2]]
    return pose + np.array(moved)


def chain(motions: np.ndarray) -> np.ndarray:
    poses = [np.zeros(3)]
    for motion in motions:
        poses.append(compose_by_hand(poses[-1], motion))
    return np.array(poses)


def test_the_error_of_a_loop_is_spread_along_the_chain() -> None:
    """Ten steps straight on, a sure heading, and a loop that says they are 0.2 m to the side and
    0.1 m further: each of the eleven measurements takes its share."""
    motions = np.tile([1.0, 0.0, 0.0], (10, 1))
    covariance = np.diag([0.04, 0.04, 1e-10])
    graph = Graph(
        chain(motions),
        motions,
        np.tile(covariance, (10, 1, 1)),
        np.array([[0, 10]]),
        np.array([[10.1, 0.2, 0.0]]),
        covariance[None],
    )
    found = optimise(graph)
    share = np.arange(11) / 11.0
    expected = np.stack([np.arange(11) + 0.1 * share, 0.2 * share, np.zeros(11)], axis=1)
    np.testing.assert_allclose(found.poses, expected, atol=1e-5)
    # The residual of each is an eleventh, in standard deviations of 0.2 m.
    assert found.error == pytest.approx(0.5 * (0.1**2 + 0.2**2) / 11 / 0.04, rel=1e-3)
    # Ten measurements beside one: the variance is that of ten, in parallel with one.
    assert found.covariance[0, 0] == pytest.approx(0.04 * 10 / 11, rel=1e-3)


def aligned_error(poses: np.ndarray, true: np.ndarray) -> float:
    """Return the root mean square error of positions after the best rigid alignment (Umeyama)."""
    one, other = (each[:, :2] - each[:, :2].mean(axis=0) for each in (poses, true))
    left, _, right = np.linalg.svd(one.T @ other)
    turn = left @ np.diag([1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return float(np.sqrt(((one @ turn - other) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("is_closed", [False, True])
def test_the_expected_error_is_that_of_drawn_motions(is_closed: bool) -> None:
    """Around a square, whose last pose is seen from the first one or not."""
    rng = np.random.default_rng(4)
    motions = np.tile([1.0, 0.0, 0.0], (28, 1))
    motions[6::7, 2] = math.pi / 2
    true = chain(motions)
    root = np.array([[0.03, 0.0, 0.0], [0.005, 0.02, 0.0], [0.002, 0.001, 0.01]])
    covariance = root @ root.T
    loop = between_by_hand(true[0], true[-1])
    given = np.tile(covariance, (28, 1, 1))
    pairs = (np.array([[0, 28]]), loop[None], 0.01 * covariance[None])
    graph = Graph(true, motions, given, *(pairs if is_closed else NOTHING))
    squared = []
    for _ in range(200):
        # The covariance of a motion is in the frame of its start.
        drawn = motions + rng.normal(size=(28, 3)) @ root.T
        poses = chain(drawn)
        if is_closed:
            seen = loop + 0.1 * root @ rng.normal(size=3)
            measured = Graph(poses, drawn, given, pairs[0], seen[None], pairs[2])
            poses = optimise(measured).poses
        squared.append(aligned_error(poses, true) ** 2)
    expected = expected_error(graph)
    assert expected == pytest.approx(math.sqrt(np.mean(squared)), rel=0.1)
    assert expected_error(Graph(true[:1], motions[:0], given[:0], *NOTHING)) == 0.0


def logarithm(motion: np.ndarray) -> np.ndarray:
    """Return the logarithm of a motion of SE(2)."""
    half = 0.5 * motion[2]
    cot = half / math.tan(half)
    x, y = motion[:2]
    return np.array([cot * x + half * y, cot * y - half * x, motion[2]])


def test_errors_are_logarithms_also_of_a_loop_that_is_wrong() -> None:
    motions = np.array([[1.0, 0.1, 0.5], [0.8, -0.2, 0.6]])
    covariances = np.array([np.diag([0.04, 0.01, 0.02]), np.diag([0.02, 0.05, 0.01])])
    loop, of_loop = np.array([0.9, 1.4, -0.6]), np.diag([0.3, 0.1, 0.2])
    pairs = np.array([[0, 2]])
    found = optimise(Graph(chain(motions), motions, covariances, pairs, loop[None], of_loop[None]))
    squares = []
    for i, j, measured, covariance in (
        (0, 1, motions[0], covariances[0]),
        (1, 2, motions[1], covariances[1]),
        (0, 2, loop, of_loop),
    ):
        error = logarithm(
            between_by_hand(measured, between_by_hand(found.poses[i], found.poses[j]))
        )
        # Covariances are given in the frame of the first node, errors are in that of the end.
        cos, sin = math.cos(measured[2]), math.sin(measured[2])
        back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        squares.append(error @ np.linalg.solve(back @ covariance @ back.T, error))
    size = math.sqrt(squares[2])
    assert size > HUBER
    huber = HUBER * (size - 0.5 * HUBER)
    assert found.error == pytest.approx(0.5 * (squares[0] + squares[1]) + huber, rel=1e-5)


def test_a_loop_that_is_heavier_takes_more_of_the_error() -> None:
    motions = np.tile([1.0, 0.0, 0.0], (4, 1))
    covariance = np.diag([0.04, 0.04, 1e-10])
    weights = np.array([1.0, 4.0, 1.0, 2.0])
    graph = Graph(
        chain(motions),
        motions,
        weights[:, None, None] * covariance,
        np.array([[0, 4]]),
        np.array([[4.1, 0.0, 0.0]]),
        0.5 * covariance[None],
    )
    moved = np.concatenate([[0.0], 0.1 * np.cumsum(weights) / (weights.sum() + 0.5)])
    np.testing.assert_allclose(optimise(graph).poses[:, 0], np.arange(5) + moved, atol=1e-5)


def test_a_wrong_loop_pulls_with_bounded_force() -> None:
    """Its residual is beyond the bound: the force on each of the steps is that of the bound,
    however wrong the loop is."""
    motions = np.tile([1.0, 0.0, 0.0], (4, 1))
    covariance = np.diag([0.01, 0.01, 1e-10])
    moved = []
    for wrong in (50.0, 500.0):
        graph = Graph(
            chain(motions),
            motions,
            np.tile(covariance, (4, 1, 1)),
            np.array([[0, 4]]),
            np.array([[4.0 + wrong, 0.0, 0.0]]),
            covariance[None],
        )
        moved.append(optimise(graph).poses[:, 0] - np.arange(5))
    for each in moved:
        np.testing.assert_allclose(each, HUBER * 0.1 * np.arange(5), rtol=1e-3)


def random_graph(seed: int) -> tuple[Graph, np.ndarray]:
    """Return a graph with three loops, one of them wrong, and its true poses."""
    rng = np.random.default_rng(seed)
    true = chain(np.column_stack([rng.uniform(0.3, 1.0, 12), rng.normal(size=(12, 2)) * 0.3]))

    def covariance() -> np.ndarray:
        factor = rng.standard_normal((3, 3)) * 0.3 + np.eye(3)
        scaled = np.array([0.05, 0.05, 0.03])[:, None] * factor
        return scaled @ scaled.T

    def measured(i: int, j: int, noise: np.ndarray) -> np.ndarray:
        error = rng.multivariate_normal(np.zeros(3), noise)
        return between_by_hand(true[i], true[j]) + error

    noises = np.array([covariance() for _ in range(12)])
    motions = np.array([measured(i, i + 1, noise) for i, noise in enumerate(noises)])
    pairs = np.array([[0, 12], [2, 9], [4, 11]])
    loop_noises = np.array([covariance() for _ in pairs])
    loops = np.array(
        [measured(*pair, noise) for pair, noise in zip(pairs, loop_noises, strict=True)]
    )
    loops[1, :2] += 0.8
    return Graph(chain(motions), motions, noises, pairs, loops, loop_noises), true


def whitened(
    poses: np.ndarray, pairs: np.ndarray, wanted: np.ndarray, noises: np.ndarray
) -> np.ndarray:
    """Return the errors (K, 3) of motions in standard deviations."""

    def apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
        dx, dy, turn = (second - first).T
        turn = np.arctan2(np.sin(turn), np.cos(turn))
        return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)

    found = apart(wanted, apart(poses[pairs[:, 0]], poses[pairs[:, 1]]))
    # The logarithm of a transform, in the frame of the end of the measured motion.
    half = 0.5 * found[:, 2]
    scale = np.where(np.abs(half) > 1e-9, half / np.tan(np.where(half == 0.0, 1.0, half)), 1.0)
    x, y = found[:, 0], found[:, 1]
    error = np.stack([scale * x + half * y, scale * y - half * x, found[:, 2]], axis=1)
    turns = np.zeros((len(wanted), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(wanted[:, 2])
    turns[:, 1, 0] = np.sin(wanted[:, 2])
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    root = np.linalg.cholesky(np.swapaxes(turns, 1, 2) @ noises @ turns)
    return np.linalg.solve(root, error[..., None])[..., 0]


@pytest.mark.parametrize("seed", range(4))
def test_a_graph_has_the_minimum_of_a_general_minimiser(seed: int) -> None:
    graph, true = random_graph(seed)
    ahead = np.stack([np.arange(12), np.arange(1, 13)], axis=1)

    def residuals(free: np.ndarray) -> np.ndarray:
        """Return errors whose squares add to twice the cost: roots of Huber's loss for loops."""
        poses = np.concatenate([np.zeros((1, 3)), free.reshape(-1, 3)])
        of_chain = whitened(poses, ahead, graph.motions, graph.motion_covariances)
        of_loops = whitened(poses, graph.pairs, graph.loops, graph.loop_covariances)
        length = np.linalg.norm(of_loops, axis=1)
        # The direction is kept, so that the residuals are smooth where a loop fits.
        loss = np.where(length <= HUBER, length**2, HUBER * (2.0 * length - HUBER))
        scaled = of_loops * (np.sqrt(loss) / np.maximum(length, 1e-12))[:, None]
        return np.concatenate([of_chain.ravel(), scaled.ravel()])

    best = least_squares(residuals, graph.poses[1:].ravel(), max_nfev=200)
    found = optimise(graph)
    assert found.error == pytest.approx(best.cost, rel=1e-3)
    np.testing.assert_allclose(found.poses[1:], best.x.reshape(-1, 3), atol=2e-3)
    # The third loop and the first bound the drift, although the second is wrong.
    apart = np.hypot(*(found.poses - true)[-1, :2])
    assert apart < 5.0 * math.sqrt(np.trace(found.covariance[:2, :2]))


def test_the_covariance_of_a_chain_is_that_of_its_motions() -> None:
    rng = np.random.default_rng(5)
    motions = np.column_stack([rng.uniform(0.3, 1.0, 15), 0.3 * rng.normal(size=(15, 2))])
    noises = np.array([np.diag(rng.uniform(0.01, 0.05, 3)) ** 2 for _ in motions])
    found = optimise(Graph(chain(motions), motions, noises, *NOTHING))
    pose, covariance = jnp.zeros(3), jnp.zeros((3, 3))
    for motion, noise in zip(motions, noises, strict=True):
        taken = jnp.asarray(motion, jnp.float32)
        covariance = propagate_covariance(pose, taken, covariance, jnp.asarray(noise, jnp.float32))
        pose = compose(pose, taken)
    np.testing.assert_allclose(found.poses[-1], pose, atol=1e-4)
    np.testing.assert_allclose(
        found.covariance, covariance, atol=1e-3 * float(jnp.abs(covariance).max())
    )
    assert found.error == pytest.approx(0.0, abs=1e-6)


def test_a_single_node_is_known() -> None:
    found = optimise(Graph(np.array([[1.0, 2.0, 0.5]]), *NOTHING[1:], *NOTHING))
    np.testing.assert_allclose(found.poses, [[1.0, 2.0, 0.5]])
    np.testing.assert_array_equal(found.covariance, np.zeros((3, 3)))


def test_covariances_of_motions_are_those_of_dense_linear_algebra() -> None:
    """The information of all factors by finite differences, inverted as a whole in float64."""
    rng = np.random.default_rng(5)
    motions = np.column_stack(
        [rng.uniform(0.5, 1.0, 9), rng.normal(0.0, 0.2, 9), rng.normal(0.0, 0.4, 9)]
    )
    roots = rng.normal(0.0, 0.05, (9, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1) + 1e-4 * np.eye(3)
    poses = chain(motions)
    pairs = np.array([[1, 6]])
    loop = between_by_hand(poses[1], poses[6])[None]
    loop_covariance = np.diag([0.01, 0.02, 0.001])[None]
    graph = Graph(poses, motions, covariances, pairs, loop, loop_covariance)
    ends = [(i, i + 1) for i in range(9)] + [(1, 6)]

    def slopes(function, at: np.ndarray) -> np.ndarray:
        steps = 1e-6 * np.eye(at.size).reshape(-1, *at.shape)
        return np.array([(function(at + d) - function(at - d)) / 2e-6 for d in steps]).T

    # The first pose is fixed: its information is infinite, so it is left out.
    information = np.zeros((30, 30))
    for (i, j), covariance in zip(ends, [*covariances, *loop_covariance], strict=True):
        slope = slopes(lambda given, i=i, j=j: between_by_hand(given[i], given[j]), poses)
        information += slope.T @ np.linalg.inv(covariance) @ slope
    covariance = np.zeros((30, 30))
    covariance[3:, 3:] = np.linalg.inv(information[3:, 3:])
    nodes = [0, 2, 4, 8]
    expected = []
    for node in nodes:
        slope = slopes(lambda given, node=node: between_by_hand(given[node], given[9]), poses)
        expected.append(slope @ covariance @ slope.T)
    found = motion_covariances(graph, nodes, 9)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-8)
    assert motion_covariances(graph, [], 9).shape == (0, 3, 3)
    for wrong in ([9], [-1]):
        with pytest.raises(ValueError, match="nodes is"):
            motion_covariances(graph, wrong, 9)
    with pytest.raises(ValueError, match="end is 10"):
        motion_covariances(graph, nodes, 10)
