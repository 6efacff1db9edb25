"""Ways of a car from its pose to the poses of its lattice."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import Count, Pose, Scalar
from jaxplore.geometry.dubins import find_ways, place_on
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, motions
from jaxplore.maps.frame import GridFrame

CLOSED = 1e6
"""Price of each pose without room that a way passes [m]: it outweighs all costs, so that a car in a
closed place takes the way that leads out soonest."""


class MotionTable(NamedTuple):
    """The motions of a car as arrays, one row a motion.

    Args:
        start: (M,) heading at the start [rad].
        end: (M,) index of the heading at the end.
        down: (M,) rows from start to end.
        right: (M,) columns from start to end.
        length: (M,) length [node spacings].
        before: (M,) length of the straight piece before the circle [node spacings].
        turn: (M,) angle by which it turns [rad].
        via: (M, L, 3) rows and columns from the start, and heading, of the states that it passes,
            with the first one.
    """

    start: np.ndarray
    end: np.ndarray
    down: np.ndarray
    right: np.ndarray
    length: np.ndarray
    before: np.ndarray
    turn: np.ndarray
    via: np.ndarray


@functools.cache
def motion_table(radius: float) -> MotionTable:
    """Return the motions of a car with a turning radius [node spacings] as arrays."""
    found = motions(radius)
    # The first pose is one of them, and fills up the list.
    longest = 1 + max(len(each.via) for each in found)
    via = [
        [*(state[:3] for state in each.via), *[(0, 0, each.start)] * (longest - len(each.via))]
        for each in found
    ]
    whole = np.array([[each.end, each.down, each.right] for each in found], np.int32)
    end, down, right = whole.T
    real = [(HEADINGS[each.start], each.length, each.before, each.turn) for each in found]
    start, length, before, turn = np.array(real, np.float32).T
    via_array = np.array(via, np.int32).reshape(len(found), longest, 3)
    return MotionTable(start, end, down, right, length, before, turn, via_array)


@functools.cache
def motions_from(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the motions that begin at each heading (N, R), and which are some.

    A heading with fewer motions than others has its first one several times.
    """
    own: list[list[int]] = [[] for _ in HEADINGS]
    for number, each in enumerate(motions(radius)):
        own[each.start].append(number)
    most = max(map(len, own))
    numbers = np.array([each + each[:1] * (most - len(each)) for each in own], np.int32)
    is_motion = np.arange(most) < np.array([[len(each)] for each in own])
    return numbers, is_motion


class DescentTree(NamedTuple):
    """A cost-to-go on the lattice of a car, and what tells which motion it is the cost of.

    Args:
        is_open: mask (N, H, W) of the poses in which the car fits, by heading of the body.
        is_clear: mask (N, H, W) of those in which it fits at the node itself, not beside it.
        slowness: cost (N, H, W) of a step of one node spacing [m].
        costs: cost-to-go (D, N, H, W) of the motions that begin at the poses [m].
        reversal_cost: price of a change between forwards and backwards [m].
        reverse_penalty: factor on the cost of what is driven backwards.
        radius: turning radius [node spacings].
    """

    is_open: Bool[Array, "N H W"]
    is_clear: Bool[Array, "N H W"]
    slowness: Float[Array, "N H W"]
    costs: Float[Array, "D N H W"]
    reversal_cost: Scalar
    reverse_penalty: Scalar
    radius: float


class Join(NamedTuple):
    """A way from a pose to a pose of the lattice; see `find_ways`.

    Args:
        begin: pose (x, y, yaw) at which it begins [m, m, rad].
        direction: 0 forwards, 1 backwards.
        heading: index of the heading of the body at its end.
        corner: (2,) row and column of its end.
        sides: (2,) sides of its circles, seen in the direction of travel.
        pieces: (3,) lengths of its pieces [turning radii].
        price: cost of a turning radius of it [m].
        beyond: cost-to-go at its end [m]; infinite without a way.
    """

    begin: Pose
    direction: Count
    heading: Count
    corner: Int[Array, "2"]
    sides: Float[Array, "2"]
    pieces: Float[Array, "3"]
    price: Scalar
    beyond: Scalar

    def pose_at(self, along: Scalar, radius: Scalar | float) -> Pose:
        """Return the pose after a length [turning radii], with a turning radius [m]."""
        x, y, turn = place_on(self.sides, self.pieces, along)
        heading = self.begin[2] + math.pi * self.direction.astype(jnp.float32)
        cos, sin = jnp.cos(heading), jnp.sin(heading)
        return self.begin + jnp.stack(
            [radius * (cos * x - sin * y), radius * (sin * x + cos * y), turn]
        )


