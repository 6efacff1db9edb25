"""Reduce the costs of several outcomes of a control sequence to one: risk measures."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar

Totals = Float[Array, "M K"]
StepCosts = Float[Array, "M K"]
Costs = Float[Array, " K"]


class Risk(eqx.Module):
    """Risk measure: maps the costs of M outcomes to one cost per control sequence; abstract."""

    @abc.abstractmethod
    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the cost of each control sequence (K,).

        Args:
            totals: cost (M, K) of each outcome.
            variation: sum (K,) of `step_variation` over the steps.
        """

    def step_variation(self, paid: StepCosts, t: Scalar, dt: Scalar) -> Costs:
        """Return the contribution (K,) of one step to the variation; 0 by default.

        Args:
            paid: stage costs (M, K) of the step.
            t: time at which the step ends [s].
            dt: length of the step [s].
        """
        return jnp.zeros(paid.shape[1])


class MeanVariance(Risk):
    """Mean plus variance: `mean_m J_m + weight * sum_t discount^t var_m(stage cost of step t)`.

    t counts the steps from 0. The variance is the unbiased sample variance, with denominator M - 1.
    Weight 0 gives the mean.

    Args:
        weight: weight of the variance.
        discount: discount of the variance per step.

    Raises:
        ValueError: a weight that is not finite, a discount outside [0, 1].
    """

    weight: Scalar
    discount: Scalar

    def __init__(self, weight: ArrayLike = 0.0, discount: ArrayLike = 0.95) -> None:
        self.weight = _checks.scalar("weight", weight)
        self.discount = _checks.scalar("discount", discount, at_least=0.0, at_most=1.0)

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the mean plus the weighted variation (K,)."""
        return jnp.mean(totals, axis=0) + self.weight * variation

    def step_variation(self, paid: StepCosts, t: Scalar, dt: Scalar) -> Costs:
        """Return the discounted variance of the step (K,)."""
        if paid.shape[0] == 1:
            return jnp.zeros(paid.shape[1])
        # The step that ends at t = dt has the index 0. The quotient is whole up to rounding.
        return self.discount ** (jnp.round(t / dt) - 1.0) * jnp.var(paid, axis=0, ddof=1)


class WorstCase(Risk):
    """Worst case: `max_m J_m`."""

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the greatest cost (K,)."""
        return jnp.max(totals, axis=0)


class ValueAtRisk(Risk):
    """Value at risk: the smallest cost that a share `level` of the outcomes does not exceed.

    Args:
        level: share of the outcomes, in (0, 1); 0.9 ignores the worst tenth.

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
    """Conditional value at risk: the mean cost of the worst share `1 - level` of the outcomes,

        CVaR = VaR + mean_m (J_m - VaR)_+ / (1 - level)

    Source: Rockafellar and Uryasev, "Optimization of conditional value-at-risk", 2000, eq. 4.

    Args:
        level: share of the outcomes that is left out, in [0, 1); 0.9 averages the worst tenth.

    Raises:
        ValueError: a level that is not within [0, 1).
    """

    level: Scalar

    def __init__(self, level: ArrayLike = 0.9) -> None:
        self.level = _checks.scalar("level", level, at_least=0.0, below=1.0)

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the mean of the tail (K,)."""
        # This form weights the outcome at the quantile by its fraction in the tail, so it holds
        # also if (1 - level) M is not a whole number.
        quantile = _quantile(totals, self.level)
        excess = jnp.mean(jnp.maximum(totals - quantile, 0.0), axis=0)
        return quantile + excess / (1.0 - self.level)


class Entropic(Risk):
    """Entropic risk, `log(mean_m exp(theta J_m)) / theta`.

    It approaches the mean for small theta and the worst case for large theta.

    Source: Whittle, "Risk-sensitive linear/quadratic/Gaussian control", 1981.

    Args:
        theta: risk aversion [1 / unit of cost]; a negative value seeks risk.

    Raises:
        ValueError: a theta of 0 or not finite.
    """

    theta: Scalar

    def __init__(self, theta: ArrayLike = 1.0) -> None:
        self.theta = _checks.scalar("theta", theta)
        if not _kinds.is_traced(theta) and self.theta == 0.0:
            raise ValueError(f"theta is {theta!r}; accepted: a finite number other than 0")

    def costs(self, totals: Totals, variation: Costs) -> Costs:
        """Return the entropic risk (K,)."""
        mean = jnp.mean(totals, axis=0)
        exponent = self.theta * (totals - mean)
        # For small exponents the logarithm of a mean of numbers near 1 would lose all digits, so
        # use expm1 and log1p. For large ones logsumexp avoids overflow, and the clip keeps
        # the unused branch finite.
        near = jnp.log1p(jnp.mean(jnp.expm1(jnp.clip(exponent, -1.0, 1.0)), axis=0))
        far = jax.nn.logsumexp(exponent, axis=0) - np.float32(np.log(totals.shape[0]))
        is_near = jnp.max(jnp.abs(exponent), axis=0) < 1.0
        return mean + jnp.where(is_near, near, far) / self.theta


def _quantile(totals: Totals, level: Scalar) -> Costs:
    """Return the cost of rank `ceil(level M)` of the M outcomes, counted from 1."""
    count = totals.shape[0]
    # Tolerate rounding, which must not lift 0.9 * 10 above 9.
    rank = jnp.ceil(level * count - 1e-4).astype(jnp.int32) - 1
    return jnp.sort(totals, axis=0)[jnp.clip(rank, 0, count - 1)]
