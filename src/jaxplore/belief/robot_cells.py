"""The cells on which a robot stands, and the voxels in which it is."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Pose, Scalar
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


def free_below(
    grid: OccupancyGrid, pose: Pose, required: Scalar, sensor_model: InverseSensorModel
) -> OccupancyGrid:
    """Return a map with the cells under a robot free, at the least probability of the sensor model.

    The robot stands on free ground, whatever the prior map says: otherwise no path starts there.
    `required` is the clearance that the robot needs [m].
    """
    distance = grid.frame.distances(pose[:2], grid.shape)
    # Clearance is measured from a cell's centre and less half a cell. The additional 1.5 cells
    # give the cell of the robot the clearance that it requires.
    stands_on = distance <= required + 1.5 * grid.resolution
    if grid.is_on_map is not None:
        stands_on = stands_on & grid.is_on_map
    # Updated from 0.5 and not from the prior: a decisive model keeps cells that are occupied.
    freed = sensor_model.update(
        jnp.full(grid.shape, 0.5), jnp.where(stands_on, sensor_model.minimum, 0.0)
    )
    return grid.with_probability(jnp.where(stands_on, freed, grid.probability))


def free_around(
    grid: VoxelGrid, position: Float[Array, "3"], required: Scalar, sensor_model: InverseSensorModel
) -> VoxelGrid:
    """Return a map with the unknown voxels of the ball that a robot needs free.

    No sensor sees where the robot itself is. The voxels get the log-odds of a free voxel of the
    sensor model. `required` is the clearance that the robot needs [m].
    """
    side = grid.resolution
    depth, height, width = grid.shape
    z, y, x = jnp.meshgrid(
        *(jnp.arange(n, dtype=jnp.float32) + 0.5 for n in (depth, height, width)),
        indexing="ij",
    )
    gap = jnp.stack([z, y, x]) - grid.to_grid(position)[:, None, None, None]
    is_in = jnp.sum(gap * gap, axis=0) * side**2 <= (required + 2.0 * side) ** 2
    known = jnp.where(is_in & grid.is_unknown, sensor_model.free, grid.log_odds)
    freed: VoxelGrid = eqx.tree_at(lambda each: each.log_odds, grid, known)
    return freed