def find_join(tree: DescentTree, frame: GridFrame, pose: Pose, speed: Scalar) -> Join:
    """Return the way from a pose to the lattice that is cheapest with the cost-to-go at its end.

    The car can drive it. A pose of the lattice that is aside is no beginning of a path, however
    near it is: beside a door post its cost may be that of driving on, where the car must go back
    first. The ways are those of Dubins, forwards and backwards, to poses up to 2 sqrt(R) + 1 nodes
    away, with R the turning radius in nodes: a bend and a bend back move the car half a node aside
    within sqrt(2 R) nodes. A way costs its length times the mean price of a metre on it, as it may
    have a door between its ends. It needs room at the nodes themselves (`is_clear`): the car does
    not pass at the best cell beside a node. The sign of `speed` [m/s] tells the direction of
    travel, and another one has its price.
    """
    directions, _, height, width = tree.costs.shape
    radius = tree.radius
    reach = math.ceil(2.0 * math.sqrt(radius)) + 1
    longest = 2 * reach
    is_finite = jnp.isfinite(pose).all()
    # A pose that is not finite has no index, and no way.
    begin = jnp.where(is_finite, pose, 0.0)
    at, yaw = frame.to_grid(begin[:2]), begin[2] - frame.origin[2]
    own = jnp.floor(at).astype(jnp.int32)
    rows, columns = own[:, None] + jnp.arange(-reach, reach + 1)
    down = (rows.astype(jnp.float32) + 0.5 - at[0])[:, None]
    right = columns.astype(jnp.float32) + 0.5 - at[1]
    turn = jnp.asarray(HEADINGS, jnp.float32)[:, None, None] - yaw
    headings = jnp.arange(NUM_HEADINGS)[:, None, None]

    def at_poses(values: Array, state: tuple[Array, ...], outside: float | bool) -> Array:
        heading, row, column = state
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        clipped = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
        return jnp.where(inside, values[heading, *clipped], outside)

    ends = (headings, rows[:, None], columns)

    def towards(direction: Array) -> tuple[Array, ...]:
        """Return the costs of the ways in a direction of travel, and what tells them."""
        start = yaw + math.pi * direction.astype(jnp.float32)
        cos, sin = jnp.cos(start), jnp.sin(start)
        x, y = cos * right + sin * down, cos * down - sin * right
        sides, pieces = find_ways(*jnp.broadcast_arrays(x / radius, y / radius, turn))
        length = radius * pieces.sum(axis=0)
        # A point in each node spacing of the longest way.
        shares = (jnp.arange(longest, dtype=jnp.float32) + 0.5) / longest
        passed = place_on(sides, pieces, shares[:, None, None, None] * length / radius)
        passed_row = radius * (sin * passed[0] + cos * passed[1]) + at[0]
        passed_column = radius * (cos * passed[0] - sin * passed[1]) + at[1]
        cells = (jnp.floor(each).astype(jnp.int32) for each in (passed_row, passed_column))
        states = (nearest_heading(passed[2] + yaw), *cells)
        is_clear = at_poses(tree.is_clear, states, False)
        # Unlike a motion, a way may have a door between its two ends.
        price = at_poses(tree.slowness, states, 0.0).mean(axis=0)
        price = price * jnp.where(direction == 1, tree.reverse_penalty, 1.0)
        beyond = at_poses(tree.costs[direction], ends, jnp.inf)
        cost = beyond + price * length + CLOSED * (~is_clear).sum(axis=0).astype(jnp.float32)
        cost = cost + jnp.where((direction == 1) == (speed < 0.0), 0.0, tree.reversal_cost)
        return jnp.where(length <= longest, cost, jnp.inf), beyond, sides, pieces, price * radius

    found = jax.vmap(towards)(jnp.arange(directions, dtype=jnp.int32))
    best = jnp.argmin(found[0])
    place = direction, heading, row, column = jnp.unravel_index(best, found[0].shape)
    way, beyond, price = (each[place] for each in (found[0], found[1], found[4]))
    sides, pieces = (each[direction, :, heading, row, column] for each in found[2:4])
    return Join(
        pose,
        direction.astype(jnp.int32),
        heading.astype(jnp.int32),
        jnp.stack([rows[row], columns[column]]),
        sides,
        pieces,
        price,
        jnp.where(is_finite & jnp.isfinite(way), beyond, jnp.inf),
    )


def nearest_heading(angle: Array) -> Array:
    """Return the index of the heading that is nearest to an angle [rad]."""
    after = (*HEADINGS[1:], math.tau)
    middle = [0.5 * (a + b) for a, b in zip(HEADINGS, after, strict=True)]
    is_beyond = jnp.mod(angle, math.tau)[..., None] >= jnp.asarray(middle, jnp.float32)
    return jnp.mod(is_beyond.sum(axis=-1, dtype=jnp.int32), NUM_HEADINGS)
