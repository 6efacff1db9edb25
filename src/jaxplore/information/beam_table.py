"""Compute the information of beams from a whole lattice of poses by shifting the map.

In one direction, the rays from all cells cross the same offsets. So the information of a beam is
computed for all poses together by a recursion over shifted maps, from the far end of the beams to
their near end: exact cell traversal without gathers. With `a = 1 - o` and f the gains of the cells,
the double sum of `jaxplore.information.beam` becomes

    V_s = o_s D_s + a_s (w_s f_emp,s K_{s+1} + V_{s+1})
    K_s = kappa_s o_s + a_s K_{s+1},            K_n = 1 if no return counts, else 0
    D_s = sum_k G_ks (w_k f_occ,k + E_k - E_s), E_k = sum_{i<k} w_i f_emp,i

w is the beam's share of a cell, `kappa_s = sum_k G_ks` the probability that noise keeps the reading
within the beam, and K the probability that the outcome of the beam counts. E_k - E_s is a sum over
the cells between s and k, so D_s depends only on cells around s within the reach of the noise.
Without noise, and with no return counted, this reduces to one multiplication and addition per cell:

    V_s = w_s b_s + a_s V_{s+1},                b = o f_occ + a f_emp
"""

import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import GridValues, Scalar
from jaxplore._xla import on_device
from jaxplore.geometry.rays import ray_offsets
from jaxplore.information.gain import CellSensor, cell_gains, expected_gain, settle
from jaxplore.information.noise import RangeNoise
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid, with_prior

UNROLL = 8
"""Cells per pass over the map: values in between stay in registers, twice as fast as one cell."""
NEGLIGIBLE = 1e-6
"""Probabilities of a reading in a cell below this are set to zero, which keeps the band narrow."""

Read = Callable[[int, Sequence[Array]], Array]
"""Function from a channel and a start index to the channel's values (rows, columns)."""


class CellMaps(eqx.Module):
    """Channels of a map, each split by `index % stride` into S = stride^2 phases.

    The split makes every strided read a slice of adjacent values. Cells in the margins absorb
    beams: off the map nothing passes (a = 0) and nothing is learned.
    """

    channels: tuple[Float[Array, "S h w"], ...]


