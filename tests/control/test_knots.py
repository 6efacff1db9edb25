"""`Knots` and the interpolations between them."""

import math
from fractions import Fraction

import equinox as eqx
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate

from jaxplore import Knots, RBFKernel
from jaxplore.control import (
    ControlSpace,
    CubicSpline,
    Direct,
    LinearInterpolation,
    MaternKernel,
    ZeroOrderHold,
)

SIZE = 2
LOW, HIGH, DEFAULT = np.array([-1.0, 0.0]), np.array([2.0, 20.0]), np.array([0.2, 9.81])
INTERPOLATIONS = {
    "hold": ZeroOrderHold(),
    "linear": LinearInterpolation(),
    "cubic": CubicSpline(),
    "rbf": RBFKernel(2.0),
    "matern": MaternKernel(3.0),
}
every = pytest.mark.parametrize("name", INTERPOLATIONS)
SIZES = [(1, 6), (2, 6), (4, 10)]
sizes = pytest.mark.parametrize(("num_knots", "horizon"), SIZES)


def build_space(horizon: int) -> ControlSpace:
    return ControlSpace(
        *(jnp.asarray(value, jnp.float32) for value in (LOW, HIGH, DEFAULT, 0.1)), horizon=horizon
    )


def compiled(function):
    """Return what computes in one program and answers in NumPy, whose operations are none."""
    program = eqx.filter_jit(function)
    return lambda *given: jax.tree.map(np.asarray, program(*given))


weights_of = compiled(lambda part, times, num_knots, end: part.weights(times, num_knots, end))
decode = compiled(lambda part, nominal, samples, space: part.decode(nominal, samples, space))
controls_of = compiled(lambda part, nominal, space: part.controls(nominal, space))
shift = compiled(lambda part, nominal, steps, space: part.shift(nominal, steps, space))
encode = compiled(lambda part, controls, space: part.encode(None, controls, space))
init = compiled(lambda part, controls, space: part.init(controls, space))


def covariance(name: str, distance: np.ndarray) -> np.ndarray:
    if name == "rbf":
        return np.exp(-(distance**2) / (2 * 2.0**2))
    scaled = math.sqrt(5) * distance / 3.0
    return (1 + scaled + scaled**2 / 3) * np.exp(-scaled)


def expected_weights(name: str, times: np.ndarray, num_knots: int, horizon: int) -> np.ndarray:
    """In double precision; beyond the last knot what it has falls to 0 over one step."""
    end, times = horizon - 1, np.asarray(times, np.float64)
    knots = np.linspace(0, end, num_knots)
    if name in ("rbf", "matern"):
        among = covariance(name, np.abs(np.subtract.outer(knots, knots)))
        across = covariance(name, np.abs(np.subtract.outer(times, knots)))
        return across @ np.linalg.inv(among)
    inside = np.minimum(times, end)
    if num_knots == 1:
        weights = np.ones((len(times), 1))
    elif name == "hold":
        index = np.searchsorted(knots, inside + 1e-9, side="right") - 1
        weights = np.eye(num_knots)[index]
    elif name == "linear":
        weights = np.stack([np.interp(inside, knots, unit) for unit in np.eye(num_knots)], axis=-1)
    else:
        # SciPy's natural spline of two points is their straight line.
        spline = scipy.interpolate.CubicSpline(knots, np.eye(num_knots), bc_type="natural")
        weights = spline(inside)
    return weights * np.clip(1 - (times - end), 0, 1)[:, None]


@every
@sizes
def test_weights_are_those_of_scipy(name: str, num_knots: int, horizon: int) -> None:
    knots = np.linspace(0.0, horizon - 1.0, num_knots)
    times = np.concatenate([knots, np.arange(0.0, horizon + 4.0, 0.125)])
    actual = weights_of(
        INTERPOLATIONS[name], jnp.asarray(times, jnp.float32), num_knots, float(horizon - 1)
    )
    expected = expected_weights(name, times, num_knots, horizon)
    tolerance = 2e-4 if name == "rbf" else 2e-5
    np.testing.assert_allclose(actual, expected, atol=tolerance)
    np.testing.assert_allclose(actual[:num_knots], np.eye(num_knots), atol=tolerance)


