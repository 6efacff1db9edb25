"""Compute the expected information of scans along a trajectory with overlapping views."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import Flag, Position, Scalar
from jaxplore.information.pose import PoseInformation
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid

METHODS = ("direct", "discount", "filtered", "temporal", "occlusion")


class TrajectoryInformation(eqx.Module):
    """Expected information of scans from poses along a trajectory [nat].

    I_i is the information of the scan from pose i alone (`PoseInformation`). M_i is the set of map
    cells within its range and field of view, regardless of occlusion. n_i(c) is the number of
    earlier poses whose set contains cell c. The information of the trajectory is the sum over poses
    of

        direct      I_i
        discount    I_i exp(-decay * mean of n_i(c) over c in M_i)
        filtered    I_i * share of the cells of M_i with n_i(c) = 0: each counts at its first view
        temporal    I_i * discount^t,  t the step of pose i
        occlusion   sum over cells c of (v_i(c) - max of v_j(c), j < i)_+

    with v_i(c) the contribution of cell c to I_i, summed over beams. So "occlusion" is
    `sum_c max_i v_i(c)`: each cell counts once, for the pose that is most likely to observe it. It
    accounts for occlusion, which the plain fields of view of the other methods do not, and is a
    lower bound of the joint information of the scans (theory 1.3).

    No method exceeds "direct". "filtered" and "occlusion" equal it if the views do not overlap.

    Memory per pose depends on the range of the sensor, not on the size of the map.

    Sources: "discount" and "filtered" are methods 3 and 2 of the quadrotor design notes, "temporal"
    is the method of the ground-vehicle design notes.

    Args:
        pose: information of one scan.
        method: name of the method, one of the five; static.
        every: stride over the poses, starting with the first; static.
        decay: decay per earlier view, of "discount".
        discount: discount per step of the trajectory, of "temporal".

    Raises:
        ValueError: an unknown method, a stride below 1, a negative decay, a discount outside
            (0, 1].
    """

    pose: PoseInformation
    method: str = eqx.field(static=True)
    every: int = eqx.field(static=True)
    decay: Scalar
    discount: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        pose: PoseInformation,
        method: str = "occlusion",
        *,
        every: int = 1,
        decay: ArrayLike = 0.7,
        discount: ArrayLike = 0.95,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"method is {method!r}; accepted: {', '.join(METHODS)}")
        self.pose = pose
        self.method = method
        self.every = _checks.positive_int("every", every)
        self.decay = _checks.scalar("decay", decay, at_least=0.0)
        self.discount = _checks.scalar("discount", discount, above=0.0, at_most=1.0)

    def __call__(
        self,
        grid: OccupancyGrid,
        positions: Float[Array, "T 2"],
        headings: Float[Array, " T"] | None = None,
    ) -> Scalar:
        """Return the information of the whole trajectory [nat], the sum of `per_pose`."""
        return self.per_pose(grid, positions, headings).sum()

    def per_pose(
        self,
        grid: OccupancyGrid,
        positions: Float[Array, "T 2"],
        headings: Float[Array, " T"] | None = None,
    ) -> Float[Array, " N"]:
        """Return the information that each evaluated pose adds [nat], N = ceil(T / every).

        Args:
            grid: occupancy grid of the robot.
            positions: world positions (T, 2) as (x, y) [m], in the order of travel.
            headings: world yaws (T,) [rad]; by default the direction of travel.

        Raises:
            ValueError: no positions, other shapes.
        """
        if positions.ndim != 2 or positions.shape[0] == 0 or positions.shape[1] != 2:
            raise ValueError(f"positions has shape {positions.shape}; accepted: (T, 2) with T >= 1")
        if headings is not None and headings.shape != positions.shape[:1]:
            raise ValueError(
                f"headings has shape {headings.shape}; accepted: {positions.shape[:1]}"
            )
        # Headings come before the stride: those between every n-th position would cut corners.
        headings = path_headings(positions) if headings is None else headings
        positions, headings = positions[:: self.every], headings[:: self.every]
        if self.method == "occlusion":
            return self._new_cells(grid, positions, headings)
        values = self.pose(grid, positions, headings)
        if self.method == "direct":
            return values
        if self.method == "temporal":
            # The discount counts steps of the trajectory, not evaluated poses.
            steps = self.every * jnp.arange(values.shape[0], dtype=jnp.float32)
            return values * self.discount**steps
        before, is_first = self._overlap(grid, positions, headings)
        return values * (jnp.exp(-self.decay * before) if self.method == "discount" else is_first)

    def _new_cells(self, grid: OccupancyGrid, positions: Array, headings: Array) -> Array:
        """Return the information that each pose adds by the method "occlusion"."""
        window = _Window(grid, self.pose.lidar.max_range)
        views = jax.vmap(lambda at, yaw: self.pose.view(grid, at, yaw))(positions, headings)

        first = jax.vmap(window.first)(positions)
        seen = jax.vmap(window.gather)(first, views.cell, views.value)

        # Keep the best contribution of each cell so far. A pose adds what exceeds it.
        def add(best: Array, given: tuple[Array, Array]) -> tuple[Array, Array]:
            first, contribution = given
            known = window.read(best, first)
            better = jnp.maximum(known, contribution)
            # Sum over rows first: XLA vectorises that order.
            return window.write(best, better, first), (better - known).sum(axis=0).sum()

        _, gains = jax.lax.scan(add, window.empty(), (first, seen))
        return gains

    def _overlap(
        self, grid: OccupancyGrid, positions: Array, headings: Array
    ) -> tuple[Array, Array]:
        """Return the mean number of earlier views of the cells in each view, and the share of its
        cells without an earlier view."""
        window = _Window(grid, self.pose.lidar.max_range)

        first = jax.vmap(window.first)(positions)

        def mask_of(first: Array, position: Array, heading: Array) -> Array:
            return self._in_view(grid, window, first, position, heading)

        masks = jax.vmap(mask_of)(first, positions, headings)

        def add(views: Array, given: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
            first, mask = given
            before = window.read(views, first)
            # Integer sums can be reordered, so XLA vectorises them.
            earlier, fresh = jnp.where(mask, before, 0).sum(), (mask & (before == 0)).sum()
            seen = before + mask.astype(before.dtype)
            return window.write(views, seen, first), (earlier, fresh)

        _, (earlier, fresh) = jax.lax.scan(add, window.empty(jnp.int32), (first, masks))
        cells = masks.sum(axis=(1, 2))
        count = jnp.maximum(cells, 1).astype(jnp.float32)
        # A view that contains no cell centre overlaps with nothing.
        is_first = jnp.where(cells > 0, fresh.astype(jnp.float32) / count, 1.0)
        return earlier.astype(jnp.float32) / count, is_first

    def _in_view(
        self, grid: OccupancyGrid, window: "_Window", first: Array, position: Array, heading: Array
    ) -> Bool[Array, "n n"]:
        """Return the mask of the window's cells on the map, in range and in the field of view."""
        start = grid.frame.to_grid(position)
        steps = jnp.arange(window.size) - window.reach
        rows, columns = first[0] + steps, first[1] + steps
        height, width = grid.sides
        is_row, is_column = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
        down = (rows.astype(jnp.float32) + 0.5 - start[0])[:, None]
        right = (columns.astype(jnp.float32) + 0.5 - start[1])[None, :]
        square = down * down + right * right
        angle = heading - grid.frame.origin[2]
        ahead = right * jnp.cos(angle) + down * jnp.sin(angle)
        # Test `ahead >= distance * cos(half the field of view)` on squares, without roots or arcs.
        edge = math.cos(0.5 * self.pose.lidar.field_of_view)
        is_narrower = ahead * ahead >= square * (edge * edge)
        is_ahead = ahead >= 0.0
        in_view = is_ahead & is_narrower if edge >= 0.0 else is_ahead | ~is_narrower
        # Cells straight behind lie on the edge of a full circle, where the test above excludes
        # them.
        if self.pose.lidar.is_full_circle:
            in_view = jnp.ones_like(in_view)
        in_range = square <= (self.pose.lidar.max_range / grid.resolution) ** 2
        here = grid.at_cell(jnp.floor(start).astype(jnp.int32))
        is_finite = jnp.isfinite(position).all() & jnp.isfinite(heading)
        is_open = is_finite & (here <= OCCUPIED_THRESHOLD)
        return in_view & in_range & is_row[:, None] & is_column[None, :] & is_open


