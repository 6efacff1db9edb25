"""Compute cost-to-go fields over known free space, which lead to remaining information."""

import functools
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore._types import Position, Scalar
from jaxplore.maps.field import ScalarField, Stencil, gather, stencil
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DIAGONAL = 2.0**0.5
"""Length of a step to a diagonal neighbour [node spacings]."""
ROOMY = 3.0
"""Ratio of clearance to required clearance above which a path has no extra cost."""
TILE = 24
"""Nodes on a side of the tiles that are relaxed at a time: a tile fits the CPU's cache."""
SWEEPS = 4
"""Sweeps between two checks for convergence; a check costs as much as a sweep."""
LAYERS = 4
"""Number of layers of closed nodes into which the fields of the robot are extended."""
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Steps (row, column) to the neighbours: the straight ones first, then the diagonal ones."""


class GuidanceField(eqx.Module):
    """Cost-to-go and its direction of descent, read by bilinear interpolation in O(1).

    Args:
        values: cost-to-go (H, W) [m]; only differences matter.
        descent: unit vectors (2, H, W) as (x, y) in the world along which it falls; 0 at a minimum.
        frame: pose and node spacing of the lattice.
        outside: cost-to-go off the lattice [m].
    """

    values: Float[Array, "H W"]
    descent: Float[Array, "2 H W"]
    frame: GridFrame
    outside: Scalar

    def __call__(self, position: Position) -> Scalar:
        """Return the cost-to-go at a world position (x, y) [m]."""
        return gather(self.values, self._around(position), self.outside)

    def plot(self) -> "Figure":
        """Draw the cost-to-go in the world, with a colour bar."""
        return lattice_figure(self.values, self.frame, "cost to go [m]")

    def direction(self, position: Position) -> Position:
        """Return the direction of descent (x, y) at a world position.

        Its length is at most 1: shorter where directions of neighbouring nodes differ, and 0 at a
        minimum.
        """
        around = self._around(position)
        return jnp.stack([gather(self.descent, around, 0.0, axis) for axis in (0, 1)])

    def _around(self, position: Position) -> Stencil:
        height, width = self.values.shape
        return stencil((height, width), self.frame.to_grid(position))


class Roadmap(NamedTuple):
    """Lattice of the places in which a disc robot fits.

    `frame` is the pose and node spacing of the lattice. `tightness` (H, W) is 0 in open space and 1
    where the robot just fits. `is_open` (H, W) is the mask of the nodes at which it fits.
    """

    frame: GridFrame
    tightness: Float[Array, "H W"]
    is_open: Bool[Array, "H W"]

    @property
    def slowness(self) -> Float[Array, "H W"]:
        """Cost of a step of one node spacing (H, W) [m], doubled where the robot just fits."""
        return self.frame.resolution * (1.0 + self.tightness)


def roadmap(clearance: ScalarField, required: Scalar, stride: int) -> Roadmap:
    """Build the lattice of places in which the robot fits, with one node per block of cells.

    A node is open if the robot fits at any cell of its block. The tightness lets costs keep paths
    in the middle of passages.

    Args:
        clearance: distance to the nearest blocked cell [m].
        required: clearance that the robot needs [m].
        stride: number of cells on a side of a block; static.
    """
    frame = clearance.frame.coarsen(stride, stride / 2.0)
    height, width = clearance.values.shape
    rows, columns = -(-height // stride), -(-width // stride)
    # Pad with 0, which is closed, so that the map's last blocks are complete.
    padded = jnp.pad(clearance.values, ((0, rows * stride - height), (0, columns * stride - width)))
    room = padded.reshape(rows, stride, columns, stride).max(axis=(1, 3))
    spare = (room - required) / required
    tightness = jnp.clip(1.0 - spare / (ROOMY - 1.0), 0.0, 1.0)
    # The tolerance absorbs rounding: a passage of exactly the required width is open.
    return Roadmap(frame, tightness, room >= required - 1e-4)


def descent_field(
    distance: Float[Array, "H W"], frame: GridFrame, num_layers: int
) -> GuidanceField:
    """Return a cost-to-go on a lattice as a field, extended into closed nodes.

    Args:
        distance: cost-to-go (H, W) from `geodesic` [m], infinite at closed nodes.
        frame: pose and node spacing of the lattice.
        num_layers: number of layers of closed nodes into which the field is extended; static.
    """
    # Rotate the descent from the axes of the lattice to those of the world.
    along_row, along_column = descent(distance, num_layers)
    cos, sin = jnp.cos(frame.origin[2]), jnp.sin(frame.origin[2])
    direction = [cos * along_column - sin * along_row, sin * along_column + cos * along_row]
    return GuidanceField(
        values=extend(distance, num_layers, jnp.asarray(3.0 * frame.resolution)),
        descent=jnp.stack(direction),
        frame=frame,
        # Costlier than any place on the map, leftovers a kilometre away included.
        outside=jnp.asarray(1e4),
    )


def point_sources(
    point: Position, frame: GridFrame, is_open: Bool[Array, "H W"]
) -> Float[Array, "H W"]:
    """Return the sources of `geodesic` for paths that end at a point.

    These are the open nodes nearest to the point, within a node spacing, with their distance to the
    point [m]. All other nodes are infinite.

    Args:
        point: position (x, y) at which paths end [m].
        frame: pose and node spacing of the lattice.
        is_open: mask (H, W) of the nodes that paths may use.
    """
    rows, columns = is_open.shape
    centres = frame.cell_centre(jnp.stack(jnp.mgrid[:rows, :columns], axis=-1))
    offset = centres - point
    distance = jnp.where(is_open, jnp.sqrt((offset * offset).sum(axis=-1)), jnp.inf)
    # With the nearest node alone, paths from other sides would pass the point and come back.
    is_nearest = distance <= distance.min() + frame.resolution
    return jnp.where(is_nearest, distance, jnp.inf)


def geodesic(
    initial: Float[Array, "H W"], slowness: Float[Array, "H W"], is_open: Bool[Array, "H W"]
) -> Float[Array, "H W"]:
    """Return the cost-to-go `min over s of initial(s) + cost of the shortest path from s`.

    Paths connect each open node with its 8 neighbours. A step of length l, in node spacings, costs
    `l * (slowness(from) + slowness(to)) / 2`. The values are those of Dijkstra's algorithm, found
    by relaxing many nodes at once until none changes (Bellman-Ford), which on a grid is a minimum
    of shifted arrays.

    On accelerators all nodes are relaxed at once; the number of sweeps is the number of steps of
    the longest shortest path. On a CPU tiles are relaxed one after another, the tile with the
    smallest new value at its edge first, so most tiles are visited only a few times. Both give the
    same bits, because the sum along a path does not depend on when it is computed.

    Args:
        initial: cost (H, W) at the sources; infinite elsewhere.
        slowness: cost (H, W) per node spacing, > 0.
        is_open: mask (H, W) of the nodes that paths may use.
    """
    # Split each step's cost in two: leave with the neighbour's half, arrive with the own half.
    half = 0.5 * jnp.where(is_open, slowness, jnp.inf)
    start = jnp.where(is_open, initial, jnp.inf)
    # Under `vmap` the maps are processed one after another: each has its own order of tiles.
    by_tiles = jax.custom_batching.sequential_vmap(_by_tiles)  # type: ignore[no-untyped-call]
    value: Array = jax.lax.platform_dependent(start, half, cpu=by_tiles, default=_everywhere)
    return value


def _everywhere(start: Array, half: Array) -> Array:
    """Relax all nodes at once until none changes."""
    padded = [jnp.pad(part, 1, constant_values=jnp.inf) for part in (start, half)]
    return _settled(*padded)[1:-1, 1:-1]


def _by_tiles(start: Array, half: Array) -> Array:
    """Relax tile by tile until no tile has a neighbour that changed since its last visit."""
    height, width = start.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    # The closed margin gives every tile neighbours on all sides, and completes the last tiles.
    margins = ((1, 1 + rows * TILE - height), (1, 1 + columns * TILE - width))
    start, half = (jnp.pad(part, margins, constant_values=jnp.inf) for part in (start, half))
    tiles = start[1:-1, 1:-1].reshape(rows, TILE, columns, TILE)
    # Priority of each tile: the smallest changed value next to it, initially the smallest value in
    # it; infinite if nothing changed.
    due = jnp.pad(tiles.min(axis=(1, 3)), 1, constant_values=jnp.inf)
    is_tile = jnp.pad(jnp.ones((rows, columns), bool), 1)

    def visit(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        value, due = carry
        first = jnp.argmin(due[1:-1, 1:-1])
        row, column = first // columns, first % columns
        corner = (row * TILE, column * TILE)
        before, own = (
            jax.lax.dynamic_slice(part, corner, (TILE + 2, TILE + 2)) for part in (value, half)
        )
        after = _settled(before, own)[1:-1, 1:-1]
        # Values that fell at the edge of the tile become due in the neighbours on that side.
        fallen = jnp.where(after < before[1:-1, 1:-1], after, jnp.inf)
        above, below = fallen[0], fallen[-1]
        left, right = fallen[:, 0].min(), fallen[:, -1].min()
        around = [
            [above[0], above.min(), above[-1]],
            [left, jnp.inf, right],
            [below[0], below.min(), below[-1]],
        ]
        # The tile is settled. Only a value that falls in a neighbour makes it due again.
        due = due.at[row + 1, column + 1].set(jnp.inf)
        others = jnp.minimum(jax.lax.dynamic_slice(due, (row, column), (3, 3)), jnp.asarray(around))
        due = jax.lax.dynamic_update_slice(due, others, (row, column))
        value = jax.lax.dynamic_update_slice(value, after, (corner[0] + 1, corner[1] + 1))
        # The margin holds no tiles: a value that falls at the map's edge makes nothing due.
        return value, jnp.where(is_tile, due, jnp.inf)

    value, _ = jax.lax.while_loop(lambda carry: jnp.isfinite(carry[1]).any(), visit, (start, due))
    return value[1 : 1 + height, 1 : 1 + width]


def _settled(start: Array, half: Array) -> Array:
    """Relax all nodes except the outermost until none changes."""
    height, width = start.shape[0] - 2, start.shape[1] - 2

    def shifted(values: Array, down: int, right: int) -> Array:
        return values[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    own = shifted(half, 0, 0)

    def relax(value: Array) -> Array:
        # Take the minimum over straight and over diagonal neighbours before adding the node's own
        # half, which saves an addition per neighbour.
        leaving, leaving_diagonally = value + half, value + DIAGONAL * half
        along = [shifted(leaving, *step) for step in NEIGHBOURS[:4]]
        across = [shifted(leaving_diagonally, *step) for step in NEIGHBOURS[4:]]
        nearest = jnp.minimum(
            functools.reduce(jnp.minimum, along) + own,
            functools.reduce(jnp.minimum, across) + DIAGONAL * own,
        )
        return jax.lax.dynamic_update_slice(
            value, jnp.minimum(shifted(value, 0, 0), nearest), (1, 1)
        )

    def sweep(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = carry
        after = before
        for _ in range(SWEEPS):
            after = relax(after)
        return after, jnp.any(after < before)

    value, _ = jax.lax.while_loop(lambda carry: carry[1], sweep, (start, jnp.array(True)))
    return value


def extend(value: Float[Array, "H W"], num_layers: int, step: Scalar) -> Float[Array, "H W"]:
    """Fill infinite nodes from their neighbours, so that interpolation stays finite.

    Each of `num_layers` layers gets the greatest finite value around it plus `step`. So an obstacle
    becomes a ridge that is higher than both of its sides, however thin it is. Nodes that are still
    infinite get the greatest finite value plus `step` per layer. A field without finite values
    becomes 0.

    If a path leads diagonally between two closed nodes, these get at most the mean of the path's
    ends: a saddle. Between two ridges the interpolated cost would rise on the way through the gap,
    and a robot that descends would stop in front of it.

    Args:
        value: cost-to-go (H, W), infinite at closed nodes.
        num_layers: number of layers of closed nodes that are filled from their neighbours.
        step: rise of the cost per layer.
    """
    height, width = value.shape
    greatest = jnp.max(jnp.where(jnp.isfinite(value), value, -jnp.inf))

    def layer(_: Array, current: Array) -> Array:
        known = jnp.where(jnp.isfinite(current), current, -jnp.inf)
        padded = jnp.pad(known, 1, constant_values=-jnp.inf)
        around = jnp.full_like(current, -jnp.inf)
        for down in (0, 1, 2):
            for right in (0, 1, 2):
                around = jnp.maximum(around, padded[down : down + height, right : right + width])
        ridge = jnp.where(jnp.isfinite(around), around + step, jnp.inf)
        return jnp.where(jnp.isfinite(current), current, ridge)

    filled = jnp.minimum(jax.lax.fori_loop(0, num_layers, layer, value), _saddles(value))
    beyond = jnp.where(jnp.isfinite(greatest), greatest + num_layers * step, 0.0)
    return jnp.where(jnp.isfinite(filled), filled, beyond)


def _saddles(value: Float[Array, "H W"]) -> Float[Array, "H W"]:
    """Return the cost at the closed nodes beside diagonal steps between two closed nodes.

    It is the smallest mean of the two ends of such a step, and infinite at all other nodes.
    """
    height, width = value.shape
    padded = jnp.pad(value, 1, constant_values=jnp.inf)

    def shifted(down: int, right: int) -> Array:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    least = jnp.full_like(value, jnp.inf)
    for down in (-1, 1):
        for right in (-1, 1):
            mean = 0.5 * (shifted(down, 0) + shifted(0, right))
            is_between = jnp.isinf(value) & jnp.isinf(shifted(down, right))
            least = jnp.minimum(least, jnp.where(is_between, mean, jnp.inf))
    return least


def descent(value: Float[Array, "H W"], num_layers: int) -> Float[Array, "2 H W"]:
    """Return the unit vectors (row, column) along which a cost-to-go falls; 0 at its minima.

    At an open node the vector is the sum of the slopes towards its lower neighbours. Closed nodes,
    whose value is infinite, get the mean direction of the nodes around them, for `num_layers`
    layers. So an obstacle does not change the direction of the path along it.

    Args:
        value: cost-to-go (H, W), infinite at closed nodes.
        num_layers: number of layers of closed nodes that are filled from their neighbours.
    """
    height, width = value.shape

    def shifted(padded: Array, down: int, right: int) -> Array:
        return padded[..., 1 + down : 1 + down + height, 1 + right : 1 + right + width]

    around = jnp.pad(value, 1, constant_values=jnp.inf)
    vector = jnp.zeros((2, height, width))
    for down, right in NEIGHBOURS:
        length = (down * down + right * right) ** 0.5
        # Differences with closed neighbours are infinite or NaN, and count as no slope.
        fall = value - shifted(around, down, right)
        fall = jnp.where(jnp.isfinite(fall), jnp.maximum(fall, 0.0), 0.0) / length
        unit = jnp.asarray([down / length, right / length])
        vector = vector + fall * unit[:, None, None]

    def normalise(vectors: Array) -> Array:
        # The inverse root of infinity is 0: where slopes cancel, the direction is 0 and not NaN.
        square = jnp.sum(vectors * vectors, axis=0)
        return vectors * jax.lax.rsqrt(jnp.where(square > 1e-12, square, jnp.inf))

    def layer(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        current, is_known = carry
        vectors = jnp.pad(current, ((0, 0), (1, 1), (1, 1)))
        known = jnp.pad(is_known, 1)
        total = functools.reduce(jnp.add, [shifted(vectors, *step) for step in NEIGHBOURS])
        near = functools.reduce(jnp.logical_or, [shifted(known, *step) for step in NEIGHBOURS])
        return jnp.where(is_known, current, normalise(total)), is_known | near

    start = normalise(vector), jnp.isfinite(value)
    filled: tuple[Array, Array] = jax.lax.fori_loop(0, num_layers, layer, start)
    return filled[0]
