import math

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.control import CovarianceAdaptation

ROWS, SIZE, SAMPLES = 3, 2, 16


@jax.jit
def adapted(adaptation, scale, weights, away):
    return adaptation.adapt(scale, weights, away)


def formula(scale, weights, away, rate, floor, ceiling) -> np.ndarray:
    """With loops, in double precision."""
    result = np.zeros((ROWS, SIZE))
    for p in range(ROWS):
        for u in range(SIZE):
            spread = sum(weights[k] * away[p, u, k] ** 2 for k in range(SAMPLES))
            square = (1 - rate) * scale[p, u] ** 2 + rate * spread
            result[p, u] = min(max(math.sqrt(square), floor), ceiling)
    return result


@hypothesis.given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.floats(0.0, 1.0, width=32),
    floor=st.floats(0.125, 0.5, width=32),
    extent=st.floats(0.0, 3.0),
)
def test_is_the_formula(seed: int, rate: float, floor: float, extent: float) -> None:
    rng = np.random.default_rng(seed)
    ceiling = floor + 1.0
    scale = rng.uniform(floor, ceiling, (ROWS, SIZE))
    weights, away = rng.dirichlet(np.ones(SAMPLES)), extent * rng.normal(size=(ROWS, SIZE, SAMPLES))
    actual = adapted(
        CovarianceAdaptation(rate, floor, ceiling),
        *(jnp.asarray(value, jnp.float32) for value in (scale, weights, away)),
    )
    expected = formula(scale, weights, away, rate, floor, ceiling)
    np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=1e-6)


def test_converges_to_the_spread_of_samples_within_the_bounds() -> None:
    rng = np.random.default_rng(0)
    extent = np.array([[0.01, 0.5], [0.8, 1.5], [0.3, 30.0]])
    away = extent[:, :, None] * rng.choice([-1.0, 1.0], (ROWS, SIZE, SAMPLES))
    scale, weights = jnp.ones((ROWS, SIZE)), jnp.full(SAMPLES, 1 / SAMPLES)
    for _ in range(60):
        scale = adapted(
            CovarianceAdaptation(0.3, 0.1, 2.0), scale, weights, jnp.asarray(away, jnp.float32)
        )
    np.testing.assert_allclose(scale, np.clip(extent, 0.1, 2.0), rtol=1e-4)


def test_without_weights_nothing_changes() -> None:
    scale = jnp.asarray([[0.3, 0.4], [0.5, 0.6], [1.0, 0.2]])
    away = jnp.full((ROWS, SIZE, SAMPLES), 7.0)
    after = adapted(CovarianceAdaptation(0.9), scale, jnp.zeros(SAMPLES), away)
    np.testing.assert_allclose(after, scale, rtol=1e-6)


def test_rate_0_changes_nothing_and_rate_1_forgets() -> None:
    scale, weights = jnp.full((ROWS, SIZE), 0.5), jnp.full(SAMPLES, 1 / SAMPLES)
    away = jnp.full((ROWS, SIZE, SAMPLES), 0.7)
    np.testing.assert_allclose(adapted(CovarianceAdaptation(0.0), scale, weights, away), 0.5)
    after = adapted(CovarianceAdaptation(1.0), scale, weights, away)
    np.testing.assert_allclose(after, 0.7, rtol=1e-6)


@pytest.mark.parametrize("rows", [0.0, 1.0, 0.25, 1.5, 3.0, 8.0])
def test_what_is_new_is_as_wide_as_given(rows: float) -> None:
    scale = np.array([[0.3, 0.4], [0.5, 0.6], [0.9, 0.2]])
    adaptation = CovarianceAdaptation()
    actual = adaptation.shift(jnp.asarray(scale, jnp.float32), jnp.asarray(rows))
    line = np.concatenate([scale, np.ones((20, SIZE))])
    expected = [
        [np.interp(row + rows, np.arange(len(line)), line[:, u]) for u in range(SIZE)]
        for row in range(ROWS)
    ]
    np.testing.assert_allclose(actual, expected, rtol=1e-6)


@pytest.mark.parametrize(("floor", "ceiling", "new"), [(0.1, 0.5, 0.5), (1.5, 2.0, 1.5)])
def test_what_is_new_is_within_the_bounds(floor: float, ceiling: float, new: float) -> None:
    adaptation = CovarianceAdaptation(0.2, floor, ceiling)
    after = adaptation.shift(jnp.full((ROWS, SIZE), floor), jnp.asarray(1.0))
    np.testing.assert_allclose(after[-1], new, rtol=1e-6)
    np.testing.assert_allclose(after[:-1], floor, rtol=1e-6)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match=r"ceiling is 0.4; accepted: at least the floor, 0.5"):
        CovarianceAdaptation(floor=0.5, ceiling=0.4)
