import math

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Elite, Softmax
from jaxplore.control import AdaptiveSoftmax
from jaxplore.control.weighting import effective_sample_size

SAMPLES = 60
PARTS = {
    "softmax": Softmax(0.7),
    "softmax without ratio": Softmax(0.7, 0.0),
    "adaptive": AdaptiveSoftmax(10.0),
    "adaptive with ratio": AdaptiveSoftmax(10.0, 1.0),
    "elite": Elite(0.1),
}


@jax.jit
def weigh(part, costs, log_ratio):
    return part.weights(costs, log_ratio)


def weights_of(part, costs, log_ratio=None) -> np.ndarray:
    costs = jnp.asarray(costs, jnp.float32)
    log_ratio = jnp.zeros_like(costs) if log_ratio is None else jnp.asarray(log_ratio, jnp.float32)
    return np.asarray(weigh(part, costs, log_ratio), np.float64)


def size_of(weights: np.ndarray) -> float:
    return 1 / (weights**2).sum()


def softmax(costs, log_ratio, temperature: float, importance: float) -> np.ndarray:
    """In double precision."""
    costs = np.asarray(costs, np.float64)
    exponent = -costs / temperature - importance * np.asarray(log_ratio, np.float64)
    exponent[~np.isfinite(costs)] = -np.inf
    relative = np.exp(exponent - exponent.max())
    return relative / relative.sum()


@hypothesis.given(
    seed=st.integers(0, 2**32 - 1),
    temperature=st.floats(0.01, 100.0),
    importance=st.sampled_from([0.0, 0.3, 1.0]),
)
def test_softmax_is_the_formula(seed: int, temperature: float, importance: float) -> None:
    rng = np.random.default_rng(seed)
    costs, ratio = rng.normal(size=SAMPLES).astype("f4"), rng.normal(size=SAMPLES).astype("f4")
    costs[rng.uniform(size=SAMPLES) < 0.2] = np.inf
    actual = weights_of(Softmax(temperature, importance), costs, ratio)
    expected = softmax(costs, ratio, temperature, importance)
    # A cost of 3 at a temperature of 0.01 is an exponent of 300, with an error of 1e-5.
    np.testing.assert_allclose(actual, expected, rtol=2e-4, atol=1e-7)


def test_softmax_is_invariant_to_a_constant_and_survives_extremes() -> None:
    costs = np.array([1.0, 2.0, np.inf, np.nan])
    expected = np.array([1.0, math.exp(-2.0), 0, 0]) / (1 + math.exp(-2.0))
    np.testing.assert_allclose(weights_of(Softmax(0.5), costs), expected, rtol=1e-6)
    np.testing.assert_allclose(weights_of(Softmax(0.5), costs + 1024.0), expected, rtol=1e-4)
    np.testing.assert_allclose(weights_of(Softmax(0.5), costs, np.full(4, 50.0)), expected, 1e-4)
    huge = weights_of(Softmax(1e-6), [1e30, 2e30, 1e38, 0.0])
    np.testing.assert_array_equal(huge, [0, 0, 0, 1])
    np.testing.assert_array_equal(weights_of(Softmax(1.0), [-1e30, 0.0, 5.0, 1e30]), [1, 0, 0, 0])
    np.testing.assert_allclose(weights_of(Softmax(1e30), costs), [0.5, 0.5, 0, 0], rtol=1e-6)


def test_samples_without_a_finite_ratio_have_no_weight() -> None:
    ratio = np.array([0.0, np.nan, np.inf, 0.0])
    for part in (Softmax(1.0), AdaptiveSoftmax(2.0, 1.0)):
        np.testing.assert_allclose(weights_of(part, np.zeros(4), ratio), [0.5, 0, 0, 0.5])


@pytest.mark.parametrize("part", [Softmax(0.7, 0.0), AdaptiveSoftmax(3.0, 0.0)])
def test_a_ratio_that_plays_no_part_excludes_nothing(part) -> None:
    costs = [1.0, 0.5, 2.0, 0.7]
    ratio = np.array([0.0, np.nan, np.inf, -np.inf])
    np.testing.assert_array_equal(weights_of(part, costs, ratio), weights_of(part, costs))


def test_derivatives_are_those_of_the_softmax_and_finite() -> None:
    costs = jnp.asarray([1.0, 1.5, 0.7, jnp.inf, jnp.nan])
    jacobian = jax.jit(jax.jacrev(lambda c: Softmax(0.5).weights(c, jnp.zeros(5))))(costs)
    assert np.isfinite(jacobian).all()
    w = softmax(np.asarray(costs), np.zeros(5), 0.5, 0.0)
    np.testing.assert_allclose(jacobian, -(np.diag(w) - np.outer(w, w)) / 0.5, atol=1e-6)


