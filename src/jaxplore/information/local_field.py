"""Compute a coarse information field around the robot, for a few headings."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._types import Position
from jaxplore._xla import on_device
from jaxplore.information.beam_table import BeamTable, window_maps
from jaxplore.information.gain import CellSensor
from jaxplore.information.heading_field import HeadingField
from jaxplore.information.pose import PoseInformation
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid

LANES = 8
"""Number of values in a vector register."""


class LocalFieldSensor(eqx.Module):
    """Evaluates the expected information of a scan on a lattice around the robot, by heading.

    It is the potential field of informative MPPI. The defaults give 10 m x 10 m at 0.5 m, so
    20 x 20 nodes, with 8 headings. The value at each node and heading is that of the given
    `PoseInformation`, with any noise and inverse sensor model. `field(...)` is the field by
    heading, (20, 20, 8). Its `.best` is the potential (20, 20), the maximum over headings, and its
    `.origin` is the position of node (0, 0).

    Beams with a common direction are evaluated once for all headings and nodes
    (`jaxplore.information.beam_table`). Therefore the nodes are at cell centres: the spacing is
    rounded to whole cells, and the middle node, (n / 2, n / 2), is in the robot's cell.

    Args:
        pose: information of a scan from a pose, with beams, field of view, range, noise and sensor
            model.
        resolution: side of a map cell [m].
        extent: half the side of the lattice [m].
        spacing: distance between nodes [m].
        num_headings: number of headings, N.

    Raises:
        ValueError: a number that is not positive, an extent below the spacing.
    """

    table: BeamTable
    sensor: CellSensor
    beams_of_heading: Float[Array, "N D"]
    num_nodes: int = eqx.field(static=True)
    spacing: float = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        pose: PoseInformation,
        resolution: float,
        *,
        extent: float = 5.0,
        spacing: float = 0.5,
        num_headings: int = 8,
    ) -> None:
        resolution = _checks.number("resolution", resolution, above=0.0)
        spacing = _checks.number("spacing", spacing, above=0.0)
        extent = _checks.number("extent", extent, at_least=spacing)
        count = _checks.positive_int("num_headings", num_headings, at_most=MOST_DIRECTIONS)
        yaws = 2.0 * np.pi / count * np.arange(count)
        beams = yaws[:, None] + np.asarray(pose.lidar.beam_angles, float)
        # Headings share beams: directions that differ by less than a microradian, which is
        # rounding, are merged.
        turned = np.mod(beams.reshape(-1) + 1e-6, 2.0 * np.pi)
        order = np.argsort(turned)
        is_new = np.diff(turned[order], prepend=-1.0) > 1e-6
        which = np.empty(len(order), int)
        which[order] = np.cumsum(is_new) - 1
        first = order[is_new]
        # A single beam has no neighbours with which it would share near cells.
        has_spacing = pose.near_weight and pose.lidar.num_beams > 1
        self.table = BeamTable(
            beams.reshape(-1)[first],
            pose.lidar.max_range / resolution,
            max(1, round(spacing / resolution)),
            spacing=pose.lidar.beam_spacing if has_spacing else None,
            noise=pose.noise,
            resolution=resolution,
            no_return=pose.no_return,
        )
        # The field by heading is then one matrix product: which beams belong to which heading.
        membership = np.zeros((count, len(first)), np.float32)
        np.add.at(membership, (np.repeat(np.arange(count), beams.shape[1]), which), 1.0)
        self.beams_of_heading = on_device(membership)
        self.sensor = pose.sensor
        self.num_nodes = round(2.0 * extent / spacing)
        self.spacing = self.table.stride * resolution

    def empty(self) -> HeadingField:
        """Return a field of the same shape as `field` returns, with zero information."""
        headings = self.beams_of_heading.shape[0]
        values = jnp.zeros((self.num_nodes, self.num_nodes, headings))
        return HeadingField(values, GridFrame(self.spacing))

    def field(self, grid: OccupancyGrid, position: Position) -> HeadingField:
        """Compute the field around a position.

        Nodes off the map or in occupied cells have no information.

        Args:
            grid: occupancy grid, of the resolution given at construction.
            position: world position (x, y) of the robot [m].
        """
        stride, count = self.table.stride, self.num_nodes
        # Round rows up to whole vector registers: extra nodes cost less than a remainder loop.
        shape = (count, -(-count // LANES) * LANES)
        # Converting NaN to a cell is undefined, so a position that is not finite is replaced here
        # and masked at the end.
        is_finite = jnp.isfinite(position).all()
        here = grid.frame.to_cell(jnp.where(is_finite, position, 0.0))
        first = here - stride * (count // 2)
        maps, corner = window_maps(self.table, grid, self.sensor, first, shape)

        def direction(number: Array) -> Array:
            return self.table.beams(maps, corner, shape, number)

        beams = jax.lax.map(direction, jnp.arange(self.table.num_directions))
        values = jnp.einsum("nd,dhw->hwn", self.beams_of_heading, beams)
        is_open = self.table.is_open(maps, corner, shape)
        values = jnp.where(is_open[..., None] & is_finite, values, 0.0)
        return HeadingField(values[:, :count], grid.frame.coarsen(stride, 0.5, first))
