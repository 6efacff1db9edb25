"""Compute slope, roughness and traversability of the ground from its elevation."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, GridMask, GridValues, Position, Scalar, Vector
from jaxplore._xla import on_device
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.chassis import Chassis, Stance
from jaxplore.geometry.vectors import root
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.padding import pad_cells

HIGHEST = 1e6
"""Greatest absolute elevation that is accepted [m]: squares of differences stay finite."""


class GroundSample(NamedTuple):
    """Layers of the ground at points: `elevation` [m], `slope` [m/m], `roughness` [m] and
    `traversability` in [0, 1], (*N) each."""

    elevation: Float[Array, "*N"]
    slope: Float[Array, "*N"]
    roughness: Float[Array, "*N"]
    traversability: Float[Array, "*N"]


class Ground(eqx.Module):
    """Elevation, slope, roughness and traversability of the ground. Scans do not change them.

    With z the elevation and n the side of a cell,

        slope          = |grad z|, central differences over 2 n, one-sided at the edge
        roughness      = root mean square vertical distance of the 3 x 3 cells around from their
                         least-squares plane
        traversability = (1 - slope / max_slope)_+ * (1 - roughness / max_roughness)_+

    Slope and roughness are exact for a plane: the elevation is extrapolated linearly beyond the
    edge, and is level along an axis of one cell. Off the map all four layers are 0, so nothing can
    drive there.

    Everything but the resolution is an array leaf, so another elevation of the same size does not
    recompile. Traced code cannot raise: there a cell whose elevation is NaN or beyond 1000 km gets
    elevation 0 and traversability 0.

    Args:
        elevation: elevation (H, W) of each cell [m]; row 0, column 0 is at the origin, as in
            `OccupancyGrid`.
        resolution: side of a cell [m].
        origin: pose (x, y, yaw) of the outer corner of cell (0, 0) in the world [m, m, rad].
        max_slope: slope at which the traversability is 0 [m/m].
        max_roughness: roughness at which the traversability is 0 [m]; by default roughness is
            ignored.
        threshold: traversability below which a cell may not be entered, in [0, 1].
        traversability: traversability (H, W) in [0, 1] that replaces the computed one.

    Raises:
        ValueError: an elevation that is empty, not two-dimensional or not within 1000 km, a
            `max_slope` or `max_roughness` that is not positive, a threshold or a traversability
            outside [0, 1], a traversability of another shape, and what `GridFrame` refuses.
    """

    elevation: GridValues
    slope: GridValues
    roughness: GridValues
    traversability: GridValues
    frame: GridFrame
    threshold: Scalar
    max_slope: Scalar
    max_roughness: Scalar | None
    is_given: bool = eqx.field(static=True)
    """Whether the traversability was given instead of computed."""

    def __init__(
        self,
        elevation: ArrayLike,
        resolution: float,
        origin: Vector = (0.0, 0.0, 0.0),
        *,
        max_slope: ArrayLike = 0.5,
        max_roughness: ArrayLike | None = None,
        threshold: ArrayLike = 0.3,
        traversability: ArrayLike | None = None,
    ) -> None:
        self.frame = GridFrame(resolution, origin)
        self.max_slope = _checks.scalar("max_slope", max_slope, above=0.0)
        self.max_roughness = None
        if max_roughness is not None:
            self.max_roughness = _checks.scalar("max_roughness", max_roughness, above=0.0)
        self.threshold = _checks.scalar("threshold", threshold, at_least=0.0, at_most=1.0)
        given = _elevation(elevation)
        # Only traced elevations can fail this test; others have been checked.
        is_known = jnp.abs(given) <= HIGHEST
        self.elevation = jnp.where(is_known, given, 0.0)
        self.slope, self.roughness = _relief(self.elevation, self.frame.resolution)
        self.is_given = traversability is not None
        if traversability is None:
            passable = jnp.clip(1.0 - self.slope / self.max_slope, 0.0, 1.0)
            if self.max_roughness is not None:
                passable *= jnp.clip(1.0 - self.roughness / self.max_roughness, 0.0, 1.0)
        else:
            passable = _traversability(traversability, self.elevation.shape)
        self.traversability = jnp.where(is_known, passable, 0.0)

    def pad(self, shape: tuple[int, int]) -> "Ground":
        """Return the ground in larger arrays, with 0 in the added cells, as off the map.

        Args:
            shape: rows and columns of the arrays, at least those of the ground.

        Raises:
            ValueError: fewer rows or columns than the ground has.
        """
        filled = [
            on_device(pad_cells("shape", np.asarray(layer), shape, 0.0)) for layer in _layers(self)
        ]
        same: Ground = eqx.tree_at(_layers, self, filled)
        return same

    def crop(self, shape: tuple[int, int]) -> "Ground":
        """Return the first rows and columns of the ground, as before `pad`."""
        rows, columns = shape
        kept = [on_device(np.asarray(layer)[:rows, :columns]) for layer in _layers(self)]
        same: Ground = eqx.tree_at(_layers, self, kept)
        return same

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.frame.resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.elevation.shape
        return height, width

    @property
    def is_traversable(self) -> GridMask:
        """Mask (H, W) of the cells that may be entered: traversability >= threshold."""
        return self.traversability >= self.threshold

    def contains(self, cell: Int[Array, "*N 2"]) -> Bool[Array, "*N"]:
        """Return whether each cell (row, column) is on the map."""
        height, width = self.shape
        row, column = cell[..., 0], cell[..., 1]
        return (row >= 0) & (row < height) & (column >= 0) & (column < width)

    def elevation_at_cell(self, cell: Int[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Return the elevation of each cell (row, column) [m], 0 off the map."""
        return self._look_up(self.elevation, cell)

    def at(self, points: Float[Array, "*N 2"]) -> GroundSample:
        """Return the layers of the cell with each world point (x, y) [m]; 0 off the map."""
        cell = self.frame.to_cell(points)
        return GroundSample(
            elevation=self._look_up(self.elevation, cell),
            slope=self._look_up(self.slope, cell),
            roughness=self._look_up(self.roughness, cell),
            traversability=self._look_up(self.traversability, cell),
        )

    @property
    def elevation_field(self) -> ScalarField:
        """Elevation [m], interpolated bilinearly between cell centres; 0 off the map."""
        return self._field(self.elevation)

    @property
    def slope_field(self) -> ScalarField:
        """Slope [m/m], interpolated bilinearly between cell centres; 0 off the map."""
        return self._field(self.slope)

    @property
    def roughness_field(self) -> ScalarField:
        """Roughness [m], interpolated bilinearly between cell centres; 0 off the map."""
        return self._field(self.roughness)

    @property
    def traversability_field(self) -> ScalarField:
        """Traversability, interpolated bilinearly between cell centres; 0 off the map."""
        return self._field(self.traversability)

    def stance(self, chassis: Chassis, position: Position, heading: Scalar) -> Stance:
        """Return the plane under the wheels of a vehicle, with the elevation interpolated.

        The wheels are where they would be on level ground: on a slope they are nearer to each other
        by the cosine of the tilt.

        Args:
            chassis: chassis of the vehicle.
            position: its position (x, y) [m].
            heading: its heading [rad].
        """
        elevation, (sin, cos) = self.elevation_field, sin_cos(heading)
        x, y = position
        half = 0.5 * chassis.track

        def under(ahead: Scalar, left: Scalar) -> Scalar:
            return elevation(
                jnp.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left])
            )

        front = chassis.offset + 0.5 * chassis.wheelbase
        rear = chassis.offset - 0.5 * chassis.wheelbase
        return chassis.stance(
            under(front, half), under(front, -half), under(rear, half), under(rear, -half)
        )

    def _field(self, layer: GridValues) -> ScalarField:
        return ScalarField(layer, self.frame, jnp.zeros(()))

    def _look_up(self, layer: GridValues, cell: Int[Array, "*N 2"]) -> Float[Array, "*N"]:
        height, width = self.shape
        # Clip first: an index out of bounds would be clamped or wrapped silently.
        row = jnp.clip(cell[..., 0], 0, height - 1)
        column = jnp.clip(cell[..., 1], 0, width - 1)
        return jnp.where(self.contains(cell), layer[row, column], 0.0)


