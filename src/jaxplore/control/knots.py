"""Parameterise a control sequence by a few knots: kernel and spline MPPI.

Time is in model steps.
"""

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ControlVector, Scalar
from jaxplore.control.parameterisations import (
    ControlSamples,
    ControlSpace,
    Parameterisation,
    Parameters,
    Samples,
    Sequence,
)

CONDITION = 3e4
"""Greatest condition number of a kernel matrix: it amplifies the rounding of float32 to 2e-3."""

Times = Float[Array, " N"]
Weights = Float[Array, "N P"]


class Interpolation(eqx.Module):
    """Linear map from the values at evenly spaced knots to the value at any time; abstract."""

    @abc.abstractmethod
    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weight (N, P) of each knot at each time.

        Args:
            times: times (N,) >= 0 [model steps]. Beyond `end` the weights fall to 0, because the
                interpolated quantity is the deviation from the default control.
            num_knots: number of knots, P, evenly spaced from 0 to `end`.
            end: time of the last knot [model steps].

        Raises:
            ValueError: knots that are too close together for this interpolation.
        """

    def weights_ahead(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights (N, P) that shift the knots in time, to the values at these times."""
        return self.weights(times, num_knots, end)


class ZeroOrderHold(Interpolation):
    """Zero-order hold: the value of a knot is held until the next knot."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return weights of 1 for the last knot at or before each time."""
        index, _, _ = _interval(times, num_knots, end)
        # `_interval` puts the end into the last interval, where the knot before it would be held.
        at_end = times >= end
        index = jnp.where(at_end, num_knots - 1, index)
        return _one_hot(index, num_knots, times) * _fade(times, end)[:, None]

    def weights_ahead(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights of linear interpolation.

        Shifts shorter than the distance of the knots would never change held values.
        """
        return LinearInterpolation().weights(times, num_knots, end)


class LinearInterpolation(Interpolation):
    """Linear interpolation between the knots."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the hat functions of the knots."""
        return _hats(times, num_knots, end) * _fade(times, end)[:, None]


class CubicSpline(Interpolation):
    """Natural cubic spline through the knots, twice continuously differentiable."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the values of the cardinal splines.

        On an interval of length h the spline is
        `a y_0 + b y_1 + ((a^3 - a) m_0 + (b^3 - b) m_1) h^2 / 6`, with a the weight of the left
        end, b = 1 - a, and m the second derivatives at the ends.
        """
        index, share, width = _interval(times, num_knots, end)
        left, right = 1.0 - share, share
        bend = (left**3 - left)[:, None] * _one_hot(index, num_knots, times)
        bend = bend + (right**3 - right)[:, None] * _one_hot(index + 1, num_knots, times)
        curvature = jnp.asarray(_second_derivatives(num_knots, width), times.dtype)
        spline = _hats(times, num_knots, end) + (width * width / 6.0) * (bend @ curvature)
        return spline * _fade(times, end)[:, None]


class Kernel(Interpolation):
    """Kernel interpolation, `k(t, t_knots) k(t_knots, t_knots)^-1`; abstract.

    It is the posterior mean of a Gaussian process with covariance k, given the knots.

    Args:
        length_scale: length scale of the covariance [model steps]; static.

    Raises:
        ValueError: a length that is not positive.
    """

    length_scale: float = eqx.field(static=True)

    def __init__(self, length_scale: float = 1.0) -> None:
        self.length_scale = _checks.number("length_scale", length_scale, above=0.0)

    @abc.abstractmethod
    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the covariance between two times at a distance [model steps]; 1 at distance 0."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights of kernel interpolation."""
        knots = jnp.linspace(0.0, end, num_knots)
        across = self.covariance(jnp.abs(times[:, None] - knots))
        return across @ jnp.asarray(self._inverse(num_knots, end), times.dtype)

    def _inverse(self, num_knots: int, end: float) -> np.ndarray:
        """Return `k(t_knots, t_knots)^-1` (P, P), computed at compile time in double precision."""
        knots = np.linspace(0.0, end, num_knots)
        distance = np.abs(knots[:, None] - knots)

        def among(length_scale: float) -> np.ndarray:
            # The length scale is static, so another one is tried by scaling the distances instead.
            scaled = distance * (self.length_scale / length_scale)
            with jax.ensure_compile_time_eval():
                return np.asarray(self.covariance(jnp.asarray(scaled, jnp.float32)), np.float64)

        matrix = among(self.length_scale)
        if np.linalg.cond(matrix) <= CONDITION:
            return np.asarray(np.linalg.inv(matrix))
        # Bisect for the largest length scale that is accepted, for the message.
        low, high = 0.0, self.length_scale
        for _ in range(20):
            middle = 0.5 * (low + high)
            is_fine = np.linalg.cond(among(middle)) <= CONDITION
            low, high = (middle, high) if is_fine else (low, middle)
        raise ValueError(
            f"length_scale is {self.length_scale}; accepted: at most {low:.3g} model steps for "
            f"{num_knots} knots over {end:g}, which cannot be told apart beyond that"
        )


class RBFKernel(Kernel):
    """Radial basis function (Gaussian) kernel, `exp(-d^2 / (2 l^2))`.

    Source: the kernel MPPI of pytorch_mppi (Zhong, Fazeli, Berenson, "RUMI", T-RO 2025).

    Args:
        length_scale: length scale l [model steps]; static.

    Raises:
        ValueError: a length that is not positive.
    """

    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the kernel at a distance [model steps]."""
        scaled = distance / self.length_scale
        return jnp.exp(-0.5 * scaled * scaled)


class MaternKernel(Kernel):
    """Matérn kernel of smoothness 5/2, `(1 + s + s^2 / 3) exp(-s)` with `s = sqrt(5) d / l`.

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", eq. 4.17.

    Args:
        length_scale: length scale l [model steps]; static.

    Raises:
        ValueError: a length that is not positive.
    """

    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the kernel at a distance [model steps]."""
        scaled = jnp.sqrt(5.0) * distance / self.length_scale
        return (1.0 + scaled + scaled * scaled / 3.0) * jnp.exp(-scaled)


def _interval(times: Times, num_knots: int, end: float) -> tuple[Array, Array, float]:
    """Return the interval of each time, the fraction passed of it, and the interval's width."""
    # A single knot or a horizon of one step has an interval of length 0: any width avoids 0 / 0.
    width = end / max(num_knots - 1, 1) or 1.0
    # Multiply before dividing: at a knot the quotient is then exactly a whole number.
    position = times * max(num_knots - 1, 0) / (end or 1.0)
    position = jnp.clip(position, 0.0, float(max(num_knots - 1, 0)))
    index = jnp.clip(jnp.floor(position), 0.0, float(max(num_knots - 2, 0)))
    return index.astype(jnp.int32), position - index, width


def _hats(times: Times, num_knots: int, end: float) -> Weights:
    """Return the hat functions of the knots: the weights of linear interpolation."""
    index, share, _ = _interval(times, num_knots, end)
    here = (1.0 - share)[:, None] * _one_hot(index, num_knots, times)
    return here + share[:, None] * _one_hot(index + 1, num_knots, times)


def _fade(times: Times, end: float) -> Float[Array, " N"]:
    """Return a factor that is 1 up to the last knot and falls to 0 over the step after it."""
    return jnp.clip(1.0 - (times - end), 0.0, 1.0)


def _one_hot(index: Array, size: int, times: Times) -> Weights:
    return (index[:, None] == jnp.arange(size, dtype=index.dtype)).astype(times.dtype)


@functools.lru_cache(maxsize=32)
def _second_derivatives(num_knots: int, width: float) -> np.ndarray:
    """Return the second derivatives (P, P) at the knots of the P natural cardinal splines."""
    import scipy.interpolate  # slow to import, and few need it

    # A natural spline through fewer than three knots is straight.
    if num_knots < 3:
        return np.zeros((num_knots, num_knots))
    knots = width * np.arange(num_knots)
    spline = scipy.interpolate.CubicSpline(knots, np.eye(num_knots), bc_type="natural")
    return np.asarray(spline.derivative(2)(knots))


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
