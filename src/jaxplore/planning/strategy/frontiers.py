"""Where an exploring robot could go next: frontiers and views, by the ways that lead there."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Position, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.dwell import dwell_discount
from jaxplore.belief.guidance import Roadmap, geodesic, point_sources, roadmap
from jaxplore.maps.occupancy_grid import OccupancyGrid


class Frontiers(NamedTuple):
    """The nodes of the guidance's lattice as places to go to.

    A frontier cell is free and has an unknown one beside it (Yamauchi, "A frontier-based approach
    for autonomous exploration", CIRA 1997). The robot cannot get onto it, since it keeps from what
    is unknown: a frontier is an open node as near as it gets, and a node, to frontier cells of some
    length together. Single cells are left to noise.

    Args:
        roads: where the robot fits.
        distance: (H, W) length of the way there [m]; infinite where none leads.
        worth: (H, W) information of a scan there, less what dwelling near it has taken away [nat].
        is_frontier: (H, W) frontiers that can be reached and are worth a look.
        is_view: (H, W) nodes that can be reached and are worth a look.
        is_leftover: (H, W) nodes that can be reached and are worth a little.
    """

    roads: Roadmap
    distance: Float[Array, "H W"]
    worth: Float[Array, "H W"]
    is_frontier: Bool[Array, "H W"]
    is_view: Bool[Array, "H W"]
    is_leftover: Bool[Array, "H W"]


def prospects(
    belief: Belief,
    position: Position,
    *,
    required_clearance: Scalar,
    min_information: Scalar,
    leftover_share: Scalar,
    min_frontier: Scalar,
    stride: int,
    near: int,
) -> Frontiers:
    """Return where a robot could go.

    Args:
        belief: what it knows.
        position: where it is (x, y) [m].
        required_clearance: that it needs [m].
        min_information: below which a place is not worth a look [nat].
        leftover_share: of that, below which it is worth nothing.
        min_frontier: length of a frontier at least [m].
        stride: cells between nodes, as of the belief's fields; static.
        near: nodes between a frontier and a frontier cell at most; static.
    """
    roads = roadmap(belief.clearance, required_clearance, stride)
    start = point_sources(position, roads.frame, roads.is_open)
    distance = geodesic(start, roads.slowness, roads.is_open)
    worth = belief.information.total * dwell_discount(belief.dwell, belief.patience)
    can_reach = roads.is_open & jnp.isfinite(distance)
    length = _frontier_length(belief.grid, stride, near, roads.is_open.shape)
    is_view = can_reach & (worth >= min_information)
    return Frontiers(
        roads,
        distance,
        worth,
        is_view & (length >= min_frontier),
        is_view,
        can_reach & (worth >= leftover_share * min_information),
    )


def _frontier_length(
    grid: OccupancyGrid, stride: int, near: int, shape: tuple[int, ...]
) -> Float[Array, "H W"]:
    """Return the sides of the frontier cells in blocks up to `near` away from each node [m]."""
    p = grid.probability
    unknown = jnp.pad(4.0 * p * (1.0 - p) > 0.5, 1)
    beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
    (rows, columns), (height, width) = shape, p.shape
    padded = jnp.pad(
        grid.is_free & beside, ((0, rows * stride - height), (0, columns * stride - width))
    )
    blocks = padded.reshape(rows, stride, columns, stride).sum(axis=(1, 3), dtype=jnp.float32)
    window = (2 * near + 1, 2 * near + 1)
    around: Array = jax.lax.reduce_window(blocks, 0.0, jax.lax.add, window, (1, 1), "SAME")
    return grid.resolution * around
