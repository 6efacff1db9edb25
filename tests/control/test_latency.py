"""Commands that take effect late."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxplore import MPPI, RK4, DifferentialDrive, GoalCost, LatencyCompensation
from jaxplore.belief import Obstacles
from jaxplore.control import LatencyState, predict_state
from jaxplore.control.base import Controller, Info
from jaxplore.geometry.outlines import Outlines

ROBOT = DifferentialDrive(integrator=RK4(), drag=0.3)
START = np.array([1.0, -2.0, 0.7, 0.5, 0.2])
CONTROLS = np.array([[0.5, -1.0], [0.3, 0.8], [-0.2, 0.4], [0.1, 0.1]])
predict = eqx.filter_jit(predict_state)


def exact(state, control, duration: float):
    """The same motion by another integrator."""

    def rate(_, values):
        _, _, yaw, v, omega = values
        return [
            v * np.cos(yaw),
            v * np.sin(yaw),
            omega,
            control[0] - 0.3 * v,
            control[1] - 0.3 * omega,
        ]

    return solve_ivp(rate, (0.0, duration), state, rtol=1e-10, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(
    "durations", [[0.02] * 4, [0.013, 0.0, 0.3, 0.05], [0.0] * 4, [-1.0, 0.1, 0.0, 0.0]]
)
def test_controls_are_held_one_after_the_other(durations) -> None:
    expected = START
    for control, duration in zip(CONTROLS, durations, strict=True):
        if duration > 0.0:
            expected = exact(expected, control, duration)
    arrays = (jnp.asarray(each, jnp.float32) for each in (START, CONTROLS, durations))
    np.testing.assert_allclose(predict(ROBOT, *arrays), expected, atol=2e-6)


def test_no_time_changes_nothing_at_all() -> None:
    start = jnp.asarray(START, jnp.float32)
    found = predict(ROBOT, start, jnp.asarray(CONTROLS, jnp.float32), jnp.zeros(4))
    np.testing.assert_array_equal(found, start)


def test_periods_of_a_simulation_are_its_steps() -> None:
    # Euler steps show their number: one per period, and not two because 0.02 / 0.02 is rounded.
    robot, state = DifferentialDrive(), jnp.asarray(START, jnp.float32)
    period, controls = jnp.asarray(0.02, jnp.float32), jnp.asarray(CONTROLS, jnp.float32)
    step = eqx.filter_jit(robot.step)
    expected = state
    for control in controls:
        expected = step(expected, control, period)
    found = predict(robot, state, controls, jnp.broadcast_to(period, (4,)))
    np.testing.assert_allclose(found, expected, rtol=3e-7)


class Noted(Controller):
    """Gives random commands, and keeps in its state what it was asked to plan from."""

    dynamics: DifferentialDrive
    control_period: jax.Array

    def init(self):
        return jnp.zeros(5), None

    def step(self, state, observation, belief=None, *, key):
        low, high = self.dynamics.control_min, self.dynamics.control_max
        control = jax.random.uniform(key, (2,), minval=low, maxval=high)
        one = jnp.ones(())
        info = Info(control[None], one[None], one[None], one, jnp.array(True))
        return control, (observation, belief), info

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        raise NotImplementedError

    def at_period(self, control_period):
        return dataclasses.replace(self, control_period=jnp.asarray(control_period))


def drive(robot, latency: float, delay: int, steps: int = 12):
    """True states, a row every half period of 20 ms, and the states that were planned from.

    A command takes effect `delay` half periods after the state was observed.
    """
    controller = LatencyCompensation(Noted(robot, jnp.asarray(0.02)), latency)
    half = jnp.asarray(0.01)
    step, move = eqx.filter_jit(controller.step), eqx.filter_jit(robot.step)
    state, truth = controller.init(), jnp.asarray(START, jnp.float32)
    commands, states, asked = [robot.default_control] * delay, [truth], []
    for key in jax.random.split(jax.random.key(0), steps):
        control, state, _ = step(state, truth, key=key)
        asked.append(state.controller[0])
        commands += [control] * 2
        for _ in range(2):
            truth = move(truth, commands[len(states) - 1], half)
            states.append(truth)
    return np.asarray(states), np.asarray(asked)


@pytest.mark.parametrize(("latency", "delay"), [(0.0, 0), (0.06, 6), (0.15, 15), (0.01, 1)])
def test_it_plans_from_the_state_in_which_its_command_takes_effect(latency, delay) -> None:
    states, asked = drive(ROBOT, latency, delay)
    reached = states[delay::2]
    np.testing.assert_allclose(asked[: len(reached)], reached[: len(asked)], atol=3e-6)
    # Something moved: the prediction is not the observation.
    assert delay == 0 or np.abs(asked[-1] - states[-3]).max() > 1e-3


def test_its_queue_has_as_many_commands_as_are_on_their_way() -> None:
    mppi = MPPI(ROBOT, GoalCost([3.0, 0.0]), horizon=5, num_samples=8, noise_std=[1.0, 1.0], dt=0.1)
    for latency, period, number in [
        (0.06, 0.02, 3),
        (0.15, 0.02, 8),
        (0.0, 0.02, 0),
        (0.1, 0.1, 1),
        (0.3, 0.1, 3),
    ]:
        controller = LatencyCompensation(mppi, latency).at_period(period)
        assert controller.num_pending == number
        assert controller.init().commands.shape == (number, 2)
        assert float(controller.controller.control_period) == np.float32(period)
    assert controller.member_names == ()


def test_it_is_a_controller_like_any_other() -> None:
    mppi = MPPI(ROBOT, GoalCost([3.0, 0.0]), horizon=5, num_samples=8, noise_std=[1.0, 1.0], dt=0.1)
    late = LatencyCompensation(mppi, 0.2)
    step, inspect = eqx.filter_jit(late.step), eqx.filter_jit(late.inspect)
    state, key = late.init(), jax.random.key(1)
    pending = jnp.asarray(CONTROLS[:2], jnp.float32)
    state = LatencyState(state.controller, pending)
    start = jnp.asarray(START, jnp.float32)
    ahead = predict(ROBOT, start, pending, jnp.full((2,), 0.1), 0.1)
    control, after, info = step(state, start, key=key)
    expected, _, of_inner = eqx.filter_jit(mppi.step)(mppi.init(), ahead, key=key)
    np.testing.assert_allclose(control, expected, atol=1e-5)
    np.testing.assert_allclose(info.costs, of_inner.costs, rtol=1e-5)
    np.testing.assert_array_equal(after.commands, [pending[1], control])
    plan = inspect(state, start, key=key, num_trajectories=4)
    np.testing.assert_allclose(plan.nominal.states[0], ahead, atol=1e-6)


def test_moving_obstacles_are_predicted_to_the_same_time(empty_belief) -> None:
    known = Obstacles(Outlines.discs([[1.0, 2.0]], [0.3]), [[0.5, -0.2]])
    belief = dataclasses.replace(empty_belief, obstacles=known)
    late = LatencyCompensation(Noted(ROBOT, jnp.asarray(0.02)), 0.2)
    _, state, _ = late.step(
        late.init(), jnp.asarray(START, jnp.float32), belief, key=jax.random.key(0)
    )
    np.testing.assert_allclose(state.controller[1].obstacles.centres, [[1.1, 1.96]], atol=1e-6)
    np.testing.assert_allclose(belief.obstacles.centres, [[1.0, 2.0]])


def test_bad_input_is_named() -> None:
    noted = Noted(ROBOT, jnp.asarray(0.02))
    with pytest.raises(ValueError, match=r"^control_period is None; accepted: the time between"):
        LatencyCompensation(eqx.tree_at(lambda at: at.control_period, noted, None), 0.1)
    with pytest.raises(ValueError, match=r"^latency or control_period is traced; accepted: num"):
        jax.jit(lambda latency: LatencyCompensation(noted, latency).latency)(0.1)
