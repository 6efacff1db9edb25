"""What a control sequence costs whose outcome is uncertain."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar

Totals = Float[Array, "M K"]
StepCosts = Float[Array, "M K"]
Costs = Float[Array, " K"]


class Risk(eqx.Module):
    """One number for M outcomes of each of K control sequences."""

    @abc.abstractmethod
    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the cost of each control sequence (K,).

        Args:
            totals: (M, K) cost of each outcome.
            variation: (K,) what `step_variation` added up to.
        """

    def step_variation(self, paid: StepCosts, t: Scalar, dt: Scalar) -> Costs:
        """Return what one step adds to the variation (K,): nothing, unless a risk says otherwise.

        Args:
            paid: (M, K) stage costs of the step.
            t: time from now at which it ends [s].
            dt: its length [s].
        """
        return jnp.zeros(paid.shape[1])


class MeanVariance(Risk):
    """`mean_m J_m + weight * sum_t discount^t var_m(stage cost of step t)`, t = 0, 1, ...

    The variance is that of a sample, with M - 1 below. Weight 0 is the plain mean.

    Args:
        weight: of the variance.
        discount: per step.

    Raises:
        ValueError: a weight that is not finite, a discount outside [0, 1].
    """

    weight: Scalar
    discount: Scalar

    def __init__(self, weight: ArrayLike = 0.0, discount: ArrayLike = 0.95) -> None:
        self.weight = _checks.scalar("weight", weight)
        self.discount = _checks.scalar("discount", discount, at_least=0.0, at_most=1.0)

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the mean and the weighted variation (K,)."""
        return jnp.mean(totals, axis=0) + self.weight * variation

    def step_variation(self, paid: StepCosts, t: Scalar, dt: Scalar) -> Costs:
        """Return the discounted variance of the step (K,)."""
        if paid.shape[0] == 1:
            return jnp.zeros(paid.shape[1])
        return self.discount ** (jnp.round(t / dt) - 1.0) * jnp.var(paid, axis=0, ddof=1)


class WorstCase(Risk):
    """`max_m J_m`."""

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the greatest cost (K,)."""
        return jnp.max(totals, axis=0)


class ValueAtRisk(Risk):
    """The least cost that a share `level` of the outcomes does not exceed.

    Args:
        level: 0 to 1; 0.9 ignores the worst tenth.

    Raises:
        ValueError: a level that is not within (0, 1).
    """

    level: Scalar

    def __init__(self, level: ArrayLike = 0.9) -> None:
        self.level = _checks.scalar("level", level, above=0.0, below=1.0)

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the quantile (K,)."""
        return _quantile(totals, self.level)


class ConditionalValueAtRisk(Risk):
    """The mean cost of the worst share `1 - level` of the outcomes.

        VaR + mean_m (J_m - VaR)_+ / (1 - level)

    Source: Rockafellar and Uryasev, "Optimization of conditional value-at-risk", 2000, eq. 4.

    Args:
        level: 0 to 1; 0.9 averages the worst tenth.

    Raises:
        ValueError: a level that is not within [0, 1).
    """

    level: Scalar

    def __init__(self, level: ArrayLike = 0.9) -> None:
        self.level = _checks.scalar("level", level, at_least=0.0, below=1.0)

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the mean of the tail (K,)."""
        quantile = _quantile(totals, self.level)
        excess = jnp.mean(jnp.maximum(totals - quantile, 0.0), axis=0)
        return quantile + excess / (1.0 - self.level)


class Entropic(Risk):
    """`log(mean_m exp(theta J_m)) / theta`: the mean for small theta, the worst case for large.

    Source: Whittle, "Risk-sensitive linear/quadratic/Gaussian control", 1981.

    Args:
        theta: aversion to risk, per unit of cost; negative values seek it.

    Raises:
        ValueError: a theta of 0 or not finite.
    """

    theta: Scalar

    def __init__(self, theta: ArrayLike = 1.0) -> None:
        self.theta = _checks.scalar("theta", theta)
        if not _checks.is_traced(theta) and self.theta == 0.0:
            raise ValueError(f"theta is {theta!r}; accepted: a finite number other than 0")

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the entropic risk (K,)."""
        mean = jnp.mean(totals, axis=0)
        exponent = self.theta * (totals - mean)
        # Near 0 the logarithm of a sum of numbers near 1 would lose all digits.
        near = jnp.log1p(jnp.mean(jnp.expm1(jnp.clip(exponent, -1.0, 1.0)), axis=0))
        far = jax.nn.logsumexp(exponent, axis=0) - np.float32(np.log(totals.shape[0]))
        is_near = jnp.max(jnp.abs(exponent), axis=0) < 1.0
        return mean + jnp.where(is_near, near, far) / self.theta


def _quantile(totals: Totals, level: Scalar) -> Costs:
    """Return the cost of rank `ceil(level M)` of the M outcomes, counted from 1."""
    count = totals.shape[0]
    # Rounding must not lift 0.9 * 10 above 9.
    rank = jnp.ceil(level * count - 1e-4).astype(jnp.int32) - 1
    return jnp.sort(totals, axis=0)[jnp.clip(rank, 0, count - 1)]