class BeamTable(eqx.Module):
    """Table of the cells that beams from a cell's centre cross, with the weight of each cell.

    Args:
        angles: directions (D,) in the grid's frame, from the column axis to the row axis [rad].
        length: length of a beam [cells].
        stride: number of cells between the poses of the lattice.
        share: number of beams that each direction stands for.
        spacing: angle between beams, which gives the share of a near cell that belongs to one beam
            [rad]; None to count every cell of every beam fully.
        noise: range noise; None for no noise.
        resolution: side of a cell, in the unit of the noise [m].
        no_return: whether a beam that meets nothing counts.
    """

    offset: Int[Array, "D N 2"]
    weight: Float[Array, "D N"]
    length: Int[Array, " D"]
    reading: Float[Array, "D N J"]
    kept: Float[Array, "D N"]
    reach: int = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    is_simple: bool = eqx.field(static=True)
    no_return: bool = eqx.field(static=True)

    def __init__(
        self,
        angles: np.ndarray,
        length: float,
        stride: int,
        *,
        share: float = 1.0,
        spacing: float | None = None,
        noise: RangeNoise | None = None,
        resolution: float = 1.0,
        no_return: bool = True,
    ) -> None:
        rays = ray_offsets(angles, length)
        weight = np.where(rays.is_crossed, near_share(rays.entry, rays.exit, spacing) * share, 0.0)
        self.offset = on_device(rays.offset.astype(np.int32))
        self.weight = on_device(weight.astype(np.float32))
        self.reach = int(np.abs(rays.offset).max())
        self.stride = stride
        self.no_return = no_return
        self.is_simple = noise is None and no_return
        reading = _readings(rays.exit, noise, resolution)
        self.reading = on_device(reading.astype(np.float32))
        self.kept = on_device(reading.sum(axis=-1).astype(np.float32))
        self.length = on_device(rays.is_crossed.sum(axis=1).astype(np.int32))

    @property
    def num_directions(self) -> int:
        """Number of directions, D."""
        return int(self.weight.shape[0])

    def maps(
        self,
        probability: GridValues,
        is_inside: Bool[Array, "H W"] | None,
        sensor: CellSensor,
        margin: tuple[tuple[int, int], tuple[int, int]] = ((0, 0), (0, 0)),
        interest: GridValues | None = None,
    ) -> CellMaps:
        """Precompute the channels that beams read from a map or a part of it, with absorbing rows
        and columns as `margin` before and after. `interest` is the additional information of
        observing each cell that a beam passes [nat]."""
        probability = settle(probability, sensor)
        if self.is_simple:
            channels = [1.0 - probability, expected_gain(probability, sensor)]
            if interest is not None:
                # The gain is averaged over hit and pass, and interest counts only where the beam
                # passes.
                channels[1] = channels[1] + (1.0 - probability) * interest
        else:
            channels = [1.0 - probability, *cell_gains(probability, sensor)]
            if interest is not None:
                channels[2] = channels[2] + interest
        if is_inside is not None:
            channels = [jnp.where(is_inside, channel, 0.0) for channel in channels]
        # The barrier makes XLA compute the channels once. Fused into the padding, their logarithms
        # would be evaluated once per phase.
        barrier = jax.lax.optimization_barrier
        stacked: Array = barrier(jnp.stack(channels))  # type: ignore[no-untyped-call]
        step = self.stride
        # The phases have equal sizes only if the padded map is a multiple of the stride.
        fill = [
            -(sum(pair) + size) % step for pair, size in zip(margin, probability.shape, strict=True)
        ]
        padding = [(low, high + more) for (low, high), more in zip(margin, fill, strict=True)]

        def split(channel: Array) -> Array:
            # One transposition: a strided slice for each phase would be a kernel to compile each.
            padded = jnp.pad(channel, padding)
            rows, columns = (size // step for size in padded.shape)
            phases = padded.reshape(rows, step, columns, step).transpose(1, 3, 0, 2)
            return phases.reshape(step * step, rows, columns)

        return CellMaps(tuple(split(channel) for channel in stacked))

    def is_open(
        self, maps: CellMaps, first: Int[Array, "2"], shape: tuple[int, int]
    ) -> Bool[Array, "rows columns"]:
        """Return the mask of the nodes at which a robot can be: on the map and not occupied.

        `first` is the cell (row, column) of node (0, 0) in `maps`, and `shape` that of the nodes.
        """
        # Channel 0 is the probability that a beam passes: 1 - p, and 0 off the map.
        passing = self._read(maps, shape)(0, list(self._starts(first, jnp.zeros(2, jnp.int32))))
        return passing >= 1.0 - OCCUPIED_THRESHOLD

    def beams(
        self,
        maps: CellMaps,
        first: Int[Array, "2"],
        shape: tuple[int, int],
        direction: Int[Array, ""],
    ) -> Float[Array, "rows columns"]:
        """Return the information of the beams in one direction, from every node of a lattice [nat].

        `maps` are at least `reach` cells wider than the nodes on every side. `first` is the cell
        (row, column) of node (0, 0) in them. `direction` is an index.
        """
        read, start = self._read(maps, shape), self._starts(first, self.offset[direction])
        if self.is_simple:
            return self._simple(read, start, shape, direction)
        return self._general(read, start, shape, direction)

    def _starts(self, first: Array, offset: Array) -> Array:
        """Return the start indices (..., 3) of the slices at offsets (..., 2) from the nodes.

        They are computed for a whole ray at once. Computed per slice, each would add a dozen
        operations to the program.
        """
        step = self.stride
        cell = first + offset
        phase = cell % step
        return jnp.concatenate([phase[..., :1] * step + phase[..., 1:], cell // step], axis=-1)

    def _read(self, maps: CellMaps, shape: tuple[int, int]) -> Read:
        """Return a function that slices (rows, columns) of a channel at a start index."""

        def read(channel: int, start: Sequence[Array]) -> Array:
            # The margins keep every start at 0 or above. Otherwise each slice would wrap negative
            # indices around, which makes the program longer by a quarter.
            values, sizes = maps.channels[channel], (1, *shape)
            return jax.lax.dynamic_slice(values, start, sizes, allow_negative_indices=False)[0]

        return read

    def _simple(self, read: Read, start: Array, shape: tuple[int, int], direction: Array) -> Array:
        """Evaluate the recursion without noise, with no return counted."""
        # Rays are padded at their far end with cells of weight 0, where V is still 0.
        starts, weights = in_blocks(start), in_blocks(self.weight[direction])
        blocks = -(-self.length[direction] // UNROLL)

        def nearer(block: Array, value: Array) -> Array:
            nearest = (blocks - 1 - block) * UNROLL
            cells = [list(start) for start in parts_from(starts, nearest, UNROLL)]
            shares = parts_from(weights, nearest, UNROLL)
            for cell, share in zip(reversed(cells), reversed(shares), strict=True):
                value = share * read(1, cell) + read(0, cell) * value
            return value

        value: Array = jax.lax.fori_loop(0, blocks, nearer, jnp.zeros(shape))
        return value

    def _general(self, read: Read, start: Array, shape: tuple[int, int], direction: Array) -> Array:
        """Evaluate the recursion with noise, or without counting no return."""
        # `value` is V, `counted` is K, and `worth` is C relative to the first cell of the window.
        taps = self.reading.shape[-1]
        width = taps // 2
        end = 1.0 if self.no_return else 0.0
        sides = (width, width)
        # The noise reaches `width` cells beyond both ends of the ray. The shares there are 0.
        starts = jnp.pad(in_blocks(start), (sides, (0, 0)))
        weights = jnp.pad(in_blocks(self.weight[direction]), sides)
        readings, kepts = in_blocks(self.reading[direction]), in_blocks(self.kept[direction])
        length = self.length[direction]
        blocks = -(-length // UNROLL)

        def nearer(block: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            value, counted = carry
            nearest = (blocks - 1 - block) * UNROLL
            # Information C of a reading in each cell of the window, summed from its first cell.
            passed, before, worth, free = jnp.zeros(shape), [], [], []
            cells = [list(start) for start in parts_from(starts, nearest, UNROLL + 2 * width)]
            shares = parts_from(weights, nearest, UNROLL + 2 * width)
            for cell, share in zip(cells, shares, strict=True):
                before.append(passed)
                worth.append(share * read(1, cell) + passed)
                free.append(share * read(2, cell))
                passed = passed + free[-1]
            reading, kept = (parts_from(rows, nearest, UNROLL) for rows in (readings, kepts))
            for part in reversed(range(UNROLL)):
                here = part + width
                passing = read(0, cells[here])
                terms = [reading[part][tap] * worth[part + tap] for tap in range(taps)]
                of_hit = functools.reduce(jnp.add, terms) - kept[part] * before[here]
                of_pass = free[here] * counted + value
                value = (1.0 - passing) * of_hit + passing * of_pass
                # V is still 0 in the padding at the far end, but K starts at `end` and must stay
                # there.
                through = kept[part] * (1.0 - passing) + passing * counted
                counted = jnp.where(nearest + part < length, through, counted)
            return value, counted

        nothing = jnp.zeros(shape), jnp.full(shape, end)
        result: tuple[Array, Array] = jax.lax.fori_loop(0, blocks, nearer, nothing)
        return result[0]


def window_maps(
    table: BeamTable,
    belief: OccupancyGrid,
    sensor: CellSensor,
    first: Array,
    shape: tuple[int, int],
    prior: Scalar | None = None,
) -> tuple[CellMaps, Array]:
    """Return the channels around a lattice of nodes, and the position of its first node in them.

    `first` is its cell, which may be off the map, and `shape` the rows and columns of nodes;
    static. `prior` is the probability of cells that were never measured; that of the grid when
    None.
    """
    reach = table.reach
    rows, columns = (
        first[axis] - reach + jnp.arange((shape[axis] - 1) * table.stride + 2 * reach + 1)
        for axis in (0, 1)
    )
    (height, width), shape_ = belief.sides, belief.shape
    is_row, is_column = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
    # Off the map the clipped indices repeat the border, which `is_inside` masks.
    piece = belief.probability[jnp.clip(rows, 0, shape_[0] - 1)]
    piece = piece[:, jnp.clip(columns, 0, shape_[1] - 1)]
    if prior is not None:
        piece = with_prior(piece, prior)
    is_inside = is_row[:, None] & is_column[None, :]
    # Add a row and a column of phases at the far end, so that no slice reaches beyond the array.
    margin = ((0, table.stride), (0, table.stride))
    maps = table.maps(piece, is_inside, sensor, margin)
    return maps, jnp.full(2, reach, jnp.int32)


def near_share(entry: np.ndarray, exit_: np.ndarray, spacing: float | None) -> np.ndarray:
    """Return the share of each cell that belongs to one beam, `min(1, r dtheta)`.

    r is the distance to the middle of the beam's section in the cell [cells], and dtheta the angle
    between beams. Near the sensor several beams cross one cell, and each gets its share.
    """
    if spacing is None:
        return np.ones_like(entry)
    share: np.ndarray = np.minimum(1.0, 0.5 * (entry + exit_) * spacing)
    return share


def parts_from(values: Array, first: Array, count: int) -> list[Array]:
    """Return `count` entries of an array as a list, starting at index `first`."""
    some: Array = jax.lax.dynamic_slice_in_dim(values, first, count, allow_negative_indices=False)
    return [jax.lax.index_in_dim(some, part, keepdims=False) for part in range(count)]


def in_blocks(values: Array) -> Array:
    """Return values padded with zeros at their end to a multiple of `UNROLL`."""
    more = -values.shape[0] % UNROLL
    return jnp.pad(values, [(0, more)] + [(0, 0)] * (values.ndim - 1))


def _readings(exit_: np.ndarray, noise: RangeNoise | None, resolution: float) -> np.ndarray:
    """Tabulate the range noise as a band, (D, N, 2 width + 1).

    Entry [d, s, i] is the probability G of a reading in cell s - width + i of ray d, given that the
    first hit is in cell s. The width is the reach of the noise in cells.
    """
    is_cell = np.isfinite(exit_)
    directions, size = exit_.shape
    if noise is None:
        return np.where(is_cell, 1.0, 0.0)[..., None]
    # Padding cells get length zero, so that no reading falls into them.
    farthest = np.where(is_cell, exit_, 0.0).max(axis=1, keepdims=True)
    edges = np.concatenate([np.zeros((directions, 1)), np.where(is_cell, exit_, farthest)], axis=1)

    # The noise of a certain hit in each cell in turn gives the whole of G.
    @jax.jit
    def spread(line: Array) -> Array:
        return jax.vmap(lambda hit: noise.apply(hit, line, resolution))(jnp.eye(size))

    share = np.stack(
        [np.asarray(spread(jnp.asarray(line * resolution, jnp.float32)), float) for line in edges]
    )
    share *= is_cell[:, None, :] & is_cell[:, :, None]
    share[share < NEGLIGIBLE] = 0.0
    source, measured = np.nonzero(share.any(axis=0))
    width = int(np.abs(source - measured).max(initial=0))
    reading = np.zeros((directions, size, 2 * width + 1))
    for tap, shift in enumerate(range(-width, width + 1)):
        cells = np.arange(max(0, -shift), min(size, size - shift))
        reading[:, cells, tap] = share[:, cells, cells + shift]
    return reading
