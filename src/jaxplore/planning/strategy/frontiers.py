"""Frontiers: the places where an exploring robot could go next, and the distances to them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.roadmap import Locomotion, Roadmap
from jaxplore.belief.volume_roads import VolumeRoads
from jaxplore.maps.occupancy_grid import OccupancyGrid


class Frontiers(NamedTuple):
    """Candidate places on the nodes of the guidance lattice, (H, W) in the plane and (D, H, W) in a
    volume, whose cells are voxels.

    A frontier cell is free and has an unknown neighbour (Yamauchi, "A frontier-based approach for
    autonomous exploration", CIRA 1997). The robot cannot reach it, since it keeps clear of unknown
    space. A frontier node is therefore a reachable node next to frontier cells of a minimum total
    length. Isolated frontier cells, which are often noise, do not make a frontier. A cluster node
    is a reachable node next to a cluster of frontier cells of that length: cells that touch, also
    at a corner.

    Args:
        roads: road map of the places where the robot fits.
        distance: length of the shortest path to each node [m]; infinite where there is none.
        worth: information of a scan from each node, discounted by the time spent near it
            [nat].
        is_frontier: frontier nodes among `is_view`.
        is_cluster: cluster nodes among `is_view`.
        is_view: nodes that can be reached and have at least `min_information`.
        is_leftover: nodes that can be reached and have at least `leftover_share` of that.
    """

    roads: Roadmap | VolumeRoads
    distance: Float[Array, "*nodes"]
    worth: Float[Array, "*nodes"]
    is_frontier: Bool[Array, "*nodes"]
    is_cluster: Bool[Array, "*nodes"]
    is_view: Bool[Array, "*nodes"]
    is_leftover: Bool[Array, "*nodes"]

    @property
    def positions(self) -> Float[Array, "*nodes D"]:
        """Position of each node: (H, W, 2) of (x, y), (D, H, W, 3) of (x, y, z) in a volume [m].

        They are in the coordinates of the belief, as the robot's pose is: relative to the datum of
        a map that is far from the origin.
        """
        indices = jnp.stack(jnp.indices(self.distance.shape), axis=-1)
        if isinstance(self.roads, VolumeRoads):
            # From layers, rows and columns to x, y and z.
            return self.roads.origin + self.roads.spacing * indices[..., ::-1].astype(jnp.float32)
        return self.roads.frame.cell_centre(indices)


def find_frontiers(
    belief: Belief,
    pose: Pose,
    locomotion: Locomotion,
    *,
    required_clearance: Scalar,
    min_information: Scalar,
    leftover_share: Scalar,
    min_frontier: Scalar,
    stride: int,
    near: int,
) -> Frontiers:
    """Find the frontiers and views that a robot can reach.

    A place whose discounted information is below `min_information` [nat] is not visited. Below the
    share `leftover_share` of that it has nothing left. `min_frontier` is the minimum length of a
    frontier, and of a cluster [m]. `near` is the largest number of nodes between a frontier node
    and its frontier cells, and `stride` the number of cells between nodes, as in the fields of the
    belief; both are static.
    """
    # The same road map as the guidance uses, so that every candidate can be driven to.
    roads = locomotion.roadmap(belief.clearance, required_clearance, stride)
    distance = roads.lengths_from(pose)
    worth = belief.worth
    can_reach = roads.is_open & jnp.isfinite(distance)
    length, longest = _frontier_lengths(belief.grid, stride, near, roads.is_open.shape)
    is_view = can_reach & (worth >= min_information)
    return Frontiers(
        roads,
        distance,
        worth,
        is_view & (length >= min_frontier),
        is_view & (longest >= min_frontier),
        is_view,
        can_reach & (worth >= leftover_share * min_information),
    )


def _frontier_lengths(
    grid: OccupancyGrid, stride: int, near: int, shape: tuple[int, ...]
) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """Compute the length of the frontier cells within `near` blocks of each node, and that of the
    longest cluster with a cell there [m]."""
    p = grid.probability
    # A cell counts as unknown above a variance of half the maximum, p between 0.15 and 0.85. The
    # padding does not: the border of the map is no frontier.
    unknown = jnp.pad(4.0 * p * (1.0 - p) > 0.5, 1)
    beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
    (rows, columns), (height, width) = shape, p.shape
    is_frontier = grid.is_free & beside
    window = (2 * near + 1, 2 * near + 1)

    def blocks(cells: Array) -> Array:
        """Return the cells of each block of the lattice (rows, stride, columns, stride)."""
        padded = jnp.pad(cells, ((0, rows * stride - height), (0, columns * stride - width)))
        return padded.reshape(rows, stride, columns, stride)

    # Over each block, then over a window of blocks.
    counted = blocks(is_frontier).sum(axis=(1, 3), dtype=jnp.float32)
    count: Array = jax.lax.reduce_window(counted, 0.0, jax.lax.add, window, (1, 1), "SAME")
    largest = blocks(cluster_sizes(is_frontier)).max(axis=(1, 3)).astype(jnp.float32)
    size: Array = jax.lax.reduce_window(largest, 0.0, jax.lax.max, window, (1, 1), "SAME")
    return grid.resolution * count, grid.resolution * size


def cluster_sizes(mask: Bool[Array, "*cells"]) -> Int[Array, "*cells"]:
    """Return the number of cells of the cluster of each cell; 0 outside the mask.

    A cluster is a set of cells that are connected by steps to neighbours within the mask, 8 in the
    plane and 26 in a volume (connected-component labelling). Each cell takes the greatest label
    around it, and then the label of the cell that this label names, until no label changes. The
    latter makes the number of rounds grow with the logarithm of the length of a cluster.
    """
    window, strides = (3,) * mask.ndim, (1,) * mask.ndim
    own = jnp.arange(mask.size, dtype=jnp.int32).reshape(mask.shape)

    def spread(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        label, _ = carry
        around = jax.lax.reduce_window(label, -1, jax.lax.max, window, strides, "SAME")
        # Labels are numbers of cells, and each cell's own label is at least its number.
        further = around.reshape(-1)[jnp.maximum(around, 0)]
        after = jnp.where(mask, further, -1)
        return after, jnp.any(after != label)

    start = jnp.where(mask, own, -1), jnp.array(True)
    label, _ = jax.lax.while_loop(lambda carry: carry[1], spread, start)
    index = jnp.maximum(label, 0)
    number = jnp.zeros(mask.size, jnp.int32).at[index].add(mask.astype(jnp.int32))
    return jnp.where(mask, number[index], 0)