@pytest.mark.parametrize("name", PARTS)
@hypothesis.given(
    costs=st.lists(
        st.one_of(
            st.floats(-100.0, 100.0, width=32),
            st.floats(-1e9, 1e9, width=32),
            st.sampled_from([math.inf, -math.inf, math.nan, 0.0]),
        ),
        min_size=6,
        max_size=6,
    ),
    ratio=st.lists(st.floats(-30.0, 30.0, width=32), min_size=6, max_size=6),
)
@hypothesis.example(costs=[math.inf] * 6, ratio=[0.0] * 6)
@hypothesis.example(costs=[math.nan, math.inf, -math.inf] * 2, ratio=[0.0] * 6)
@hypothesis.example(costs=[5.0] * 6, ratio=[0.0] * 6)
def test_weights_add_up_to_1_or_are_all_0(name: str, costs, ratio) -> None:
    weights = weights_of(PARTS[name], costs, ratio)
    finite = np.isfinite(costs)
    assert (weights >= 0.0).all()
    assert (weights[~finite] == 0.0).all()
    assert weights.sum() == pytest.approx(1.0 if finite.any() else 0.0, abs=1e-5)
    if finite.any() and "with ratio" not in name and name != "softmax":
        assert weights[np.nanargmin(np.where(finite, costs, np.nan))] == weights.max()


@pytest.mark.parametrize("part", [Softmax(1e-6), AdaptiveSoftmax(2.0)], ids=["fixed", "adaptive"])
def test_huge_costs_have_weights_too(part) -> None:
    weights = weights_of(part, [3e38, 3e38, 3e38, 3e38])
    np.testing.assert_allclose(weights, 0.25)


@hypothesis.given(
    seed=st.integers(0, 2**32 - 1),
    decade=st.floats(-10.0, 10.0),
    wanted=st.floats(1.5, 0.9 * SAMPLES),
    shape=st.sampled_from(["uniform", "normal", "heavy"]),
)
def test_the_effective_sample_size_is_the_one_wanted(seed, decade, wanted, shape) -> None:
    rng = np.random.default_rng(seed)
    costs = {
        "uniform": rng.uniform(size=SAMPLES),
        "normal": rng.normal(size=SAMPLES),
        "heavy": np.exp(3.0 * rng.normal(size=SAMPLES)),
    }[shape] * 10.0**decade
    weights = weights_of(AdaptiveSoftmax(wanted), costs)
    assert size_of(weights) == pytest.approx(wanted, rel=0.01)
    assert float(effective_sample_size(jnp.asarray(weights, jnp.float32))) == pytest.approx(
        wanted, rel=0.01
    )
    part = AdaptiveSoftmax(wanted)
    single = jnp.asarray(costs, jnp.float32)
    temperature = float(temperature_of(part, single, jnp.zeros(SAMPLES)))
    expected = softmax(single, np.zeros(SAMPLES), temperature, 0.0)
    np.testing.assert_allclose(weights, expected, rtol=1e-2, atol=1e-6)
    # A least temperature below that changes nothing. One above it is taken, and more samples count.
    lower = weights_of(AdaptiveSoftmax(wanted, temperature=0.5 * temperature), costs)
    np.testing.assert_array_equal(lower, weights)
    warmer = weights_of(AdaptiveSoftmax(wanted, temperature=2.0 * temperature), costs)
    expected = softmax(single, np.zeros(SAMPLES), 2.0 * temperature, 0.0)
    np.testing.assert_allclose(warmer, expected, rtol=1e-2, atol=1e-6)
    assert size_of(warmer) > size_of(weights)


@jax.jit
def temperature_of(part, costs, log_ratio):
    return part.choose_temperature(costs, log_ratio)


@pytest.mark.parametrize("importance", [0.5, 1.0])
def test_the_wanted_size_counts_the_likelihood_ratio(importance: float) -> None:
    rng = np.random.default_rng(0)
    costs, ratio = rng.normal(size=SAMPLES), 0.5 * rng.normal(size=SAMPLES)
    part = AdaptiveSoftmax(12.0, importance)
    weights = weights_of(part, costs, ratio)
    assert size_of(weights) == pytest.approx(12.0, rel=0.01)
    temperature = float(
        temperature_of(part, jnp.asarray(costs, jnp.float32), jnp.asarray(ratio, jnp.float32))
    )
    np.testing.assert_allclose(weights, softmax(costs, ratio, temperature, importance), rtol=1e-3)
    without = weights_of(AdaptiveSoftmax(12.0), costs, ratio)
    np.testing.assert_array_equal(without, weights_of(AdaptiveSoftmax(12.0), costs))


@pytest.mark.parametrize(
    "penalty",
    [
        1e3,
        1e6,
        1e10,
        1e25,
    ],
)
def test_a_penalty_does_not_hide_what_is_good(penalty: float) -> None:
    costs = np.random.default_rng(0).uniform(size=SAMPLES)
    costs[::10] += penalty
    weights = weights_of(AdaptiveSoftmax(8.0), costs)
    assert size_of(weights) == pytest.approx(8.0, rel=0.01)


