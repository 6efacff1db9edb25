"""What the guard expects of the robot, one period at a time; its closed loops are in
simulation/test_guard.py."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, MotionGuard
from jaxplore.control.guard import FROZEN, GOOD

ROBOT = DifferentialDrive(max_speed=1.0)
PERIOD = jnp.asarray(0.05)
GUARD = MotionGuard(max_delay=4)
expect = eqx.filter_jit(
    lambda state, control: GUARD.moved(ROBOT, state, state.expected, control, PERIOD)
)
step = eqx.filter_jit(ROBOT.step)
COMMANDS = np.array([[0.1, -1.0], [0.3, 0.5], [-0.2, 1.5], [0.5, -0.4], [0.7, 0.9]], np.float32)
"""Sent before, the newest last."""
START = np.array([1.0, 2.0, 0.4, 0.6, 0.3], np.float32)


def after_commands(delay: int, stop: int):
    """The state of a guard to which a delay of so many periods explains the motion best."""
    state = GUARD.init(ROBOT, jnp.asarray(START))
    errors = np.ones(5, np.float32)
    errors[delay] = 0.0
    return state._replace(
        commands=jnp.asarray(COMMANDS),
        errors=jnp.asarray(errors),
        stop=jnp.asarray(stop, jnp.int32),
    )


@pytest.mark.parametrize("delay", range(5))
def test_the_robot_moves_by_the_command_that_is_due(delay: int) -> None:
    """The command sent `delay` periods before the newest takes effect now."""
    after = expect(after_commands(delay, GOOD), jnp.zeros(2))
    wanted = np.asarray(step(jnp.asarray(START), jnp.asarray(COMMANDS[4 - delay]), PERIOD))
    np.testing.assert_array_equal(after.expected, wanted)
    turn = (wanted[:3] - START[:3]) / 0.05
    np.testing.assert_allclose(after.velocity, turn, atol=1e-4)
    others = [step(jnp.asarray(START), jnp.asarray(each), PERIOD) for each in COMMANDS]
    assert sum(np.array_equal(after.expected, each) for each in others) == 1


def test_a_stopped_robot_moves_by_its_braking() -> None:
    braking = jnp.asarray([-1.0, 0.2])
    after = expect(after_commands(2, FROZEN), braking)
    np.testing.assert_array_equal(after.expected, step(jnp.asarray(START), braking, PERIOD))
