"""Compute the information of long beams from every cell at a cost logarithmic in their length.

A ray from the centre of a cell in the direction of an integer vector (p, q) without a common
divisor passes through the centre of the cell (p, q) farther on, and from there its cells repeat.
The effect of one such period, for every cell, is a pair of maps (A, B) with

    information from here = B + A (information from one period on),

and 2, 4, 8 ... periods follow by composing a pair with its own shifted copy (theory 1.1):

    (A, B) after (A', B') = (A A', B + A B').

A beam of any length is a few of these pairs and a rest, which is followed cell by cell. The cells
of every ray are exact; only the directions are chosen, within their sectors, among periodic ones.

Near the sensor a cell counts less the closer it is, because several beams share it. There beams are
followed cell by cell, up to the distance at which they are one cell apart. That distance depends on
the number of beams, not on their length.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import GridValues
from jaxplore.geometry.rays import ray_offsets
from jaxplore.information.beam_table import near_share
from jaxplore.information.gain import CellSensor, expected_gain, settle
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid

WORTHWHILE = 140.0
"""Cells per beam, beyond those near the sensor, from which doubling is faster (measured)."""
UNROLL = 4
"""Cells that are followed per pass over the map."""


def is_faster(length: float, stride: int, spacing: float | None) -> bool:
    """Return whether doubling is faster than following every cell of beams of a length [cells]: it
    evaluates every cell whatever the `stride` between nodes. `spacing` is the angle between beams;
    None if near cells are not shared among beams."""
    # Nearer than 1 / spacing, where beams are less than a cell apart, doubling saves nothing.
    near = 0.0 if spacing is None else 1.0 / spacing
    return length - near > WORTHWHILE * stride * stride


class Segment(eqx.Module):
    """Cells of a ray that are followed one by one: offsets, shares, and a mask of the padding."""

    offset: Int[Array, "... N 2"]
    weight: Float[Array, "... N"]
    is_cell: Bool[Array, "... N"]


class Doubling(eqx.Module):
    """Beams from all cells of a map in D directions, without noise and with no return counted.

    Args:
        angles: centres (D,) of the sectors [rad].
        length: length of a beam [cells].
        stride: number of cells between the nodes whose values are returned.
        share: number of beams that each direction stands for.
        spacing: angle between beams, which gives the share of a near cell that belongs to one beam
            [rad]; None to count every cell of every beam fully.
    """

    period: Int[Array, "D 2"]
    sign: Int[Array, "D 2"]
    num_near: Int[Array, " D"]
    num_far: Int[Array, " D"]
    cells: Segment
    near: Segment
    rest: Segment
    angles: Float[Array, " D"]
    share: float = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    num_levels: int = eqx.field(static=True)
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        angles: np.ndarray,
        length: float,
        stride: int,
        *,
        share: float = 1.0,
        spacing: float | None = None,
    ) -> None:
        self.share, self.stride = float(share), stride
        near_length = 0.0 if spacing is None else min(length, 1.0 / spacing)
        # The direction may deviate by a quarter of its sector. A wider tolerance allows shorter
        # periods, and so fewer cells that are followed one by one.
        tolerance = 0.25 * 2.0 * np.pi / len(angles)
        period, sign, counts, parts = [], [], [], []
        for angle in angles:
            vector = _shortest_period(angle, tolerance)
            step = math.hypot(*vector)
            # Rays are tabulated for the first quadrant; for the others `flip` flips the map.
            positive = math.atan2(abs(vector[0]), abs(vector[1]))
            # Split the ray into cells near the sensor, whole periods, and the rest.
            ray = ray_offsets(np.array([positive]), length)
            offset, entry, leave = ray.offset[0], ray.entry[0], ray.exit[0]
            size = int(np.isfinite(leave).sum())
            # The table holds only cells that a ray leaves within its length. A length of one cell
            # more than the period includes the cell in which the next period begins.
            one = ray_offsets(np.array([positive]), step + 1.0).offset[0].tolist()
            cells = one.index([abs(vector[0]), abs(vector[1])])
            num_near = math.ceil(near_length / step - 1e-9)
            num_far = max(0, size // cells - num_near)
            split = [min(size, num_near * cells), min(size, (num_near + num_far) * cells)]
            weight = near_share(entry, leave, spacing)
            period.append(np.abs(vector))
            sign.append([-1 if part < 0 else 1 for part in vector])
            counts.append((num_near, num_far))
            parts.append(
                (
                    (np.array(one[:cells]), np.ones(cells)),
                    (offset[: split[0]], weight[: split[0]]),
                    (offset[split[1] : size], weight[split[1] : size]),
                )
            )
        self.period, self.sign = jnp.asarray(np.array(period)), jnp.asarray(np.array(sign))
        self.num_near, self.num_far = jnp.asarray(np.array(counts).T)
        self.cells, self.near, self.rest = (
            _segments([part[index] for part in parts]) for index in range(3)
        )
        self.reach = math.ceil(length) + int(np.max(period))
        self.num_levels = max(far for _, far in counts).bit_length()
        vectors = np.array(sign) * np.array(period)
        self.angles = jnp.asarray(
            np.mod(np.arctan2(vectors[:, 0], vectors[:, 1]), 2.0 * np.pi), jnp.float32
        )

    def beams(
        self, belief: OccupancyGrid, sensor: CellSensor, interest: GridValues | None = None
    ) -> Float[Array, "D rows columns"]:
        """Return the information of the beams in each direction, from every node [nat].

        `interest` is the additional information of observing each cell that a beam passes [nat].
        """
        probability = settle(belief.probability, sensor)
        gain = expected_gain(probability, sensor)
        if interest is not None:
            gain = gain + (1.0 - probability) * interest
        if belief.is_on_map is not None:
            gain = jnp.where(belief.is_on_map, gain, 0.0)
            probability = jnp.where(belief.is_on_map, probability, 1.0)
        is_open = probability <= OCCUPIED_THRESHOLD
        middle, step = self.stride // 2, self.stride
        height, width = probability.shape

        def flip(direction: Array, values: Array) -> Array:
            """Flip the map so that the beams run towards greater rows and columns."""
            down, right = self.sign[direction, 0] < 0, self.sign[direction, 1] < 0
            values = jnp.where(down, values[::-1], values)
            return jnp.where(right, values[:, ::-1], values)

        def direction(number: Array) -> Array:
            passing, worth = flip(number, 1.0 - probability), flip(number, gain)
            value = self._one(passing, worth, number)
            value = jnp.where(is_open, flip(number, value), 0.0)
            # Pad so that there is a node in every started block of cells; off the map it is 0.
            more = [-size % step if size % step <= middle else 0 for size in (height, width)]
            return jnp.pad(value, [(0, more[0]), (0, more[1])])[middle::step, middle::step]

        values: Array = jax.lax.map(direction, jnp.arange(self.period.shape[0]))
        return values

    def _one(self, passing: Array, gain: Array, direction: Array) -> Array:
        """Return the information (H, W) of the beams in one direction, from every cell.

        Longer than 60 lines because every helper shares the padded maps of the direction.
        """
        height, width = shape = passing.shape
        # Pad with zeros: off the map nothing passes and nothing is learned. Shifts beyond the map
        # are cut to its size, where everything is zero already.
        farthest = jnp.asarray([min(self.reach, height), min(self.reach, width)], jnp.int32)
        empty = jnp.zeros((height + min(self.reach, height), width + min(self.reach, width)))

        def put(buffer: Array, values: Array) -> Array:
            return jax.lax.dynamic_update_slice(buffer, values, (0, 0))

        def slice_at(buffer: Array, offset: Array) -> Array:
            row, column = jnp.minimum(offset.astype(jnp.int32), farthest)
            return jax.lax.dynamic_slice(buffer, (row, column), shape)

        # The barrier makes XLA compute the padded maps once, not once per slice that reads them.
        buffers: tuple[Array, Array] = jax.lax.optimization_barrier(  # type: ignore[no-untyped-call]
            (put(empty, passing), put(empty, gain))
        )
        passings, gains = buffers
        period = self.period[direction]

        def follow(segment: Segment, value: Array) -> Array:
            """Follow the cells of a segment from its far end to its near end."""
            last = segment.weight.shape[-1] - 1

            def nearer(block: Array, value: Array) -> Array:
                for part in range(UNROLL):
                    index = last - (block * UNROLL + part)
                    offset = segment.offset[direction, index]
                    gained = segment.weight[direction, index] * slice_at(gains, offset)
                    beyond = gained + slice_at(passings, offset) * value
                    # Padding has offset (0, 0), whose cell must not reduce the value.
                    value = jnp.where(segment.is_cell[direction, index], beyond, value)
                return value

            blocks = segment.weight.shape[-1] // UNROLL
            result: Array = jax.lax.fori_loop(0, blocks, nearer, value)
            return result

        def pass_period(block: Array, value: Array) -> Array:
            """Multiply by the probability of passing the cells of one period: A."""
            for part in range(UNROLL):
                index = block * UNROLL + part
                through = slice_at(passings, self.cells.offset[direction, index]) * value
                value = jnp.where(self.cells.is_cell[direction, index], through, value)
            return value

        blocks = self.cells.weight.shape[-1] // UNROLL
        through: Array = jax.lax.fori_loop(0, blocks, pass_period, jnp.ones(shape))
        within = follow(self.cells, jnp.zeros(shape))
        value = follow(self.rest, jnp.zeros(shape))

        def level(number: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            """Add 2^number periods if the number of periods has that bit set; then double."""
            through, within, value, position = carry
            # Periods are added from the far end towards the sensor, as the recursion runs.
            is_part = (self.num_far[direction] >> number) & 1
            position = position - (is_part << number)
            start = position * period
            value = jax.lax.cond(
                is_part == 1,
                lambda: slice_at(within, start) + slice_at(through, start) * value,
                lambda: value,
            )
            ahead = period << number
            near_through, near_within = through[:height, :width], within[:height, :width]
            return (
                put(through, near_through * slice_at(through, ahead)),
                put(within, near_within + near_through * slice_at(within, ahead)),
                value,
                position,
            )

        position = self.num_near[direction] + self.num_far[direction]
        start = (put(empty, through), put(empty, within), value, position)
        levels: tuple[Array, ...] = jax.lax.fori_loop(0, self.num_levels, level, start)
        return self.share * follow(self.near, levels[2])


def _shortest_period(angle: float, tolerance: float) -> np.ndarray:
    """Return the shortest integer vector (row, column) within a tolerance of a direction [rad]."""
    # Try all vectors of 1-norm 1, 2, 3, ...: the first hit has no common divisor.
    size = 0
    while True:
        size += 1
        rows = np.arange(-size, size + 1)
        columns = size - np.abs(rows)
        vectors = np.concatenate([np.stack([rows, columns], 1), np.stack([rows, -columns], 1)])
        off = np.arctan2(vectors[:, 0], vectors[:, 1]) - angle
        off = np.abs(np.mod(off + np.pi, 2.0 * np.pi) - np.pi)
        if off.min() <= tolerance:
            nearest: np.ndarray = vectors[np.argmin(off)]
            return nearest


def _segments(rays: list[tuple[np.ndarray, np.ndarray]]) -> Segment:
    """Pad the offsets and shares of each ray to one length, a multiple of `UNROLL`."""
    longest = max(len(weight) for _, weight in rays)
    longest = max(UNROLL, -(-longest // UNROLL) * UNROLL)
    offset = np.zeros((len(rays), longest, 2), np.int32)
    weight, is_cell = np.zeros((len(rays), longest)), np.zeros((len(rays), longest), bool)
    for index, (cells, shares) in enumerate(rays):
        offset[index, : len(shares)] = cells
        weight[index, : len(shares)] = shares
        is_cell[index, : len(shares)] = True
    return Segment(jnp.asarray(offset), jnp.asarray(weight, jnp.float32), jnp.asarray(is_cell))
