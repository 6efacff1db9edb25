"""The way to a goal through a volume that is partly unknown."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar
from jaxplore.belief.volume_roads import VolumeRoads

AHEAD = 4
"""Nodes along the way to the goal to the one in whose direction the robot looks."""


def goal_roads(
    roads: VolumeRoads,
    wall_room: Float[Array, "D2 H2 W2"],
    required: Scalar,
    least: Scalar,
    near: Float[Array, "D H W"],
    unknown_factor: Scalar,
) -> VolumeRoads:
    """Return the lattice on which a robot flies to its goal: unknown voxels are passable.

    A place is open if the nearest voxel known to be occupied is `least` [m] away or more
    (free-space assumption). A metre costs

        (1 + t) (1 + (unknown_factor + near^2) u)

    with t from 0 to 1 where the walls are nearer than three times `required` [m], and u 1 where the
    robot is not known to fit and 0 elsewhere. `near` is the time for which the robot has looked at
    a place from nearby, in units of its patience: what it cannot see into it flies around.

    Source: Koenig and Smirnov, "Sensor-based planning with the freespace assumption", ICRA 1997.

    `roads` are those of the places at which the robot is known to fit, and `wall_room` the least
    distance to an occupied voxel at the points of half the spacing [m].
    """
    tightness = jnp.clip(3.0 - wall_room[::2, ::2, ::2] / required, 0.0, 2.0) / 2.0
    doubt = jnp.where(roads.is_open, 0.0, unknown_factor + near * near)
    slowness = (1.0 + tightness) * (1.0 + doubt)
    return VolumeRoads(wall_room >= least, slowness, roads.origin, roads.spacing)


def goal_sources(roads: VolumeRoads, goal: Float[Array, "3"]) -> Float[Array, "D H W"]:
    """Return the cost of the open nodes around a goal as ends of a path, infinite elsewhere [m].

    These are the nodes within a spacing of the nearest open one; the cost is the straight distance.
    """
    away = jnp.where(roads.is_open, roads.distances(goal), jnp.inf)
    return jnp.where(away <= away.min() + roads.spacing, away, jnp.inf)


def way_ahead(
    costs: Float[Array, "D H W"], roads: VolumeRoads, position: Float[Array, "3"]
) -> Float[Array, "2"]:
    """Return the level direction (x, y) from a position to the node that is `AHEAD` steps down the
    costs [m] from the nearest node with a path; 0 without a path.
    """
    far = jnp.where(jnp.isfinite(costs), roads.distances(position), jnp.inf)
    here = jnp.stack(jnp.unravel_index(jnp.argmin(far), costs.shape)).astype(jnp.int32)
    wide = jnp.pad(costs, 1, constant_values=jnp.inf)

    def descend(_: Array, node: Array) -> Array:
        around = jax.lax.dynamic_slice(wide, node, (3, 3, 3))
        best = jnp.stack(jnp.unravel_index(jnp.argmin(around), around.shape))
        return node + best.astype(jnp.int32) - 1

    node = jax.lax.fori_loop(0, AHEAD, descend, here)
    gap = roads.origin + roads.spacing * jnp.flip(node).astype(jnp.float32) - position
    length = jnp.sqrt(jnp.sum(gap * gap))
    is_way = jnp.isfinite(far.min()) & (length > 0.0)
    return jnp.where(is_way, gap[:2] / jnp.where(is_way, length, 1.0), 0.0)