@pytest.mark.parametrize(
    ("name", "num_knots", "horizon"),
    [*((name, 4, 10) for name in INTERPOLATIONS), ("cubic", 1, 6), ("cubic", 2, 6)],
)
def test_controls_are_the_interpolated_deviation_from_the_default(
    name: str, num_knots: int, horizon: int
) -> None:
    rng, space = np.random.default_rng(0), build_space(horizon)
    knots = rng.uniform(-0.5, 1.5, (num_knots, SIZE)) + np.array([0.0, 8.0])
    weights = expected_weights(name, np.arange(horizon), num_knots, horizon)
    expected = np.clip(DEFAULT + weights @ (knots - DEFAULT), LOW, HIGH)
    part, nominal = Knots(num_knots, INTERPOLATIONS[name]), jnp.asarray(knots, jnp.float32)
    assert part.num_parameters(horizon) == num_knots
    np.testing.assert_allclose(controls_of(part, nominal, space), expected, atol=1e-3)
    controls, effective = decode(part, nominal, np.asarray(nominal)[:, :, None], space)
    np.testing.assert_allclose(controls[:, :, 0], expected, atol=1e-3)
    np.testing.assert_allclose(effective[:, :, 0], knots, rtol=1e-6)


@pytest.mark.parametrize(
    ("num_knots", "horizon"),
    [
        (3, 60),
        (13, 25),
        (7, 27),
        (15, 17),
    ],
)
def test_a_held_knot_begins_at_its_time(num_knots: int, horizon: int) -> None:
    times = jnp.arange(horizon, dtype=jnp.float32)
    weights = np.asarray(weights_of(ZeroOrderHold(), times, num_knots, float(horizon - 1)))
    exact = [int(Fraction(t * (num_knots - 1), horizon - 1)) for t in range(horizon)]
    np.testing.assert_array_equal(weights, np.eye(num_knots)[exact])


@pytest.mark.parametrize(
    ("kernel", "share"),
    [
        (RBFKernel, 1.5),
        (MaternKernel, 3.99),
    ],
)
def test_kernels_that_are_accepted_are_well_conditioned(kernel, share: float) -> None:
    """In units of the knots' distance, 2 steps here."""
    times = jnp.linspace(0.0, 40.0, 21)
    actual = weights_of(kernel(2.0 * share), times, 21, 40.0)
    np.testing.assert_allclose(actual, np.eye(21), atol=1e-3)


@pytest.mark.parametrize("name", ["linear", "cubic"])
def test_the_cubic_spline_has_no_kinks(name: str) -> None:
    """Between neighbouring points its second derivative changes by no more than the third says."""
    num_knots, horizon, step = 5, 13, 0.125
    values = np.random.default_rng(1).normal(size=num_knots)
    times = np.arange(0.0, horizon - 1.0 + step / 2, step)
    weights = weights_of(
        INTERPOLATIONS[name], jnp.asarray(times, jnp.float32), num_knots, float(horizon - 1)
    )
    curve = np.asarray(weights, np.float64) @ values
    jumps = np.abs(np.diff(np.diff(curve, 2) / step**2))
    knots = np.linspace(0, horizon - 1, num_knots)
    spline = scipy.interpolate.CubicSpline(knots, values, bc_type="natural")
    bound = step * np.abs(spline(times, 3)).max() + 1e-3
    assert (jumps.max() > 5 * bound) if name == "linear" else (jumps.max() <= bound)


@every
def test_controls_fall_to_the_default_away_from_the_knots(name: str) -> None:
    """A quadrotor keeps its hover thrust, 9.81, however often the plan is moved on."""
    part, space = Knots(4, INTERPOLATIONS[name]), build_space(10)
    nominal = jnp.asarray(np.random.default_rng(0).uniform(LOW, HIGH, (4, SIZE)), jnp.float32)
    far = np.abs(np.asarray(nominal) - DEFAULT).max(axis=0)
    for steps in [1.0, 0.4, 1.6] * 20:
        nominal = shift(part, nominal, jnp.asarray(steps), space)
        assert (np.asarray(controls_of(part, nominal, space))[:, 1] > 0.0).all()
    for values in (nominal, controls_of(part, nominal, space)):
        assert (np.abs(np.asarray(values) - DEFAULT) < 0.01 * far).all()
    rest = np.tile(space.default, (4, 1))
    np.testing.assert_allclose(shift(part, rest, jnp.asarray(2.3), space), rest, rtol=1e-6)
    np.testing.assert_allclose(controls_of(part, rest, space), np.tile(DEFAULT, (10, 1)), rtol=1e-6)


def test_a_kernel_falls_to_the_default_between_far_knots() -> None:
    part, space = Knots(2, RBFKernel(1.0)), build_space(13)
    controls = np.asarray(controls_of(part, jnp.asarray([[2.0, 0.0], [2.0, 0.0]]), space))
    np.testing.assert_allclose(controls[[0, 12]], [[2.0, 0.0]] * 2, atol=1e-5)
    np.testing.assert_allclose(controls[6], DEFAULT, rtol=1e-5)


