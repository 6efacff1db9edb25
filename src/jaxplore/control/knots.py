"""Parameterise a control sequence by a few knots: kernel and spline MPPI."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ControlVector, Scalar
from jaxplore.control.interpolation import CubicSpline, Interpolation
from jaxplore.control.parameterisations import (
    ControlSamples,
    ControlSpace,
    Parameterisation,
    Parameters,
    Samples,
    Sequence,
)


class Knots(Parameterisation):
    """Controls at a few knots, evenly spaced over the horizon and interpolated in between:

        u_t = u_default + sum_p W_tp (theta_p - u_default)

    Fewer parameters are sampled, and the controls are as smooth as the interpolation. The deviation
    from the default control is interpolated, so that a kernel, which falls to 0 away from the
    knots, falls to the default control. W depends on static sizes only and is computed at compile
    time. Given control sequences, such as a reference or an escape manoeuvre, are encoded as the
    nearest knots in the least-squares sense.

    With `RBFKernel` this is the kernel MPPI of pytorch_mppi, with `CubicSpline` spline MPPI.

    Args:
        num_knots: number of knots, P; at most the horizon.
        interpolation: interpolation between the knots; `CubicSpline()` by default.

    Raises:
        ValueError: `num_knots` < 1; from `num_parameters`, more knots than steps.
    """

    interpolation: Interpolation
    num_knots: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(self, num_knots: int, interpolation: Interpolation | None = None) -> None:
        self.num_knots = _checks.positive_int("num_knots", num_knots)
        self.interpolation = CubicSpline() if interpolation is None else interpolation

    def num_parameters(self, horizon: int) -> int:
        """Return the number of knots."""
        if self.num_knots > horizon:
            raise ValueError(
                f"num_knots is {self.num_knots}; accepted: at most the horizon, {horizon}"
            )
        self._matrix(horizon)  # raises if the interpolation cannot separate the knots
        return self.num_knots

    def init(self, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the nearest knots to a control sequence, in the least-squares sense."""
        return self.encode(None, controls, space)

    def centre(self, nominal: Parameters) -> Parameters:
        """Return the knots."""
        return nominal

    def rest(self, space: ControlSpace) -> ControlVector:
        """Return the default control."""
        return space.default

    def decode(
        self, nominal: Parameters, samples: Samples, space: ControlSpace
    ) -> tuple[ControlSamples, Samples]:
        """Return the interpolated controls, and the knots clipped to the bounds."""
        knots = space.clip_samples(samples)
        default = space.default[:, None]
        # Interpolated controls can overshoot the knots, so they are clipped again.
        deviation = jnp.einsum("tp,puk->tuk", self._matrix(space.horizon), knots - default)
        return space.clip_samples(default + deviation), knots

    def encode(self, nominal: object, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the nearest knots (least squares), clipped to the bounds."""
        # The matrix is static: its pseudoinverse is computed at compile time, in double precision.
        nearest = np.linalg.pinv(np.asarray(self._matrix(controls.shape[0]), np.float64))
        deviation = jnp.asarray(nearest, controls.dtype) @ (controls - space.default)
        return space.clip(space.default + deviation)

    def update(self, nominal: Parameters, mean: Parameters, space: ControlSpace) -> Parameters:
        """Return the weighted mean of the knots."""
        return mean

    def controls(self, nominal: Parameters, space: ControlSpace) -> Sequence:
        """Return the interpolated controls, clipped to the bounds."""
        deviation = self._matrix(space.horizon) @ (nominal - space.default)
        return space.clip(space.default + deviation)

    def shift(self, nominal: Parameters, steps: Scalar, space: ControlSpace) -> Parameters:
        """Return the interpolated values `steps` model steps after each knot."""
        end = float(space.horizon - 1)
        times = jnp.linspace(0.0, end, self.num_knots) + steps
        weights = self.interpolation.weights_ahead(times, self.num_knots, end)
        return space.default + weights @ (nominal - space.default)

    def _matrix(self, horizon: int) -> Float[Array, "T P"]:
        """Return the interpolation matrix W (T, P), computed at compile time."""
        with jax.ensure_compile_time_eval():
            times = jnp.arange(float(horizon))
            return self.interpolation.weights(times, self.num_knots, float(horizon - 1))
