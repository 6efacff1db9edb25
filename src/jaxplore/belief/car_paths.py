"""Paths of a car: its motions on a lattice, one after another, down a cost-to-go."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxplore._types import Count, Flag, Pose, Scalar
from jaxplore.belief.car_joins import DescentTree, Join, motion_table, motions_from, nearest_heading
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS
from jaxplore.maps.frame import GridFrame

CHANNEL_LENGTH = 20
"""Length of the path ahead along which the cost has a channel [nodes]."""
CHANNEL_WIDTH = 3
"""Width of the channel on either side of the path [nodes]."""
STRAYING = 4.0
"""Cost of straying from the path ahead; it grows with the square of the distance [1/m]."""
SLACK = 0.01
"""Rise of the cost-to-go along a motion that rounding may cause [m]."""


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
    """Return a path without a cost where its channel would lower that of the pose it begins at.

    After a reversal a path may come back beside its beginning, turned by what the car must turn
    first. To stray there costs less than the way does, and a car that looks for the least cost
    would stand at its beginning. `radius` is the turning radius [m], and `direction` the direction
    of travel at the pose; see `with_channel`.
    """
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
    """Lower a cost-to-go beside a path to that of straying from the path and driving along it.

    At a pose x of the lattice, at most `CHANNEL_WIDTH` nodes beside a point p of the path, the cost
    becomes at most

        U(p) + STRAYING (|x - p|^2 + (R turn)^2)

    with R the turning radius (`radius` is in node spacings), plus `reversal_cost` [m] if the
    direction of travel is not that at p. `path` has its points on one axis.
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
