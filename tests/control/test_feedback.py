"""Gains, and the control that follows a plan between plans."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    Cost,
    DifferentialDrive,
    Elite,
    FeedbackMPPI,
    Knots,
    Pendulum,
    PointMass,
    Quadrotor,
    Smooth,
    Softmax,
    StateCost,
    StateNoise,
    Unicycle,
    WaypointCost,
)
from jaxplore.control import (
    AdaptiveSoftmax,
    CubicSpline,
    Entropic,
    ModelEnsemble,
    SavitzkyGolay,
    step_with_gains,
)
from jaxplore.costs import QuadraticControlCost

pytestmark = pytest.mark.long

MASS = PointMass(2, max_acceleration=4.0)
TO_POINT = StateCost(
    {"x": 1.0, "y": 0.5, "vx": 0.2, "vy": 0.2}, {"x": 0.5}, terminal_weight=3.0
) + QuadraticControlCost([0.05, 0.05])
CAR = DifferentialDrive(max_speed=5.0, max_turn_rate=5.0)
POSE = WaypointCost([1.0, 0.5], heading=0.3, terminal_weight=2.0)
FLIGHT = Quadrotor()
HOVER = StateCost(
    {"x": 1.0, "y": 1.0, "z": 1.0, "vx": 0.1, "vy": 0.1, "vz": 0.1},
    {"x": 0.4, "z": -0.3},
    terminal_weight=3.0,
)
LEVEL = FLIGHT.at_pose(0.0, 0.0, 0.2)
AT_MASS = jnp.asarray([0.1, -0.2, 0.3, 0.1])
UPRIGHT = StateCost({"angle": 1.0, "rate": 0.1}, angles=("angle",))
UNCERTAIN = {"disturbance": StateNoise([0.1] * 4), "num_outcomes": 4}
ENSEMBLE = {
    "disturbance": ModelEnsemble(
        *(PointMass(2, max_acceleration=4.0, drag=drag) for drag in (0.0, 0.5, 1.0))
    ),
    "num_outcomes": 3,
}


def gains_and_differences(model, cost, start, std, key, steps, **changes):
    """Return the gains, and central differences of `step` for the same noise."""
    mppi = MPPI(model, cost, horizon=10, num_samples=64, noise_std=std, dt=0.1, **changes)
    rows = mppi.parameterisation.num_parameters(10)
    noise = np.random.default_rng(0).normal(size=(rows, len(std), 64)) * np.array(std)[:, None]
    noise = jnp.asarray(noise, jnp.float32)

    @eqx.filter_jit
    def both(mppi, observations):
        def control(observation):
            return mppi.step(mppi.init(), observation, key=key, perturbations=noise)[0]

        found = step_with_gains(mppi, mppi.init(), observations[0], key=key, perturbations=noise)
        return found, jax.lax.map(control, observations)

    offsets = steps * np.concatenate([np.zeros((1, len(start))), np.eye(len(start))])
    offsets = np.concatenate([offsets, -offsets[1:]]).astype(np.float32)
    found, controls = both(mppi, start + offsets)
    np.testing.assert_allclose(found[0], controls[0], atol=1e-6)
    ahead, behind = np.split(np.asarray(controls)[1:], 2)
    return np.asarray(found[3]), ((ahead - behind) / (2.0 * steps)).T


@pytest.mark.parametrize(
    ("model", "cost", "start", "std", "changes"),
    [
        pytest.param(
            MASS, TO_POINT, AT_MASS, [4.0, 4.0], {"parameterisation": Smooth()}, id="mass, smooth"
        ),
        pytest.param(
            MASS,
            TO_POINT,
            AT_MASS,
            [1.0, 1.0],
            {"parameterisation": Knots(4, CubicSpline()), "smoothing": SavitzkyGolay(5, 2)},
            id="mass, knots, smoothed",
        ),
        pytest.param(MASS, TO_POINT, AT_MASS, [1.0, 1.0], UNCERTAIN, id="mass, outcomes"),
        pytest.param(
            MASS,
            TO_POINT,
            AT_MASS,
            [1.0, 1.0],
            {**ENSEMBLE, "risk": Entropic(0.2), "parameterisation": Knots(5)},
            id="mass, ensemble, entropic",
        ),
        pytest.param(
            CAR,
            POSE,
            jnp.asarray([0.0, 0.0, 0.4, 0.8, 0.2]),
            [0.8, 1.5],
            {},
            id="differential drive",
        ),
        pytest.param(
            Pendulum(max_torque=4.0),
            UPRIGHT,
            jnp.asarray([0.3, -0.2]),
            [1.5],
            {},
            id="pendulum",
        ),
        pytest.param(
            Unicycle(max_speed=3.0, min_speed=-3.0),
            WaypointCost([1.0, 0.5], terminal_weight=2.0),
            jnp.asarray([0.0, 0.0, 0.2]),
            [0.8, 0.8],
            {"parameterisation": Knots(4, CubicSpline())},
            id="unicycle, knots",
        ),
        pytest.param(FLIGHT, HOVER, LEVEL, [3.0, 1.0, 1.0, 1.0], {}, id="quadrotor"),
    ],
)
def test_gains_are_the_derivative_of_the_step(model, cost, start, std, changes) -> None:
    changes = {"weighting": Softmax(1.0, 0.5), **changes}
    # The braking distance of the differential drive's cost has a kink, so its steps are small.
    step = 1e-3 if model is FLIGHT else 5e-4 if model is CAR else 5e-3
    gains, differences = gains_and_differences(
        model, cost, start, std, jax.random.key(1), step, **changes
    )
    largest = np.abs(differences).max()
    assert largest > 0.05
    np.testing.assert_allclose(gains, differences, atol=0.01 * largest, rtol=0.01)


def test_gains_pass_through_a_temperature_that_adapts() -> None:
    gains, differences = gains_and_differences(
        MASS,
        TO_POINT,
        AT_MASS,
        [1.0, 1.0],
        jax.random.key(1),
        5e-3,
        weighting=AdaptiveSoftmax(16.0),
    )
    largest = np.abs(differences).max()
    np.testing.assert_allclose(gains, differences, atol=0.02 * largest, rtol=0.02)


def test_gains_are_the_formula_in_double_precision() -> None:
    horizon, samples, dt, temperature, start = 6, 48, 0.2, 0.7, np.array([0.2, -0.3])
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(horizon, samples)) * 0.9
    cost = StateCost({"x": 1.0, "vx": 0.2}, {"x": 1.0}, terminal_weight=2.0)
    mppi = MPPI(
        PointMass(1, max_acceleration=100.0),
        cost,
        horizon=horizon,
        num_samples=samples,
        noise_std=[0.9],
        dt=dt,
        temperature=temperature,
    )
    control, _, info, gains = eqx.filter_jit(step_with_gains)(
        mppi,
        mppi.init(),
        jnp.asarray(start, jnp.float32),
        key=jax.random.key(0),
        perturbations=jnp.asarray(noise[:, None], jnp.float32),
    )
    move, push, q = np.array([[1, dt], [0, 1]]), np.array([dt**2 / 2, dt]), np.array([1.0, 0.2])
    costs, slopes = np.zeros(samples), np.zeros((samples, 2))
    for k in range(samples):
        x, sensitivity = start.copy(), np.eye(2)
        for t in range(horizon):
            x, sensitivity = move @ x + push * noise[t, k], move @ sensitivity
            times = 3.0 if t == horizon - 1 else 1.0
            error = x - [1.0, 0.0]
            costs[k] += times * (q * error**2).sum()
            slopes[k] += times * 2.0 * (q * error) @ sensitivity
    weights = np.exp(-(costs - costs.min()) / temperature)
    weights /= weights.sum()
    expected = -(weights * noise[0]) @ (slopes - weights @ slopes) / temperature
    np.testing.assert_allclose(info.costs, costs, rtol=1e-5)
    np.testing.assert_allclose(control, [weights @ noise[0]], rtol=1e-4)
    np.testing.assert_allclose(gains[0], expected, rtol=2e-4)


def test_gains_push_back() -> None:
    mppi = MPPI(
        MASS,
        TO_POINT,
        horizon=15,
        num_samples=1024,
        noise_std=[1.0, 1.0],
        dt=0.1,
        weighting=Softmax(0.5, 0.0),
    )
    _, _, _, gains = eqx.filter_jit(step_with_gains)(
        mppi, mppi.init(), jnp.asarray([0.5, 0.0, 0.0, 0.0]), key=jax.random.key(0)
    )
    away, across = np.asarray(gains[:, :2]), np.asarray(gains[:, 2:])
    for block in (away, across):
        assert (np.diag(block) < -0.1).all()
        # Each axis answers for itself.
        assert np.abs(block - np.diag(np.diag(block))).max() < 0.5 * np.abs(np.diag(block)).min()


def test_elites_have_no_derivative() -> None:
    mppi = MPPI(
        MASS, TO_POINT, horizon=6, num_samples=32, noise_std=[1.0, 1.0], weighting=Elite(0.2)
    )
    control, _, _, gains = eqx.filter_jit(step_with_gains)(
        mppi, mppi.init(), AT_MASS, key=jax.random.key(0)
    )
    np.testing.assert_array_equal(gains, 0.0)
    assert (control != 0.0).any()


class Edge(Cost):
    """Not a number where the first control is above a limit, no weight where it is far below 0;
    elsewhere smooth, but for speeds at which a root ends."""

    limit: jax.Array
    end: jax.Array

    def stage(self, state, control, t, belief):
        # The root has no derivative where the maximum is 0.
        paid = jnp.sum(state.position**2) + jnp.sqrt(jnp.maximum(state["vy"] - self.end, 0.0))
        paid = jnp.where(control[0] > self.limit, jnp.nan, paid)
        return jnp.where(control[0] < -3.0, 1e6, paid)


def at_an_edge(limit: float, end: float):
    """Return a controller that meets an edge, and its step from one place, for noise."""
    cost = Edge(jnp.asarray(limit), jnp.asarray(end))
    mppi = MPPI(MASS, cost, horizon=4, num_samples=32, noise_std=[0.6, 0.6], temperature=1.0)

    def step(noise, observation=(1.0, -1.0, 0.0, 0.0)):
        _, _, info, gains = eqx.filter_jit(step_with_gains)(
            mppi,
            mppi.init(),
            jnp.asarray(observation),
            key=jax.random.key(0),
            perturbations=jnp.asarray(noise, jnp.float32),
        )
        return info, gains

    return step


EDGE_NOISE = np.random.default_rng(2).normal(size=(4, 2, 32)) * 0.6


def test_rollouts_that_are_not_finite_do_not_count_in_the_gains() -> None:
    step = at_an_edge(0.7, -9.0)
    info, gains = step(EDGE_NOISE)
    bad = (EDGE_NOISE[:, 0] > 0.7).any(axis=0)
    np.testing.assert_array_equal(np.isinf(info.costs), bad)
    assert 0 < bad.sum() < 32
    # The same without them: replaced by copies of one that is so bad that it has no weight.
    costly = np.where(bad, np.array([-3.5, 0.0])[:, None], EDGE_NOISE)
    info, expected = step(costly)
    assert np.isfinite(info.costs).all()
    np.testing.assert_array_equal(np.asarray(info.weights)[bad], 0.0)
    assert np.abs(expected).max() > 0.0
    np.testing.assert_allclose(gains, expected, rtol=1e-4, atol=1e-6)
    # All of them bad: no gain, and no number that is none.
    info, none = step(np.zeros((4, 2, 32)), [np.nan] * 4)
    assert not bool(info.is_finite)
    np.testing.assert_array_equal(none, 0.0)


def test_slopes_that_are_not_finite_do_not_spoil_the_gains() -> None:
    # Every second rollout or so gets to where the root ends.
    info, gains = at_an_edge(np.inf, -0.05)(EDGE_NOISE)
    assert np.isfinite(info.costs).all()
    assert np.isfinite(gains).all()
    assert np.abs(gains).max() > 0.0


def follower(**changes) -> FeedbackMPPI:
    settings = {"dt": 0.05, "control_period": 0.02, "temperature": 0.5, "noise_std": [1.0, 1.0]}
    settings.update(changes)
    planner = MPPI(MASS, TO_POINT, horizon=10, num_samples=64, **settings)
    return FeedbackMPPI(planner, commands_per_plan=4)


def test_between_plans_the_command_is_the_plan_and_the_gains() -> None:
    # 50 plans and 200 commands a second; and a plan that lasts for two model steps.
    rng = np.random.default_rng(0)
    for period, dt in ((0.02, 0.05), (0.1, 0.05)):
        controller = follower(control_period=period, dt=dt)
        assert float(controller.command_period) == pytest.approx(period / 4)
        step = eqx.filter_jit(controller.step)
        planner, state = controller.planner, controller.init()
        plans = []
        for index in range(9):
            x = jnp.asarray(rng.normal(size=4) * 0.3, jnp.float32)
            key = jax.random.key(index)
            before = state.planner
            control, state, info = step(state, x, key=key)
            plans.append(np.asarray(info.controls))
            since = index % 4
            if since == 0:
                # At a plan the command is that of the planner itself.
                expected, _, _, gains = eqx.filter_jit(step_with_gains)(planner, before, x, key=key)
                np.testing.assert_allclose(control, expected, atol=1e-5)
                np.testing.assert_allclose(state.gains, gains, rtol=1e-3, atol=1e-4)
                np.testing.assert_array_equal(state.states[0], x)
            else:
                np.testing.assert_array_equal(plans[-1], plans[-2])
            steps = since * period / 4 / dt
            row, share = int(steps + 1e-6), steps - int(steps + 1e-6)
            planned = (1 - share) * state.states[row] + share * state.states[row + 1]
            wanted = info.controls[row] + state.gains @ (x - planned)
            np.testing.assert_allclose(control, np.clip(wanted, -4.0, 4.0), atol=2e-4)
            np.testing.assert_array_equal(state.planner.applied, control)
        assert not np.array_equal(plans[0], plans[4])
        assert not np.array_equal(plans[4], plans[8])


def test_commands_stay_within_the_bounds_and_finite() -> None:
    controller = follower()
    step = eqx.filter_jit(controller.step)
    _, state, _ = step(controller.init(), AT_MASS, key=jax.random.key(0))
    for away in (1e4, -1e4):
        control, _, _ = step(state, AT_MASS + away, key=jax.random.key(0))
        np.testing.assert_allclose(np.abs(control), 4.0)
    control, _, _ = step(state, jnp.full(4, jnp.nan), key=jax.random.key(0))
    assert np.isfinite(control).all()


def test_another_period_keeps_the_ratio() -> None:
    controller = follower().at_period(0.01)
    assert float(controller.command_period) == pytest.approx(0.01)
    assert float(controller.planner.control_period) == pytest.approx(0.04)
    assert int(controller.commands_per_plan) == 4


def test_a_disturbed_robot_is_held_better_with_gains() -> None:
    model = PointMass(1, max_acceleration=10.0)
    planner = MPPI(
        model,
        StateCost({"x": 1.0, "vx": 0.1}, terminal_weight=5.0),
        horizon=15,
        num_samples=1024,
        noise_std=[2.0],
        dt=0.1,
        control_period=0.4,
        weighting=Softmax(0.3, 0.0),
        parameterisation=Knots(5, CubicSpline()),
    )
    controller = FeedbackMPPI(planner, commands_per_plan=20)

    @eqx.filter_jit
    def hold(controller, share, key):
        def advance(carry, key):
            x, state = carry
            step_key, push_key = jax.random.split(key)
            control, state, _ = controller.step(state, x, key=step_key)
            # At a plan the correction is 0: gains taken away here are never used.
            state = state._replace(gains=share * state.gains)
            x = model.step(x, control, controller.command_period)
            x = x.at[1].add(0.14 * jax.random.normal(push_key))
            return (x, state), x[0]

        carry = (jnp.zeros(2), controller.init())
        return jnp.sqrt(jnp.mean(jax.lax.scan(advance, carry, jax.random.split(key, 500))[1] ** 2))

    with_gains, without = (
        np.array([float(hold(controller, share, jax.random.key(seed))) for seed in range(4)])
        for share in (jnp.ones(()), jnp.zeros(()))
    )
    assert (with_gains < without).all()
    assert with_gains.mean() < 0.75 * without.mean()
