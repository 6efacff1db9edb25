"""The information of the viewpoints in a volume, computed anew where the map has changed."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Scalar
from jaxplore.belief.coarse_voxels import OCCUPIED, UNKNOWN, find_stale_columns
from jaxplore.information.stale_tiles import first_group
from jaxplore.information.voxel_table import VoxelTable
from jaxplore.maps.window import Window
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

TILE = 24
"""Most nodes along x and y that are computed at a time: their arrays fit the CPU's cache."""
BEYOND = 3
"""State of what is beyond the map."""


def update_information(
    table: VoxelTable,
    model: InverseSensorModel,
    occupancy_prior: Scalar,
    states: Int[Array, "D2 H2 W2"],
    side: float,
    changed: Bool[Array, "H2 W2"],
    before: Float[Array, "A D H W"],
) -> Float[Array, "A D H W"]:
    """Return the information of each sector from each node, computed within reach of what has
    changed [nat m^3].

    It is the information of each voxel times its volume, so that it does not depend on the
    resolution. The viewpoints of the table are every `table.stride`-th voxel, from the second one
    on. `occupancy_prior` is the probability of occupancy of an unknown voxel. `states` are those of
    the coarser voxels, with a side of `side` [m]. `changed` are the columns with a voxel that has
    changed since `before`.
    """
    depth, rows, columns = before.shape[1:]
    tile, reach, stride = (_side(rows), _side(columns)), table.reach, table.stride
    stale = find_stale_columns(changed, reach, 1, stride, (rows, columns))
    # Beyond the map nothing passes and nothing is learned: that of certainly occupied voxels.
    margin = (reach, reach + stride)
    padded = jnp.pad(states, ((0, 0), margin, margin), constant_values=BEYOND)
    cut = (padded.shape[0], *(stride * (size - 1) + 1 + 2 * reach for size in tile))
    low, high = jax.nn.sigmoid(model.minimum), jax.nn.sigmoid(model.maximum)

    def probability(of: Int[Array, "*N"]) -> Float[Array, "*N"]:
        known = jnp.where(of == OCCUPIED, high, low)
        known = jnp.where(of == UNKNOWN, occupancy_prior, known)
        return jnp.where(of == BEYOND, 1.0, known)

    def renew(state: tuple[Array, Array]) -> tuple[Array, Array]:
        is_stale, values = state
        node = first_group(is_stale, tile)
        begin = stride * node + 1
        part = probability(jax.lax.dynamic_slice(padded, (0, begin[0], begin[1]), cut))
        found = table.information(part, (1, reach, reach), (depth, *tile), model)
        at = Window(node, tile, (rows, columns))
        return at.write(is_stale, jnp.zeros(tile, bool)), at.write(values, side**3 * found)

    _, values = jax.lax.while_loop(lambda state: jnp.any(state[0]), renew, (stale, before))
    return values


def _side(number: int) -> int:
    """Return the side of tiles that cover a number of nodes with as little overlap as can be."""
    return -(-number // -(-number // TILE))
