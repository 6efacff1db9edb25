"""Entropy within a sensor's field of view: the plain gain of ground vehicles and cameras."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import GridValues, Position, Scalar
from jaxplore.geometry.rays import traverse
from jaxplore.information.batches import over_poses
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.sensing.lidar import Lidar

PoseGain = Callable[[OccupancyGrid, Position, Scalar], Scalar]
"""What a pose is worth: `gain(grid, position, heading)` of one pose (2,), () is a scalar."""


class EntropyFan(eqx.Module):
    """Entropy of the map over a fan of samples in front of a pose [nat], nearer samples first.

        I(x, y, yaw) = sum over beams b, ranges r of
                       seen(b, r) h(p(x + r cos(yaw + a_b), y + r sin(yaw + a_b))) exp(-r / l)

    with h the binary entropy of the cell that holds the sample, 0 off the map, ranges r in
    `linspace(0, max_range, num_ranges)`, beam angles a_b of the lidar and the decay length l. The
    first sample of every beam is at the pose itself.

    Without line of sight every sample is seen, through walls too. With it, those up to where the
    beam leaves the first cell known to be occupied: the wall counts, what is behind it does not.
    The wall is found by exact traversal, so none is stepped over however coarse the ranges are.

    It is a sum over samples, not the information of a scan: a cell counts as often as samples fall
    into it. `PoseInformation` is the measure that predicts what a scan brings. The sum is constant
    but for jumps where samples change cells, so its gradient in the pose is 0; the interpolated
    `pose_table` has a useful one.

    A pose off the map, in a cell known to be occupied or not finite is worth 0.

    Ground-vehicle design notes, sections 5.2 (camera, here with line of sight) and 8.1 (lidar,
    without).

    Args:
        lidar: the beams: their number, range and field of view. Its noise is not read.
        num_ranges: samples along each beam, R; static.
        decay_length: distance at which a sample counts 1/e, l [m]; the lidar's range when absent.
        line_of_sight: whether walls hide what is behind them; static.

    Raises:
        ValueError: no ranges, a decay length that is not positive.
    """

    lidar: Lidar
    num_ranges: int = eqx.field(static=True)
    decay_length: Scalar
    line_of_sight: bool = eqx.field(static=True)

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
        self.line_of_sight = bool(line_of_sight)

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
        """Return the gain of a forward camera: its frustum seen from above, with line of sight.

        Args:
            horizontal_field_of_view: in (0, 2 pi] [rad], centred on the heading.
            max_range: effective depth [m].
            num_columns: directions over the field of view, the first and last on its edges.
            num_ranges: samples along each direction.
            decay_length: distance at which a sample counts 1/e [m]; `max_range` when absent.

        Raises:
            ValueError: a field of view outside (0, 2 pi], no columns or ranges, a range or decay
                length that is not positive.
        """
        view = _checks.number(
            "horizontal_field_of_view",
            horizontal_field_of_view,
            above=0.0,
            at_most=2.0 * math.pi + 1e-6,
        )
        columns = _checks.positive_int("num_columns", num_columns)
        reach = _checks.number("max_range", max_range, above=0.0)
        lidar = Lidar(num_beams=columns, max_range=reach, field_of_view=view)
        return cls(lidar, num_ranges=num_ranges, decay_length=decay_length)

    def __call__(
        self, grid: OccupancyGrid, position: Float[Array, "*N 2"], heading: Float[Array, "*N"]
    ) -> Float[Array, "*N"]:
        """Return what one pose is worth, or each of N [nat].

        Args:
            grid: what is known.
            position: (2,) or (N, 2), world (x, y) [m].
            heading: () or (N,), world yaw [rad].

        Raises:
            ValueError: other shapes.
        """
        entropy = grid.entropy

        def one(position: Position, heading: Scalar) -> Scalar:
            return self._at_pose(grid, entropy, position, heading)

        return over_poses(one, position, heading)

    def _at_pose(
        self, grid: OccupancyGrid, entropy: GridValues, position: Position, heading: Scalar
    ) -> Scalar:
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
            direction = jnp.stack([jnp.sin(angle), jnp.cos(angle)])
            cell = jnp.floor(start + depth[:, None] * direction).astype(jnp.int32)
            index = cell[:, 0] * width + cell[:, 1]
            index = jnp.where(grid.contains(cell), index, height * width)
            sample = entropy.reshape(-1).at[index].get(mode="fill", fill_value=0.0)
            if self.line_of_sight:
                sample = jnp.where(depth <= self._sight(grid, start, angle), sample, 0.0)
            return (sample * decay).sum()

        total = jax.vmap(beam)(yaw + jnp.asarray(self.lidar.beam_angles)).sum()
        return jnp.where(is_open, total, 0.0)

    def _sight(self, grid: OccupancyGrid, start: Position, angle: Scalar) -> Scalar:
        """Return where a beam leaves the first cell known to be occupied [cells]."""
        cells = traverse(start, angle, self.lidar.max_range / grid.resolution)
        is_wall = cells.is_crossed & (grid.at_cell(cells.cell) > OCCUPIED_THRESHOLD)
        return jnp.where(is_wall, cells.exit, jnp.inf).min()


def pose_table(
    gain: PoseGain, grid: OccupancyGrid, num_headings: int = 16, *, batch_size: int = 256
) -> HeadingField:
    """Return the lookup table of a gain: its value at every cell centre and heading of a map.

    Row i, column j, n of the values (H, W, num_headings) is `gain` at the centre of cell (i, j),
    heading `n 2 pi / num_headings` from the map's x axis. A lookup is then O(1), exact at the
    nodes, trilinear in between and 0 beyond the outermost centres. Ground-vehicle design notes,
    section 8.1.

    That is H W num_headings evaluations, `batch_size` of them at a time, so memory stays bounded.
    Where it is called more than once, call it from a compiled function (`equinox.filter_jit`).

    Args:
        gain: `gain(grid, position, heading)` of one pose, (2,) [m] and () [rad]: an `EntropyFan`,
            a `PoseInformation` or a function.
        grid: what is known.
        num_headings: headings of the table.
        batch_size: poses evaluated at once.

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
