"""Compute the expected information of a scan from every node of a lattice, in all directions."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._types import GridValues, Position, Scalar
from jaxplore._xla import on_device
from jaxplore.information.beam_table import BeamTable, CellMaps, window_maps
from jaxplore.information.doubling import Doubling, is_faster
from jaxplore.information.field import InformationField
from jaxplore.information.gain import CellSensor
from jaxplore.information.noise import RangeNoise
from jaxplore.information.stale_tiles import (
    BLOCKS,
    TILE,
    find_changed_blocks,
    find_reached_blocks,
    find_touched_tiles,
    first_group,
    group_shape,
)
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.window import Window
from jaxplore.sensing.base import Sensor

SUMS = 8
"""Directions that are added up per loop iteration."""


class Values(NamedTuple):
    """Information of the sectors (D, rows, columns), and sums over the first d sectors."""

    sectors: Array
    cumulative: Array


class FieldSensor(eqx.Module):
    """Evaluates the expected information of a scan on a lattice over a map, in all directions.

    Build it once per sensor, map resolution and number of directions. At the nodes it gives
    `PoseInformation`, with one beam in the middle of each sector representing all beams of the
    sector.

    The cost is proportional to nodes x directions x cells per beam. For very long beams another
    method, whose cost grows with the logarithm of their length, is faster
    (`jaxplore.information.doubling`).

    Args:
        lidar: sensor, a lidar or a camera. Its range and beam spacing are used here, its field of
            view when the field is looked up. The view is taken as level over flat ground: hills and
            the vertical view of a camera are ignored.
        resolution: side of a map cell [m].
        num_directions: number of directions, D; each represents the beams of its sector.
        stride: number of cells between nodes of the field.
        noise: range noise [m]; None for no noise.
        no_return: whether a beam that meets nothing counts.
        near_weight: whether near cells are shared among beams.
        method: "scan", "doubling" (only without noise and with no return counted), or None for the
            faster one.

    Raises:
        ValueError: a number that is not positive, an unknown method, doubling with noise or with
            `no_return` False.
    """

    table: BeamTable
    doubling: Doubling | None
    angles: Float[Array, " D"]
    nearby: Float[Array, "blocks blocks D"]
    field_of_view: float = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        lidar: Sensor,
        resolution: float,
        num_directions: int,
        stride: int = 1,
        *,
        noise: RangeNoise | None = None,
        no_return: bool = True,
        near_weight: bool = True,
        method: str | None = None,
    ) -> None:
        _kinds.flag("no_return", no_return)
        _kinds.flag("near_weight", near_weight)
        resolution = _checks.number("resolution", resolution, above=0.0)
        count = _checks.positive_int("num_directions", num_directions, at_most=MOST_DIRECTIONS)
        stride = _checks.positive_int("stride", stride)
        if method not in (None, "scan", "doubling"):
            raise ValueError(f"method is {method!r}; accepted: 'scan', 'doubling' or None")
        is_simple = noise is None and no_return
        if method == "doubling" and not is_simple:
            raise ValueError(
                "method is 'doubling'; accepted with noise or without no_return: 'scan'"
            )
        # One beam in the middle of each sector stands for all beams of the sensor within it.
        angles = (np.arange(count) + 0.5) * (2.0 * np.pi / count)
        length = lidar.max_range / resolution
        spacing = lidar.beam_spacing if near_weight and lidar.num_beams > 1 else None
        share = 2.0 * np.pi / count / lidar.beam_spacing
        self.doubling = None
        if method == "doubling" or (
            method is None and is_simple and is_faster(length, stride, spacing)
        ):
            self.doubling = Doubling(angles, length, stride, share=share, spacing=spacing)
            # The table of single cells is then unused: keep it small.
            angles, length = np.asarray(self.doubling.angles), 1.0
        self.table = BeamTable(
            angles,
            length,
            stride,
            share=share,
            spacing=spacing,
            noise=noise,
            resolution=resolution,
            no_return=no_return,
        )
        self.angles = on_device(np.array(angles, np.float32))
        reached = find_reached_blocks(np.asarray(self.table.offset), stride)
        self.nearby = on_device(reached.astype(np.float32))
        self.field_of_view, self.num_beams = lidar.field_of_view, lidar.num_beams

    @property
    def stride(self) -> int:
        """Number of cells between nodes."""
        return self.table.stride

    def field(
        self,
        belief: OccupancyGrid,
        sensor: CellSensor,
        interest: GridValues | None = None,
        *,
        prior: Scalar | None = None,
    ) -> InformationField:
        """Compute the information field of a whole map.

        Args:
            belief: occupancy grid, of the resolution given at construction.
            sensor: update of a cell by a measurement.
            interest: additional information (H, W) of observing each cell that a beam passes [nat],
                for example of search or patrol; see `IdlenessMap`.
            prior: probability of occupancy of the cells that were never measured, see
                `OccupancyGrid.with_prior`; that of the grid when absent.
        """
        shape = self._lattice(belief)
        frame, source = self._frame(belief), belief.probability
        if prior is not None:
            belief = belief.with_prior(prior)
        if self.doubling is not None:
            sectors = self.doubling.beams(belief, sensor, interest)
            empty, corner = jnp.zeros((sectors.shape[0] + 1, *shape)), jnp.zeros(2, jnp.int32)
            values = Values(sectors, _add_up(sectors, empty, corner, shape))
            return self._field(values, source, frame)
        values = self._all(self._maps(belief, sensor, interest), self._first, shape)
        return self._field(values, source, frame)

    def window(
        self,
        belief: OccupancyGrid,
        sensor: CellSensor,
        position: Position,
        shape: tuple[int, int],
        *,
        prior: Scalar | None = None,
    ) -> InformationField:
        """Compute the information field of a window around a position, for a local planner.

        The cost does not depend on the size of the map. Nodes off the map have no information.

        Args:
            belief: occupancy grid, of the resolution given at construction.
            sensor: update of a cell by a measurement.
            position: world position (x, y) [m]; node (rows // 2, columns // 2) is in its cell.
            shape: rows and columns of nodes; static.
            prior: as in `field`.

        Raises:
            ValueError: a window without nodes; the method "doubling", which needs whole maps.
        """
        rows, columns = (_checks.positive_int("shape", count) for count in shape)
        if self.doubling is not None:
            raise ValueError("method is 'doubling'; accepted for a window: 'scan'")
        is_finite = jnp.isfinite(position).all()
        here = belief.frame.to_cell(jnp.where(is_finite, position, 0.0))
        first = here - self.stride * jnp.asarray([rows // 2, columns // 2], jnp.int32)
        maps, corner = window_maps(self.table, belief, sensor, first, (rows, columns), prior)
        frame = belief.frame.coarsen(self.stride, 0.5, first)
        values = self._all(maps, corner, (rows, columns))
        values = Values(*(jnp.where(is_finite, part, 0.0) for part in values))
        return self._field(values, belief.probability, frame)

    def update(
        self,
        field: InformationField,
        belief: OccupancyGrid,
        sensor: CellSensor,
        *,
        prior: Scalar | None = None,
    ) -> InformationField:
        """Return `field(belief, sensor, prior=prior)`, recomputing only what can have changed.

        The information of a beam depends on the cells that it crosses. A tile of nodes is evaluated
        again in the directions in which one of its beams reaches a block with a changed cell. The
        result equals that of `field` to the bit.

        Args:
            field: field of an earlier map, `field.source`, computed with the same sensor and prior.
            belief: present occupancy grid.
            sensor: update of a cell by a measurement.
            prior: as in `field`.

        Raises:
            ValueError: a field that is not of this whole map, such as a window.
        """
        shape = self._lattice(belief)
        if field.sectors.shape[1:] != shape or field.source.shape != belief.shape:
            raise ValueError(
                f"field has {field.sectors.shape[1:]} nodes; accepted: {shape}, those of the map"
            )
        if self.doubling is not None:
            # Doubling works on whole maps only.
            return self.field(belief, sensor, prior=prior)
        size, tiles = self.nearby.shape[0], (-(-shape[0] // TILE), -(-shape[1] // TILE))
        is_changed = field.source != belief.probability
        changed = find_changed_blocks(is_changed, tiles, self.stride, (size - BLOCKS) // 2)
        touched = find_touched_tiles(changed, size)
        # The maps that beams read are computed for a group of tiles at a time: their cost is that
        # of what is around the changes, and not of the whole map.
        group = group_shape(tiles, self.table.reach, self.stride)

        def renew_group(carry: tuple[Values, Array, Array]) -> tuple[Values, Array, Array]:
            values, source, pending = carry
            first = first_group(pending, group)
            here = jax.lax.dynamic_slice(pending, tuple(first), group)
            # Shapes are static, so the list has room for all tiles. The loop visits only the first
            # of them.
            (order,) = jnp.nonzero(here.reshape(-1), size=here.size, fill_value=0)
            nodes = group[0] * TILE, group[1] * TILE
            cell = self.stride // 2 + self.stride * TILE * first
            maps, corner = window_maps(self.table, belief, sensor, cell, nodes, prior)
            origin = corner - self.stride * TILE * first

            def renew(number: Array, values: Values) -> Values:
                row, column = order[number] // group[1], order[number] % group[1]
                tile = first + jnp.stack([row, column]).astype(jnp.int32)
                # A direction is stale if one of its beams reaches a changed block: a sum of
                # products over blocks is a fast way to take `any`.
                blocks = jax.lax.dynamic_slice(changed, tuple(tile * BLOCKS), (size, size))
                is_stale = jnp.tensordot(blocks.astype(jnp.float32), self.nearby, 2) > 0.0
                return self._renew(maps, origin, tile * TILE, (TILE, TILE), is_stale, values)

            count = jnp.sum(here, dtype=jnp.int32)
            values = jax.lax.fori_loop(0, count, renew, values)
            # The tile of a changed cell is touched, so all changed cells are in a group.
            cells = Window.at(
                self.stride * TILE * first, [self.stride * each for each in nodes], belief.shape
            )
            source = cells.write(source, cells.read(belief.probability))
            rest = jax.lax.dynamic_update_slice(pending, jnp.zeros_like(here), tuple(first))
            return values, source, rest

        start = Values(field.sectors, field.cumulative), field.source, touched
        values, source, _ = jax.lax.while_loop(lambda carry: carry[2].any(), renew_group, start)
        return self._field(values, source, self._frame(belief))

    def _lattice(self, belief: OccupancyGrid) -> tuple[int, int]:
        height, width = belief.shape
        return -(-height // self.stride), -(-width // self.stride)

    def _frame(self, belief: OccupancyGrid) -> GridFrame:
        return belief.frame.coarsen(self.stride, self.stride // 2 + 0.5)

    @property
    def _first(self) -> Array:
        """Cell (row, column) of node (0, 0) in the padded maps of a whole grid."""
        return jnp.full(2, self.table.reach + self.stride // 2, jnp.int32)

    def _maps(
        self, belief: OccupancyGrid, sensor: CellSensor, interest: GridValues | None = None
    ) -> CellMaps:
        """Return the channels of a whole grid, with margins as wide as the beams are long."""
        reach = self.table.reach
        rows, columns = (
            (reach, reach + (count + 1) * self.stride - size)
            for count, size in zip(self._lattice(belief), belief.shape, strict=True)
        )
        return self.table.maps(
            belief.probability, belief.is_on_map, sensor, (rows, columns), interest
        )

    def _all(self, maps: CellMaps, first: Array, shape: tuple[int, int]) -> Values:
        """Evaluate a whole lattice, in strips of roughly equal height."""
        directions = self.table.num_directions
        start = Values(jnp.zeros((directions, *shape)), jnp.zeros((directions + 1, *shape)))
        every = jnp.ones(directions, jnp.bool_)
        # Equal heights, because a last strip that is moved inwards is computed twice where it
        # overlaps.
        count = -(-shape[0] // TILE)
        height = -(-shape[0] // count)

        def strip(index: Array, values: Values) -> Values:
            node = jnp.stack([index * height, jnp.zeros((), jnp.int32)])
            return self._renew(maps, first, node, (height, shape[1]), every, values)

        values: Values = jax.lax.fori_loop(0, count, strip, start)
        return values

    def _renew(
        self,
        maps: CellMaps,
        first: Array,
        node: Array,
        size: tuple[int, int],
        is_stale: Bool[Array, " D"],
        values: Values,
    ) -> Values:
        """Evaluate the nodes of a tile in the stale directions.

        A tile that would extend beyond the lattice is moved inwards. Nodes that it then shares with
        its neighbour are recomputed with the same result.
        """
        rows, columns = values.sectors.shape[1:]
        size = min(size[0], rows), min(size[1], columns)
        node = jnp.minimum(node, jnp.asarray([rows - size[0], columns - size[1]]))
        corner = first + self.stride * node.astype(jnp.int32)
        is_open = self.table.is_open(maps, corner, size)
        # The stale directions come first, so that a loop over their number visits just them.
        order = jnp.argsort(~is_stale)

        def evaluate(number: Array, sectors: Array) -> Array:
            beams = self.table.beams(maps, corner, size, order[number])
            beams = jnp.where(is_open, beams, 0.0)[None]
            at = order[number], node[0], node[1]
            return jax.lax.dynamic_update_slice(sectors, beams, at, allow_negative_indices=False)

        count = jnp.sum(is_stale, dtype=jnp.int32)
        sectors: Array = jax.lax.fori_loop(0, count, evaluate, values.sectors)
        return Values(sectors, _add_up(sectors, values.cumulative, node, size))

    def _field(self, values: Values, source: GridValues, frame: GridFrame) -> InformationField:
        return InformationField(
            sectors=values.sectors,
            cumulative=values.cumulative,
            source=source,
            frame=frame,
            field_of_view=self.field_of_view,
            num_beams=self.num_beams,
        )


def _add_up(sectors: Array, cumulative: Array, node: Array, size: tuple[int, int]) -> Array:
    """Recompute the cumulative sums over directions for the nodes of a tile."""
    row, column = node

    def add(first: Array, count: int, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        so_far, cumulative = carry
        for part in range(count):
            index = first + part
            so_far = so_far + jax.lax.dynamic_slice(
                sectors, (index, row, column), (1, *size), allow_negative_indices=False
            )
            cumulative = jax.lax.dynamic_update_slice(
                cumulative, so_far, (index + 1, row, column), allow_negative_indices=False
            )
        return so_far, cumulative

    blocks, rest = divmod(sectors.shape[0], SUMS)
    carry: tuple[Array, Array] = jax.lax.fori_loop(
        0,
        blocks,
        lambda block, carry: add(block * SUMS, SUMS, carry),
        (jnp.zeros((1, *size)), cumulative),
    )
    return add(jnp.asarray(blocks * SUMS, row.dtype), rest, carry)[1]
