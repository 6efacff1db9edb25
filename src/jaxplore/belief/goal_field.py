"""The way to a goal through a map of which parts are unknown."""

import jax.numpy as jnp

from jaxplore._types import GridMask, Position, Scalar
from jaxplore.belief.guidance import GuidanceField, downhill, geodesic, near_point, roadmap
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.occupancy_grid import OccupancyGrid

TIGHT = 5.0
"""How much more a way counts where the robot just fits."""


def goal_field(
    grid: OccupancyGrid,
    blocked: GridMask | None,
    goal: Position,
    required: Scalar,
    *,
    unknown_factor: Scalar,
    max_clearance: float,
    stride: int,
    num_layers: int,
) -> GuidanceField:
    """Return the cost to go to a goal [m], and the way there.

    The length of the shortest path on which the robot fits between what is *known* to be occupied,
    unknown space being passable: the free-space assumption. Where a path turns out to be blocked,
    the next field leads around; a robot that keeps to it arrives, or has seen that there is no way.
    Ways count `1 + 5 t^4` times, with t from 0 where there is room to 1 where the robot just fits:
    most rollouts collide there, so a way around is taken if there is one. In the unknown they count
    `1 + unknown_factor` times.

    Source: Koenig and Smirnov, "Sensor-based planning with the freespace assumption", ICRA 1997.

    Args:
        grid: the robot's map.
        blocked: (H, W) cells that may not be entered for another reason; none when absent.
        goal: (x, y) [m].
        required: clearance that the robot needs [m].
        unknown_factor: how much farther unknown space counts.
        max_clearance: bound of the clearance [m]; static.
        stride: cells between nodes; static.
        num_layers: nodes deep into what is closed that the field is continued; static.
    """
    solid = grid.is_occupied if blocked is None else grid.is_occupied | blocked
    clearance = clearance_field(solid, grid.frame, max_clearance)
    roads = roadmap(clearance, required, stride)
    rows, columns = roads.is_open.shape
    height, width = grid.shape
    is_unknown = ~grid.is_free & ~grid.is_occupied
    padded = jnp.pad(is_unknown, ((0, rows * stride - height), (0, columns * stride - width)))
    share = jnp.mean(padded.reshape(rows, stride, columns, stride), axis=(1, 3), dtype=jnp.float32)
    slowness = roads.frame.resolution * (1.0 + TIGHT * roads.tightness**4)
    slowness = slowness * (1.0 + unknown_factor * share)
    source = near_point(goal, roads.frame, roads.is_open)
    distance = geodesic(source, slowness, roads.is_open)
    return downhill(distance, roads.frame, num_layers)
