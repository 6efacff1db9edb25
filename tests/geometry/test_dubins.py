"""Ways of Dubins, against OMPL and against the integral of their curvature."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from ompl import base as ompl

from jaxplore.geometry.dubins import find_ways, place_on


@jax.jit
def ways_to(poses):
    """Return the ways to poses (N, 3), and the poses on them after shares of their length."""
    sides, pieces = find_ways(*poses.T)
    shares = jnp.linspace(0.0, 1.0, 6)
    passed = place_on(sides, pieces, shares[:, None] * pieces.sum(axis=0))
    return sides, pieces, jnp.stack(passed, axis=-1)


def random_poses(number: int) -> np.ndarray:
    rng = np.random.default_rng(2)
    places = rng.uniform(-6.0, 6.0, (number, 2))
    return np.column_stack([places, rng.uniform(-4.0, 4.0, number)]).astype(np.float32)


def test_no_way_is_longer_than_it_must_be() -> None:
    poses = random_poses(400)
    found = np.asarray(ways_to(poses)[1]).sum(axis=0)
    space = ompl.DubinsStateSpace(1.0)
    start, end = space.allocState(), space.allocState()
    start.setXY(0.0, 0.0)
    start.setYaw(0.0)
    expected = []
    for x, y, turn in poses.tolist():
        end.setXY(x, y)
        end.setYaw((turn + math.pi) % math.tau - math.pi)
        expected.append(space.distance(start, end))
    is_far = np.hypot(*poses.T[:2]) > 4.0
    assert 100 < is_far.sum() < 380
    np.testing.assert_allclose(found[is_far], np.array(expected)[is_far], atol=2e-3)
    # Nearer, one with three circles may be shorter.
    assert (found > np.array(expected) - 2e-3).all()


def test_ways_lead_to_their_poses_on_circles_of_radius_1() -> None:
    poses = random_poses(60)
    sides, pieces, passed = (np.asarray(each, np.float64) for each in ways_to(poses))
    number = 3000
    for index, pose in enumerate(poses):
        ends = np.cumsum(pieces[:, index])
        step = ends[-1] / number
        at = step * (np.arange(number) + 0.5)
        first, last = sides[:, index]
        curvature = np.where(at < ends[0], first, np.where(at < ends[1], 0.0, last))
        turn = np.concatenate([[0.0], np.cumsum(step * curvature)])
        middle = turn[:-1] + 0.5 * step * curvature
        moves = step * np.stack([np.cos(middle), np.sin(middle)])
        places = np.concatenate([np.zeros((2, 1)), np.cumsum(moves, axis=1)], axis=1)
        driven = np.concatenate([places, turn[None]]).T[:: number // 5]
        np.testing.assert_allclose(passed[:, index], driven, atol=0.02)
        np.testing.assert_allclose(passed[-1, index, :2], pose[:2], atol=2e-3)
        assert abs(np.angle(np.exp(1j * (passed[-1, index, 2] - pose[2])))) < 2e-3
