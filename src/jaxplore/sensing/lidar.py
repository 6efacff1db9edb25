"""A planar lidar: simulated scans, and what a scan does to a belief."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Key, Pose, Scalar
from jaxplore.geometry.rays import RayCells, traverse
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

ONE_HIT_IN = 3
"""So many of the beams that hit or pass a cell may be for one hit to find it occupied."""


class Scan(NamedTuple):
    """One scan: `ranges` (B,) [m], and which beams came back (B,).

    A beam that met nothing within the sensor's range has `is_return` False and the maximum range.
    """

    ranges: Float[Array, " B"]
    is_return: Bool[Array, " B"]


class Lidar(eqx.Module):
    """A planar lidar at the robot's centre.

    Args:
        num_beams: beams per scan, B.
        max_range: reach of a beam [m]; static, as the number of cells that it crosses.
        field_of_view: in (0, 2 pi] [rad], centred on the heading. Over a full circle the beams are
            2 pi / B apart and none comes twice; over less, the first and last lie on the edges.
        range_noise: standard deviation of a returned range [m].

    Raises:
        ValueError: no beams, a range that is not positive, a field of view outside (0, 2 pi], a
            negative noise.
    """

    num_beams: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    range_noise: Scalar

    def __init__(
        self,
        num_beams: int = 360,
        max_range: float = 5.0,
        field_of_view: float = 2.0 * math.pi,
        range_noise: ArrayLike = 0.02,
    ) -> None:
        self.num_beams = _checks.positive_int("num_beams", num_beams)
        self.max_range = _checks.number("max_range", max_range, above=0.0)
        self.field_of_view = _checks.number(
            "field_of_view", field_of_view, above=0.0, at_most=2.0 * math.pi + 1e-6
        )
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)

    @property
    def is_full_circle(self) -> bool:
        """Whether the field of view is 2 pi."""
        return self.field_of_view >= 2.0 * math.pi - 1e-6

    @property
    def beam_spacing(self) -> float:
        """Angle between neighbouring beams [rad]."""
        gaps = self.num_beams if self.is_full_circle else max(1, self.num_beams - 1)
        return self.field_of_view / gaps

    @property
    def beam_angles(self) -> np.ndarray:
        """Direction of each beam (B,) relative to the heading [rad]."""
        if self.num_beams == 1:
            return np.zeros(1, np.float32)
        first = -math.pi if self.is_full_circle else -self.field_of_view / 2.0
        return (first + self.beam_spacing * np.arange(self.num_beams)).astype(np.float32)

    def scan(self, world: OccupancyGrid, pose: Pose, *, key: Key) -> Scan:
        """Measure a world from a pose (x, y, yaw) [m, m, rad].

        A beam ends where it enters the first cell that is not known to be free, off the map
        included: a world's unknown cells are as solid as its walls, since nothing says what would
        be behind. Exact cell traversal; Gaussian noise on what comes back.
        """
        cells = self._cells(world, pose)
        solid = cells.is_crossed & (world.at_cell(cells.cell) >= FREE_THRESHOLD)
        entry = jnp.where(solid, cells.entry * world.resolution, jnp.inf)
        first = entry.min(axis=-1)
        is_return = first < self.max_range
        noise = self.range_noise * jax.random.normal(key, first.shape)
        ranges = jnp.clip(first + noise, 0.0, self.max_range)
        return Scan(jnp.where(is_return, ranges, self.max_range), is_return)

    def update(
        self, belief: OccupancyGrid, scan: Scan, pose: Pose, model: InverseSensorModel
    ) -> OccupancyGrid:
        """Return the belief after a scan from a pose: the inverse sensor model, cell by cell.

        A cell that a beam leaves before its reading (or before the maximum range, where nothing
        came back) was passed; the cell that holds the reading was hit. A reading lies on the face
        of its cell, and noise would put half of them into the cell in front, so the cell is taken
        `min(2 sigma, resolution / 2)` behind the reading.

        Each cell is updated once per scan however many beams cross it: as occupied if at least a
        third of those that hit or passed it hit it. A wall keeps its cells though some beams graze
        them, and one reading in fifty that noise cuts short does not close a passage beside it.
        """
        resolution = belief.resolution
        cells = self._cells(belief, pose)
        margin = jnp.minimum(2.0 * self.range_noise, 0.5 * resolution) / resolution + 1e-3
        reading = (scan.ranges / resolution)[:, None]
        is_return = scan.is_return[:, None]
        depth = reading + margin
        is_hit = is_return & (cells.entry <= depth) & (depth < cells.exit)
        is_passed = cells.exit <= reading + 1e-3
        height, width = belief.shape
        seen = cells.is_crossed & (is_hit | is_passed)
        index = cells.cell[..., 0] * width + cells.cell[..., 1]
        index = jnp.where(seen & belief.contains(cells.cell), index, height * width)
        # One scatter counts both: passes in the low half of the word, hits in the high half.
        count = (
            jnp.zeros(height * width, jnp.int32)
            .at[index.reshape(-1)]
            .add(jnp.where(is_hit, 1 << 16, 1).reshape(-1), mode="drop")
            .reshape(height, width)
        )
        hits, passes = count >> 16, count & 0xFFFF
        is_occupied = (hits > 0) & (ONE_HIT_IN * hits >= hits + passes)
        change = jnp.where(is_occupied, model.occupied, jnp.where(passes > 0, model.free, 0.0))
        updated = model.update(belief.probability, change)
        return OccupancyGrid(updated, resolution, belief.frame.origin)

    def _cells(self, grid: OccupancyGrid, pose: Pose) -> RayCells:
        start = grid.frame.to_grid(pose[:2])
        angles = pose[2] - grid.frame.origin[2] + jnp.asarray(self.beam_angles)
        length = self.max_range / grid.resolution
        return jax.vmap(lambda angle: traverse(start, angle, length))(angles)
