"""Simulate a forward depth camera that sees the ground and obstacles, with occlusion by hills."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_BEAMS
from jaxplore._types import ArrayLike, Scalar
from jaxplore.geometry.rays import TOUCH, RayCells
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.fan import check_range, check_view

STEEPEST = 1.57
"""Greatest angle between an edge of the view and the horizontal [rad]: in single precision it
differs from a right angle, so its tangent is finite."""


class Camera(Sensor):
    """Forward depth camera, `num_beams` columns of pixels wide.

    It is `height` above the ground of the robot's cell. Along the ray of a column, the ground of a
    cell appears at the angle a with

        tan a = (elevation of the cell - z of the camera) / d

    where d is the distance to the middle of the ray's section in the cell. The pixels of a column
    are treated as continuous. With the edges of the view a- = tilt - vertical_view / 2 and
    a+ = tilt + vertical_view / 2, and the horizon h, the greatest a of all nearer cells,

        a free cell is visible    if  a- <= a <= a+  and  a >= h
        a solid cell is visible   if  max(a, h) < a+

    Solid cells are taller than the view and occlude everything behind them; so does ground that
    rises above a+. Without a `Ground` the ground is level at elevation 0 and visible from the
    distance height / tan(-a-) on, 1.9 m with the defaults.

    A column returns from the face of the first visible solid cell. The ground gives no return, but
    `sight` counts a cell as passed only if its ground was visible.

    Args:
        num_beams: number of columns, B, evenly spaced in angle.
        max_range: greatest range [m]; static, like the number of cells that a ray crosses.
        field_of_view: horizontal field of view, in (0, 2 pi] [rad], centred on the heading.
        vertical_view: angle between the lower and the upper edge of the view [rad].
        height: height above the ground on which the robot stands [m].
        tilt: pitch of the middle of the view, negative downwards [rad].
        range_noise: standard deviation of a returned range [m].

    Raises:
        ValueError: no columns, a range, view or height that is not positive, a field of view over
            2 pi, an edge of the view more than 1.57 rad from the horizontal, a negative noise.
    """

    num_beams: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    vertical_view: Scalar
    height: Scalar
    tilt: Scalar
    range_noise: Scalar

    def __init__(
        self,
        num_beams: int = 61,
        max_range: float = 20.0,
        field_of_view: float = math.pi / 3.0,
        vertical_view: ArrayLike = math.pi / 4.0,
        height: ArrayLike = 1.0,
        tilt: ArrayLike = -0.1,
        range_noise: ArrayLike = 0.0,
    ) -> None:
        self.num_beams = _checks.positive_int("num_beams", num_beams, at_most=MOST_BEAMS)
        self.max_range = check_range("max_range", max_range)
        self.field_of_view = check_view("field_of_view", field_of_view)
        view = _checks.scalar("vertical_view", vertical_view, above=0.0, below=2.0 * STEEPEST)
        self.vertical_view = view
        self.height = _checks.scalar("height", height, above=0.0)
        # Both edges of the view must stay below the steepest angle.
        most = STEEPEST - (0.0 if _kinds.is_traced(view) else 0.5 * float(view))
        self.tilt = _checks.scalar("tilt", tilt, at_least=-most, at_most=most)
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)

    def stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the masks of the cells that return a beam and of those that end it."""
        # Ground that fills the view ends a column without a return.
        _, wall = self._surfaces(cells, solid, rise, resolution)
        return solid & wall, solid | (cells.is_crossed & ~wall)

    def visible(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        """Return the mask of the cells that are visible to each beam."""
        ground, wall = self._surfaces(cells, solid, rise, resolution)
        return jnp.where(solid, wall, ground)

    def consistent(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the hits and passes that are consistent with the known ground."""
        # What is solid is not known here: visibility follows from the ground alone, and obstacles
        # in front are accounted for by the reading.
        ground, wall = self._surfaces(cells, jnp.zeros_like(is_hit), rise, resolution)
        return is_hit & wall, is_passed & ground

    def _surfaces(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return for each cell whether its ground is visible if the cell is free, and whether the
        cell is visible if it is solid."""
        half = 0.5 * self.vertical_view
        # Traced angles are not checked. Beyond a right angle the tangent would change its sign.
        bottom = jnp.tan(jnp.clip(self.tilt - half, -STEEPEST, STEEPEST))
        top = jnp.tan(jnp.clip(self.tilt + half, -STEEPEST, STEEPEST))
        # The bound keeps the distance from being 0 in the camera's own cell.
        middle = jnp.maximum(0.5 * (cells.entry + cells.exit), TOUCH) * resolution
        ground = (-self.height if rise is None else rise) / middle
        # The horizon of a cell is the running maximum over all nearer cells; solid cells are
        # infinitely high, and cells that the ray only touches do not count.
        crest = jnp.where(solid, jnp.inf, jnp.where(cells.is_crossed, ground, -jnp.inf))
        nearer = jax.lax.cummax(crest, axis=1)[:, :-1]
        horizon = jnp.pad(nearer, ((0, 0), (1, 0)), constant_values=-jnp.inf)
        is_ground = (ground >= bottom) & (ground <= top) & (ground >= horizon)
        return is_ground, jnp.maximum(ground, horizon) < top
