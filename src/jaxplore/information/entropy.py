"""Sum the map entropy within a sensor's field of view: a simple information gain."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, GridValues, Position, Scalar
from jaxplore.geometry.rays import traverse
from jaxplore.information.batches import over_poses
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.sensing.fan import check_view
from jaxplore.sensing.lidar import Lidar

PoseGain = Callable[[OccupancyGrid, Position, Scalar], Scalar]
"""Information of a pose: `gain(grid, position, heading)` of one pose (2,) and () is a scalar."""


class EntropyFan(eqx.Module):
    """Map entropy at samples along a fan of beams [nat], with a weight that decays with range:

        I(x, y, yaw) = sum over beams b, ranges r of
                       seen(b, r) h(p(x + r cos(yaw + a_b), y + r sin(yaw + a_b))) exp(-r / l)

    with h the binary entropy of the cell that contains the sample (0 off the map), ranges r in
    `linspace(0, max_range, num_ranges)`, beam angles a_b of the lidar and the decay length l. The
    first sample of every beam is at the pose itself.

    Without line of sight every sample counts, even behind walls. With it, samples count up to the
    point at which the beam leaves the first occupied cell: the wall counts, the cells behind it do
    not. The wall is found by exact traversal, so coarse ranges cannot step over it.

    The result is a sum over samples, not the information of a scan: a cell counts as often as
    samples fall into it. `PoseInformation` predicts the information of a scan. The sum is piecewise
    constant in the pose, so its gradient is 0; the interpolated `pose_table` has a useful gradient.

    A pose that is off the map, in an occupied cell or not finite gets 0.

    Source: ground-vehicle design notes, sections 5.2 (camera, here with line of sight) and 8.1
    (lidar, without line of sight).

    Args:
        lidar: sensor whose number of beams, range and field of view are used; its noise is not.
        num_ranges: number of samples along each beam, R; static.
        decay_length: distance l at which the weight of a sample is 1/e [m]; by default the range.
        line_of_sight: whether walls occlude what is behind them; static.

    Raises:
        ValueError: no ranges, a decay length that is not positive.
    """

    lidar: Lidar
    num_ranges: int = eqx.field(static=True)
    decay_length: Scalar
    line_of_sight: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        lidar: Lidar,
        *,
        num_ranges: int = 20,
        decay_length: ArrayLike | None = None,
        line_of_sight: bool = True,
    ) -> None:
        self.lidar = lidar
        self.num_ranges = _checks.positive_int("num_ranges", num_ranges)
        decay_length = lidar.max_range if decay_length is None else decay_length
        self.decay_length = _checks.scalar("decay_length", decay_length, above=0.0)
        self.line_of_sight = _kinds.flag("line_of_sight", line_of_sight)

    @classmethod
    def camera(
        cls,
        horizontal_field_of_view: float = math.pi / 3.0,
        max_range: float = 20.0,
        *,
        num_columns: int = 30,
        num_ranges: int = 20,
        decay_length: ArrayLike | None = None,
    ) -> "EntropyFan":
        """Build the gain of a forward camera: its frustum in the plane, with line of sight.

        Args:
            horizontal_field_of_view: field of view, in (0, 2 pi] [rad], centred on the heading.
            max_range: effective depth [m].
            num_columns: number of directions, with the first and the last on the edges of the view.
            num_ranges: number of samples along each direction.
            decay_length: distance at which the weight of a sample is 1/e [m]; by default
                `max_range`.

        Raises:
            ValueError: a field of view outside (0, 2 pi], no columns or ranges, a range or decay
                length that is not positive.
        """
        view = check_view("horizontal_field_of_view", horizontal_field_of_view)
        columns = _checks.positive_int("num_columns", num_columns)
        reach = _checks.number("max_range", max_range, above=0.0)
        lidar = Lidar(num_beams=columns, max_range=reach, field_of_view=view)
        return cls(lidar, num_ranges=num_ranges, decay_length=decay_length)

    def __call__(
        self, grid: OccupancyGrid, position: Float[Array, "*N 2"], heading: Float[Array, "*N"]
    ) -> Float[Array, "*N"]:
        """Return the gain of one pose, (2,) and (), or of each of N poses [nat]."""
        entropy = grid.entropy

        def one(position: Position, heading: Scalar) -> Scalar:
            return self._at_pose(grid, entropy, position, heading)

        return over_poses(one, position, heading)

    def _at_pose(
        self, grid: OccupancyGrid, entropy: GridValues, position: Position, heading: Scalar
    ) -> Scalar:
        # Converting NaN to a cell is undefined, so a pose that is not finite is replaced here and
        # masked at the end.
        is_finite = jnp.isfinite(position).all() & jnp.isfinite(heading)
        start = grid.frame.to_grid(jnp.where(is_finite, position, 0.0))
        here = grid.at_cell(jnp.floor(start).astype(jnp.int32))
        is_open = is_finite & (here <= OCCUPIED_THRESHOLD)  # off the map the probability is 1
        yaw = jnp.where(is_finite, heading, 0.0) - grid.frame.origin[2]
        ranges = np.linspace(0.0, self.lidar.max_range, self.num_ranges)
        depth = jnp.asarray(ranges / grid.resolution, jnp.float32)
        decay = jnp.exp(-jnp.asarray(ranges, jnp.float32) / self.decay_length)
        height, width = grid.shape

        def beam(angle: Scalar) -> Scalar:
            # Grid coordinates are (row, column): rows are along y, so the sine comes first.
            direction = jnp.stack([jnp.sin(angle), jnp.cos(angle)])
            cell = jnp.floor(start + depth[:, None] * direction).astype(jnp.int32)
            # Samples off the map read an index out of bounds, which is filled with 0.
            index = cell[:, 0] * width + cell[:, 1]
            index = jnp.where(grid.contains(cell), index, height * width)
            sample = entropy.reshape(-1).at[index].get(mode="fill", fill_value=0.0)
            if self.line_of_sight:
                sample = jnp.where(depth <= self._sight(grid, start, angle), sample, 0.0)
            return (sample * decay).sum()

        total = jax.vmap(beam)(yaw + jnp.asarray(self.lidar.beam_angles)).sum()
        return jnp.where(is_open, total, 0.0)

    def _sight(self, grid: OccupancyGrid, start: Position, angle: Scalar) -> Scalar:
        """Return the distance at which a beam leaves the first occupied cell [cells]."""
        cells = traverse(start, angle, self.lidar.max_range / grid.resolution)
        # A beam that only touches the corner of a wall passes it.
        is_wall = cells.is_crossed & (grid.at_cell(cells.cell) > OCCUPIED_THRESHOLD)
        return jnp.where(is_wall, cells.exit, jnp.inf).min()


def pose_table(
    gain: PoseGain, grid: OccupancyGrid, num_headings: int = 16, *, batch_size: int = 256
) -> HeadingField:
    """Build a lookup table of a gain at every cell centre and heading of a map.

    Entry [i, j, n] of the values (H, W, num_headings) is `gain` at the centre of cell (i, j) with
    heading `n 2 pi / num_headings` from the map's x axis. A look-up is O(1), exact at the nodes,
    trilinear in between and 0 beyond the outermost centres.

    The table takes H W num_headings evaluations, `batch_size` at a time, so memory stays bounded.
    To call it repeatedly, call it from a compiled function (`equinox.filter_jit`).

    Source: ground-vehicle design notes, section 8.1.

    Args:
        gain: `gain(grid, position, heading)` of one pose, (2,) [m] and () [rad]: an `EntropyFan`,
            a `PoseInformation` or a function.
        grid: occupancy grid of the robot.
        num_headings: number of headings in the table.
        batch_size: number of poses that are evaluated at once.

    Raises:
        ValueError: no headings, an empty batch.
    """
    count = _checks.positive_int("num_headings", num_headings)
    batch = _checks.positive_int("batch_size", batch_size)
    height, width = grid.shape
    turn = 2.0 * math.pi / count

    def value(node: Array) -> Array:
        cell, index = jnp.divmod(node, count)
        position = grid.frame.cell_centre(jnp.stack(jnp.divmod(cell, width)))
        return gain(grid, position, grid.frame.origin[2] + index.astype(jnp.float32) * turn)

    nodes = jnp.arange(height * width * count)
    values = jax.lax.map(value, nodes, batch_size=min(batch, nodes.size))
    return HeadingField(values.reshape(height, width, count), grid.frame)