class _Window:
    """Square windows of cells around poses, of the sensor's range, on a map padded by the range."""

    def __init__(self, grid: OccupancyGrid, max_range: float) -> None:
        self.grid = grid
        self.reach = math.ceil(max_range / grid.resolution) + 1
        self.size = 2 * self.reach + 1

    def empty(self, dtype: DTypeLike = jnp.float32) -> Array:
        height, width = self.grid.shape
        return jnp.zeros((height + 2 * self.reach, width + 2 * self.reach), dtype)

    def first(self, position: Position) -> Int[Array, "2"]:
        """Return the middle cell of a window, clipped to the map.

        On the padded map it is the index at which the window begins.
        """
        # A pose off the map sees nothing, but its window still has to lie within the padded map.
        cell = self.grid.frame.to_cell(jnp.where(jnp.isfinite(position), position, 0.0))
        return jnp.clip(cell, 0, jnp.asarray(self.grid.shape, jnp.int32) - 1)

    def gather(self, first: Array, cell: Array, value: Array) -> Array:
        """Sum the values of equal cells over a window; cells outside of it are dropped."""
        local = cell + self.reach - first
        inside = ((local >= 0) & (local < self.size)).all(axis=-1)
        # Cells outside get an index past the end, which `mode="drop"` leaves out.
        index = jnp.where(inside, local[..., 0] * self.size + local[..., 1], self.size**2)
        total = jnp.zeros(self.size**2)
        total = total.at[index.reshape(-1)].add(value.reshape(-1), mode="drop")
        return total.reshape(self.size, self.size)

    def read(self, values: Array, first: Array) -> Array:
        return jax.lax.dynamic_slice(values, (first[0], first[1]), (self.size, self.size))

    def write(self, values: Array, part: Array, first: Array) -> Array:
        return jax.lax.dynamic_update_slice(values, part, (first[0], first[1]))


def path_headings(positions: Float[Array, "T 2"]) -> Float[Array, " T"]:
    """Return the direction of travel at each position [rad].

    It points from each position to the next; the last position gets the heading of the one before.
    A robot that stands still keeps its heading. The headings are 0 if it never moves.

    Args:
        positions: positions (T, 2) as (x, y) [m], in the order of travel.
    """
    if positions.shape[0] == 1:
        return jnp.zeros(1)
    step = jnp.diff(positions, axis=0)
    # A step below a micrometre has no direction. The gradient of `arctan2` is NaN at (0, 0), so
    # such a step is replaced by (1, 0).
    moves = jnp.sum(step * step, axis=-1) > 1e-12
    angle = jnp.arctan2(jnp.where(moves, step[:, 1], 0.0), jnp.where(moves, step[:, 0], 1.0))

    def keep(last: Scalar, given: tuple[Flag, Scalar]) -> tuple[Scalar, Scalar]:
        heading = jnp.where(given[0], given[1], last)
        return heading, heading

    # Before its first move the robot has the heading of that move.
    first = jnp.where(moves.any(), angle[jnp.argmax(moves)], 0.0)
    _, headings = jax.lax.scan(keep, first, (moves, angle))
    return jnp.append(headings, headings[-1])
