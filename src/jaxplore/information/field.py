"""The information of a scan, for every pose of a map and every field of view at once."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore._types import Position, Scalar
from jaxplore.geometry.rays import ray_offsets
from jaxplore.information.gain import expected_gain
from jaxplore.maps.field import Stencil, gather, stencil
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar


class InformationField(eqx.Module):
    """Expected information of a scan at any position, heading and field of view, in O(1).

    `cumulative[d, row, column]` is the information of the beams in the first d of D equal sectors
    of the circle at a node, so that with linear interpolation over direction

        I(x, y, yaw, fov) = S(yaw + fov / 2) - S(yaw - fov / 2)                          [nat]

    (theory: a circular prefix sum over directions). Over the full circle that is the last entry.
    Bilinear between nodes, 0 off the map.
    """

    cumulative: Float[Array, "D H W"]
    total: Float[Array, "H W"]
    frame: GridFrame
    field_of_view: float = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)

    def __call__(
        self, position: Position, heading: Scalar, field_of_view: float | None = None
    ) -> Scalar:
        """Return the information of a scan [nat].

        Args:
            position: (x, y) [m].
            heading: centre of the field of view [rad].
            field_of_view: in (0, 2 pi] [rad]; static; the sensor's own when absent.
        """
        field_of_view = self.field_of_view if field_of_view is None else field_of_view
        height, width = self.total.shape
        nodes = stencil((height, width), self.frame.to_grid(position))
        if field_of_view >= 2.0 * math.pi - 1e-6:
            return gather(self.total, nodes, 0.0)
        centre = heading - self.frame.origin[2]
        upper = self._until(nodes, centre + field_of_view / 2.0)
        return upper - self._until(nodes, centre - field_of_view / 2.0)

    def _until(self, nodes: Stencil, angle: Scalar) -> Scalar:
        """Return S(angle), continued over full turns: `S(angle + 2 pi) = S(angle) + total`."""
        sectors = self.cumulative.shape[0] - 1
        sector = angle * (sectors / (2.0 * math.pi))
        turns = jnp.floor(sector / sectors)
        within = jnp.clip(sector - turns * sectors, 0.0, float(sectors))
        first = jnp.minimum(within.astype(jnp.int32), sectors - 1)
        share = within - first.astype(within.dtype)
        before = gather(self.cumulative, nodes, 0.0, first)
        after = gather(self.cumulative, nodes, 0.0, first + 1)
        return before + share * (after - before) + turns * gather(self.total, nodes, 0.0)


class FieldSensor(eqx.Module):
    """The table behind a field: which cells a lidar's beams cross, and how much each counts.

    Made once per sensor, map resolution and number of directions.

    Args:
        lidar: the sensor; its range and its beams' spacing matter here, its field of view when the
            field is looked up.
        resolution: side of a map cell [m].
        num_directions: D, directions evaluated; each stands for the beams of its sector.
        stride: cells between nodes of the field.
    """

    offset: Array
    weight: Array
    stride: int = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)

    def __init__(self, lidar: Lidar, resolution: float, num_directions: int, stride: int) -> None:
        angles = (np.arange(num_directions) + 0.5) * (2.0 * np.pi / num_directions)
        rays = ray_offsets(angles, lidar.max_range / resolution)
        distance = np.hypot(rays.offset[..., 0], rays.offset[..., 1])
        # Near the sensor many beams cross one cell, which learns from a scan only once: a beam's
        # share of a cell is the arc between beams, r dtheta cells (theory 1.3).
        share = np.minimum(1.0, distance * lidar.beam_spacing)
        beams = 2.0 * np.pi / num_directions / lidar.beam_spacing
        self.offset = jnp.asarray(rays.offset)
        self.weight = jnp.asarray(np.where(np.isfinite(rays.exit), share * beams, 0.0), jnp.float32)
        self.field_of_view, self.num_beams = lidar.field_of_view, lidar.num_beams
        self.stride = stride
        self.reach = int(np.abs(rays.offset).max())

    def field(self, belief: OccupancyGrid, model: InverseSensorModel) -> InformationField:
        """Return the information field of a belief.

        Along one direction the rays of all nodes cross the same offsets, so the beam's value, from
        its far end to its near end (noise-free sensor, no-return event included),

            V_i = w_i b_i + (1 - o_i) V_{i+1},   b = o f_occ + (1 - o) f_emp

        (`w` the near-cell weight) is one multiplication and addition of the whole shifted map per
        cell of the ray: exact cell traversal, no gather. Off the map cells absorb (o = 1, b = 0):
        nothing is learned there, so borders do not look unexplored.
        """
        height, width = belief.shape
        rows, columns = -(-height // self.stride), -(-width // self.stride)
        centre = self.stride // 2
        padding = [
            (self.reach, self.reach + (count + 1) * self.stride - size)
            for count, size in ((rows, height), (columns, width))
        ]
        passing = self._phases(1.0 - belief.probability, padding)
        # Materialised once: fused into the padding, its logarithms would be evaluated many times.
        per_cell = expected_gain(belief.probability, model)
        per_cell = jax.lax.optimization_barrier(per_cell)  # type: ignore[no-untyped-call]
        gain = self._phases(per_cell, padding)
        both = jnp.stack([passing, gain])

        def add_direction(so_far: Array, ray: tuple[Array, Array]) -> tuple[Array, Array]:
            offset, weight = ray
            last = weight.shape[0] - 1

            def nearer(step: Array, value: Array) -> Array:
                index = last - step
                row, column = offset[index] + (self.reach + centre)
                phase = (row % self.stride) * self.stride + column % self.stride
                start = (0, phase, row // self.stride, column // self.stride)
                cell = jax.lax.dynamic_slice(both, start, (2, 1, rows, columns))
                return weight[index] * cell[1, 0] + cell[0, 0] * value

            value = jax.lax.fori_loop(0, last + 1, nearer, jnp.zeros((rows, columns)))
            return so_far + value, so_far

        total, before = jax.lax.scan(
            add_direction, jnp.zeros((rows, columns)), (self.offset, self.weight)
        )
        return InformationField(
            cumulative=jnp.concatenate([before, total[None]]),
            total=total,
            frame=belief.frame.coarsen(self.stride, centre + 0.5),
            field_of_view=self.field_of_view,
            num_beams=self.num_beams,
        )

    def _phases(self, values: Array, padding: list[tuple[int, int]]) -> Array:
        """Split a padded map by `index % stride`: every strided read becomes a plain slice."""
        padded = jnp.pad(values, padding)
        height, width = (size // self.stride * self.stride for size in padded.shape)
        return jnp.stack(
            [
                padded[row : height : self.stride, column : width : self.stride]
                for row in range(self.stride)
                for column in range(self.stride)
            ]
        )