@every
def test_the_first_control_is_the_first_knot(name: str) -> None:
    part, space = Knots(4, INTERPOLATIONS[name]), build_space(10)
    nominal = np.random.default_rng(0).uniform(LOW, HIGH, (4, SIZE)).astype(np.float32)
    controls = controls_of(part, jnp.asarray(nominal), space)
    np.testing.assert_allclose(controls[0], nominal[0], atol=2e-3)
    np.testing.assert_allclose(controls[-1], nominal[-1], atol=2e-3)


@every
@pytest.mark.parametrize("steps", [0.0, 1.0, 3.0, 0.3, 2.7, 9.0, 9.5, 30.0])
def test_a_shift_takes_the_curve_where_the_knots_will_be(name: str, steps: float) -> None:
    space, nominal = build_space(10), np.random.default_rng(2).uniform(LOW, HIGH, (4, SIZE))
    part = Knots(4, INTERPOLATIONS[name])
    actual = shift(part, jnp.asarray(nominal, jnp.float32), jnp.asarray(steps), space)
    times = np.linspace(0, 9, 4) + steps
    # Held values are moved on along straight lines.
    curve = expected_weights("linear" if name == "hold" else name, times, 4, 10)
    np.testing.assert_allclose(actual, DEFAULT + curve @ (nominal - DEFAULT), atol=3e-3)


@pytest.mark.parametrize("name", ["hold", "linear", "cubic"])
def test_a_shift_by_a_knot_s_distance_moves_every_knot_one_on(name: str) -> None:
    part, space = Knots(4, INTERPOLATIONS[name]), build_space(10)
    nominal = np.random.default_rng(2).uniform(LOW, HIGH, (4, SIZE)).astype(np.float32)
    actual = np.asarray(shift(part, jnp.asarray(nominal), jnp.asarray(3.0), space))
    np.testing.assert_allclose(actual[:-1], nominal[1:], atol=1e-5)
    np.testing.assert_allclose(actual[-1], DEFAULT, atol=1e-5)
    if name != "cubic":  # Whose curve depends on all knots.
        before = np.asarray(controls_of(part, jnp.asarray(nominal), space))
        after = np.asarray(controls_of(part, jnp.asarray(actual), space))
        np.testing.assert_allclose(after[:7], before[3:], atol=1e-5)


