"""Commands that take effect late."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxplore import RK4, DifferentialDrive
from jaxplore.control import predicted_state

ROBOT = DifferentialDrive(integrator=RK4(), drag=0.3)
START = np.array([1.0, -2.0, 0.7, 0.5, 0.2])
CONTROLS = np.array([[0.5, -1.0], [0.3, 0.8], [-0.2, 0.4], [0.1, 0.1]])
predict = eqx.filter_jit(predicted_state)


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
