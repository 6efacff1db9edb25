"""Motions in the plane: round trips, and the covariance against derivatives and samples."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.geometry.motion import (
    between,
    compose,
    propagate_covariance,
    rotation,
    transform_points,
    wrap_angle,
)

lengths = st.floats(-20.0, 20.0, width=32)
angles = st.floats(-3.0, 3.0, width=32)
poses = st.tuples(lengths, lengths, angles).map(lambda pose: jnp.array(pose, jnp.float32))
seeds = st.integers(0, 2**32 - 1)


def matrix(pose: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[cos, -sin, pose[0]], [sin, cos, pose[1]], [0.0, 0.0, 1.0]])


def random_covariance(seed: int, size: float) -> np.ndarray:
    factor = size * np.random.default_rng(seed).standard_normal((3, 3))
    return factor @ factor.T


@given(poses, poses)
def test_a_motion_is_the_product_of_transforms(pose: jax.Array, motion: jax.Array) -> None:
    first, second = (np.asarray(each, float) for each in (pose, motion))
    moved = compose(pose, motion)
    np.testing.assert_allclose(
        matrix(np.asarray(moved, float)), matrix(first) @ matrix(second), atol=2e-5
    )
    np.testing.assert_allclose(between(pose, moved), motion, atol=2e-5)


@given(poses, poses)
def test_between_leads_to_the_other_pose(pose: jax.Array, other: jax.Array) -> None:
    reached = compose(pose, between(pose, other))
    np.testing.assert_allclose(reached[:2], other[:2], atol=2e-5)
    assert abs(math.remainder(float(reached[2] - other[2]), math.tau)) < 1e-5
    assert abs(float(between(pose, other)[2])) <= math.pi + 1e-6


@given(st.floats(-50.0, 50.0, width=32))
def test_angles_are_wrapped(angle: float) -> None:
    found = float(wrap_angle(jnp.asarray(angle, jnp.float32)))
    assert abs(found) <= math.pi + 1e-6
    assert abs(math.remainder(found - angle, math.tau)) < 1e-4


@given(poses, seeds)
def test_points_are_placed_as_motions_are(pose: jax.Array, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-5.0, 5.0, (4, 2)).astype(np.float32)
    expected = [compose(pose, jnp.append(jnp.asarray(each), 0.0))[:2] for each in points]
    np.testing.assert_allclose(
        transform_points(pose, jnp.asarray(points)), jnp.stack(expected), atol=2e-5
    )
    np.testing.assert_allclose(
        rotation(pose[2])[:2, :2], matrix(np.asarray(pose, float))[:2, :2], atol=1e-6
    )


@given(poses, poses, seeds)
def test_covariance_has_the_derivatives_of_a_motion(
    pose: jax.Array, motion: jax.Array, seed: int
) -> None:
    before, added = random_covariance(seed, 0.3), random_covariance(seed + 1, 0.3)
    # Central differences in double precision, of the product of transforms.
    at, by = np.asarray(pose, float), np.asarray(motion, float)

    def moved(at: np.ndarray, by: np.ndarray) -> np.ndarray:
        both = matrix(at) @ matrix(by)
        return np.array([both[0, 2], both[1, 2], at[2] + by[2]])

    step = 1e-5 * np.eye(3)
    by_pose = np.stack([moved(at + e, by) - moved(at - e, by) for e in step], axis=1) / 2e-5
    by_motion = np.stack([moved(at, by + e) - moved(at, by - e) for e in step], axis=1) / 2e-5
    expected = by_pose @ before @ by_pose.T + by_motion @ added @ by_motion.T
    found = propagate_covariance(
        pose, motion, jnp.asarray(before, jnp.float32), jnp.asarray(added, jnp.float32)
    )
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max() + 1e-6)


def test_covariance_is_the_spread_of_a_chain_of_motions() -> None:
    """2000 chains of 30 noisy motions: the spread has a standard error of 3 %."""
    rng = np.random.default_rng(0)
    motions = rng.uniform(-1.0, 1.0, (30, 3)) * [0.3, 0.1, 0.4]
    noise = np.diag([0.01, 0.02, 0.01]) ** 2
    chains = np.zeros((2000, 3))
    pose, covariance = jnp.zeros(3), jnp.zeros((3, 3))
    for motion in motions:
        taken = motion + rng.multivariate_normal(np.zeros(3), noise, len(chains))
        cos, sin = np.cos(chains[:, 2]), np.sin(chains[:, 2])
        dx, dy, turn = taken.T
        chains += np.stack([cos * dx - sin * dy, sin * dx + cos * dy, turn], axis=1)
        now = jnp.asarray(motion, jnp.float32)
        covariance = propagate_covariance(pose, now, covariance, jnp.asarray(noise, jnp.float32))
        pose = compose(pose, now)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), (chains - np.asarray(pose)).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.12)