def _layers(ground: Ground) -> list[Any]:
    return [ground.elevation, ground.slope, ground.roughness, ground.traversability]


# Outside of `jit` each of the many slices would be compiled as a program of its own.
@jax.jit
def _relief(elevation: GridValues, resolution: Scalar | float) -> tuple[GridValues, GridValues]:
    """Return the slope [m/m] and the roughness [m] of each cell."""
    # An odd reflection by one cell extrapolates linearly; an axis of one cell stays level.
    padded: Array = elevation
    for axis, size in enumerate(elevation.shape):
        width = [(1, 1) if axis == other else (0, 0) for other in range(2)]
        padded = (
            jnp.pad(padded, width, mode="reflect", reflect_type="odd")
            if size > 1
            else jnp.pad(padded, width, mode="edge")
        )
    # The filters sum (1, 1, 1), difference (-1, 0, 1) and bend (1, -2, 1) are an orthogonal basis
    # of three cells, and their nine products one of 3 x 3 cells. A plane is spanned by three of the
    # products; the other six, divided by their norms, are the residual. Fitting the plane and
    # subtracting it would lose digits where the ground is high; differences of neighbours do not.
    difference, bend = _difference(padded, 0), _bend(padded, 0)
    by_row, by_column = _inner(difference, 1), _inner(_difference(padded, 1), 0)
    slope = root(by_row**2 + by_column**2) / (2.0 * resolution)
    twist = _difference(difference, 1)
    residual = twist**2 / 4.0
    residual += (_sum(bend, 1) ** 2 + _sum(_bend(padded, 1), 0) ** 2) / 18.0
    residual += (_bend(difference, 1) ** 2 + _difference(bend, 1) ** 2) / 12.0
    residual += _bend(bend, 1) ** 2 / 36.0
    return slope, root(residual / 9.0)