@pytest.mark.parametrize("name", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("steps", [0.25, 0.5, 1.0])
def test_many_small_shifts_go_as_far_as_a_large_one(name: str, steps: float) -> None:
    """Along a straight line, which interpolation does not smear."""
    part, space = Knots(9, INTERPOLATIONS[name]), build_space(33)
    line = np.linspace([0.0, 2.0], [1.0, 14.0], 9)
    nominal = jnp.asarray(line, jnp.float32)
    for _ in range(round(4 / steps)):
        nominal = shift(part, nominal, jnp.asarray(steps), space)
    # At the end the default comes in, and a little of it reaches the knots before.
    gone = np.asarray(nominal)[:4] - line[:4]
    np.testing.assert_allclose(gone / (line[1] - line[0]), 1.0, atol=0.03)


@every
def test_small_shifts_move_the_first_control(name: str) -> None:
    part, space = Knots(4, INTERPOLATIONS[name]), build_space(10)
    nominal = jnp.asarray([[0.0, 9.81], [1.0, 9.81], [1.0, 9.81], [1.0, 9.81]])
    before = 0.0
    for _ in range(8):
        nominal = shift(part, nominal, jnp.asarray(0.25), space)
        first = float(controls_of(part, nominal, space)[0, 0])
        assert first > before + 0.01
        before = first
    assert before > 0.3


@every
def test_a_knot_at_every_step_is_direct(name: str) -> None:
    horizon = 7
    space, rng = build_space(horizon), np.random.default_rng(3)
    part, direct = Knots(horizon, INTERPOLATIONS[name]), Direct()
    if name in ("rbf", "matern"):
        part = Knots(horizon, type(INTERPOLATIONS[name])(1.0))
    nominal = jnp.asarray(rng.uniform(LOW, HIGH, (horizon, SIZE)), jnp.float32)
    np.testing.assert_allclose(controls_of(part, nominal, space), nominal, atol=1e-4)
    samples = jnp.asarray(rng.normal(0.0, 9.0, (horizon, SIZE, 4)), jnp.float32)
    for actual, expected in zip(
        decode(part, nominal, samples, space), decode(direct, nominal, samples, space), strict=True
    ):
        np.testing.assert_allclose(actual, expected, atol=2e-4)
    np.testing.assert_allclose(init(part, nominal, space), nominal, atol=2e-4)
    for steps in (1.0, 2.0, 0.3, 6.7):
        if steps % 1 and name not in ("hold", "linear"):
            continue
        actual = shift(part, nominal, jnp.asarray(steps), space)
        expected = shift(direct, nominal, jnp.asarray(steps), space)
        rows = horizon if name in ("hold", "linear", "cubic") else horizon - int(steps)
        np.testing.assert_allclose(actual[:rows], expected[:rows], atol=2e-4)


@every
def test_encode_finds_the_nearest_knots(name: str) -> None:
    space, rng = build_space(10), np.random.default_rng(4)
    part = Knots(4, INTERPOLATIONS[name])
    controls = rng.uniform(LOW, HIGH, (10, SIZE))
    weights = expected_weights(name, np.arange(10), 4, 10)
    solved = np.linalg.lstsq(weights, controls - DEFAULT, rcond=None)[0]
    expected = np.clip(DEFAULT + solved, LOW, HIGH)
    for actual in (
        encode(part, jnp.asarray(controls, jnp.float32), space),
        init(part, jnp.asarray(controls, jnp.float32), space),
    ):
        np.testing.assert_allclose(actual, expected, atol=5e-3)


@every
def test_encode_is_the_inverse_of_decode(name: str) -> None:
    """For knots whose controls are within the bounds."""
    space, rng = build_space(10), np.random.default_rng(4)
    part = Knots(4, INTERPOLATIONS[name])
    knots = DEFAULT + rng.uniform(-0.3, 0.3, (4, SIZE))
    nominal = jnp.asarray(knots, jnp.float32)
    controls, effective = decode(part, nominal, np.asarray(nominal)[:, :, None], space)
    np.testing.assert_allclose(effective[:, :, 0], knots, rtol=1e-6)
    np.testing.assert_allclose(encode(part, controls[:, :, 0], space), knots, atol=1e-3)
    np.testing.assert_array_equal(part.centre(nominal), nominal)
    np.testing.assert_array_equal(part.update(nominal, nominal, space), nominal)
    np.testing.assert_allclose(part.rest(space), DEFAULT, rtol=1e-6)


@pytest.mark.parametrize("name", ["linear", "cubic", "rbf"])
@hypothesis.given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0.01, 1e4))
@hypothesis.settings(max_examples=15)
def test_everything_stays_within_the_bounds(name: str, seed: int, spread: float) -> None:
    """Controls too, where a spline overshoots; and the mean of the knots that took effect."""
    part, space, rng = Knots(4, INTERPOLATIONS[name]), build_space(10), np.random.default_rng(seed)
    drawn = rng.normal(0.0, spread, (4, SIZE, 8)).astype(np.float32)
    controls, knots = decode(part, jnp.zeros((4, SIZE)), jnp.asarray(drawn), space)
    np.testing.assert_array_equal(
        knots, np.clip(drawn, *(np.float32(b)[:, None] for b in (LOW, HIGH)))
    )
    mean = np.asarray(knots) @ rng.dirichlet(np.ones(8))
    for values in (np.moveaxis(np.asarray(controls), -1, 0), mean):
        assert (values >= LOW - 1e-5).all()
        assert (values <= HIGH + 1e-5).all()


def test_the_matrix_is_computed_when_the_step_is_compiled() -> None:
    part, space = Knots(4, RBFKernel(2.0)), build_space(10)
    jaxpr = str(
        jax.make_jaxpr(lambda samples: part.decode(samples[:, :, 0], samples, space))(
            jnp.zeros((4, SIZE, 3))
        )
    )
    assert "dot_general" in jaxpr
    for heavy in ("exp", "lu", "triangular_solve", "iota"):
        assert f" {heavy}" not in jaxpr


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Knots(8).num_parameters(7), r"num_knots is 8; accepted: at most the horizon, 7"),
        (
            lambda: Knots(4, RBFKernel(40.0)).num_parameters(10),
            r"length_scale is 40.0; accepted: at most .* steps for 4 knots over 9",
        ),
        (
            lambda: Knots(21, RBFKernel(5.0)).num_parameters(41),
            r"length_scale is 5.0; accepted: at most 3\.",
        ),
    ],
)
def test_bad_input_is_named(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


def test_one_knot_may_have_any_length_scale() -> None:
    assert Knots(1, RBFKernel(1e3)).num_parameters(10) == 1
