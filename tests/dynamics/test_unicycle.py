import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Euler, State, Unicycle

ROBOT = Unicycle()
ANGLE = st.floats(-4, 4, width=32)
_step = eqx.filter_jit(ROBOT.step)


def arc(state, control, duration: float) -> list[float]:
    """Where a circular arc ends, in closed form."""
    x, y, yaw = state
    v, omega = control
    radius, end = v / omega, yaw + omega * duration
    return [
        x + radius * (math.sin(end) - math.sin(yaw)),
        y - radius * (math.cos(end) - math.cos(yaw)),
        end,
    ]


@given(
    st.tuples(ANGLE, ANGLE, ANGLE),
    st.floats(-2, 2, width=32),
    st.floats(0.25, 2, width=32),
    st.sampled_from([-1.0, 1.0]),
)
def test_a_step_is_an_arc(state, v: float, turn_rate: float, side: float) -> None:
    control = (v, side * turn_rate)
    found = _step(jnp.asarray(state), jnp.asarray(control), jnp.asarray(0.1))
    np.testing.assert_allclose(found, arc(state, control, 0.1), atol=2e-6)


@given(ANGLE, st.floats(-2, 2, width=32))
def test_without_turning_it_goes_straight(yaw: float, v: float) -> None:
    found = _step(jnp.asarray([0.0, 0.0, yaw]), jnp.asarray([v, 0.0]), jnp.asarray(0.5))
    expected = [0.5 * v * math.cos(yaw), 0.5 * v * math.sin(yaw), yaw]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_drive_of_arcs(fly) -> None:
    controls = np.random.default_rng(0).uniform([-1.0, 0.3], [2.0, 2.0], (100, 2))
    expected = [np.array([1.0, 2.0, -0.5])]
    for control in controls:
        expected.append(np.array(arc(expected[-1], control, 0.05)))
    found = fly(ROBOT, expected[0], controls, 0.05)
    np.testing.assert_allclose(found, expected[1:], atol=2e-5)


def test_another_integrator(fly) -> None:
    found = fly(Unicycle(integrator=Euler()), [0.0, 0.0, 0.0], [[1.0, 2.0]] * 2, 0.5)
    expected = [[0.5, 0.0, 1.0], [0.5 + 0.5 * math.cos(1.0), 0.5 * math.sin(1.0), 2.0]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_bounds_and_default() -> None:
    np.testing.assert_array_equal(ROBOT.control_min, [0.0, -2.0])
    np.testing.assert_array_equal(ROBOT.control_max, [1.0, 2.0])
    robot = Unicycle(max_speed=3.0, max_turn_rate=1.5, min_speed=-0.5)
    np.testing.assert_array_equal(robot.control_min, [-0.5, -1.5])
    np.testing.assert_array_equal(robot.control_max, [3.0, 1.5])
    np.testing.assert_array_equal(robot.default_control, [0.0, 0.0])
    # A robot that cannot stop is left to go as slowly as it can.
    np.testing.assert_array_equal(Unicycle(min_speed=0.5).default_control, [0.5, 0.0])


def test_state_is_read_by_name() -> None:
    state = State(jnp.asarray([1.0, 2.0, 0.5]), ROBOT)
    np.testing.assert_array_equal(state.position, [1.0, 2.0])
    assert float(state.heading) == 0.5
    assert float(state.speed) == 0.0
    assert float(State(state.values, ROBOT, jnp.asarray([0.7, -0.3])).speed) == np.float32(0.7)
    with pytest.raises(ValueError, match="no state component 'v'; accepted: x, y, yaw"):
        state["v"]
