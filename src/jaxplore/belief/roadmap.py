"""Road maps: the nodes of a lattice at which a robot fits, and the costs of the paths on it."""

import abc
import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Pose, Position, Scalar
from jaxplore.belief.descent import NEIGHBOURS, corner_of, find_predecessors, neighbour
from jaxplore.belief.guidance import LAYERS, GuidanceField, descent_field
from jaxplore.belief.tiles import Part, relax_costs
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame

DIAGONAL = 2.0**0.5
"""Length of a step to a diagonal neighbour [node spacings]."""
ROOMY = 3.0
"""Ratio of clearance to required clearance above which a path has no extra cost."""
NARROW_PRICE = 30.0
"""Cost of a metre in a passage without the margin: such a passage is taken when little else is
left, and still before the places with little information."""


def geodesic(
    initial: Float[Array, "H W"],
    slowness: Float[Array, "H W"],
    is_open: Bool[Array, "H W"],
    corners: Bool[Array, "H W"] | None = None,
) -> Float[Array, "H W"]:
    """Return the cost-to-go `min over s of initial(s) + cost of the shortest path from s`.

    `initial` is infinite where no path ends. Paths connect each open node with its 8 neighbours,
    with the diagonal ones only past a clear corner (`clear_corners`; all are when None). A step of
    length l, in node spacings, costs `l * (slowness(from) + slowness(to)) / 2`, with slowness > 0.
    The values are those of Dijkstra's algorithm, found by relaxing many nodes at once until none
    changes (Bellman-Ford), which on a grid is a minimum of shifted arrays.
    """
    # Split each step's cost in two: leave with the neighbour's half, arrive with the own half.
    half = 0.5 * jnp.where(is_open, slowness, jnp.inf)
    start = jnp.where(is_open, initial, jnp.inf)
    parts = [Part(half, jnp.inf, 1)]
    if corners is not None:
        parts.append(Part(jnp.where(corners, 0.0, jnp.inf), jnp.inf, 1))
    return relax_costs(start, parts, _relax, 1)


