"""The last manoeuvre of a car, against the ways to many ends and a car that descends it."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.belief.car import car_motion
from jaxplore.costs._arrival import (
    END,
    END_DISTANCE,
    END_TURN,
    REVERSAL,
    ROUND,
    homing_cost,
    manoeuvre,
)
from jaxplore.geometry.reeds_shepp import lengths
from jaxplore.maps.frame import GridFrame

RADIUS = 0.75
ROBOT = jx.Ackermann(max_speed=1.0, min_speed=-0.5)


@eqx.filter_jit
def costs(poses, speeds):
    """Return the costs of poses around a goal."""
    return jax.vmap(lambda pose, speed: manoeuvre(RADIUS, *pose, speed))(poses, speeds)


def test_it_is_the_cheapest_way_to_an_end_with_its_price() -> None:
    rng = np.random.default_rng(0)
    poses = np.stack([*rng.uniform(-0.7, 0.7, (2, 60)), rng.uniform(-4.0, 4.0, 60)], axis=-1)
    ends = np.stack([*rng.uniform(-0.15, 0.15, (2, 4000)), rng.uniform(-0.1, 0.1, 4000)], axis=-1)
    price = END * ((ends[:, :2] ** 2).sum(axis=1) / END_DISTANCE**2 + (ends[:, 2] / END_TURN) ** 2)
    # The end from the car.
    x, y = np.moveaxis(ends[:, None, :2] - poses[:, :2], -1, 0)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ways = RADIUS * lengths(
        (cos * x + sin * y) / RADIUS,
        (cos * y - sin * x) / RADIUS,
        ends[:, None, 2] - poses[:, 2],
        REVERSAL / RADIUS,
    )
    expected = (ways + price[:, None]).min(axis=1)
    for row, speed in enumerate((0.0, -0.1)):
        found = np.asarray(costs(poses.astype(np.float32), np.full(60, speed, np.float32)))
        # Between the nodes the ways of a car are not smooth.
        assert np.abs(found - expected[row]).mean() < 0.1
        assert np.quantile(np.abs(found - expected[row]), 0.9) < 0.25


def test_a_car_that_descends_it_is_at_the_goal() -> None:
    rng = np.random.default_rng(1)
    pose = np.stack([*rng.uniform(-0.6, 0.6, (2, 40)), rng.uniform(-3.1, 3.1, 40)], axis=-1)
    gear, stays = np.ones(40), np.zeros(40, bool)
    # Left, straight and right, forwards and backwards.
    bends = np.tile([1.0, 0.0, -1.0], 8) / RADIUS
    ways = np.repeat([0.05, 0.15, 0.25, 0.4, -0.05, -0.15, -0.25, -0.4], 3)
    for _ in range(200):
        middle = pose[:, 2:] + 0.5 * ways * bends
        moved = np.stack([np.cos(middle), np.sin(middle), bends + 0.0 * middle], axis=-1)
        after = pose[:, None] + ways[:, None] * moved
        found = np.asarray(
            costs(after.reshape(-1, 3).astype(np.float32), np.tile(ways, 40).astype(np.float32))
        ).reshape(40, 24)
        found = found + np.abs(ways) + REVERSAL * (np.sign(ways) != gear[:, None])
        best = found.argmin(axis=1)
        here = np.asarray(costs(pose.astype(np.float32), gear.astype(np.float32)))
        stays |= (np.hypot(*pose[:, :2].T) < 0.1) & (here < found.min(axis=1))
        pose = np.where(stays[:, None], pose, after[np.arange(40), best])
        gear = np.where(stays, gear, np.sign(ways[best]))
    is_there = np.hypot(*pose[:, :2].T) < END_DISTANCE
    is_there &= np.abs(np.angle(np.exp(1j * pose[:, 2]))) < END_TURN
    # One piece ahead it may find no better pose, where ways of two kinds meet between the nodes.
    assert is_there.mean() >= 0.9


def test_what_is_not_finite_has_a_finite_cost() -> None:
    poses = jnp.asarray([[math.nan, 0.0, 0.0], [0.0, math.inf, 0.0], [0.0, 0.0, -math.inf]])
    assert np.isfinite(np.asarray(costs(poses, jnp.asarray([0.0, math.nan, -1.0])))).all()


def test_the_goal_of_a_car_costs_the_manoeuvre_and_walls_the_way_around_them() -> None:
    lattice = car_motion(ROBOT).lattice(0.2)
    level = lattice.level_field(GridFrame(0.2, np.zeros(3, np.float32)), (30, 30))
    goal, heading = jnp.asarray([3.0, 3.0]), jnp.asarray(0.5)
    state = jx.State(jnp.asarray([3.1, 3.3, 0.9, 0.0, 0.0]), ROBOT)

    @eqx.filter_jit
    def cost(to_go):
        return homing_cost(state, level, to_go, goal, heading, jnp.asarray(0.3))

    cos, sin = math.cos(0.5), math.sin(0.5)
    pose = jnp.asarray([[0.1 * cos + 0.3 * sin, 0.3 * cos - 0.1 * sin, 0.4]])
    way = float(costs(pose, jnp.zeros(1))[0])
    for to_go in (0.0, way + 0.5 * ROUND, way + 3.0):
        assert float(cost(jnp.asarray(to_go))) == pytest.approx(max(way, to_go - ROUND), abs=1e-4)
