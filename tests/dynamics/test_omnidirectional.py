import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import RK4, Omnidirectional, State

EXACT = Omnidirectional(
    max_speed=2.0, min_speed=-1.0, max_turn_rate=1.5, drag=0.0, integrator=RK4()
)


def test_held_velocities_drive_a_circle_sideways(fly) -> None:
    # The velocity turns with the body: a circle of radius |v| / omega around a point beside it.
    vx, vy, omega, yaw = 0.6, -0.8, 0.5, 0.7
    steps = 200
    dt = math.tau / omega / steps
    states = fly(EXACT, [1.0, -2.0, yaw, vx, vy, omega], np.zeros((steps, 3)), dt)
    heading = yaw + math.atan2(vy, vx)
    radius = math.hypot(vx, vy) / omega
    centre = np.array([1.0 - radius * math.sin(heading), -2.0 + radius * math.cos(heading)])
    np.testing.assert_allclose(np.hypot(*(states[:, :2] - centre).T), radius, atol=2e-5)
    np.testing.assert_allclose(states[-1, :2], [1.0, -2.0], atol=2e-4)
    assert states[-1, 2] == pytest.approx(yaw + math.tau, abs=1e-4)


def test_it_strafes_without_a_turn(fly) -> None:
    states = fly(EXACT, [0.0, 0.0, 0.3, 0.0, 0.5, 0.0], np.zeros((100, 3)), 0.05)
    along = 0.5 * 0.05 * np.arange(1, 101)
    np.testing.assert_allclose(states[:, 0], -math.sin(0.3) * along, atol=1e-5)
    np.testing.assert_allclose(states[:, 1], math.cos(0.3) * along, atol=1e-5)
    np.testing.assert_array_equal(states[:, 2], np.float32(0.3))


def test_drive(fly, solve) -> None:
    def drive(state, control):
        _, _, yaw, vx, vy, omega = state
        return np.array(
            [
                vx * np.cos(yaw) - vy * np.sin(yaw),
                vx * np.sin(yaw) + vy * np.cos(yaw),
                omega,
                control[0] - 0.3 * vx,
                control[1] - 0.3 * vy,
                control[2] - 0.3 * omega,
            ]
        )

    start = [1.0, -2.0, 0.7, 0.6, 0.1, -0.2]
    controls = np.random.default_rng(0).uniform(-0.5, [0.8, 0.5, 0.5], (60, 3))
    exact = solve(drive, start, controls, 0.05)
    robot = Omnidirectional(max_speed=2.0, min_speed=-1.0, drag=0.3, integrator=RK4())
    np.testing.assert_allclose(fly(robot, start, controls, 0.05), exact, atol=2e-5)


def test_speeds_stop_at_their_bounds(fly) -> None:
    robot = Omnidirectional(1.5, 1.2, min_speed=-0.4, max_lateral_speed=0.7)
    reached = fly(robot, np.zeros(6), np.tile([1.0, 1.0, 2.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.max(axis=0), [1.5, 0.7, 1.2], rtol=1e-6)
    reached = fly(robot, np.zeros(6), np.tile([-1.0, -1.0, -2.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.min(axis=0), [-0.4, -0.7, -1.2], rtol=1e-6)
    forwards = fly(Omnidirectional(), np.zeros(6), np.tile([-1.0, 0.0, 0.0], (100, 1)), 0.05)
    np.testing.assert_array_equal(forwards[:, :2], 0.0)


BRAKED = Omnidirectional(
    max_speed=2.0, min_speed=-2.0, max_acceleration=1.0, max_deceleration=4.0, drag=0.0
)
STEP = eqx.filter_jit(BRAKED.step)


@given(
    st.lists(st.floats(-2.0, 2.0, width=32), min_size=2, max_size=2),
    st.lists(st.floats(-6.0, 6.0, width=32), min_size=2, max_size=2),
)
def test_each_axis_speeds_up_and_brakes_within_its_bounds(speeds, accelerations) -> None:
    before = jnp.asarray([0.0, 0.0, 0.4, *speeds, 0.1], jnp.float32)
    after = STEP(before, jnp.asarray([*accelerations, 0.0], jnp.float32), jnp.asarray(0.1))
    for v, reached in zip(speeds, np.asarray(after, np.float64)[3:5], strict=True):
        grown = math.copysign(1.0, v) * (reached - v)
        to_zero = min(abs(v) / 4.0, 0.1)
        assert -4.0 * to_zero - 1.0 * (0.1 - to_zero) - 1e-5 <= grown <= 0.1 + 1e-5


def test_it_brakes_along_a_line() -> None:
    start = jnp.asarray([0.0, 0.0, 0.0, 1.0, -0.4, 0.0])
    state = start
    for _ in range(3):
        control = BRAKED.stopping_control(state, jnp.asarray(0.05))
        state = STEP(state, control, jnp.asarray(0.05))
        assert float(state[4] / state[3]) == pytest.approx(-0.4, rel=1e-4)
    assert float(state[3]) == pytest.approx(1.0 - 3 * 0.05 * 4.0, abs=1e-5)


def test_state_is_read_by_name_and_both_axes_are_speed() -> None:
    state = State(jnp.asarray([1.0, 2.0, 0.5, 0.3, -0.4, 0.1]), EXACT)
    np.testing.assert_array_equal(state.position, [1.0, 2.0])
    assert float(state.heading) == 0.5
    assert float(state.speed) == pytest.approx(0.5)
    assert float(state["vy"]) == pytest.approx(-0.4)
    at_rest = EXACT.at_pose(1.0, 2.0, 0.5)
    blocked = EXACT.resolve_collision(at_rest, jnp.asarray([1.1, 2.1, 0.6, 0.7, 0.3, 0.2]))
    np.testing.assert_allclose(blocked, [1.0, 2.0, 0.6, 0.0, 0.0, 0.2])
