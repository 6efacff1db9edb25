"""`Direct` and `Smooth`; `Knots` has its own file."""

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Knots, Smooth
from jaxplore.control import ControlSpace, Direct, SmoothNominal

HORIZON, SIZE, SAMPLES, DT = 6, 2, 12, 0.1
LOW, HIGH, DEFAULT = np.array([-1.0, -0.5]), np.array([2.0, 0.7]), np.array([0.4, -0.2])
SPACE = ControlSpace(
    *(jnp.asarray(value, jnp.float32) for value in (LOW, HIGH, DEFAULT, DT)), horizon=HORIZON
)
RNG = np.random.default_rng(0)
CONTROLS = RNG.uniform(LOW, HIGH, (HORIZON, SIZE)).astype(np.float32)
RATES = RNG.normal(0.0, 3.0, (HORIZON, SIZE)).astype(np.float32)
NOMINALS = {
    "direct": jnp.asarray(CONTROLS),
    "smooth": SmoothNominal(jnp.asarray(RATES), jnp.asarray(CONTROLS)),
    "bounded": SmoothNominal(jnp.asarray(RATES), jnp.asarray(CONTROLS)),
}
KINDS = {"direct": Direct(), "smooth": Smooth(), "bounded": Smooth(max_rate=4.0)}
kinds = pytest.mark.parametrize("kind", KINDS)


@jax.jit
def decode(parameterisation, nominal, samples):
    return parameterisation.decode(nominal, samples, SPACE)


@jax.jit
def shift(parameterisation, nominal, steps):
    return parameterisation.shift(nominal, steps, SPACE)


def drawn(spread: float, seed: int = 1) -> np.ndarray:
    shape = (HORIZON, SIZE, SAMPLES)
    return np.random.default_rng(seed).normal(0.0, spread, shape).astype(np.float32)


