"""A forward depth camera: it sees the ground and what stands on it, as far as hills let it."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.geometry.rays import TOUCH, RayCells
from jaxplore.sensing.base import Sensor

STEEPEST = 1.57
"""Greatest angle of the view's edges from the horizontal [rad]: single precision can tell it from
a right angle, and its tangent is finite."""


class Camera(Sensor):
    """A depth camera that looks ahead, `num_beams` columns of pixels wide.

    It stands `height` above the ground of the robot's cell. Along a column's ray, the ground of a
    cell appears at

        tan a = (elevation of the cell - z of the camera) / d

    with d the distance to the middle of the ray's stretch in the cell. Pixels of a column are
    continuous, so with the view's edges a- = tilt - vertical_view / 2 and a+ = tilt +
    vertical_view / 2, and the horizon h the greatest a of all nearer cells:

        a free cell is seen    where  a- <= a <= a+  and  a >= h
        a solid cell is seen   where  max(a, h) < a+

    Solid cells are taller than the view, and hide all that is behind them; so does ground that
    rises above a+. Without a `Ground` it is level at elevation 0: seen from height / tan(-a-) on,
    1.9 m with the defaults.

    A column comes back from the first solid cell that is seen, at its face; the ground does not
    return, but `sight` knows where it was seen, and only there are cells passed.

    Args:
        num_beams: columns, B, evenly spaced in angle.
        max_range: reach [m]; static, as the number of cells that a ray crosses.
        field_of_view: horizontal, in (0, 2 pi] [rad], centred on the heading.
        vertical_view: from the view's lower to its upper edge [rad].
        height: above the ground on which the robot stands [m].
        tilt: of the view's middle, negative downwards [rad].
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
        self.num_beams = _checks.positive_int("num_beams", num_beams)
        self.max_range = _checks.number("max_range", max_range, above=0.0)
        self.field_of_view = _checks.number(
            "field_of_view", field_of_view, above=0.0, at_most=2.0 * math.pi + 1e-6
        )
        view = _checks.scalar("vertical_view", vertical_view, above=0.0, below=2.0 * STEEPEST)
        self.vertical_view = view
        self.height = _checks.scalar("height", height, above=0.0)
        most = STEEPEST - (0.0 if _checks.is_traced(view) else 0.5 * float(view))
        self.tilt = _checks.scalar("tilt", tilt, at_least=-most, at_most=most)
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)

    def _stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        _, wall = self._visible(cells, solid, rise, resolution)
        return solid & wall, solid | (cells.is_crossed & ~wall)

    def _shown(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        ground, wall = self._visible(cells, solid, rise, resolution)
        return jnp.where(solid, wall, ground)

    def _believed(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        ground, wall = self._visible(cells, jnp.zeros_like(is_hit), rise, resolution)
        return is_hit & wall, is_passed & ground

    def _visible(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Say of each cell whether its ground is seen if it is free, and itself if it is solid."""
        half = 0.5 * self.vertical_view
        bottom = jnp.tan(jnp.clip(self.tilt - half, -STEEPEST, STEEPEST))
        top = jnp.tan(jnp.clip(self.tilt + half, -STEEPEST, STEEPEST))
        middle = jnp.maximum(0.5 * (cells.entry + cells.exit), TOUCH) * resolution
        ground = (-self.height if rise is None else rise) / middle
        crest = jnp.where(solid, jnp.inf, jnp.where(cells.is_crossed, ground, -jnp.inf))
        nearer = jax.lax.cummax(crest, axis=1)[:, :-1]
        horizon = jnp.pad(nearer, ((0, 0), (1, 0)), constant_values=-jnp.inf)
        is_ground = (ground >= bottom) & (ground <= top) & (ground >= horizon)
        return is_ground, jnp.maximum(ground, horizon) < top
