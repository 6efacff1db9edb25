"""The lattice of the viewpoints in a volume: every second of the coarser voxels."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore.belief.volume_roads import FAR
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid

NODE = 2
"""Coarser voxels between the nodes of the lattice."""


def volume_lattice(
    grid: VoxelGrid, pool: int
) -> tuple[tuple[int, int, int], Float[Array, "3"], float]:
    """Return the numbers of nodes along z, y and x, the first node (x, y, z), and the spacing [m].

    `pool` is the number of voxels on a side of a coarser one; static.
    """
    coarse = [-(-size // pool) for size in grid.shape]
    depth, height, width = (max(1, (size - 2) // NODE + 1) for size in coarse)
    side = grid.resolution * pool
    return (depth, height, width), grid.origin + 1.5 * side, NODE * side


def points_of(coarse: Float[Array, "D2 H2 W2"], shape: tuple[int, ...]) -> Float[Array, "D3 H3 W3"]:
    """Return the coarser voxels at the points of half the spacing of a lattice of so many nodes."""
    depth, height, width = (2 * size - 1 for size in shape)
    return coarse[1:, 1:, 1:][:depth, :height, :width]


def blank_field(grid: VoxelGrid, pool: int) -> VolumeField:
    """Return a cost-to-go that is 0 at every node of `volume_lattice`."""
    shape, origin, spacing = volume_lattice(grid, pool)
    return VolumeField(jnp.zeros(shape), origin, spacing, jnp.asarray(FAR))