def decoded(kind: str, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The formulas of the docstrings with loops, in double precision."""
    controls, effective = np.zeros(samples.shape), np.zeros(samples.shape)
    for t, u, k in np.ndindex(samples.shape):
        value = float(samples[t, u, k])
        if kind == "direct":
            effective[t, u, k] = controls[t, u, k] = min(max(value, LOW[u]), HIGH[u])
            continue
        if kind == "bounded":
            value = min(max(value, -4.0), 4.0)
        start = float(CONTROLS[t, u])
        controls[t, u, k] = min(max(start + DT * value, LOW[u]), HIGH[u])
        effective[t, u, k] = (controls[t, u, k] - start) / DT
    return controls, effective


@kinds
@pytest.mark.parametrize("spread", [0.1, 3.0, 100.0])
def test_decodes_as_its_formula_says(kind: str, spread: float) -> None:
    samples = drawn(spread)
    controls, effective = decode(KINDS[kind], NOMINALS[kind], jnp.asarray(samples))
    expected, took_effect = decoded(kind, samples)
    np.testing.assert_allclose(controls, expected, atol=1e-6)
    np.testing.assert_allclose(effective, took_effect, atol=1e-5)
    assert (np.asarray(controls) >= LOW[:, None] - 1e-6).all()
    assert (np.asarray(controls) <= HIGH[:, None] + 1e-6).all()


@kinds
def test_what_took_effect_leads_to_the_same_controls(kind: str) -> None:
    controls, effective = decode(KINDS[kind], NOMINALS[kind], jnp.asarray(drawn(30.0)))
    again, same = decode(KINDS[kind], NOMINALS[kind], effective)
    np.testing.assert_allclose(again, controls, atol=1e-6)
    np.testing.assert_allclose(same, effective, atol=2e-5)


@kinds
def test_samples_within_the_bounds_take_effect_as_they_are(kind: str) -> None:
    """And the parameters of their controls are they themselves."""
    inside = RNG.uniform(LOW, HIGH, (SAMPLES, HORIZON, SIZE)).astype(np.float32)
    if kind != "direct":
        inside = (inside - CONTROLS) / np.float32(DT)
        inside = np.clip(inside, -4.0, 4.0) if kind == "bounded" else inside
    samples = np.moveaxis(inside, 0, -1)
    controls, effective = decode(KINDS[kind], NOMINALS[kind], jnp.asarray(samples))
    np.testing.assert_allclose(effective, samples, atol=1e-5)
    for index in range(SAMPLES):
        parameters = KINDS[kind].encode(NOMINALS[kind], controls[:, :, index], SPACE)
        np.testing.assert_allclose(parameters, samples[:, :, index], atol=1e-5)


@pytest.mark.parametrize("kind", ["direct", "smooth"])
def test_encode_is_the_inverse_of_decode(kind: str) -> None:
    wanted = RNG.uniform(LOW, HIGH, (HORIZON, SIZE)).astype(np.float32)
    parameters = KINDS[kind].encode(NOMINALS[kind], jnp.asarray(wanted), SPACE)
    controls, _ = decode(KINDS[kind], NOMINALS[kind], parameters[:, :, None])
    np.testing.assert_allclose(controls[:, :, 0], wanted, atol=1e-6)


@kinds
@hypothesis.given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0.01, 1e4))
def test_the_mean_of_what_took_effect_stays_within_the_bounds(kind, seed, spread) -> None:
    rng = np.random.default_rng(seed)
    _, effective = decode(KINDS[kind], NOMINALS[kind], jnp.asarray(drawn(spread, seed)))
    weights = rng.dirichlet(np.full(SAMPLES, 0.3))
    mean = jnp.asarray(np.asarray(effective, np.float64) @ weights, jnp.float32)
    if kind == "direct":
        controls = np.asarray(KINDS[kind].update(NOMINALS[kind], mean, SPACE))
        np.testing.assert_array_equal(controls, mean)
    else:  # Not clipped here: `update` does so, and would hide what is averaged.
        controls = CONTROLS + DT * np.asarray(mean, np.float64)
    assert (controls >= LOW - 1e-5).all()
    assert (controls <= HIGH + 1e-5).all()


def test_smooth_integrates() -> None:
    mean = RNG.normal(0.0, 5.0, (HORIZON, SIZE)).astype(np.float32)
    after = Smooth().update(NOMINALS["smooth"], jnp.asarray(mean), SPACE)
    np.testing.assert_array_equal(after.rates, mean)
    np.testing.assert_allclose(after.controls, np.clip(CONTROLS + DT * mean, LOW, HIGH), atol=1e-6)
    np.testing.assert_array_equal(Smooth().controls(after, SPACE), after.controls)


def test_a_bounded_rate_bounds_the_change_of_the_plan() -> None:
    controls, effective = decode(KINDS["bounded"], NOMINALS["bounded"], jnp.asarray(drawn(1e3)))
    change = np.abs(np.asarray(controls) - CONTROLS[:, :, None])
    assert change.max() <= 4.0 * DT + 1e-6
    assert np.abs(effective).max() <= 4.0 + 1e-5
    assert change.max() >= 0.39


@kinds
def test_the_first_nominal_has_the_controls_given_within_the_bounds(kind: str) -> None:
    given = 3.0 * RNG.normal(size=(HORIZON, SIZE))
    nominal = KINDS[kind].init(jnp.asarray(given, jnp.float32), SPACE)
    expected = np.clip(given, LOW, HIGH)
    np.testing.assert_allclose(KINDS[kind].controls(nominal, SPACE), expected, atol=1e-6)
    centre = np.zeros((HORIZON, SIZE)) if kind != "direct" else expected
    np.testing.assert_allclose(KINDS[kind].centre(nominal), centre, atol=1e-6)
    rest = DEFAULT if kind == "direct" else np.zeros(SIZE)
    np.testing.assert_allclose(KINDS[kind].rest(SPACE), rest, atol=1e-7)
    assert KINDS[kind].num_parameters(HORIZON) == HORIZON


def moved(rows: np.ndarray, steps: float, after: np.ndarray) -> np.ndarray:
    line = np.concatenate([rows, np.tile(after, (40, 1))])
    times = np.arange(len(rows)) + steps
    return np.stack([np.interp(times, np.arange(len(line)), column) for column in line.T], axis=-1)


STEPS = [0.0, 1.0, 3.0, 0.25, 1.5, HORIZON - 1.0, HORIZON - 0.5, float(HORIZON), 30.0]


@pytest.mark.parametrize("steps", STEPS)
def test_direct_continues_with_the_default_control(steps: float) -> None:
    actual = shift(Direct(), NOMINALS["direct"], jnp.asarray(steps))
    np.testing.assert_allclose(actual, moved(CONTROLS, steps, DEFAULT), atol=1e-6)


@pytest.mark.parametrize("steps", STEPS)
def test_smooth_holds_the_last_control_and_lets_the_rates_end(steps: float) -> None:
    assert len(set(CONTROLS.ravel())) == CONTROLS.size  # Another element would show.
    actual = shift(Smooth(), NOMINALS["smooth"], jnp.asarray(steps))
    np.testing.assert_allclose(actual.controls, moved(CONTROLS, steps, CONTROLS[-1]), atol=1e-6)
    np.testing.assert_allclose(actual.rates, moved(RATES, steps, np.zeros(SIZE)), atol=1e-6)


@kinds
def test_fractions_of_a_step_add_up_to_one(kind: str) -> None:
    """For a straight line, which interpolation does not smear."""
    line = np.linspace(LOW, HIGH, 2 * HORIZON)[:HORIZON]
    nominal = KINDS[kind].init(jnp.asarray(line, jnp.float32), SPACE)
    whole = shift(KINDS[kind], nominal, jnp.asarray(1.0))
    for _ in range(4):
        nominal = shift(KINDS[kind], nominal, jnp.asarray(0.25))
    first = KINDS[kind].controls(nominal, SPACE)[: HORIZON - 4]
    expected = KINDS[kind].controls(whole, SPACE)[: HORIZON - 4]
    np.testing.assert_allclose(first, expected, atol=1e-6)
    np.testing.assert_allclose(first, line[1 : HORIZON - 3], atol=1e-6)


@pytest.mark.parametrize("parameterisation", [Direct(), Smooth(), Knots(1)])
def test_a_horizon_of_1_works(parameterisation) -> None:
    space = ControlSpace(SPACE.minimum, SPACE.maximum, SPACE.default, SPACE.dt, 1)
    assert parameterisation.num_parameters(1) == 1
    nominal = parameterisation.init(jnp.asarray([[1.0, 0.5]]), space)
    np.testing.assert_allclose(parameterisation.controls(nominal, space), [[1.0, 0.5]], atol=1e-6)
    zeros = jnp.zeros((1, SIZE, 3)) + parameterisation.centre(nominal)[:, :, None]
    controls, _ = parameterisation.decode(nominal, zeros, space)
    np.testing.assert_allclose(controls[0], [[1.0] * 3, [0.5] * 3], atol=1e-6)
    later = parameterisation.shift(nominal, jnp.asarray(1.0), space)
    after = [1.0, 0.5] if isinstance(parameterisation, Smooth) else DEFAULT
    np.testing.assert_allclose(parameterisation.controls(later, space)[0], after, atol=1e-6)