def narrow_passages(
    value: Float[Array, "H W"],
    half: Float[Array, "H W"],
    is_narrow: Bool[Array, "H W"],
    corners: Bool[Array, "H W"] | None,
    begins: Bool[Array, "H W"] | None = None,
) -> Bool[Array, "H W"]:
    """Return the narrow nodes through which shortest paths from other nodes, or from the narrow
    nodes `begins`, lead. `value` is the cost-to-go of `geodesic`, and `half` half the cost of a
    step of one node spacing. `corners` may be passed by diagonal steps; all when None."""
    costs = []
    for step in NEIGHBOURS:
        length = DIAGONAL if all(step) else 1.0
        there = neighbour(value + length * half, step, jnp.inf) + length * half
        if corners is not None and all(step):
            there = jnp.where(neighbour(corners, corner_of(step), False), there, jnp.inf)
        costs.append(there)
    least = functools.reduce(jnp.minimum, costs)
    # A source is where a path ends. The tolerance is for another order of the additions.
    goes_on = jnp.isfinite(value) & (least <= value + 1e-4 * (1.0 + jnp.abs(value)))
    steps = [goes_on & (cost == least) for cost in costs]

    first = jnp.zeros_like(is_narrow)
    if begins is not None:
        first = is_narrow & begins & jnp.isfinite(value)

    def follow(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        is_used, _ = carry
        comes_from = ~is_narrow | is_used
        led_to = [
            neighbour(comes_from & taken, (-step[0], -step[1]), False)
            for step, taken in zip(NEIGHBOURS, steps, strict=True)
        ]
        more = is_narrow & functools.reduce(jnp.logical_or, led_to) | first
        return more, jnp.any(more & ~is_used)

    is_used, _ = jax.lax.while_loop(lambda carry: carry[1], follow, (first, jnp.array(True)))
    return is_used


def _relax(value: Array, half: Array, detour: Array | None = None) -> Array:
    """Return the least cost-to-go by a step to a neighbour. All arrays have a margin of 1.

    `half` is half the cost of a step of one node spacing, and `detour` what a diagonal step past
    each corner costs more; 0 when None.
    """
    height, width = value.shape[0] - 2, value.shape[1] - 2

    def shift(values: Array, down: int, right: int) -> Array:
        return values[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    own = shift(half, 0, 0)
    # Take the minimum over straight and over diagonal neighbours before adding the node's own half,
    # which saves an addition per neighbour.
    leaving, leaving_diagonally = value + half, value + DIAGONAL * half
    along = [shift(leaving, *step) for step in NEIGHBOURS[:4]]
    across = [
        shift(leaving_diagonally, *step)
        + (0.0 if detour is None else shift(detour, *corner_of(step)))
        for step in NEIGHBOURS[4:]
    ]
    return jnp.minimum(
        functools.reduce(jnp.minimum, along) + own,
        functools.reduce(jnp.minimum, across) + DIAGONAL * own,
    )


class Roadmap(eqx.Module):
    """Lattice of the places in which a robot fits that can turn on the spot, with paths on it.

    Args:
        frame: pose and node spacing of the lattice.
        slowness: cost (H, W) of a step of one node spacing [m].
        is_open: mask (H, W) of the nodes at which the robot fits.
        corners: mask (H, W) of the corners that a diagonal step may pass, see `clear_corners`;
            None for all.
        is_narrow: mask (H, W) of the further nodes at which the robot fits without its margin.
            Paths lead through them, at a high price, and do not end there. None without such.
    """

    frame: GridFrame
    slowness: Float[Array, "H W"]
    is_open: Bool[Array, "H W"]
    corners: Bool[Array, "H W"] | None
    is_narrow: Bool[Array, "H W"] | None = eqx.field(default=None, kw_only=True)

    @property
    def spacing(self) -> float:
        """Distance between nodes [m]."""
        return self.frame.resolution

    def lengths(self, source: Float[Array, "H W"]) -> Float[Array, "H W"]:
        """Return the cost-to-go of each node [m]; infinite where no path leads to a source.

        `source` is the cost at the nodes where paths may end [m]; infinite elsewhere.
        """
        source = jnp.where(self.is_open, source, jnp.inf)
        return geodesic(source, self.slowness, self.is_passable, self.corners)

    def lengths_from(self, pose: Pose) -> Float[Array, "H W"]:
        """Return the cost of the path from a pose (x, y, yaw) to each node [m].

        It may begin at a narrow node.
        """
        begin = point_sources(pose[:2], self.frame, self.is_passable, self.corners)
        return geodesic(begin, self.slowness, self.is_passable, self.corners)

    def sources_at(
        self, point: Position, heading: Scalar | None = None
    ) -> Float[Array, "*headings H W"]:
        """Return the sources of paths that end at a point (x, y) [m], see `point_sources`.

        Only a robot that cannot turn on the spot must drive for a heading there [rad]; None: any.
        """
        return point_sources(point, self.frame, self.is_open, self.corners)

    @property
    def is_passable(self) -> Bool[Array, "H W"]:
        """Mask (H, W) of the nodes through which paths may lead."""
        return self.is_open if self.is_narrow is None else self.is_open | self.is_narrow

    def field(self, source: Float[Array, "H W"], start: Position | None = None) -> GuidanceField:
        """Return the cost-to-go of `lengths` as a field, extended into closed nodes.

        Narrow nodes are closed unless a path leads through them. The path of a robot at `start`
        (x, y) [m] may also begin at one.
        """
        return self._extend(self.lengths(source), start)

    def field_and_cost(
        self, source: Float[Array, "H W"], pose: Pose
    ) -> tuple[GuidanceField, Scalar]:
        """Return the field, and the cost of the path from a pose [m]; infinite without a path."""
        lengths = self.lengths(source)
        start = point_sources(pose[:2], self.frame, self.is_passable, self.corners)
        return self._extend(lengths, pose[:2]), (start + lengths).min()

    def _extend(self, lengths: Float[Array, "H W"], start: Position | None) -> GuidanceField:
        """Return a cost-to-go as a field, extended into closed nodes."""
        if self.is_narrow is not None:
            # Narrow nodes along walls are closed, so that a wall looks to the robot as without
            # them.
            half = 0.5 * jnp.where(jnp.isfinite(lengths), self.slowness, jnp.inf)
            begins = None if start is None else self._nearest_passable(start)
            is_used = narrow_passages(lengths, half, self.is_narrow, self.corners, begins)
            lengths = jnp.where(self.is_narrow & ~is_used, jnp.inf, lengths)
        return descent_field(lengths, self.frame, LAYERS, self.corners)

    def _nearest_passable(self, point: Position) -> Bool[Array, "H W"]:
        """Mask the passable node nearest to a point, if it is in the point's block or beside it."""
        distance = self.frame.distances(point, self.is_passable.shape)
        distance = jnp.where(self.is_passable, distance, jnp.inf)
        return (distance <= distance.min()) & (distance < 1.5 * self.spacing)


Price = Callable[[Array], Array]
"""Function that returns the cost of a metre for a tightness: 0 in open space, 1 where the robot
just fits."""


def double_where_tight(tightness: Array) -> Array:
    """Return the cost of a metre that is doubled where the robot just fits."""
    return 1.0 + tightness


class Locomotion(eqx.Module):
    """What paths a robot can drive between the nodes of a lattice."""

    @abc.abstractmethod
    def roadmap(
        self,
        clearance: ScalarField,
        required: Scalar,
        stride: int,
        price: Price = double_where_tight,
        factor: Float[Array, "H W"] | None = None,
    ) -> Roadmap:
        """Build the lattice of places in which the robot fits, with one node per block of cells.

        A node is open if the robot fits at any cell of its block, of `stride` cells on a side;
        static. `price`, the cost of a metre by tightness, keeps paths in the middle of passages.
        `factor` multiplies the cost of each node; 1 when None.
        """

    @abc.abstractmethod
    def level_field(self, frame: GridFrame, shape: tuple[int, int]) -> GuidanceField:
        """Return a field of such a road map that is 0 everywhere, on a lattice of this shape."""


class TurnsOnTheSpot(Locomotion):
    """Locomotion of a robot whose paths do not depend on its heading.

    Below the required clearance paths lead through passages at `NARROW_PRICE` down to `narrow` [m],
    at least `narrowest`; not at all when None.
    """

    narrow: Scalar | None = None

    def level_field(self, frame: GridFrame, shape: tuple[int, int]) -> GuidanceField:
        """Return a field that is 0 everywhere."""
        return descent_field(jnp.zeros(shape), frame, LAYERS)

    def roadmap(
        self,
        clearance: ScalarField,
        required: Scalar,
        stride: int,
        price: Price = double_where_tight,
        factor: Float[Array, "H W"] | None = None,
    ) -> Roadmap:
        """Build the lattice of places in which the robot fits; see `Locomotion`."""
        frame = clearance.frame.coarsen(stride, stride / 2.0)
        room = block_maximum(clearance.values, stride)
        is_open, tightness = fit(room, required)
        slowness = frame.resolution * price(tightness)
        corners, is_narrow = clear_corners(clearance, stride), None
        if self.narrow is not None:
            fits = fit(clearance.values, self.narrow)[0]
            passable = fit(room, self.narrow)[0]
            is_narrow = passable & ~is_open & ~_find_bottleneck_nodes(passable, fits, stride)
            slowness = jnp.where(is_narrow, frame.resolution * NARROW_PRICE, slowness)
            if corners is None:
                corners = _corners_at(is_narrow, fits, stride)
        slowness = slowness if factor is None else slowness * factor
        return Roadmap(frame, slowness, is_open, corners, is_narrow=is_narrow)


def block_maximum(values: Float[Array, "H W"], stride: int) -> Float[Array, "rows columns"]:
    """Return the maximum over each block of cells; the map's last blocks are completed with 0."""
    height, width = values.shape
    rows, columns = -(-height // stride), -(-width // stride)
    padded = jnp.pad(values, ((0, rows * stride - height), (0, columns * stride - width)))
    return padded.reshape(rows, stride, columns, stride).max(axis=(1, 3))


def fit(room: Float[Array, "*S"], required: Scalar) -> tuple[Bool[Array, "*S"], Float[Array, "*S"]]:
    """Return where a robot fits, and how tightly: 0 in open space, 1 where it just fits.

    `room` is the clearance there, and `required` that which the robot needs [m].
    """
    spare = (room - required) / required
    # The tolerance absorbs rounding: a passage of exactly the required width is open.
    return room >= required - 1e-4, jnp.clip(1.0 - spare / (ROOMY - 1.0), 0.0, 1.0)


def clear_corners(clearance: ScalarField, stride: int) -> Bool[Array, "H W"] | None:
    """Return the mask of the corners that a diagonal step may pass; None for all.

    Entry (r, c) is the corner between the nodes (r, c), (r, c + 1), (r + 1, c) and (r + 1, c + 1).
    It is clear if none of these cells is blocked. Two cells on the two sides of a wall that touch
    at a corner of it are both free, and where the robot needs no more room than half a cell they
    are open nodes as well: only the cells beside the step show the wall.

    Blocks of several cells need no mask: `safe_stride` takes them only for a robot so wide that no
    two open blocks on two sides of a wall touch. `clearance` is 0 in blocked cells, and `stride`
    the number of cells on a side of a block; static.
    """
    return _block_corners(clearance.values > 0.0, 1) if stride == 1 else None


def narrowest(stride: int, resolution: float, *, has_corners: bool = True) -> float:
    """Return the least clearance at which no path can jump a wall [m].

    It is that of `safe_stride` for a stride s: with R the clearance plus half a cell, two open
    cells on two sides of a wall are at least `2 sqrt(R^2 - 1/2)` cells apart. Two such cells in
    adjacent blocks that are `sqrt(2) (2 s - 1)` cells apart have the wall at the corner between
    the blocks. Where paths are checked at corners (`has_corners`), a step needs free cells there,
    and all others are at most `sqrt((2 s - 1)^2 + (2 s - 2)^2)` cells apart.
    """
    across = 2.0 * stride - 1.0
    apart = math.hypot(across, across - 1.0 if has_corners else across)
    # The tolerance counts equal lengths as a path that jumps.
    return resolution * (math.sqrt(0.25 * apart**2 + 0.5) - 0.5 + 1e-3)


def _corners_at(
    is_narrow: Bool[Array, "H W"], fits: Bool[Array, "h w"], stride: int
) -> Bool[Array, "H W"]:
    """Return the mask (H, W) of the corners that a diagonal step may pass, see `clear_corners`.

    Two blocks of several cells at a corner may each have a cell in which the robot fits, and a
    bottleneck or a wall at the corner between them. So where one of them is narrow, the robot must
    fit in the two cells of one of the blocks' diagonals at the corner. For blocks of one cell that
    is not enough, as it fits on both sides of a wall that passes between them: `clear_corners`.
    """
    rows, columns = is_narrow.shape
    first, second, third, fourth = _at_corners(fits, stride)
    is_clear = ((first & fourth) | (second & third))[:rows, :columns]
    return is_clear | _block_corners(~is_narrow, 1)


def _find_bottleneck_nodes(
    passable: Bool[Array, "H W"], fits: Bool[Array, "h w"], stride: int
) -> Bool[Array, "H W"]:
    """Return the passable nodes with a bottleneck to a passable node above, below or beside them.

    Each of the two has a cell in which the robot fits (`fits`), but between these cells it does
    not. `stride` is the number of cells on a side of a block; static.
    """
    found = jnp.zeros_like(passable)
    if stride == 1:
        return found
    rows, columns = passable.shape
    height, width = fits.shape
    padded = jnp.pad(fits, ((0, rows * stride - height), (0, columns * stride - width)))
    blocks = padded.reshape(rows, stride, columns, stride)
    for axis, last, first in (
        (0, blocks[:, -1], blocks[:, 0]),
        (1, blocks[..., -1], blocks[..., 0]),
    ):
        # The cells along the common edge, (rows, columns, stride).
        last, first = (each if axis == 0 else jnp.moveaxis(each, 1, 2) for each in (last, first))
        ahead = jnp.roll(first, -1, axis)
        wide = jnp.pad(ahead, ((0, 0), (0, 0), (1, 1)))
        touches = last & (wide[..., :-2] | wide[..., 1:-1] | wide[..., 2:])
        is_cut = passable & jnp.roll(passable, -1, axis) & ~touches.any(axis=-1)
        # The last node has none after it.
        is_cut = is_cut.at[-1].set(False) if axis == 0 else is_cut.at[:, -1].set(False)
        found |= is_cut | jnp.roll(is_cut, 1, axis)
    return found


def _block_corners(is_clear: Bool[Array, "rows columns"], stride: int) -> Bool[Array, "H W"]:
    """Return where all four cells at the corner after each block are clear; none off the map."""
    return functools.reduce(jnp.logical_and, _at_corners(is_clear, stride))


def _at_corners(cells: Bool[Array, "rows columns"], stride: int) -> list[Bool[Array, "H W"]]:
    """Return the four cells at the corner after each block: of its own block, the one beside it,
    the one below it, and across; False off the map."""
    height, width = cells.shape
    rows, columns = -(-height // stride), -(-width // stride)
    # The last blocks are completed, and followed by one more cell.
    padded = jnp.pad(cells, ((0, rows * stride - height + 1), (0, columns * stride - width + 1)))
    return [
        padded[i + stride - 1 :: stride, j + stride - 1 :: stride][:rows, :columns]
        for i in (0, 1)
        for j in (0, 1)
    ]


def point_sources(
    point: Position,
    frame: GridFrame,
    is_open: Bool[Array, "H W"],
    corners: Bool[Array, "H W"] | None = None,
) -> Float[Array, "H W"]:
    """Return the sources of `geodesic` for paths that end at a point (x, y) [m]: the open nodes
    within a node spacing, on its side of walls (`nearest_open`), with their distance to it [m]; all
    others are infinite."""
    distance = jnp.where(is_open, frame.distances(point, is_open.shape), jnp.inf)
    return nearest_open(distance, distance, frame.resolution, corners)


def nearest_open(
    cost: Float[Array, "*N H W"],
    distance: Float[Array, "H W"],
    spacing: float,
    corners: Bool[Array, "H W"] | None,
) -> Float[Array, "*N H W"]:
    """Return the costs within a node spacing of the least one; all others infinite.

    `cost` is that of the way from a point to the nodes, and `distance` their distance from it; both
    are infinite at closed nodes. All lengths are in metres.

    With a mask of corners that a diagonal step may pass, and where the point is in the cell of an
    open node, only nodes count to which at most two steps lead from that node. A node on the other
    side of a wall may be as near as one on this side.
    """
    if corners is not None:
        is_reached = distance <= distance.min()
        for _ in range(2):
            around = [find_predecessors(is_reached, step, corners) for step in NEIGHBOURS]
            around.append(is_reached)
            is_reached = jnp.isfinite(distance) & functools.reduce(jnp.logical_or, around)
        # Farther than half the diagonal of a cell the point itself is in a closed place.
        is_reached = is_reached | (distance.min() > 0.75 * spacing)
        cost = jnp.where(is_reached, cost, jnp.inf)
    # With the nearest node alone, paths from other sides would pass the point and come back.
    return jnp.where(cost <= cost.min() + spacing, cost, jnp.inf)
