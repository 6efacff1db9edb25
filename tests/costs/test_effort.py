import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import ControlCost, ControlRateCost, Cost, State
from jaxplore.costs import ControlJerkCost, QuadraticControlCost

HORIZON = 6
SEQUENCES = hnp.arrays(
    np.float32, (HORIZON, 3), elements=st.floats(-4, 4, width=32, allow_subnormal=False)
)
SCALES = np.array([0.5, 2.0, 4.0])


def test_control_cost_is_relative_to_the_bounds(stage, at) -> None:
    assert stage(ControlCost(), at(1.0, 1.0), (1.0, -4.0)) == pytest.approx(0.25 + 1.0)


def test_control_cost_of_bounds_on_one_side_or_none(drone) -> None:
    control = jnp.asarray([1.5, -1.0, 0.0])
    found = ControlCost().stage(drone(), control, jnp.asarray(0.1), None)
    assert float(found) == pytest.approx((1.5 / 3.0) ** 2 + (1.0 / 4.0) ** 2)
    slope = jax.grad(lambda u: ControlCost().stage(drone(), u, jnp.asarray(0.1), None))(control)
    np.testing.assert_allclose(slope, [2 * 1.5 / 9.0, -2 * 1.0 / 16.0, 0.0], rtol=1e-6)


def test_symmetric_bounds_cost_what_they_did(at) -> None:
    control = jnp.asarray([0.37, -3.1])
    share = control / at(0.0, 0.0).dynamics.control_max
    found = ControlCost().stage(at(0.0, 0.0), control, jnp.asarray(0.1), None)
    assert float(found) == float(jnp.sum(share * share))


WEIGHTS = np.array([[2.0, 0.3, 0.0], [0.5, 1.0, -0.2], [0.0, 0.4, 3.0]])


def quadratic(cost: Cost, state: State, control: np.ndarray) -> float:
    return float(cost.stage(state, jnp.asarray(control, jnp.float32), jnp.asarray(0.1), None))


@pytest.mark.parametrize("target", [None, (0.5, -1.0, 2.0)])
@pytest.mark.parametrize("is_matrix", [False, True])
def test_quadratic_control_cost(target, is_matrix: bool, drone) -> None:
    control = np.array([1.7, -3.0, 0.4])
    # The drone's thrust may not be less than 1: that is what it does when left alone.
    error = control - (np.array([1.0, 0.0, 0.0]) if target is None else np.asarray(target))
    matrix = WEIGHTS if is_matrix else np.diag(np.diag(WEIGHTS))
    weights = WEIGHTS if is_matrix else np.diag(WEIGHTS)
    expected = sum(matrix[i, j] * error[i] * error[j] for i in range(3) for j in range(3))
    cost = QuadraticControlCost(weights, target)
    assert quadratic(cost, drone(), control) == pytest.approx(expected, rel=1e-5)


def test_a_robot_left_alone_costs_no_effort(drone) -> None:
    cost = QuadraticControlCost(WEIGHTS)
    assert quadratic(cost, drone(), np.array([1.0, 0.0, 0.0])) == 0.0


def test_weights_of_rank_one_are_accepted(at) -> None:
    direction = np.array([0.1, 0.3])
    cost = QuadraticControlCost(np.outer(direction, direction))
    across = np.array([3.0, -1.0])
    assert quadratic(cost, at(0.0, 0.0), across) == pytest.approx(0.0, abs=1e-6)
    assert quadratic(cost, at(0.0, 0.0), direction) == pytest.approx(0.01)


@eqx.filter_jit
def run(cost: Cost, controls, applied, robot):
    return cost.sequence(controls, applied, jnp.asarray(0.05), robot)


def sequence(cost: Cost, controls: np.ndarray, applied: np.ndarray, robot) -> float:
    as_floats = (jnp.asarray(values, jnp.float32) for values in (controls, applied))
    return float(run(cost, *as_floats, robot))


def differences(controls: np.ndarray, applied: np.ndarray | None, order: int, scale) -> float:
    """Squared differences in double precision, one by one, from the definition."""
    controls = np.asarray(controls, np.float64)
    if applied is not None:
        controls = np.vstack([np.asarray(applied, np.float64), controls])
    total = 0.0
    for i in range(controls.shape[1]):
        u = controls[:, i]
        for t in range(order, len(u)):
            change = u[t] - u[t - 1] if order == 1 else u[t] - 2 * u[t - 1] + u[t - 2]
            total += (change / scale[i]) ** 2
    return total


@given(controls=SEQUENCES, applied=hnp.arrays(np.float32, 3, elements=st.integers(-3, 3)))
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("include_applied", [False, True])
def test_rate_and_jerk_are_squared_differences(
    order: int, include_applied: bool, controls, applied, drone
) -> None:
    kind = ControlRateCost if order == 1 else ControlJerkCost
    cost = kind(SCALES, include_applied)
    expected = differences(controls, applied if include_applied else None, order, SCALES)
    found = sequence(cost, controls, applied, drone().dynamics)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(("kind", "order"), [(ControlRateCost, 1), (ControlJerkCost, 2)])
def test_the_scale_is_the_range_of_the_model_unless_given(kind, order: int, drone) -> None:
    robot, rng = drone().dynamics, np.random.default_rng(0)
    controls, applied = rng.normal(size=(HORIZON, 3)), rng.normal(size=3)
    # The third control is locked: its bounds are equal.
    expected = differences(controls, applied, order, [2.0, 4.0, np.inf])
    assert sequence(kind(), controls, applied, robot) == pytest.approx(expected, rel=1e-4)
    expected = differences(controls, applied, order, [0.7] * 3)
    assert sequence(kind(0.7), controls, applied, robot) == pytest.approx(expected, rel=1e-4)
    unbounded = eqx.tree_at(lambda r: r.control_max, robot, jnp.asarray([jnp.inf, 0.0, 0.0]))
    expected = differences(controls, applied, order, [np.inf, 4.0, np.inf])
    assert sequence(kind(), controls, applied, unbounded) == pytest.approx(expected, rel=1e-4)


