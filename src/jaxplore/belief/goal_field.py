"""Compute the cost-to-go to a goal through a partly unknown map."""

import jax.numpy as jnp

from jaxplore._types import GridMask, Position, Scalar
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.roadmap import Locomotion
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.occupancy_grid import OccupancyGrid

TIGHT = 5.0
"""Additional cost per metre where the robot just fits, relative to open space. Most rollouts
collide there."""


def goal_field(
    grid: OccupancyGrid,
    blocked: GridMask | None,
    goal: Position,
    required: Scalar,
    locomotion: Locomotion,
    *,
    unknown_factor: Scalar,
    max_clearance: float,
    stride: int,
    start: Position | None = None,
    heading: Scalar | None = None,
) -> GuidanceField:
    """Return the cost-to-go to a goal [m] and the direction of its descent.

    The cost is the weighted length of the shortest path on which the robot fits between *occupied*
    cells; unknown cells are passable (free-space assumption). No path enters the cells `blocked`.
    If a path turns out to be blocked, the next field leads around. A robot that follows the field
    reaches the goal, or has observed that no path exists.

    Path length is weighted by `1 + 5 t^4`, with the tightness t from 0 in open space to 1 where the
    robot just fits, with the clearance `required` [m]. Most rollouts collide in tight passages, so
    a longer but wider path is preferred. In unknown space the length is also weighted by
    `1 + unknown_factor`.

    Source: Koenig and Smirnov, "Sensor-based planning with the freespace assumption", ICRA 1997.

    The clearance is computed up to `max_clearance` [m], and nodes are `stride` cells apart; both
    static. For `start`, the position of the robot, see `Roadmap.field`. Paths end with `heading`
    [rad]; with any when None.
    """
    solid = grid.is_occupied if blocked is None else grid.is_occupied | blocked
    clearance = clearance_field(solid, grid.frame, max_clearance)
    rows, columns = (-(-side // stride) for side in grid.shape)
    height, width = grid.shape
    # A node stands for a block of cells: weight it by the share of unknown cells in its block.
    is_unknown = ~grid.is_free & ~grid.is_occupied
    padded = jnp.pad(is_unknown, ((0, rows * stride - height), (0, columns * stride - width)))
    share = jnp.mean(padded.reshape(rows, stride, columns, stride), axis=(1, 3), dtype=jnp.float32)
    roads = locomotion.roadmap(
        clearance,
        required,
        stride,
        lambda tightness: 1.0 + TIGHT * tightness**4,
        1.0 + unknown_factor * share,
    )
    return roads.field(roads.sources_at(goal, heading), start)
