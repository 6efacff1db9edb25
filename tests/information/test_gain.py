import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, expected_gain, update_gain
from jaxplore.information.gain import IdealSensor, cell_gains

WIDE = InverseSensorModel(occupied=0.85, free=-0.4, minimum=-30.0, maximum=30.0)


@given(st.floats(0.01, 0.99), st.sampled_from([0.85, -0.4, 2.0, -2.0]))
def test_gain_is_the_formula_of_fsmi(p: float, change: float) -> None:
    # theory 1: f(d, r) with r the odds, d the factor of the update, checked in double precision.
    r, d = p / (1 - p), math.exp(change)
    expected = math.log((r + 1) / (r + 1 / d)) - math.log(d) / (r * d + 1)
    found = float(update_gain(jnp.float32(p), jnp.float32(change), WIDE))
    assert found == pytest.approx(expected, abs=2e-6, rel=1e-4)


def test_gain_is_accurate_for_nearly_certain_cells_too() -> None:
    margins = np.geomspace(1e-6, 0.5, 200)
    p = np.concatenate([margins, 1 - margins]).astype(np.float32)
    odds = p.astype(float) / (1 - p.astype(float))
    model = InverseSensorModel.from_odds()
    # Of a tiny update only the absolute error is small: the terms of the gain are not.
    for change, rtol, atol in (
        *((change, 2e-5, 1e-11) for change in (0.85, -0.4, 2.0, -2.0, 10.0, -10.0)),
        *((change, 0.0, 2e-7) for change in (0.01, -0.01)),
    ):
        d = math.exp(float(np.float32(change)))
        expected = np.log((odds + 1) / (odds + 1 / d)) - math.log(d) / (odds * d + 1)
        found = update_gain(jnp.asarray(p), jnp.float32(change), model)
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)


def test_an_ideal_look_gains_the_cells_entropy() -> None:
    p = np.asarray([0.0, 1e-6, 0.2, 0.5, 0.9, 1 - 1e-6, 1.0], np.float32)
    inner, free = p[1:-1].astype(float), 1 - p[1:-1].astype(float)
    gains = cell_gains(jnp.asarray(p), IdealSensor())
    # An impossible measurement gains 0, not infinity.
    np.testing.assert_allclose(gains.occupied, [0, *-np.log(inner), 0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(gains.free, [0, *-np.log(free), 0], rtol=1e-5, atol=1e-7)
    entropy = [0, *(-inner * np.log(inner) - free * np.log(free)), 0]
    found = expected_gain(jnp.asarray(p), IdealSensor())
    np.testing.assert_allclose(found, entropy, rtol=1e-5, atol=1e-7)


def test_cell_gains_are_those_of_either_update() -> None:
    p = jnp.linspace(0.0, 1.0, 11)
    for model in (InverseSensorModel(), InverseSensorModel.from_odds(3.0, 0.25, clamp=(-2.0, 3.0))):
        gains = cell_gains(p, model)
        np.testing.assert_array_equal(gains.occupied, update_gain(p, model.occupied, model))
        np.testing.assert_array_equal(gains.free, update_gain(p, model.free, model))


@pytest.mark.parametrize("p", [0.02, 0.49, 0.5, 0.51, 0.98])
@pytest.mark.parametrize("change", [0.85, -0.4, 2.0, -2.0])
def test_derivative_of_the_gain(p: float, change: float) -> None:
    """Against central differences of FSMI's formula."""

    def gain(p: float) -> float:
        r, d = p / (1 - p), math.exp(change)
        return math.log((r + 1) / (r + 1 / d)) - math.log(d) / (r * d + 1)

    expected = (gain(p + 1e-6) - gain(p - 1e-6)) / 2e-6
    found = float(jax.grad(update_gain)(jnp.float32(p), jnp.float32(change), WIDE))
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"occupied": 1.0}, "occupied is 1.0; accepted: a finite number > 1.0"),
        ({"occupied": 0.5}, "occupied is 0.5; accepted: a finite number > 1.0"),
        ({"occupied": math.inf}, "occupied is inf; accepted"),
        ({"free": 1.0}, "free is 1.0; accepted: a finite number > 0.0 and < 1.0"),
        ({"free": 0.0}, "free is 0.0; accepted: a finite number > 0.0 and < 1.0"),
        ({"free": math.nan}, "free is nan; accepted"),
        ({"clamp": (0.5, 3.0)}, "minimum is 0.5; accepted: a finite number < 0.0"),
        ({"clamp": (-2.0, 0.0)}, "maximum is 0.0; accepted: a finite number > 0.0"),
    ],
)
def test_bad_odds(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        InverseSensorModel.from_odds(**arguments)


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
