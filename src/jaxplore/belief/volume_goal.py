"""The way to a goal through a volume that is partly unknown."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import Flag, Scalar
from jaxplore.belief.volume_roads import VolumeRoads
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import CERTAIN, FREE_BELOW, OCCUPIED_ABOVE, VoxelGrid

AHEAD = 4
"""Nodes along the way to the goal to the one in whose direction the robot looks."""
INSIDE = 0.9
"""Share of the radius of a goal within which the robot comes to rest: the rest is for control."""
EASE, EASE_PRICE = 0.05, 2.0
"""Room beyond the robot's radius that it seeks there [m], and metres from the goal that a metre of
it is worth."""
LOOKS_WITHIN = 4.0
"""Distance from a goal within which the robot looks for a place to see it from [m]."""
SIGHT_BEGINS, SIGHT_ENDS = 0.8, 3.0
"""Distances between which the robot looks at what is unknown around its goal [m]."""
SIGHT_TAIL = 0.5
"""End of such a line of sight that need not be known to be free [m]."""
SIGHT_EDGE = 0.1
"""Angle by which it keeps from the upper and the lower edge of the view [rad]."""
SIGHT_POINTS = 30
"""Points of a line of sight that are examined."""


def _ball(number: int) -> np.ndarray:
    """Return the points (N, 3) of a lattice that are in the unit ball, the middle first."""
    along = np.linspace(-1.0, 1.0, number)
    points = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    length = np.linalg.norm(points, axis=1)
    order = np.argsort(length, kind="stable")
    return points[order][length[order] <= 1.0 + 1e-6].astype(np.float32)


BALL = _ball(9)
"""Points (N, 3) of a unit ball."""


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


def resting_place(
    known: VolumeField,
    walls: VolumeField,
    goal: Float[Array, "3"],
    reach: Scalar,
    radius: Scalar,
) -> tuple[Float[Array, "3"], Flag]:
    """Return the place near a goal at which the robot comes to rest, and whether it is known to fit
    there.

    It is the place p with the least

        |p - goal| + 2 (radius + 0.05 m - c(p))_+,   |p - goal| <= 0.9 reach

    among those where the robot is known to fit, c(p) >= radius with c the clearance `known` [m]. If
    there is none, c is that from `walls`, and unknown space is taken to be free.

    `reach` is the radius of the goal, and `radius` that of the robot [m].
    """
    offsets = INSIDE * reach * BALL
    places, away = goal + offsets, jnp.sqrt(jnp.sum(offsets * offsets, axis=1))

    def choose(field: VolumeField) -> tuple[Array, Array]:
        room = jax.vmap(field)(places)
        cost = away + EASE_PRICE * jnp.maximum(radius + EASE - room, 0.0)
        # A place that is too narrow comes after all others.
        cost = cost + jnp.where(room >= radius, 0.0, 1e3 * (1.0 + radius - room))
        best = jnp.argmin(cost)
        return places[best], room[best] >= radius

    (here, fits), (there, _) = choose(known), choose(walls)
    return jnp.where(fits, here, there), fits


def unknown_around(grid: VoxelGrid, place: Float[Array, "3"], radius: Scalar) -> Float[Array, "3"]:
    """Return the middle of what is unknown within a radius of a place; the place without any."""
    points = place + (radius + 0.5 * grid.resolution) * BALL
    voxels = jnp.floor(grid.to_grid(points.T)).astype(jnp.int32)
    found = grid.at(voxels, outside=CERTAIN)
    weight = ((found >= FREE_BELOW) & (found <= OCCUPIED_ABOVE)).astype(jnp.float32)
    total = weight.sum()
    middle = weight @ points / jnp.maximum(total, 1.0)
    return jnp.where(total > 0.0, middle, place)


def sees(
    grid: VoxelGrid,
    elevations: tuple[float, float],
    max_range: float,
    places: Float[Array, "N 3"],
    point: Float[Array, "3"],
) -> Bool[Array, " N"]:
    """Return from which places a level robot that turns to a point would see it [m].

    It is 0.8 m to 3 m away and between the lower and the upper edge of the view, `elevations`
    [rad]. What is before it is known to be free, except for the last 0.5 m, where no wall is known.
    """
    gap = point - places
    level = jnp.sqrt(jnp.sum(gap[:, :2] ** 2, axis=1))
    length = jnp.sqrt(jnp.sum(gap * gap, axis=1))
    elevation = jnp.arctan2(gap[:, 2], level)
    low, high = elevations
    is_shown = (elevation >= low + SIGHT_EDGE) & (elevation <= high - SIGHT_EDGE)
    farthest = min(SIGHT_ENDS, 0.9 * max_range)
    is_shown = is_shown & (length >= SIGHT_BEGINS) & (length <= farthest)
    shares = jnp.linspace(0.0, 1.0, SIGHT_POINTS)
    line = places[:, :, None] + shares * gap[:, :, None]
    voxels = jnp.floor(grid.to_grid(jnp.moveaxis(line, 1, 0))).astype(jnp.int32)
    met = grid.at(voxels, outside=CERTAIN)
    is_end = (1.0 - shares) * length[:, None] <= SIGHT_TAIL
    return is_shown & ((met < FREE_BELOW) | (is_end & (met <= OCCUPIED_ABOVE))).all(axis=1)


def look_sources(
    grid: VoxelGrid,
    roads: VolumeRoads,
    elevations: tuple[float, float],
    max_range: float,
    dwell: Float[Array, "A D H W"],
    point: Float[Array, "3"],
) -> Float[Array, "D H W"]:
    """Return the cost of the nodes from which a robot would see a point [m]; infinite elsewhere.

    Each second for which the robot has looked from nearby to the point costs 1 m: what it has not
    seen by then it does not see from there. `dwell` is that time for each sector [s], and `roads`
    are those of the places at which the robot is known to fit.
    """
    x, y, z = roads.places
    places = jnp.stack([x, y, z], axis=-1)
    is_seen = sees(grid, elevations, max_range, places.reshape(-1, 3), point).reshape(x.shape)
    number = dwell.shape[0]
    turn = jnp.arctan2(point[1] - y, point[0] - x) * (number / (2.0 * jnp.pi))
    sector = jnp.floor(turn).astype(jnp.int32) % number
    spent = jnp.take_along_axis(dwell, sector[None], axis=0)[0]
    return jnp.where(is_seen & roads.is_open, spent, jnp.inf)


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
