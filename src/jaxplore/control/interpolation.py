"""Ways to interpolate between knots; time is counted in model steps."""

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.interpolate
from jaxtyping import Array, Float

from jaxplore import _checks

CONDITION = 3e4
"""Greatest condition number of a kernel's matrix: times the rounding of float32, 2e-3."""

Times = Float[Array, " N"]
Weights = Float[Array, "N P"]


class Interpolation(eqx.Module):
    """Values at any time as weighted sums of the values at evenly spaced knots."""

    @abc.abstractmethod
    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weight (N, P) of each knot at each time.

        Args:
            times: (N,) >= 0, in model steps. Beyond `end` the weights fall to 0: what is
                interpolated is the deviation from the default control.
            num_knots: P knots, evenly spaced from 0 to `end`.
            end: time of the last knot.

        Raises:
            ValueError: knots that this interpolation cannot tell apart.
        """

    def weights_ahead(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights (N, P) that move the knots on, to the values at these times."""
        return self.weights(times, num_knots, end)


class ZeroOrderHold(Interpolation):
    """Each knot's value is held until the next knot."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return 1 for the last knot that is not later than the time."""
        index, _, _ = _interval(times, num_knots, end)
        at_end = times >= end
        index = jnp.where(at_end, num_knots - 1, index)
        return _one_hot(index, num_knots, times) * _fade(times, end)[:, None]

    def weights_ahead(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights of straight lines.

        Held values would never move on in steps shorter than the knots' distance.
        """
        return LinearInterpolation().weights(times, num_knots, end)


class LinearInterpolation(Interpolation):
    """Straight lines between the knots."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the hat functions of the knots."""
        return _hats(times, num_knots, end) * _fade(times, end)[:, None]


class CubicSpline(Interpolation):
    """The natural cubic spline through the knots: twice continuously differentiable."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the cardinal splines.

        On an interval of length h, with a the share of its left end, b = 1 - a, and m the second
        derivatives: `a y_0 + b y_1 + ((a^3 - a) m_0 + (b^3 - b) m_1) h^2 / 6`.
        """
        index, share, width = _interval(times, num_knots, end)
        left, right = 1.0 - share, share
        bend = (left**3 - left)[:, None] * _one_hot(index, num_knots, times)
        bend = bend + (right**3 - right)[:, None] * _one_hot(index + 1, num_knots, times)
        curvature = jnp.asarray(_second_derivatives(num_knots, width), times.dtype)
        spline = _hats(times, num_knots, end) + (width * width / 6.0) * (bend @ curvature)
        return spline * _fade(times, end)[:, None]


class Kernel(Interpolation):
    """Interpolation by a kernel, `k(t, t_knots) k(t_knots, t_knots)^-1`.

    It is the mean of a Gaussian process with this covariance through the knots.
    """

    length_scale: eqx.AbstractVar[float]

    @abc.abstractmethod
    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the covariance of two times this far apart; 1 at distance 0."""

    def weights(self, times: Times, num_knots: int, end: float) -> Weights:
        """Return the weights of the kernel."""
        knots = jnp.linspace(0.0, end, num_knots)
        across = self.covariance(jnp.abs(times[:, None] - knots))
        return across @ jnp.asarray(self._inverse(num_knots, end), times.dtype)

    def _inverse(self, num_knots: int, end: float) -> np.ndarray:
        """Return `k(t_knots, t_knots)^-1` (P, P), computed when compiled, in double precision."""
        knots = np.linspace(0.0, end, num_knots)
        distance = np.abs(knots[:, None] - knots)

        def among(length_scale: float) -> np.ndarray:
            scaled = distance * (self.length_scale / length_scale)
            with jax.ensure_compile_time_eval():
                return np.asarray(self.covariance(jnp.asarray(scaled, jnp.float32)), np.float64)

        matrix = among(self.length_scale)
        if np.linalg.cond(matrix) <= CONDITION:
            return np.asarray(np.linalg.inv(matrix))
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
    """`exp(-d^2 / (2 l^2))`.

    Source: the kernel MPPI of pytorch_mppi (Zhong, Fazeli, Berenson, "RUMI", T-RO 2025).

    Args:
        length_scale: l, in model steps; static.

    Raises:
        ValueError: a length that is not positive.
    """

    length_scale: float = eqx.field(static=True)

    def __init__(self, length_scale: float = 1.0) -> None:
        self.length_scale = _checks.number("length_scale", length_scale, above=0.0)

    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the Gaussian of the distance."""
        scaled = distance / self.length_scale
        return jnp.exp(-0.5 * scaled * scaled)


class MaternKernel(Kernel):
    """The Matérn covariance of smoothness 5/2, `(1 + s + s^2 / 3) exp(-s)`, `s = sqrt(5) d / l`.

    Source: Rasmussen and Williams, "Gaussian Processes for Machine Learning", eq. 4.17.

    Args:
        length_scale: l, in model steps; static.

    Raises:
        ValueError: a length that is not positive.
    """

    length_scale: float = eqx.field(static=True)

    def __init__(self, length_scale: float = 1.0) -> None:
        self.length_scale = _checks.number("length_scale", length_scale, above=0.0)

    def covariance(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the covariance."""
        scaled = jnp.sqrt(5.0) * distance / self.length_scale
        return (1.0 + scaled + scaled * scaled / 3.0) * jnp.exp(-scaled)


def _interval(times: Times, num_knots: int, end: float) -> tuple[Array, Array, float]:
    """Return the interval of each time, its share of it, and the intervals' width."""
    width = end / max(num_knots - 1, 1) or 1.0
    # Multiplied first: at a knot the quotient is then a whole number exactly.
    position = times * max(num_knots - 1, 0) / (end or 1.0)
    position = jnp.clip(position, 0.0, float(max(num_knots - 1, 0)))
    index = jnp.clip(jnp.floor(position), 0.0, float(max(num_knots - 2, 0)))
    return index.astype(jnp.int32), position - index, width


def _hats(times: Times, num_knots: int, end: float) -> Weights:
    index, share, _ = _interval(times, num_knots, end)
    here = (1.0 - share)[:, None] * _one_hot(index, num_knots, times)
    return here + share[:, None] * _one_hot(index + 1, num_knots, times)


def _fade(times: Times, end: float) -> Float[Array, " N"]:
    """Return 1 up to the last knot, falling to 0 over the step after it."""
    return jnp.clip(1.0 - (times - end), 0.0, 1.0)


def _one_hot(index: Array, size: int, times: Times) -> Weights:
    return (index[:, None] == jnp.arange(size, dtype=index.dtype)).astype(times.dtype)


@functools.lru_cache(maxsize=32)
def _second_derivatives(num_knots: int, width: float) -> np.ndarray:
    """Return (P, P): second derivatives at the knots of the natural splines of unit values."""
    if num_knots < 3:
        return np.zeros((num_knots, num_knots))
    knots = width * np.arange(num_knots)
    spline = scipy.interpolate.CubicSpline(knots, np.eye(num_knots), bc_type="natural")
    return np.asarray(spline.derivative(2)(knots))
