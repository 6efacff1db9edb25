"""Costs of being near obstacles that move: those given beforehand, and those the robot tracks."""

import functools
import itertools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._checks import array, covariances, isotropic, one_each
from jaxplore._types import ControlVector, Flag, Rows, Scalar, Vector
from jaxplore.belief.tracks import Tracks
from jaxplore.costs._contact import contact, depth, levers, shifted
from jaxplore.costs._distance import offset
from jaxplore.costs._many import add_up
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.vectors import length


class MovingObstacleCost(Cost):
    """Nearness to where moving obstacles are expected, a Gaussian around each:

        sum_n exp(-1/2 d_n^T S_n(t)^-1 d_n),   d_n = p - (p_n + v_n t)
        S_n(t) = C_n + ((growth t)^2 + (r + r_n)^2) I

    They go on straight, and where they are becomes less certain with time: `growth` is the standard
    deviation of their velocity. The robot's radius r and theirs widen the Gaussian, so at contact
    with an obstacle that is known exactly it is exp(-1/2), about 0.6, and still rises further in.

    The peak is 1 at any time, not normalised: uncertainty spreads the cost and makes it no smaller.

    Of a robot that several discs cover (`Footprint`), r is their radius, and of each obstacle's
    term the greatest over their centres p counts.

    Args:
        positions: p_n, (N, 2) where they are now [m]; none of them, N = 0, cost nothing.
        velocities: v_n, (N, 2) [m/s].
        radii: r_n, (N,) or one number [m].
        std: of the position now along either axis, (N,) or one number [m]: `C_n = std_n^2 I`; 0.2
            when absent.
        covariance: C_n, (N, 2, 2), or (2, 2) for all [m^2]; instead of `std`.
        growth: (N,) or one number [m/s].

    Raises:
        ValueError: shapes that do not fit, a `std` that is not positive, a covariance that is not
            symmetric and positive definite, both of them, a negative radius or growth.
    """

    positions: Float[Array, "N 2"]
    velocities: Float[Array, "N 2"]
    radii: Float[Array, " N"]
    covariance: Float[Array, "N 2 2"]
    growth: Float[Array, " N"]

    def __init__(
        self,
        positions: Rows,
        velocities: Rows,
        radii: Vector = 0.0,
        std: Vector | None = None,
        covariance: Rows | None = None,
        growth: Vector = 0.2,
    ) -> None:
        self.positions = array("positions", positions, ("N", 2), may_be_empty=True)
        number = self.positions.shape[0]
        self.velocities = array("velocities", velocities, (number, 2), may_be_empty=number == 0)
        self.radii = one_each("radii", radii, number, at_least=0.0)
        std = 0.2 if std is None and covariance is None else std
        self.covariance = covariances(std, covariance, number)
        self.growth = one_each("growth", growth, number, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the sum over the obstacles at the time when the state is reached."""
        extent = state.dynamics.footprint.radius + self.radii
        forms = _forms(self.covariance, self.growth * t, extent)
        centres = self.positions + t * self.velocities
        parts = levers(state)

        def nearness(obstacle: tuple[Array, Array]) -> Scalar:
            centre, form = obstacle
            away = offset(state, centre)
            return _nearness(form, [shifted(away, lever) for lever in parts])

        return add_up(nearness, (centres, forms))


class TrackedObstacleCost(Cost):
    """Nearness to the moving obstacles that the robot tracks, and contact with them.

    With g_n the distance of the robot's centre from the surface of obstacle n where it is expected
    when the state is reached, negative inside,

        sum over the known n of exp(-1/2 d_n^T S_n(t)^-1 d_n) + collision * ((c - g_n)_+ / 0.05 m)^2
        d_n = p - (p_n + v_n t),  S_n(t) = (std_n^2 + (growth t)^2 + (r + r_n)^2) I
        g_n = |d_n| - r_n,  c = r + margin + reaction_time * |v|

    The first term is that of `MovingObstacleCost`: it keeps away from where one may be. The second
    is that of `ObstacleCost`: it keeps from touching one that does what is expected. What was never
    seen costs nothing.

    Of a robot that several discs cover (`Footprint`), r is their radius, and for each obstacle the
    nearest of their centres p counts.

    Reads `belief.tracks`, a `Tracks`.

    Args:
        margin: kept beyond both radii [m].
        reaction_time: [s].
        collision: cost of each step that is 5 cm too close.

    Raises:
        ValueError: a negative value.
    """

    margin: Scalar
    reaction_time: Scalar
    collision: Scalar

    def __init__(
        self,
        margin: ArrayLike = 0.1,
        reaction_time: ArrayLike = 0.05,
        collision: ArrayLike = 100.0,
    ) -> None:
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.collision = _checks.scalar("collision", collision, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the sum over the obstacles at the time when the state is reached."""
        # Of an obstacle that was never seen nothing need be a number.
        tracks: Tracks = belief.tracks
        is_known = tracks.is_known
        centres = jnp.where(is_known[:, None], tracks.predicted(t), 0.0)
        std = jnp.where(is_known, tracks.deviation(t), 1.0)
        extent = state.dynamics.footprint.radius + tracks.radii
        forms = _forms(isotropic(std), jnp.zeros(()), extent)
        too_close = contact(state, self.margin, self.reaction_time)
        parts = levers(state)

        def price(obstacle: tuple[Array, Array, Scalar, Flag]) -> Scalar:
            centre, form, radius, counts = obstacle
            away = [shifted(offset(state, centre), lever) for lever in parts]
            distance = functools.reduce(jnp.minimum, itertools.starmap(length, away)) - radius
            deep = depth(distance, too_close)
            paid = _nearness(form, away) + self.collision * deep * deep
            return jnp.where(counts, paid, 0.0)

        return add_up(price, (centres, forms, tracks.radii, is_known))


def _forms(
    covariance: Float[Array, "N 2 2"], drift: Float[Array, "*N"], extent: Float[Array, " N"]
) -> Float[Array, "N 3"]:
    """Return the coefficients of x^2, x y and y^2 in -1/2 d^T S^-1 d.

    Args:
        covariance: (N, 2, 2) of the positions now [m^2].
        drift: what the deviation has become since, (N,) or one number [m].
        extent: (N,) both radii together [m].
    """
    wider = drift * drift + extent * extent
    a, b = covariance[:, 0, 0] + wider, covariance[:, 0, 1]
    c = covariance[:, 1, 1] + wider
    # -1/2 of the inverse of [[a, b], [b, c]], with the factor 2 of the mixed term.
    scale = -0.5 / (a * c - b * b)
    return jnp.stack([scale * c, -2.0 * scale * b, scale * a], axis=-1)


def _nearness(form: Float[Array, "3"], offsets: Sequence[tuple[Scalar, ...]]) -> Scalar:
    """Return the Gaussian at the offset from its middle where it is greatest."""
    exponents = [form[0] * x * x + form[1] * x * y + form[2] * y * y for x, y in offsets]
    return jnp.exp(functools.reduce(jnp.maximum, exponents))
