import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Pendulum

MASS, LENGTH, GRAVITY = 0.8, 0.6, 9.81
ROBOT = Pendulum(MASS, LENGTH, GRAVITY, max_torque=3.0, max_rate=20.0)
_derivative = eqx.filter_jit(ROBOT.derivative)


def rod(state, control):
    """Euler's equation of a uniform rod about its end, the angle counted from upright."""
    angle, rate = state
    inertia = MASS * LENGTH**2 / 3
    return np.array([rate, (MASS * GRAVITY * LENGTH / 2 * np.sin(angle) + control[0]) / inertia])


def energy(angle, rate):
    return MASS * LENGTH**2 / 3 * rate**2 / 2 + MASS * GRAVITY * LENGTH / 2 * np.cos(angle)


@given(st.tuples(*[st.floats(-7, 7, width=32)] * 2), st.floats(-3, 3, width=32))
def test_derivative_is_that_of_a_rod(state, torque: float) -> None:
    found = _derivative(jnp.asarray(state), jnp.asarray([torque]))
    np.testing.assert_allclose(found, rod(state, [torque]), atol=2e-5)


@given(st.tuples(*[st.floats(-7, 7, width=32)] * 2), st.floats(-2, 2, width=32))
def test_default_is_gymnasium_s(state, torque: float) -> None:
    # Its code, "g=10.0, m=1.0, l=1.0", as published: envs/classic_control/pendulum.py.
    th, thdot = state
    g, m, l, u = 10.0, 1.0, 1.0, torque  # noqa: E741
    found = Pendulum().derivative(jnp.asarray(state), jnp.asarray([torque]))
    expected = [thdot, 3 * g / (2 * l) * math.sin(th) + 3.0 / (m * l**2) * u]
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_swing(fly, solve) -> None:
    torques = np.random.default_rng(0).uniform(-3.0, 3.0, (60, 1))
    start = [2.5, -1.0]
    expected = solve(rod, start, torques, 0.02)
    np.testing.assert_allclose(fly(ROBOT, start, torques, 0.02), expected, atol=2e-4)


def test_without_torque_it_keeps_its_energy(fly) -> None:
    angle, rate = fly(ROBOT, [0.4, 2.0], np.zeros((500, 1)), 0.01).T
    assert np.ptp(rate) > 5.0
    np.testing.assert_allclose(energy(angle, rate), energy(0.4, 2.0), atol=2e-4)


def test_period_of_small_swings(fly) -> None:
    period = 2 * math.pi * math.sqrt(2 * LENGTH / (3 * GRAVITY))
    angle, rate = fly(ROBOT, [math.pi + 0.01, 0.0], np.zeros((200, 1)), period / 200).T
    assert angle[-1] - math.pi == pytest.approx(0.01, abs=1e-5)
    assert angle[99] - math.pi == pytest.approx(-0.01, abs=1e-5)
    assert rate[49] == pytest.approx(-0.01 * 2 * math.pi / period, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi, 4.0])
def test_a_torque_against_gravity_holds_it(angle: float, fly) -> None:
    torque = -MASS * GRAVITY * LENGTH / 2 * math.sin(angle)
    held = fly(ROBOT, [angle, 0.0], np.full((10, 1), torque), 0.02)
    np.testing.assert_allclose(held, np.tile([angle, 0.0], (10, 1)), atol=1e-5)


def test_rate_stops_at_its_bound(fly) -> None:
    robot = Pendulum(max_rate=1.5)
    angle, rate = fly(robot, [0.5, 1.5], np.full((20, 1), 2.0), 0.05).T
    np.testing.assert_allclose(rate, 1.5)
    # Nor does it turn farther within a step.
    np.testing.assert_allclose(angle, 0.5 + 0.075 * np.arange(1, 21), rtol=1e-6)


def test_it_is_no_vehicle() -> None:
    for read, name in ((ROBOT.position, "x"), (ROBOT.heading, "yaw"), (ROBOT.speed, "v")):
        with pytest.raises(ValueError, match=f"Pendulum .*'{name}'; accepted: angle, rate"):
            read(jnp.zeros(2))
    with pytest.raises(ValueError, match=r"^pose is \(1\.0, 2\.0, 0\.5\), .*; accepted: a state"):
        ROBOT.at_pose(1.0, 2.0, 0.5)
    np.testing.assert_array_equal(ROBOT.resolve_collision(jnp.zeros(2), jnp.ones(2)), jnp.ones(2))


def test_bounds() -> None:
    np.testing.assert_array_equal(ROBOT.control_max, [3.0])
    np.testing.assert_array_equal(ROBOT.control_min, [-3.0])
    assert float(ROBOT.radius) == pytest.approx(LENGTH)
