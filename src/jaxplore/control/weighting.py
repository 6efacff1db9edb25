"""How much each rollout counts."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar

Costs = Float[Array, " K"]
Weights = Float[Array, " K"]


class Weighting(eqx.Module):
    """Maps costs to weights."""

    @abc.abstractmethod
    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Return weights (K,) that add up to 1, or are all 0 if no cost is finite.

        Args:
            costs: (K,) of the rollouts; those that are not finite get no weight.
            log_ratio: (K,) `log q - log p` of the samples: see `Proposal.log_ratio`.
        """


class Softmax(Weighting):
    """`w_k = softmax(-J_k / temperature - importance * log_ratio_k)`.

    With `importance` = 1 this is information-theoretic MPPI (Williams et al., ICRA 2017, eq. 22):
    the term `temperature * sum u^T Sigma^-1 eps` of the cost, divided by the temperature. It keeps
    the plan near the default control in units of the noise. 0 leaves it out, as many
    implementations do; values between are `1 - alpha` of Williams et al., "Information-theoretic
    model predictive control", T-RO 2018, section III-C.

    Args:
        temperature: lambda, in units of cost: differences of this size matter.
        importance: how much the likelihood ratio counts, 0 to 1.

    Raises:
        ValueError: a temperature that is not positive, an importance outside [0, 1].
    """

    temperature: Scalar
    importance: Scalar

    def __init__(self, temperature: ArrayLike, importance: ArrayLike = 1.0) -> None:
        self.temperature = _checks.scalar("temperature", temperature, above=0.0)
        self.importance = _checks.scalar("importance", importance, at_least=0.0, at_most=1.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Return the weights (K,)."""
        return _softmax(costs, self.temperature, self.importance * log_ratio)


class AdaptiveSoftmax(Weighting):
    """The softmax at the temperature that gives a wanted effective sample size.

    Costs need no scale then: `1 / sum w^2` grows with the temperature, so the one wanted is found
    by bisection of its logarithm, from 43 decades below the range of the costs to 8 above. What
    cannot be reached, because fewer rollouts are finite or several are equally good, is approached.

    Args:
        effective_sample_size: wanted, in samples.
        importance: as of `Softmax`.

    Raises:
        ValueError: a size < 1, an importance outside [0, 1].
    """

    effective_sample_size: Scalar
    importance: Scalar

    def __init__(self, effective_sample_size: ArrayLike, importance: ArrayLike = 0.0) -> None:
        self.effective_sample_size = _checks.scalar(
            "effective_sample_size", effective_sample_size, at_least=1.0
        )
        self.importance = _checks.scalar("importance", importance, at_least=0.0, at_most=1.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Return the weights (K,)."""
        return _softmax(costs, self.temperature(costs, log_ratio), self.importance * log_ratio)

    def temperature(self, costs: Costs, log_ratio: Costs) -> Scalar:
        """Return the temperature that is used for these costs."""
        is_finite = jnp.isfinite(costs)
        least = jnp.min(jnp.where(is_finite, costs, jnp.inf))
        spread = jnp.max(jnp.where(is_finite, costs, -jnp.inf)) - least
        scale = jnp.log(jnp.where(jnp.isfinite(spread) & (spread > 0.0), spread, 1.0))
        offset = self.importance * log_ratio

        def excess(logarithm: Scalar) -> Scalar:
            weights = _softmax(costs, jnp.exp(logarithm), offset)
            return effective_sample_size(weights) - self.effective_sample_size

        def bisect(function: Callable[[Scalar], Scalar], start: Scalar) -> Scalar:
            def halve(bounds: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
                low, high = bounds
                middle = 0.5 * (low + high)
                is_low = function(middle) < 0.0
                return (jnp.where(is_low, middle, low), jnp.where(is_low, high, middle)), None

            # A penalty may be 30 decades above the differences that matter; within float32.
            ends = (jnp.maximum(start - 100.0, -80.0), jnp.minimum(start + 18.0, 85.0))
            ends, _ = jax.lax.scan(halve, ends, None, length=30)
            return 0.5 * (ends[0] + ends[1])

        def solve(slope: Callable[[Scalar], Scalar], value: Scalar) -> Scalar:
            # Where the size does not depend on the temperature, neither does the temperature on it.
            rise = slope(jnp.ones(()))
            return jnp.where(rise != 0.0, value / jnp.where(rise != 0.0, rise, 1.0), 0.0)

        # The root's derivative is that of the implicit function, not that of halving intervals.
        root: Scalar = jax.lax.custom_root(excess, jax.lax.stop_gradient(scale), bisect, solve)
        return jnp.exp(root)


class Elite(Weighting):
    """The best share of the rollouts counts equally, the rest not at all (cross-entropy method).

    Rollouts as good as the last of them count too. Likelihood ratios do not enter. With
    `CovarianceAdaptation` this is CEM.

    Source: Kobilarov, "Cross-entropy motion planning", IJRR 2012.

    Args:
        fraction: share of the rollouts; at least one counts.

    Raises:
        ValueError: a fraction that is not within (0, 1].
    """

    fraction: Scalar

    def __init__(self, fraction: ArrayLike = 0.1) -> None:
        self.fraction = _checks.scalar("fraction", fraction, above=0.0, at_most=1.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Return the weights (K,)."""
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        count = jnp.maximum(jnp.round(self.fraction * costs.shape[0]), 1.0).astype(jnp.int32)
        threshold = jnp.sort(costs)[count - 1]
        chosen = ((costs <= threshold) & jnp.isfinite(costs)).astype(jnp.float32)
        return chosen / jnp.maximum(jnp.sum(chosen), 1.0)


def effective_sample_size(weights: Weights) -> Scalar:
    """Return `1 / sum of weights^2`, between 1 and K; 0 if all weights are 0."""
    squares = jnp.sum(weights * weights)
    return jnp.where(squares > 0.0, 1.0 / jnp.where(squares > 0.0, squares, 1.0), 0.0)


def _softmax(costs: Costs, temperature: Scalar, offset: Costs) -> Weights:
    is_finite = jnp.isfinite(costs) & jnp.isfinite(offset)
    # Guarded before dividing, so that derivatives stay finite too; and differences are divided, not
    # costs, whose quotient may be infinite.
    cheapest = jnp.min(jnp.where(is_finite, costs, jnp.inf))
    above = jnp.where(is_finite, costs - cheapest, 0.0)
    exponent = above / temperature + jnp.where(is_finite, offset, 0.0)
    exponent = jnp.where(is_finite, exponent, jnp.inf)
    least = jnp.min(exponent)
    relative = jnp.exp(jnp.where(jnp.isfinite(least), least, 0.0) - exponent)
    total = jnp.sum(relative)
    return relative / jnp.where(total > 0.0, total, 1.0)
