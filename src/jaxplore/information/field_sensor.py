"""The information of a scan from every node of a lattice over a map, in all directions."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import GridValues, Position
from jaxplore.information.beam_table import BeamTable, CellMaps, window_maps
from jaxplore.information.doubling import Doubling, is_faster
from jaxplore.information.field import InformationField
from jaxplore.information.gain import CellSensor
from jaxplore.information.noise import RangeNoise
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor

TILE = 40
"""Nodes on a side of the pieces that are evaluated at a time: they stay in the cache."""
SUMS = 8
"""Directions added up at a time."""
BLOCKS = 5
"""Blocks on a side of a tile, in which changed cells are looked for."""


class Values(NamedTuple):
    """Values of sectors (D, rows, columns), and the sums of the first d of them."""

    sectors: Array
    cumulative: Array


class FieldSensor(eqx.Module):
    """What a lidar's scan is worth from every node of a lattice over a map, in all directions.

    Made once per sensor, map resolution and number of directions. It gives `PoseInformation` at its
    nodes, with one beam in the middle of each sector standing for all of the sector's.

    The cost grows with nodes x directions x cells of a beam; where beams are so long that it pays
    (`method`), with the logarithm of their length (`jaxplore.information.doubling`).

    Args:
        lidar: the sensor, a lidar or a camera; its range and its beams' spacing matter here, its
            field of view when the field is looked up. It is taken to look straight ahead over flat
            ground: hills, and what is below or above a camera's view, are not accounted for.
        resolution: side of a map cell [m].
        num_directions: D, directions evaluated; each stands for the beams of its sector.
        stride: cells between nodes of the field.
        noise: of the range [m]; None for none.
        no_return: whether a beam that meets nothing counts.
        near_weight: whether near cells are shared among beams.
        method: "scan", "doubling" (without noise, with no return), or None for the faster one.

    Raises:
        ValueError: a number that is not positive, an unknown method, doubling with noise or without
            no return.
    """

    table: BeamTable
    doubling: Doubling | None
    angles: Float[Array, " D"]
    nearby: Float[Array, "blocks blocks D"]
    field_of_view: float = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)

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
        resolution = _checks.number("resolution", resolution, above=0.0)
        count = _checks.positive_int("num_directions", num_directions)
        stride = _checks.positive_int("stride", stride)
        if method not in (None, "scan", "doubling"):
            raise ValueError(f"method is {method!r}; accepted: 'scan', 'doubling' or None")
        is_simple = noise is None and no_return
        if method == "doubling" and not is_simple:
            raise ValueError(
                "method is 'doubling'; accepted with noise or without no_return: 'scan'"
            )
        angles = (np.arange(count) + 0.5) * (2.0 * np.pi / count)
        length = lidar.max_range / resolution
        spacing = lidar.beam_spacing if near_weight and lidar.num_beams > 1 else None
        share = 2.0 * np.pi / count / lidar.beam_spacing
        self.doubling = None
        if method == "doubling" or (
            method is None and is_simple and is_faster(length, stride, spacing)
        ):
            self.doubling = Doubling(angles, length, stride, share=share, spacing=spacing)
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
        self.angles = jnp.asarray(angles, jnp.float32)
        self.nearby = jnp.asarray(_nearby(np.asarray(self.table.offset), stride), jnp.float32)
        self.field_of_view, self.num_beams = lidar.field_of_view, lidar.num_beams

    @property
    def stride(self) -> int:
        """Cells between nodes."""
        return self.table.stride

    def field(
        self,
        belief: OccupancyGrid,
        sensor: CellSensor,
        interest: GridValues | None = None,
    ) -> InformationField:
        """Return the information field of a whole map.

        Args:
            belief: the map; of the resolution that this was made for.
            sensor: what a measurement does to a cell.
            interest: (H, W) what a look into each cell is worth on top, if a beam passes it [nat]:
                what is looked for may be there, see `IdlenessMap`.
        """
        shape = self._lattice(belief)
        frame = self._frame(belief)
        if self.doubling is not None:
            sectors = self.doubling.beams(belief.probability, sensor, interest)
            empty, corner = jnp.zeros((sectors.shape[0] + 1, *shape)), jnp.zeros(2, jnp.int32)
            values = Values(sectors, _add_up(sectors, empty, corner, shape))
            return self._field(values, belief, frame)
        values = self._all(self._maps(belief, sensor, interest), self._first, shape)
        return self._field(values, belief, frame)

    def window(
        self,
        belief: OccupancyGrid,
        sensor: CellSensor,
        position: Position,
        shape: tuple[int, int],
    ) -> InformationField:
        """Return the field of a window around a position: as much as a local planner needs.

        Its cost does not depend on the size of the map. Nodes off the map have no information.

        Args:
            belief: the map; of the resolution that this was made for.
            sensor: what a measurement does to a cell.
            position: world (x, y) [m]; the node at (rows // 2, columns // 2) is in its cell.
            shape: rows and columns of nodes; static.

        Raises:
            ValueError: a window without nodes; a sensor that doubles, which needs whole maps.
        """
        rows, columns = (_checks.positive_int("shape", count) for count in shape)
        if self.doubling is not None:
            raise ValueError("method is 'doubling'; accepted for a window: 'scan'")
        is_finite = jnp.isfinite(position).all()
        here = belief.frame.to_cell(jnp.where(is_finite, position, 0.0))
        first = here - self.stride * jnp.asarray([rows // 2, columns // 2], jnp.int32)
        maps, corner = window_maps(self.table, belief, sensor, first, (rows, columns))
        frame = belief.frame.coarsen(self.stride, 0.5, first)
        values = self._all(maps, corner, (rows, columns))
        values = Values(*(jnp.where(is_finite, part, 0.0) for part in values))
        return self._field(values, belief, frame)

    def update(
        self, field: InformationField, belief: OccupancyGrid, sensor: CellSensor
    ) -> InformationField:
        """Return `field(belief, sensor)`, computing anew only what can have changed.

        A beam's value depends on the cells it crosses. Tiles of nodes are evaluated again in those
        directions in which some beam of theirs reaches a block with a changed cell; the result is
        the same to the bit.

        Args:
            field: of an earlier map, `field.source`, with the same sensor.
            belief: the map now.
            sensor: what a measurement does to a cell.

        Raises:
            ValueError: a field that is not of this whole map, such as a window.
        """
        shape = self._lattice(belief)
        if field.sectors.shape[1:] != shape or field.source.shape != belief.shape:
            raise ValueError(
                f"field has {field.sectors.shape[1:]} nodes; accepted: {shape}, those of the map"
            )
        if self.doubling is not None:
            return self.field(belief, sensor)
        tiles = tuple(-(-count // TILE) for count in shape)
        changed = self._changed_blocks(field.source != belief.probability, tiles)
        size = self.nearby.shape[0]
        touched = jax.lax.reduce_window(
            changed, False, jax.lax.bitwise_or, (size, size), (BLOCKS, BLOCKS), "VALID"
        )
        count = jnp.sum(touched, dtype=jnp.int32)
        (order,) = jnp.nonzero(touched.reshape(-1), size=tiles[0] * tiles[1], fill_value=0)
        maps = self._maps(belief, sensor)

        def renew(number: Array, values: Values) -> Values:
            tile = jnp.stack([order[number] // tiles[1], order[number] % tiles[1]])
            blocks = jax.lax.dynamic_slice(changed, tuple(tile * BLOCKS), (size, size))
            is_stale = jnp.tensordot(blocks.astype(jnp.float32), self.nearby, 2) > 0.0
            return self._renew(maps, self._first, tile * TILE, (TILE, TILE), is_stale, values)

        start = Values(field.sectors, field.cumulative)
        renewed: Values = jax.lax.fori_loop(0, count, renew, start)
        return self._field(renewed, belief, self._frame(belief))

    def _lattice(self, belief: OccupancyGrid) -> tuple[int, int]:
        height, width = belief.shape
        return -(-height // self.stride), -(-width // self.stride)

    def _frame(self, belief: OccupancyGrid) -> GridFrame:
        return belief.frame.coarsen(self.stride, self.stride // 2 + 0.5)

    @property
    def _first(self) -> Array:
        """Where the cell of node (0, 0) is in the maps of a whole belief."""
        return jnp.full(2, self.table.reach + self.stride // 2, jnp.int32)

    def _maps(
        self, belief: OccupancyGrid, sensor: CellSensor, interest: GridValues | None = None
    ) -> CellMaps:
        """Return the maps of a whole belief, with margins as wide as beams are long."""
        reach = self.table.reach
        rows, columns = (
            (reach, reach + (count + 1) * self.stride - size)
            for count, size in zip(self._lattice(belief), belief.shape, strict=True)
        )
        return self.table.maps(belief.probability, None, sensor, (rows, columns), interest)

    def _all(self, maps: CellMaps, first: Array, shape: tuple[int, int]) -> Values:
        """Evaluate a whole lattice, in strips of about equal height."""
        directions = self.table.num_directions
        start = Values(jnp.zeros((directions, *shape)), jnp.zeros((directions + 1, *shape)))
        every = jnp.ones(directions, jnp.bool_)
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
        """Evaluate the nodes of a tile in the directions that are stale.

        A tile that would stand out is moved in: what it has in common with its neighbour comes out
        the same again.
        """
        rows, columns = values.sectors.shape[1:]
        size = min(size[0], rows), min(size[1], columns)
        node = jnp.minimum(node, jnp.asarray([rows - size[0], columns - size[1]]))
        corner = first + self.stride * node.astype(jnp.int32)
        is_open = self.table.is_open(maps, corner, size)
        order = jnp.argsort(~is_stale)

        def evaluate(number: Array, sectors: Array) -> Array:
            beams = self.table.beams(maps, corner, size, order[number])
            beams = jnp.where(is_open, beams, 0.0)[None]
            return jax.lax.dynamic_update_slice(sectors, beams, (order[number], node[0], node[1]))

        count = jnp.sum(is_stale, dtype=jnp.int32)
        sectors: Array = jax.lax.fori_loop(0, count, evaluate, values.sectors)
        return Values(sectors, _add_up(sectors, values.cumulative, node, size))

    def _changed_blocks(
        self, is_changed: Array, tiles: tuple[int, ...]
    ) -> Bool[Array, "rows columns"]:
        """Say which blocks of cells hold a changed one, margins for `nearby` included."""
        side = TILE * self.stride // BLOCKS
        margin = (self.nearby.shape[0] - BLOCKS) // 2
        padding = [
            (0, count * BLOCKS * side - size)
            for count, size in zip(tiles, is_changed.shape, strict=True)
        ]
        cells = jnp.pad(is_changed, padding)
        blocks = cells.reshape(tiles[0] * BLOCKS, side, tiles[1] * BLOCKS, side)
        return jnp.pad(blocks.any(axis=(1, 3)), margin)

    def _field(self, values: Values, belief: OccupancyGrid, frame: GridFrame) -> InformationField:
        return InformationField(
            sectors=values.sectors,
            cumulative=values.cumulative,
            source=belief.probability,
            frame=frame,
            field_of_view=self.field_of_view,
            num_beams=self.num_beams,
        )


def _add_up(sectors: Array, cumulative: Array, node: Array, size: tuple[int, int]) -> Array:
    """Renew the sums over directions of a tile."""
    row, column = node

    def add(first: Array, count: int, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        so_far, cumulative = carry
        for part in range(count):
            index = first + part
            so_far = so_far + jax.lax.dynamic_slice(sectors, (index, row, column), (1, *size))
            cumulative = jax.lax.dynamic_update_slice(cumulative, so_far, (index + 1, row, column))
        return so_far, cumulative

    blocks, rest = divmod(sectors.shape[0], SUMS)
    carry: tuple[Array, Array] = jax.lax.fori_loop(
        0,
        blocks,
        lambda block, carry: add(block * SUMS, SUMS, carry),
        (jnp.zeros((1, *size)), cumulative),
    )
    return add(jnp.asarray(blocks * SUMS, row.dtype), rest, carry)[1]


def _nearby(offset: np.ndarray, stride: int) -> np.ndarray:
    """Say in which directions a beam of a tile's nodes can reach each block around the tile.

    Returns (n, n, D), n blocks with the tile's own in the middle.
    """
    side = TILE * stride // BLOCKS
    margin = -(-int(np.abs(offset).max() + stride) // side)
    reached = np.zeros((BLOCKS + 2 * margin, BLOCKS + 2 * margin, len(offset)), bool)
    low, high = stride // 2, stride // 2 + (TILE - 1) * stride
    for direction, cells in enumerate(offset):
        for row, column in np.unique(cells, axis=0):
            rows, columns = (
                slice((low + cell) // side + margin, (high + cell) // side + margin + 1)
                for cell in (row, column)
            )
            reached[rows, columns, direction] = True
    return reached
