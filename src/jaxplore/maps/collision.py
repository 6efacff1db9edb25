"""Distances from the robot's outline to the true world and to moving obstacles.

For a disc and a rectangle they are from the outline itself, not from the discs that cover it.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import GridMask, Position, Scalar
from jaxplore.geometry.footprint import Disc, Footprint, Rectangle
from jaxplore.maps.frame import GridFrame


def footprint_clearance(
    solid: GridMask,
    frame: GridFrame,
    position: Position,
    heading: Scalar,
    footprint: Footprint,
    reach: int,
) -> Scalar:
    """Compute the distance from a robot's edge to the nearest solid square cell [m].

    Exact for a disc and for a rectangle; for another footprint, the distance from the discs that
    cover it. `reach` is static; see `clearance_reach`.
    """
    if isinstance(footprint, Rectangle):
        in_grid, turn = frame.to_grid(position), heading - frame.origin[2]
        return rectangle_clearance(solid, in_grid, turn, footprint, frame.resolution, reach)
    distances = [
        disc_clearance(solid, frame.to_grid(centre), footprint.radius, frame.resolution, reach)
        for centre in _centres(position, heading, footprint)
    ]
    return jnp.min(jnp.stack(distances))


def disc_clearance(
    solid: GridMask, grid: Array, radius: Scalar, resolution: float, reach: int
) -> Scalar:
    """Compute the distance from a disc's edge to the nearest solid square cell [m], negative where
    they overlap. Exact for cells within `reach` cells (static) of the centre `grid` (row, column),
    and limited to that distance. Everything off the map is solid."""
    rows, columns, is_solid = _around(solid, grid, reach)

    def to_interval(cells: Array, centre: Array) -> Array:
        low = cells.astype(jnp.float32)
        return jnp.maximum(jnp.maximum(low - centre, centre - (low + 1.0)), 0.0)

    gap = jnp.hypot(to_interval(rows, grid[0])[:, None], to_interval(columns, grid[1])[None])
    # Cells beyond `reach` were not examined, so the distance is limited to it.
    nearest = jnp.min(jnp.where(is_solid, gap, float(reach)))
    return nearest * resolution - radius


def rectangle_clearance(
    solid: GridMask,
    grid: Array,
    heading: Scalar,
    footprint: Rectangle,
    resolution: float,
    reach: int,
) -> Scalar:
    """Compute the distance from a rectangle's edge to the nearest solid square cell [m].

    For two disjoint convex polygons it is the least distance of a corner of one from the other.
    They overlap if no edge normal separates them (separating axis theorem). Then it is minus the
    penetration depth, the shortest translation that separates them, which is along an edge normal.

    Exact for cells within `reach` cells (static) of the rectangle's origin, and limited to the
    least distance of a cell beyond them. Everything off the map is solid. The origin `grid` is
    (row, column) in cells. The heading is in the grid's frame, from the column axis to the row
    axis.

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.2.1 (separating axes).
    """
    rows, columns, is_solid = _around(solid, grid, reach)
    front, rear = footprint.front / resolution, footprint.rear / resolution
    beside = 0.5 * footprint.width / resolution
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    # All lengths are in cells from the origin: the grid lines, and the rectangle's corners (4,).
    y, x = _lines(rows, grid[0]), _lines(columns, grid[1])
    ahead, left = jnp.stack([front, front, -rear, -rear]), jnp.stack([beside, -beside] * 2)
    corner_x, corner_y = cos * ahead - sin * left, sin * ahead + cos * left

    # Squared distances are compared, so that one root at the end is enough.
    gap_x = _outside(corner_x[:, None], x[:-1], x[1:])
    gap_y = _outside(corner_y[:, None], y[:-1], y[1:])
    corners = jnp.min((gap_y * gap_y)[:, :, None] + (gap_x * gap_x)[:, None, :], axis=0)

    # Corners of the cells in the rectangle's frame, one more than cells along each axis.
    ahead, left = cos * x + (sin * y)[:, None], (cos * y)[:, None] - sin * x
    gap_ahead, gap_left = _outside(ahead, -rear, front), _outside(left, -beside, beside)
    squares = gap_ahead * gap_ahead + gap_left * gap_left
    # Neighbouring cells share corners: the least of a cell's four corners is taken axis by axis.
    squares = jnp.minimum(squares[:-1], squares[1:])
    squares = jnp.minimum(squares[:, :-1], squares[:, 1:])
    distance = jnp.sqrt(jnp.minimum(corners, squares))

    # Gaps between the projections on the four edge normals; a negative gap is an overlap.
    half = 0.5 * (jnp.abs(cos) + jnp.abs(sin))
    middle_ahead = ahead[:-1, :-1] + 0.5 * (cos + sin)
    middle_left = left[:-1, :-1] + 0.5 * (cos - sin)
    separation = jnp.maximum(
        jnp.maximum(middle_ahead - half - front, -rear - middle_ahead - half),
        jnp.abs(middle_left) - half - beside,
    )
    apart_x = jnp.maximum(x[:-1] - jnp.max(corner_x), jnp.min(corner_x) - x[1:])
    apart_y = jnp.maximum(y[:-1] - jnp.max(corner_y), jnp.min(corner_y) - y[1:])
    separation = jnp.maximum(separation, jnp.maximum(apart_y[:, None], apart_x))

    clearance = jnp.where(separation < 0.0, separation, distance)
    beyond = reach - jnp.hypot(jnp.maximum(front, rear), beside)
    return jnp.minimum(jnp.min(jnp.where(is_solid, clearance, jnp.inf)), beyond) * resolution


def discs_clearance(
    centres: Float[Array, "M 2"],
    radii: Float[Array, " M"],
    position: Position,
    heading: Scalar,
    footprint: Footprint,
) -> Scalar:
    """Compute the distance from a robot's edge to the nearest of M discs [m].

    Exact for a disc and for a rectangle, negative where they overlap; for another footprint, the
    distance from the discs that cover it. Infinite without discs. Positions and heading are in the
    world.
    """
    if isinstance(footprint, Rectangle):
        x, y = centres[:, 0] - position[0], centres[:, 1] - position[1]
        cos, sin = jnp.cos(heading), jnp.sin(heading)
        ahead, left = cos * x + sin * y, cos * y - sin * x
        over_ahead = jnp.maximum(ahead - footprint.front, -footprint.rear - ahead)
        over_left = jnp.abs(left) - 0.5 * footprint.width
        outside = jnp.hypot(jnp.maximum(over_ahead, 0.0), jnp.maximum(over_left, 0.0))
        # Inside the rectangle, the nearest edge gives minus the penetration depth.
        inside = jnp.minimum(jnp.maximum(over_ahead, over_left), 0.0)
        return jnp.min(outside + inside - radii, initial=jnp.inf)
    middles = jnp.stack(_centres(position, heading, footprint))
    offsets = centres - middles[:, None]
    distances = jnp.hypot(offsets[..., 0], offsets[..., 1]) - radii
    return jnp.min(distances, initial=jnp.inf) - footprint.radius


def clearance_reach(footprint: Footprint | float, resolution: float, margin: float = 0.5) -> int:
    """Return the number of cells to examine for a clearance that is exact up to `margin` [m].

    A number as the footprint is the radius of a disc [m].
    """
    if isinstance(footprint, Rectangle):
        ends = max(float(footprint.front), float(footprint.rear))
        extent = math.hypot(ends, 0.5 * float(footprint.width))
    elif isinstance(footprint, Footprint):
        extent = float(footprint.radius)  # each disc is looked at from its own centre
    else:
        extent = footprint
    # The point of reference may lie anywhere in its cell, which takes one more cell.
    return math.ceil((extent + margin) / resolution) + 1


def _around(
    solid: GridMask, grid: Array, reach: int
) -> tuple[Int[Array, " n"], Int[Array, " n"], Bool[Array, "n n"]]:
    """Return the rows and columns within `reach` of a point, and which of their cells are solid."""
    height, width = solid.shape
    base = jnp.floor(grid).astype(jnp.int32)
    offsets = jnp.arange(-reach, reach + 1)
    rows, columns = base[0] + offsets, base[1] + offsets
    # Indices beyond the map are clipped for reading only: those cells are solid.
    on_map = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
    is_solid = ~on_map | solid[jnp.clip(rows, 0, height - 1)][:, jnp.clip(columns, 0, width - 1)]
    return rows, columns, is_solid


def _lines(cells: Int[Array, " n"], origin: Scalar) -> Float[Array, " m"]:
    """Return the grid lines of cells along one axis, relative to the origin."""
    low = cells.astype(jnp.float32)
    return jnp.concatenate([low, low[-1:] + 1.0]) - origin


def _outside(value: Array, low: Array, high: Array) -> Array:
    """Return the distance of a value from an interval, 0 inside."""
    return jnp.maximum(jnp.maximum(low - value, value - high), 0.0)


def _centres(position: Position, heading: Scalar, footprint: Footprint) -> list[Position]:
    """Return the centres of the discs that cover a robot, in the world [m]."""
    if isinstance(footprint, Disc):
        return [position]
    ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
    return [position + offset * ahead for offset in footprint.offsets]
