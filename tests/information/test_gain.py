import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, expected_gain, update_gain

WIDE = InverseSensorModel(occupied=0.85, free=-0.4, minimum=-30.0, maximum=30.0)


@given(st.floats(0.01, 0.99), st.sampled_from([0.85, -0.4, 2.0, -2.0]))
def test_gain_is_the_formula_of_fsmi(p: float, change: float) -> None:
    # theory 1: f(d, r) with r the odds, d the factor of the update, checked in double precision.
    r, d = p / (1 - p), math.exp(change)
    expected = math.log((r + 1) / (r + 1 / d)) - math.log(d) / (r * d + 1)
    found = float(update_gain(jnp.float32(p), jnp.float32(change), WIDE))
    assert found == pytest.approx(expected, abs=2e-6, rel=1e-4)


@given(st.floats(0.002, 0.99), st.sampled_from([2.0, -2.0]))
def test_gain_through_the_clamp_is_the_divergence_of_what_the_map_does(
    p: float, change: float
) -> None:
    model = InverseSensorModel()
    q = float(model.update(jnp.float32(p), jnp.float32(change)))
    expected = q * math.log(q / p) + (1 - q) * math.log((1 - q) / (1 - p))
    found = float(update_gain(jnp.float32(p), jnp.float32(change), model))
    assert found == pytest.approx(expected, abs=2e-6, rel=1e-3)


def test_a_saturated_cell_gains_nothing_from_more_of_the_same() -> None:
    model = InverseSensorModel()
    low, high = 1 / (1 + math.exp(7)), 1 / (1 + math.exp(-5))
    assert float(update_gain(jnp.float32(low), model.free, model)) == pytest.approx(0.0, abs=1e-6)
    assert float(update_gain(jnp.float32(high), model.occupied, model)) == pytest.approx(
        0, abs=1e-6
    )


def test_certain_cells_give_finite_gains() -> None:
    gain = expected_gain(jnp.asarray([0.0, 1.0, 0.5]), InverseSensorModel())
    assert np.isfinite(gain).all()
    assert (np.asarray(gain) >= 0).all()
    assert float(gain[2]) > 100 * float(gain[0])


def test_scan_recursion_is_the_expectation_over_all_maps() -> None:
    """V = sum over maps m of P(m) sum_i KL(posterior_i || prior_i), by enumeration of 2^n maps."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        p = rng.uniform(0.02, 0.98, 7)
        r = p / (1 - p)

        def gain(change: float, odds: np.ndarray = r) -> np.ndarray:
            d = math.exp(change)
            return np.log((odds + 1) / (odds + 1 / d)) - math.log(d) / (odds * d + 1)

        occupied, free = gain(0.85), gain(-0.4)
        total = 0.0
        for cells in itertools.product([0, 1], repeat=7):
            probability = np.prod(np.where(cells, p, 1 - p))
            first = cells.index(1) if 1 in cells else 7
            total += probability * (free[:first].sum() + (occupied[first] if first < 7 else 0.0))
        b = np.asarray(expected_gain(jnp.asarray(p, jnp.float32), WIDE), float)
        value = 0.0
        for i in reversed(range(7)):
            value = b[i] + (1 - p[i]) * value
        assert value == pytest.approx(total, rel=1e-5)