def test_what_cannot_be_reached_is_approached() -> None:
    part, nothing = AdaptiveSoftmax(10.0), [np.inf] * (SAMPLES - 4)
    few = weights_of(part, [1.0, 7.0, 3.0, 1000.0, *nothing])
    np.testing.assert_allclose(few[:4], 0.25, rtol=1e-4)
    assert (few[4:] == 0).all()
    ties = np.arange(SAMPLES, dtype=float)
    ties[10:30] = 0.0
    ties[0] = 0.0
    tied = weights_of(part, ties)
    np.testing.assert_allclose(tied[ties == 0.0], 1 / 21, rtol=1e-4)
    np.testing.assert_allclose(weights_of(part, np.full(SAMPLES, 3.0)), 1 / SAMPLES, rtol=1e-5)
    one = weights_of(part, [5.0, *[np.inf] * (SAMPLES - 1)])
    np.testing.assert_allclose(one[0], 1.0)
    assert (weights_of(part, np.full(SAMPLES, np.inf)) == 0.0).all()
    assert (weights_of(part, np.full(SAMPLES, np.nan)) == 0.0).all()
    np.testing.assert_allclose(weights_of(AdaptiveSoftmax(1.0), [3.0]), [1.0])
    best = weights_of(AdaptiveSoftmax(1.0), np.arange(SAMPLES))
    np.testing.assert_allclose(best[0], 1.0, atol=1e-4)


def test_derivatives_follow_the_temperature() -> None:
    """Those of the weights at the temperature that keeps the wanted size, by finite differences."""
    rng = np.random.default_rng(3)
    costs, ratio = rng.normal(size=8), 0.3 * rng.normal(size=8)
    costs[5] = np.inf

    def weights(costs: np.ndarray) -> np.ndarray:
        low, high = math.log(1e-6), math.log(1e6)
        for _ in range(200):
            middle = 0.5 * (low + high)
            is_low = size_of(softmax(costs, ratio, math.exp(middle), 1.0)) < 4.0
            low, high = (middle, high) if is_low else (low, middle)
        return softmax(costs, ratio, math.exp(low), 1.0)

    expected = np.zeros((8, 8))
    for index in np.flatnonzero(np.isfinite(costs)):
        step = 1e-5 * np.eye(8)[index]
        expected[:, index] = (weights(costs + step) - weights(costs - step)) / 2e-5
    part, ratio32 = AdaptiveSoftmax(4.0, 1.0), jnp.asarray(ratio, jnp.float32)
    derivatives = jax.jit(jax.jacrev(lambda c: part.weights(c, ratio32)))
    actual = derivatives(jnp.asarray(costs, jnp.float32))
    np.testing.assert_allclose(actual, expected, rtol=1e-2, atol=2e-3)
    assert np.abs(expected).max() > 0.05


@hypothesis.given(seed=st.integers(0, 2**32 - 1), fraction=st.floats(0.001, 1.0))
def test_the_elite_are_the_best(seed: int, fraction: float) -> None:
    rng = np.random.default_rng(seed)
    costs = rng.permutation(SAMPLES).astype(float) - 20.0
    costs[rng.uniform(size=SAMPLES) < 0.3] = np.nan
    count = max(round(float(np.float32(fraction)) * SAMPLES), 1)
    best = [index for index in np.argsort(costs) if np.isfinite(costs[index])][:count]
    expected = np.zeros(SAMPLES)
    expected[best] = 1 / max(len(best), 1)
    np.testing.assert_allclose(weights_of(Elite(fraction), costs), expected, rtol=1e-6)


def test_elite_ties_count_all() -> None:
    weights = weights_of(Elite(0.34), [2.0, 1.0, 2.0, 3.0, 2.0, np.inf])
    np.testing.assert_allclose(weights, [0.25, 0.25, 0.25, 0, 0.25, 0])


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS.keys())
def test_one_rollout_counts_fully_or_not_at_all(part) -> None:
    assert weights_of(part, [7.0]) == 1.0
    for cost in (np.inf, -np.inf, np.nan):
        assert weights_of(part, [cost]) == 0.0


def test_the_elite_ignore_likelihood_ratios() -> None:
    costs, ratio = [3.0, 1.0, 2.0], [0.0, 99.0, np.nan]
    np.testing.assert_allclose(weights_of(Elite(0.67), costs, ratio), [0.0, 0.5, 0.5])


def test_effective_sample_size() -> None:
    for weights in ([1.0], [0.25] * 4, [0.7, 0.2, 0.1]):
        expected = 1 / sum(w * w for w in weights)
        assert float(effective_sample_size(jnp.asarray(weights))) == pytest.approx(expected, 1e-6)
    assert float(effective_sample_size(jnp.zeros(5))) == 0.0
    assert np.isfinite(jax.grad(effective_sample_size)(jnp.zeros(5))).all()
