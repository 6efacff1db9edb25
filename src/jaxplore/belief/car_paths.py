"""Paths of a car: from its pose to its lattice, and motion after motion down a cost-to-go."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import Count, Flag, Pose, Scalar
from jaxplore.geometry.dubins import find_ways, place_on
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, motions
from jaxplore.maps.frame import GridFrame

CLOSED = 1e6
"""Price of each pose without room that a way passes [m]: it outweighs all costs, so that a car in a
closed place takes the way that leads out soonest."""
CHANNEL_LENGTH = 20
"""Length of the path ahead along which the cost has a channel [nodes]."""
CHANNEL_WIDTH = 3
"""Width of the channel on either side of the path [nodes]."""
STRAYING = 4.0
"""Cost of straying from the path ahead; it grows with the square of the distance [1/m]."""
SLACK = 0.01
"""Rise of the cost-to-go along a motion that rounding may cause [m]."""


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


class Moving(NamedTuple):
    """A place on a motion.

    Args:
        direction: 0 forwards, 1 backwards.
        number: number of the motion.
        corner: (2,) row and column where the motion begins.
        along: length of the motion up to here [node spacings]; negative on the way to it.
        moves: whether the car goes on.
        beyond: cost-to-go at the end of the motion [m].
        price: cost of a node spacing of the motion [m].
    """

    direction: Count
    number: Count
    corner: Int[Array, "2"]
    along: Scalar
    moves: Flag
    beyond: Scalar
    price: Scalar


class DrivenPath(NamedTuple):
    """Poses of a car along its motions.

    Args:
        poses: (..., 3) poses (x, y, yaw) [m, m, rad].
        directions: (...) 0 forwards, 1 backwards.
        costs: (...) cost-to-go there [m]; infinite without a motion.
    """

    poses: Float[Array, "*points 3"]
    directions: Int[Array, "*points"]
    costs: Float[Array, "*points"]


def trace_path(
    tree: DescentTree,
    frame: GridFrame,
    start: Join,
    steps: Float[Array, "2"],
    num_steps: int,
) -> DrivenPath:
    """Return the path after 1 ... T steps to the lattice and along the cheapest motions.

    The path ends where no motion lowers the cost. Without a way the car stands at its pose. `steps`
    are the lengths of a step forwards and of a step backwards [m].
    """
    spacing = frame.resolution
    lengths = jnp.asarray(motion_table(tree.radius).length)
    way = tree.radius * start.pieces.sum()
    first = _next(tree, start.direction, start.heading, start.corner)
    first = first._replace(
        direction=jnp.where(first.moves, first.direction, start.direction),
        along=-way,
        # Where no motion leads on, it stays at the end of the way.
        beyond=jnp.where(first.moves, first.beyond, start.beyond),
        price=jnp.where(first.moves, first.price, 0.0),
    )
    # A piece is no longer than the shortest motion, so that it passes one end at most.
    shares = steps / spacing
    pieces = jnp.maximum(jnp.ceil(shares.max()), 1.0)

    def direction_at(at: Moving) -> Array:
        return jnp.where(at.along < 0.0, start.direction, at.direction)

    def piece(_: Array, at: Moving) -> Moving:
        length = lengths[at.number]
        ahead = shares[direction_at(at)] / pieces
        end = jnp.where(at.moves, jnp.inf, jnp.maximum(at.along, 0.0))
        along = jnp.minimum(at.along + ahead, end)

        def turn_over(at: Moving) -> Moving:
            corner, body = _end(tree, at)
            after = _next(tree, at.direction, body, corner)
            # At its last pose it stays where it is.
            stays = at._replace(along=length, moves=jnp.array(False))
            further = after._replace(along=after.along + along - length)
            either: Moving = jax.tree.map(lambda a, b: jnp.where(after.moves, a, b), further, stays)
            return either

        is_over = at.moves & (along >= length)
        after: Moving = jax.lax.cond(is_over, turn_over, lambda at: at._replace(along=along), at)
        return after

    def step(at: Moving, _: None) -> tuple[Moving, DrivenPath]:
        at = jax.lax.fori_loop(0, pieces.astype(jnp.int32), piece, at)
        is_before = at.along < 0.0
        passed = (at.along + way) / tree.radius
        pose = jnp.where(
            is_before, start.pose_at(passed, tree.radius * spacing), _pose(tree, frame, at)
        )
        to_end = start.beyond - at.along / tree.radius * start.price
        cost = jnp.where(is_before, to_end, at.beyond + (lengths[at.number] - at.along) * at.price)
        return at, DrivenPath(pose, direction_at(at), cost)

    path: DrivenPath
    _, path = jax.lax.scan(step, first, length=num_steps)
    # Where paths end at the pose of the lattice nearest to it, the car stays.
    own = jnp.clip(frame.to_cell(start.begin[:2]), 0, jnp.asarray(tree.is_open.shape[1:]) - 1)
    body = nearest_heading(start.begin[2] - frame.origin[2])
    leads_on = _next(tree, start.direction, body, own).moves
    is_end = jnp.isfinite(tree.costs[start.direction, body, own[0], own[1]]) & ~leads_on
    has_way = jnp.isfinite(start.beyond) & ~is_end
    return DrivenPath(
        jnp.where(has_way, path.poses, start.begin),
        path.directions,
        jnp.where(has_way, path.costs, jnp.inf),
    )


def without_shortcuts(
    path: DrivenPath,
    pose: Pose,
    direction: Count,
    radius: float,
    reversal_cost: Scalar,
) -> DrivenPath:
    """Return a path without a cost where its channel (`with_channel`) would lower that of the pose
    it begins at. After a reversal a path may come back beside its beginning. To stray there costs
    less than the way does, and a car that looks for the least cost would stand at its beginning."""
    turn = jnp.mod(path.poses[:, 2] - pose[2] + jnp.pi, 2.0 * jnp.pi) - jnp.pi
    away = ((path.poses[:, :2] - pose[:2]) ** 2).sum(axis=1) + (radius * turn) ** 2
    costs = path.costs + jnp.where(path.directions != direction, reversal_cost, 0.0)
    is_later = jnp.cumsum(path.directions != path.directions[0]) > 0
    is_shortcut = is_later & (costs + STRAYING * away < costs[0])
    return path._replace(costs=jnp.where(is_shortcut, jnp.inf, path.costs))


def with_channel(
    costs: Float[Array, "D N H W"],
    path: DrivenPath,
    frame: GridFrame,
    radius: float,
    reversal_cost: Scalar,
) -> Float[Array, "D N H W"]:
    """Lower a cost-to-go beside a path (one axis of points) to that of straying from it and driving
    along.

    At a pose x of the lattice, at most `CHANNEL_WIDTH` nodes beside a point p of the path, the cost
    becomes at most

        U(p) + STRAYING (|x - p|^2 + (R turn)^2)

    with R the turning radius [nodes], plus `reversal_cost` [m] if the direction of travel is not
    that at p.
    """
    spacing = frame.resolution
    # A car without a path has infinite costs, and may have a pose that is not finite.
    poses = jnp.where(jnp.isfinite(path.costs)[:, None], path.poses, 0.0)
    beside = jnp.arange(-CHANNEL_WIDTH, CHANNEL_WIDTH + 1)
    nodes = frame.to_cell(poses[:, :2])[..., None] + beside
    row, column = nodes[:, 0, :, None], nodes[:, 1, None, :]
    away = nodes.astype(jnp.float32) + 0.5 - frame.to_grid(poses[:, :2])[..., None]
    squared = spacing**2 * (away[:, 0, :, None] ** 2 + away[:, 1, None, :] ** 2)
    turn = jnp.asarray(HEADINGS, jnp.float32)[:, None] - (poses[:, 2] - frame.origin[2])
    arc = radius * spacing * (jnp.mod(turn + jnp.pi, 2.0 * jnp.pi) - jnp.pi)
    # All bounds have the axes direction, heading, point, row and column.
    is_other = jnp.arange(costs.shape[0])[:, None] != path.directions
    along = path.costs + jnp.where(is_other, reversal_cost, 0.0)
    straying = STRAYING * (arc[..., None, None] ** 2 + squared)
    bounds = along[:, None, :, None, None] + straying
    # An index below 0 is off the map, not counted from its far side.
    return costs.at[:, :, row, column].min(bounds, mode="drop", wrap_negative_indices=False)


def _next(tree: DescentTree, direction: Count, body: Count, corner: Int[Array, "2"]) -> Moving:
    """Return the beginning of the cheapest motion from a pose of the lattice.

    `direction` is the direction of travel up to here.
    """
    directions, _, height, width = tree.costs.shape
    table = motion_table(tree.radius)
    numbers, is_motion = motions_from(tree.radius)

    def at(values: Array, heading: Array, places: Array, outside: float | bool) -> Array:
        """Return the values at poses (heading, place), and another one off the map."""
        inside = ((places >= 0) & (places < jnp.asarray([height, width]))).all(axis=-1)
        row, column = (
            jnp.clip(places[..., 0], 0, height - 1),
            jnp.clip(places[..., 1], 0, width - 1),
        )
        return jnp.where(inside, values[heading, row, column], outside)

    def of(values: np.ndarray, number: Array) -> Array:
        return jnp.asarray(values)[number]

    def options(travel: Array) -> tuple[Array, Array, Array, Array]:
        # Backwards, the body is the other way round than the motion.
        half_turn = travel * (NUM_HEADINGS // 2)
        motion = jnp.mod(body + half_turn, NUM_HEADINGS)
        number = jnp.asarray(numbers)[motion]
        ends = corner + jnp.stack([of(table.down, number), of(table.right, number)], axis=-1)
        body_after = jnp.mod(of(table.end, number) + half_turn, NUM_HEADINGS)
        after = at(tree.costs[travel], body_after, ends, jnp.inf)
        price = 0.5 * (tree.slowness[body, corner[0], corner[1]])
        price = price + 0.5 * at(tree.slowness, body_after, ends, jnp.inf)
        price = price * jnp.where(travel == 1, tree.reverse_penalty, 1.0)
        passed = of(table.via, number)
        bodies = jnp.mod(passed[..., 2] + half_turn, NUM_HEADINGS)
        is_open = at(tree.is_open, bodies, corner + passed[..., :2], False).all(axis=-1)
        is_open = is_open & jnp.asarray(is_motion)[motion]
        cost = jnp.where(is_open, after + of(table.length, number) * price, jnp.inf)
        cost = jnp.where(travel == direction, cost, cost + tree.reversal_cost)
        return number, cost, after, price

    numbers_at, costs, after, price = jax.vmap(options)(jnp.arange(directions, dtype=jnp.int32))
    best = jnp.argmin(costs)
    least = costs.reshape(-1)[best]
    travel, place = (each.astype(jnp.int32) for each in jnp.unravel_index(best, costs.shape))
    # At a place where paths end, every motion costs more than to stay.
    here = tree.costs[direction, body, corner[0], corner[1]]
    moves = jnp.isfinite(least) & (least <= here + SLACK)
    rest = (jnp.zeros(()), moves, after[travel, place], price[travel, place])
    return Moving(travel, numbers_at[travel, place], corner, *rest)


def _end(tree: DescentTree, at: Moving) -> tuple[Int[Array, "2"], Count]:
    """Return row and column of the end of a motion, and the heading of the body there."""
    table = motion_table(tree.radius)
    down, right = jnp.asarray(table.down)[at.number], jnp.asarray(table.right)[at.number]
    heading = jnp.asarray(table.end)[at.number] + at.direction * (NUM_HEADINGS // 2)
    return at.corner + jnp.stack([down, right]), jnp.mod(heading, NUM_HEADINGS)


def _pose(tree: DescentTree, frame: GridFrame, at: Moving) -> Pose:
    """Return the pose (x, y, yaw) at a place on a motion: straight, on a circle, straight."""
    table = motion_table(tree.radius)
    start, before, turn = (
        jnp.asarray(each)[at.number] for each in (table.start, table.before, table.turn)
    )
    side = tree.radius * jnp.sign(turn)
    first = jnp.minimum(at.along, before)
    arc = jnp.clip(at.along - before, 0.0, tree.radius * jnp.abs(turn))
    last = at.along - first - arc
    heading = start + jnp.sign(turn) * arc / tree.radius
    x = first * jnp.cos(start) + side * (jnp.sin(heading) - jnp.sin(start))
    y = first * jnp.sin(start) - side * (jnp.cos(heading) - jnp.cos(start))
    along = jnp.stack([x + last * jnp.cos(heading), y + last * jnp.sin(heading)])
    # Nodes are the centres of the cells of the lattice.
    cell = at.corner.astype(jnp.float32) + 0.5 + along[::-1]
    place = frame.to_world(cell)
    yaw = heading + at.direction.astype(jnp.float32) * jnp.pi + frame.origin[2]
    return jnp.append(place, yaw)