def _difference(values: Array, axis: int) -> Array:
    return _from(values, axis, 2) - _from(values, axis, 0)


def _bend(values: Array, axis: int) -> Array:
    middle = _inner(values, axis)
    return (_from(values, axis, 2) - middle) - (middle - _from(values, axis, 0))


def _sum(values: Array, axis: int) -> Array:
    return _from(values, axis, 0) + _inner(values, axis) + _from(values, axis, 2)


def _inner(values: Array, axis: int) -> Array:
    return _from(values, axis, 1)


def _from(values: Array, axis: int, first: int) -> Array:
    """Return the values from `first` on along an axis, two fewer than the array has."""
    return jax.lax.slice_in_dim(values, first, first + values.shape[axis] - 2, axis=axis)


def _elevation(value: ArrayLike) -> GridValues:
    shape = np.shape(value)
    if len(shape) != 2 or 0 in shape:
        raise ValueError(f"elevation has shape {shape}; accepted: (H, W) with H, W >= 1")
    if not _kinds.is_traced(value):
        array = np.asarray(value, np.float64)
        if not (np.abs(array) <= HIGHEST).all():
            raise ValueError(
                f"elevation spans {array.min()} to {array.max()}; "
                f"accepted: finite numbers within {HIGHEST:g} m of 0"
            )
    return jnp.asarray(value, jnp.float32)


def _traversability(value: ArrayLike, shape: tuple[int, ...]) -> GridValues:
    if np.shape(value) != shape:
        raise ValueError(
            f"traversability has shape {np.shape(value)}; accepted: the elevation's, {shape}"
        )
    given = _checks.probabilities("traversability", value, 2)
    # Only traced values can fail this test; others have been checked.
    return jnp.clip(jnp.where(jnp.isnan(given), 0.0, given), 0.0, 1.0)
