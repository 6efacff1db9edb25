"""Compute the expected information of a scan from a pose by ray casting."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxplore import _kinds
from jaxplore._types import Position, Scalar
from jaxplore.geometry.rays import RayCells, traverse
from jaxplore.information.batches import over_poses
from jaxplore.information.beam import contributions
from jaxplore.information.gain import CellGains, CellSensor, cell_gains, settle
from jaxplore.information.noise import RangeNoise
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar


class PoseView(NamedTuple):
    """Contribution of each cell to the expected information of a scan.

    `cell` (B, N, 2) is (row, column) of the cells that each beam crosses, nearest first. `value`
    (B, N) is their contribution [nat], 0 for a cell that does not count.
    """

    cell: Int[Array, "B N 2"]
    value: Float[Array, "B N"]


class PoseInformation(eqx.Module):
    """Expected information of a scan from any pose [nat], by ray casting.

        I(x, yaw) = sum over beams b, cells k of w(r_bk) v_bk

    v is the contribution of a cell to its beam (`jaxplore.information.beam`). The sum is over the
    cells that a beam leaves within its range, found by exact traversal.

    Near the sensor many beams cross one cell, but a scan updates the cell only once. Therefore a
    beam gets the share `w = min(1, r dtheta)` of a cell, the arc between beams, where r is the
    distance in cells to the middle of the beam's section in the cell. Without it, 360 beams count
    four times the information of a scan.

    Cells off the map absorb beams: a beam ends there and learns nothing. A pose that is off the
    map, in an occupied cell or not finite has no information.

    For many poses on one map, `FieldSensor` computes the same without noise far faster.

    Args:
        lidar: sensor whose number of beams, range and field of view are used; its noise is not.
        sensor: update of a cell by a measurement, `InverseSensorModel()` by default. The clamp of
            the map's own model keeps known corridors from appearing informative.
        noise: range noise [m]; None for no noise.
        no_return: whether a beam that meets nothing counts; static.
        near_weight: whether near cells are shared among beams; static.
    """

    lidar: Lidar
    sensor: CellSensor
    noise: RangeNoise | None
    no_return: bool = eqx.field(static=True)
    near_weight: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        lidar: Lidar,
        sensor: CellSensor | None = None,
        *,
        noise: RangeNoise | None = None,
        no_return: bool = True,
        near_weight: bool = True,
    ) -> None:
        self.lidar = lidar
        self.sensor = InverseSensorModel() if sensor is None else sensor
        self.noise = noise
        self.no_return = _kinds.flag("no_return", no_return)
        self.near_weight = _kinds.flag("near_weight", near_weight)

    def __call__(
        self, grid: OccupancyGrid, position: Float[Array, "*N 2"], heading: Float[Array, "*N"]
    ) -> Float[Array, "*N"]:
        """Return the information of a scan from one pose, (2,) and (), or from each of N poses
        [nat]."""

        def one(position: Position, heading: Scalar) -> Scalar:
            return self.view(grid, position, heading).value.sum()

        return over_poses(one, position, heading)

    def view(self, grid: OccupancyGrid, position: Position, heading: Scalar) -> PoseView:
        """Return the contribution of each cell along each beam to the information of a scan.

        Args:
            grid: occupancy grid of the robot.
            position: world position (x, y) of the sensor [m].
            heading: world yaw of the sensor [rad].
        """
        resolution = grid.resolution
        length = self.lidar.max_range / resolution
        # Converting NaN to a cell is undefined, so a pose that is not finite is replaced here and
        # masked by `is_open`.
        is_finite = jnp.isfinite(position).all() & jnp.isfinite(heading)
        start = grid.frame.to_grid(jnp.where(is_finite, position, 0.0))
        angles = jnp.where(is_finite, heading, 0.0) - grid.frame.origin[2]
        here = grid.at_cell(jnp.floor(start).astype(jnp.int32))
        is_open = is_finite & (here <= OCCUPIED_THRESHOLD)
        shares_cells = self.near_weight and self.lidar.num_beams > 1

        def beam(angle: Scalar) -> PoseView:
            cells = traverse(start, angle, length)
            if self.noise is not None:
                cells = _only_crossed(cells)
            # A cell that the beam does not leave within its range cannot be measured as passed.
            in_range = cells.exit <= length
            is_cell = in_range & cells.is_crossed
            found = settle(grid.at_cell(cells.cell), self.sensor)
            probability = jnp.where(is_cell, found, 0.0)
            counts = is_cell & grid.contains(cells.cell) & is_open
            gains = cell_gains(probability, self.sensor)
            gains = CellGains(*(jnp.where(counts, gain, 0.0) for gain in gains))
            # The barrier keeps XLA from fusing the logarithms into each of their uses, which was
            # three times slower.
            gains = jax.lax.optimization_barrier(gains)  # type: ignore[no-untyped-call]
            edges = jnp.append(cells.entry, cells.exit[-1]) * resolution
            value = contributions(
                probability, gains, self.noise, self.no_return, edges, resolution, in_range
            )
            if shares_cells:
                middle = 0.5 * (cells.entry + cells.exit)
                value = value * jnp.minimum(1.0, middle * self.lidar.beam_spacing)
            return PoseView(cells.cell, value)

        return jax.vmap(beam)(angles + jnp.asarray(self.lidar.beam_angles))


def _only_crossed(cells: RayCells) -> RayCells:
    """Move cells that the ray only touches to the end, with length zero.

    `UniformNoise` and `ToeplitzNoise` count cells, and must not count these.
    """
    # The sort is stable: the cells that count stay in the order of their distance.
    order = jnp.argsort(~cells.is_crossed)
    cell, entry, exit_, is_crossed = (part[order] for part in cells)
    end = cells.exit[-1]
    return RayCells(
        cell, jnp.where(is_crossed, entry, end), jnp.where(is_crossed, exit_, end), is_crossed
    )