@given(applied=hnp.arrays(np.float32, 3, elements=st.floats(-4, 4, width=32)))
def test_going_on_as_before_costs_nothing(applied: np.ndarray, drone) -> None:
    controls = np.tile(applied, (HORIZON, 1))
    for cost in (ControlRateCost(SCALES), ControlJerkCost(SCALES)):
        assert sequence(cost, controls, applied, drone().dynamics) == 0.0


@given(
    start=hnp.arrays(np.float32, 3, elements=st.integers(-8, 8)),
    slope=hnp.arrays(np.float32, 3, elements=st.integers(-4, 4)),
)
def test_an_even_rise_has_no_jerk(start: np.ndarray, slope: np.ndarray, drone) -> None:
    ramp = start + np.arange(1, HORIZON + 1)[:, None] * slope
    robot = drone().dynamics
    assert sequence(ControlJerkCost(SCALES), ramp, start, robot) == 0.0
    rate = sequence(ControlRateCost(SCALES), ramp, start, robot)
    assert rate == pytest.approx(HORIZON * ((slope / SCALES) ** 2).sum(), rel=1e-5)
    # Left to a standing start, the rise itself is a bend.
    jolt = sequence(ControlJerkCost(SCALES), ramp, ramp[0], robot)
    assert jolt == pytest.approx(((slope / SCALES) ** 2).sum(), rel=1e-5)


@pytest.mark.parametrize("include_applied", [False, True])
def test_sequences_too_short_for_a_difference(include_applied: bool, drone) -> None:
    one, applied, robot = np.ones((1, 3)), np.zeros(3), drone().dynamics
    rate = sequence(ControlRateCost(SCALES, include_applied), one, applied, robot)
    assert rate == pytest.approx((1.0 / SCALES**2).sum() if include_applied else 0.0)
    assert sequence(ControlJerkCost(SCALES, include_applied), one, applied, robot) == 0.0


@pytest.mark.parametrize("kind", [ControlRateCost, ControlJerkCost])
def test_no_step_pays_for_the_sequence(kind, price, drone) -> None:
    assert price(kind(), drone(x=3.0, v=2.0)) == 0.0


@pytest.mark.parametrize("kind", [ControlRateCost, ControlJerkCost])
def test_samples_on_the_last_axis_are_priced_one_by_one(kind, drone) -> None:
    robot, rng = drone().dynamics, np.random.default_rng(1)
    controls = rng.normal(size=(HORIZON, 3, 5)).astype(np.float32)
    applied, cost = rng.normal(size=3).astype(np.float32), kind(SCALES)
    together = eqx.filter_vmap(run, in_axes=(None, -1, None, None))(
        cost, jnp.asarray(controls), jnp.asarray(applied), robot
    )
    alone = [sequence(cost, controls[:, :, k], applied, robot) for k in range(5)]
    np.testing.assert_allclose(together, alone, rtol=1e-5)


@pytest.mark.parametrize("kind", [ControlRateCost, ControlJerkCost])
def test_another_scale_does_not_recompile(kind, drone) -> None:
    traced = 0

    @eqx.filter_jit
    def count(cost: Cost):
        nonlocal traced
        traced += 1
        return cost.sequence(jnp.ones((4, 3)), jnp.zeros(3), jnp.asarray(0.05), drone().dynamics)

    results = {float(count(kind(scale * SCALES))) for scale in (1.0, 2.0, 3.0)}
    assert traced == 1
    assert len(results) == 3


@pytest.mark.parametrize(
    ("make", "culprit"),
    [
        (lambda: QuadraticControlCost([1.0, -1.0]), r"weights is \[1.0, -1.0\], which rewards"),
        (
            lambda: QuadraticControlCost([[1.0, 2.0], [2.0, 1.0]]),
            r"weights is .*eigenvalue -1\); accepted: no eigenvalue below 0",
        ),
        (lambda: QuadraticControlCost(np.ones((2, 3))), r"weights has shape \(2, 3\); accepted"),
        (lambda: QuadraticControlCost([1.0], [1.0, 2.0]), r"target has shape \(2,\); accepted"),
        (lambda: ControlJerkCost(np.ones((2, 2))), r"scale has shape \(2, 2\); accepted: one numb"),
    ],
)
def test_bad_input_is_named(make, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        make()


def test_sizes_that_do_not_fit_the_model_are_named(at) -> None:
    state, culprit = at(0.0, 0.0), "is for 3 controls; accepted: 2, the controls of DifferentialD"
    with pytest.raises(ValueError, match="weights " + culprit):
        quadratic(QuadraticControlCost(np.ones(3)), state, np.zeros(2))
    with pytest.raises(ValueError, match="scale " + culprit):
        sequence(ControlRateCost(np.ones(3)), np.zeros((4, 2)), np.zeros(2), state.dynamics)


def test_traced_numbers_pass() -> None:
    @jax.jit
    def make(weights, scale):
        return QuadraticControlCost(weights), ControlRateCost(scale)

    quadratic_cost, rate = make(-jnp.ones(2), -jnp.ones(()))
    assert float(quadratic_cost.weights[0]) == float(rate.scale) == -1.0
