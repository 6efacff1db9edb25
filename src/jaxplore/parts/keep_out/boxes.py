"""Boxes of a volume that a robot must not enter, and in which it looks for nothing."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_NAMES
from jaxplore._types import Rows, Scalar
from jaxplore.belief.part import Part
from jaxplore.maps.voxel_grid import VoxelGrid

TOUCHING = 1e-4
"""Share of a voxel that a box may reach into it without closing it: rounding."""


class KeepOutBoxes(Part):
    """Boxes of a volume that the robot must not enter.

    A voxel that a box reaches into is closed. Paths keep from closed voxels the clearance that they
    keep from walls. The robot sees through closed voxels and maps what it sees there, but what is
    unknown there has no information.

    Args:
        boxes: (N, 6) corners (x_min, y_min, z_min, x_max, y_max, z_max) of the boxes, with z up
            [m].

    Raises:
        ValueError: no box, too many of them, a box without an extent.
    """

    name: ClassVar[str] = "keep_out"
    dimensions: ClassVar[tuple[int, ...]] = (3,)
    is_revisiting: ClassVar[bool] = False

    boxes: Float[Array, "N 6"]

    def __init__(self, boxes: Rows) -> None:
        self.boxes = _checks.array("boxes", boxes, ("N", 6))
        _checks.whole_number("number of boxes", len(self.boxes), at_least=1, at_most=MOST_NAMES)
        if not _kinds.is_traced(self.boxes):
            for index, box in enumerate(np.asarray(self.boxes, np.float64)):
                if not (box[:3] < box[3:]).all():
                    raise ValueError(
                        f"boxes[{index}] is {box.tolist()}; accepted: x_min, y_min, z_min, x_max, "
                        "y_max, z_max, each minimum below its maximum"
                    )

    def init(self, grid: VoxelGrid) -> Bool[Array, "D H W"]:
        """Return the closed voxels (D, H, W) of a map."""
        inside = []
        for axis, size in zip((2, 1, 0), grid.shape, strict=True):
            voxel = jnp.arange(size, dtype=jnp.float32)
            low, high = (
                (self.boxes[:, axis + end] - grid.origin[axis]) / grid.resolution for end in (0, 3)
            )
            is_under = low[:, None] < voxel + (1.0 - TOUCHING)
            inside.append(is_under & (high[:, None] > voxel + TOUCHING))
        z, y, x = inside
        return jnp.any(z[:, :, None, None] & y[:, None, :, None] & x[:, None, None, :], axis=0)

    def closed_cells(self, own: Bool[Array, "D H W"]) -> Bool[Array, "D H W"]:
        """Return the closed voxels (D, H, W)."""
        return own

    def distance(self, place: Float[Array, "3"]) -> Scalar:
        """Return the distance of a place (x, y, z) from the nearest box, 0 inside [m]."""
        gap = jnp.maximum(jnp.maximum(self.boxes[:, :3] - place, place - self.boxes[:, 3:]), 0.0)
        return jnp.sqrt(jnp.sum(gap * gap, axis=1)).min()
