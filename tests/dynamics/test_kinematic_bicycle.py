import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, KinematicBicycle, State

FRONT, REAR = 0.3, 0.2
ROBOT = KinematicBicycle(
    FRONT, REAR, max_speed=2.0, max_steering=0.6, max_acceleration=3.0, min_speed=-1.0
)
_derivative = eqx.filter_jit(ROBOT.derivative)


def kong(state, control):
    """Kong et al., eq. 1: the yaw rate by the rear axle's distance."""
    _, _, yaw, v = state
    a, steering = control
    beta = np.arctan(REAR / (FRONT + REAR) * np.tan(steering))
    return np.array([v * np.cos(yaw + beta), v * np.sin(yaw + beta), v / REAR * np.sin(beta), a])


@given(
    st.tuples(*[st.floats(-3, 3, width=32)] * 3, st.floats(-0.875, 2, width=32)),
    st.tuples(st.floats(-2, 2, width=32), st.floats(-1.25, 1.25, width=32)),
)
def test_derivative_is_kong_s(state, control) -> None:
    found = _derivative(jnp.asarray(state), jnp.asarray(control))
    np.testing.assert_allclose(found, kong(state, control), atol=1e-5)


def test_drive(fly, solve) -> None:
    start = [1.0, -2.0, 0.7, 0.8]
    controls = np.random.default_rng(0).uniform([-0.6, -0.5], [0.7, 0.5], (60, 2))
    expected = solve(kong, start, controls, 0.05)
    assert 0.0 < expected[:, 3].min() < expected[:, 3].max() < 2.0
    np.testing.assert_allclose(fly(ROBOT, start, controls, 0.05), expected, atol=2e-5)


@pytest.mark.parametrize("steering", [-0.4, 0.25, 0.6])
def test_held_steering_drives_a_circle(steering: float, fly) -> None:
    # Both axles circle about one point, at the height of the rear axle.
    to_rear = (FRONT + REAR) / math.tan(steering)
    radius = math.hypot(REAR, to_rear)
    speed, steps = 1.0, 200
    period = 2 * math.pi * radius / speed
    x, y, yaw, _ = fly(
        ROBOT, [0.0, 0.0, 0.0, speed], np.tile([0.0, steering], (steps, 1)), period / steps
    ).T
    np.testing.assert_allclose(np.hypot(x + REAR, y - to_rear), radius, atol=2e-5)
    np.testing.assert_allclose([x[-1], y[-1]], 0.0, atol=1e-4)
    assert yaw[-1] == pytest.approx(math.copysign(2 * math.pi, steering), abs=1e-4)


@given(
    st.floats(-3, 3, width=32),
    st.floats(-0.875, 2, width=32),
    st.floats(-0.5625, 0.5625, width=32),
)
def test_no_wheel_slips(yaw: float, v: float, steering: float) -> None:
    state = jnp.asarray([0.3, -0.2, yaw, v])
    rate = _derivative(state, jnp.asarray([1.0, steering]))

    def axles(values):
        x, y, heading, _ = values
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        centre = jnp.stack([x, y])
        return centre + FRONT * ahead, centre - REAR * ahead

    _, (front, rear) = jax.jvp(axles, (state,), (rate,))
    for velocity, wheel in ((front, yaw + steering), (rear, yaw)):
        across = np.array([-np.sin(wheel), np.cos(wheel)])
        assert across @ np.asarray(velocity) == pytest.approx(0.0, abs=3e-6)
    assert np.hypot(*np.asarray(rate[:2])) == pytest.approx(abs(v), abs=1e-6)


def test_with_its_weight_on_the_rear_axle_it_is_an_ackermann_car(fly) -> None:
    steering, steps = 0.35, 80
    bicycle = KinematicBicycle(0.5, 1e-6)
    car = Ackermann(wheelbase=0.5)
    controls = np.random.default_rng(1).uniform(0.0, 0.5, steps)
    found = fly(bicycle, [0.0, 0.0, 0.2, 0.5], [[a, steering] for a in controls], 0.05)
    expected = fly(car, [0.0, 0.0, 0.2, 0.5, steering], [[a, 0.0] for a in controls], 0.05)
    np.testing.assert_allclose(found, expected[:, :4], atol=2e-5)


def test_speed_stops_at_its_bounds(fly) -> None:
    # At the bound, full acceleration gains nothing within a step either.
    states = fly(ROBOT, [0.0, 0.0, 0.0, 2.0], np.tile([3.0, 0.0], (40, 1)), 0.05)
    np.testing.assert_allclose(states[:, 0], 0.1 * np.arange(1, 41), rtol=1e-5)
    np.testing.assert_allclose(states[:, 3], 2.0)
    states = fly(ROBOT, [0.0, 0.0, 0.0, -1.0], np.tile([-3.0, 0.0], (40, 1)), 0.05)
    np.testing.assert_allclose(states[:, 0], -0.05 * np.arange(1, 41), rtol=1e-5)
    np.testing.assert_allclose(states[:, 3], -1.0)


def test_bounds_and_names() -> None:
    robot = KinematicBicycle(max_acceleration=1.5, max_steering=0.3)
    np.testing.assert_allclose(robot.control_max, [1.5, 0.3])
    np.testing.assert_allclose(robot.control_min, [-1.5, -0.3])
    state = State(jnp.asarray([1.0, 2.0, 0.5, -0.7]), ROBOT)
    np.testing.assert_array_equal(state.position, [1.0, 2.0])
    assert float(state.heading) == 0.5
    assert float(state.speed) == pytest.approx(-0.7)
