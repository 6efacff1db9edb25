"""Weightings: the weights of rollouts from their costs."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Scalar

Costs = Float[Array, " K"]
Weights = Float[Array, " K"]


class Weighting(eqx.Module):
    """A map from the costs of rollouts to their weights."""

    @abc.abstractmethod
    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Compute weights (K,) that add up to 1, or are all 0 if no cost is finite.

        Args:
            costs: (K,) costs of the rollouts; a cost that is not finite gets no weight.
            log_ratio: (K,) log likelihood ratios of the samples, see `Proposal.log_ratio`.
        """


class Softmax(Weighting):
    """`w_k = softmax(-J_k / temperature - importance * log_ratio_k)`.

    With `importance` = 1 this is information-theoretic MPPI (Williams et al., ICRA 2017, eq. 22).
    The likelihood ratio is the cost term `temperature * sum u^T Sigma^-1 eps` divided by the
    temperature; it keeps the plan near the default control, in units of the noise. With 0 the term
    is left out, as in many implementations. Values between are `1 - alpha` of Williams et al.,
    "Information-theoretic model predictive control", T-RO 2018, section III-C.

    Args:
        temperature: lambda, the cost difference that reduces a weight to 1/e.
        importance: weight of the likelihood ratio, 0 to 1.

    Raises:
        ValueError: a temperature that is not positive, an importance outside [0, 1].
    """

    temperature: Scalar
    importance: Scalar

    def __init__(self, temperature: ArrayLike, importance: ArrayLike = 1.0) -> None:
        self.temperature = _checks.scalar("temperature", temperature, above=0.0)
        self.importance = _checks.scalar("importance", importance, at_least=0.0, at_most=1.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Compute the weights (K,)."""
        return _softmax(costs, self.temperature, _tilt(self.importance, log_ratio))


class AdaptiveSoftmax(Weighting):
    """A softmax whose temperature is chosen in each step for a given effective sample size.

    No scale of the costs has to be known. `1 / sum w^2` grows with the temperature, so the
    temperature is found by bisection of its logarithm, from 43 decades below the range of the costs
    to 8 decades above. A size that cannot be reached, because too few rollouts are finite or
    several are equally good, is approached.

    A least `temperature` [units of cost] says which differences of cost do not matter. The size is
    then the least one: the temperature is raised only where fewer samples would count.

    Args:
        effective_sample_size: wanted effective sample size, in samples.
        importance: weight of the likelihood ratio, 0 to 1.
        temperature: least temperature; 0 for none.

    Raises:
        ValueError: a size < 1, an importance outside [0, 1], a negative temperature.
    """

    effective_sample_size: Scalar
    importance: Scalar
    temperature: Scalar

    def __init__(
        self,
        effective_sample_size: ArrayLike,
        importance: ArrayLike = 0.0,
        temperature: ArrayLike = 0.0,
    ) -> None:
        self.effective_sample_size = _checks.scalar(
            "effective_sample_size", effective_sample_size, at_least=1.0
        )
        self.importance = _checks.scalar("importance", importance, at_least=0.0, at_most=1.0)
        self.temperature = _checks.scalar("temperature", temperature, at_least=0.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Compute the weights (K,)."""
        chosen = self.choose_temperature(costs, log_ratio)
        return _softmax(costs, chosen, _tilt(self.importance, log_ratio))

    def choose_temperature(self, costs: Costs, log_ratio: Costs) -> Scalar:
        """Find the temperature at which these costs have the wanted effective sample size, or the
        least one if that is higher."""
        is_finite = jnp.isfinite(costs)
        least = jnp.min(jnp.where(is_finite, costs, jnp.inf))
        spread = jnp.max(jnp.where(is_finite, costs, -jnp.inf)) - least
        # If all costs are equal or none is finite there is no spread, and any scale will do.
        scale = jnp.log(jnp.where(jnp.isfinite(spread) & (spread > 0.0), spread, 1.0))
        offset = _tilt(self.importance, log_ratio)

        def excess(logarithm: Scalar) -> Scalar:
            weights = _softmax(costs, jnp.exp(logarithm), offset)
            return effective_sample_size(weights) - self.effective_sample_size

        def bisect(function: Callable[[Scalar], Scalar], start: Scalar) -> Scalar:
            def halve(bounds: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
                low, high = bounds
                middle = 0.5 * (low + high)
                is_low = function(middle) < 0.0
                return (jnp.where(is_low, middle, low), jnp.where(is_low, high, middle)), None

            # One penalty may exceed the differences that matter by 30 decades, so the interval is
            # wide; its ends keep the exponential within float32.
            ends = (jnp.maximum(start - 100.0, -80.0), jnp.minimum(start + 18.0, 85.0))
            # 30 halvings of an interval of at most 118 leave 1e-7.
            ends, _ = jax.lax.scan(halve, ends, None, length=30)
            return 0.5 * (ends[0] + ends[1])

        def solve(slope: Callable[[Scalar], Scalar], value: Scalar) -> Scalar:
            # If all weights are equal, the sample size does not depend on the temperature and the
            # slope is 0: the derivative is then defined as 0.
            rise = slope(jnp.ones(()))
            return jnp.where(rise != 0.0, value / jnp.where(rise != 0.0, rise, 1.0), 0.0)

        # Differentiating the bisection would give 0. `custom_root` differentiates the equation.
        root: Scalar = jax.lax.custom_root(excess, jax.lax.stop_gradient(scale), bisect, solve)
        return jnp.maximum(jnp.exp(root), self.temperature)


class Elite(Weighting):
    """Equal weights for the best rollouts and none for the others, as in the cross-entropy method.

    Rollouts that tie with the worst of the best count too. Likelihood ratios are not used. Together
    with `CovarianceAdaptation` this is CEM.

    Source: Kobilarov, "Cross-entropy motion planning", IJRR 2012.

    Args:
        fraction: share of the rollouts that count, at least one rollout.

    Raises:
        ValueError: a fraction outside (0, 1].
    """

    fraction: Scalar

    def __init__(self, fraction: ArrayLike = 0.1) -> None:
        self.fraction = _checks.scalar("fraction", fraction, above=0.0, at_most=1.0)

    def weights(self, costs: Costs, log_ratio: Costs) -> Weights:
        """Compute the weights (K,)."""
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        count = jnp.maximum(jnp.round(self.fraction * costs.shape[0]), 1.0).astype(jnp.int32)
        # A threshold instead of the first `count` indices: the fraction may be traced, and ties all
        # count.
        threshold = jnp.sort(costs)[count - 1]
        chosen = ((costs <= threshold) & jnp.isfinite(costs)).astype(jnp.float32)
        return chosen / jnp.maximum(jnp.sum(chosen), 1.0)


def effective_sample_size(weights: Weights) -> Scalar:
    """Compute `1 / sum of weights^2`, between 1 and K; 0 if all weights are 0."""
    squares = jnp.sum(weights * weights)
    return jnp.where(squares > 0.0, 1.0 / jnp.where(squares > 0.0, squares, 1.0), 0.0)


def _tilt(importance: Scalar, log_ratio: Costs) -> Costs:
    """Return `importance * log_ratio`, which is 0 for an importance of 0, also if the ratio is not
    finite: samples count whose likelihood plays no part."""
    is_left_out = (importance == 0.0) & ~jnp.isfinite(log_ratio)
    return importance * jnp.where(is_left_out, 0.0, log_ratio)


def _softmax(costs: Costs, temperature: Scalar, offset: Costs) -> Weights:
    """Compute `softmax(-costs / temperature - offset)` (K,); 0 for what is not finite."""
    is_finite = jnp.isfinite(costs) & jnp.isfinite(offset)
    # Infinite costs are replaced before the division: masked afterwards, they would still make
    # derivatives NaN. Differences are divided, not costs, whose quotient may overflow.
    cheapest = jnp.min(jnp.where(is_finite, costs, jnp.inf))
    above = jnp.where(is_finite, costs - cheapest, 0.0)
    exponent = above / temperature + jnp.where(is_finite, offset, 0.0)
    exponent = jnp.where(is_finite, exponent, jnp.inf)
    # The smallest exponent is subtracted, so that the best sample has weight 1 before normalising
    # and the sum cannot underflow.
    least = jnp.min(exponent)
    relative = jnp.exp(jnp.where(jnp.isfinite(least), least, 0.0) - exponent)
    total = jnp.sum(relative)
    return relative / jnp.where(total > 0.0, total, 1.0)
