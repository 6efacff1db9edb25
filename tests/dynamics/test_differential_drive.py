import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import RK4, DifferentialDrive, Euler, State

ROBOT = DifferentialDrive(max_speed=1.5, max_turn_rate=1.2, drag=0.3)


@given(
    st.lists(st.floats(-3, 3, width=32), min_size=5, max_size=5),
    st.lists(st.floats(-2, 2, width=32), min_size=2, max_size=2),
    st.floats(0.0078125, 0.25, width=32),
)
def test_step_is_the_seed_s_formula(state, control, dt: float) -> None:
    x, y, yaw, v, omega = state
    a, alpha = control
    expected = [
        x + v * math.cos(yaw) * dt,
        y + v * math.sin(yaw) * dt,
        yaw + omega * dt,
        min(max(v + (a - 0.3 * v) * dt, 0.0), 1.5),
        min(max(omega + (alpha - 0.3 * omega) * dt, -1.2), 1.2),
    ]
    found = ROBOT.step(jnp.asarray(state), jnp.asarray(control), jnp.asarray(dt))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_rk4_drives_the_exact_way(fly, solve) -> None:
    def drive(state, control):
        _, _, yaw, v, omega = state
        return np.array(
            [
                v * np.cos(yaw),
                v * np.sin(yaw),
                omega,
                control[0] - 0.3 * v,
                control[1] - 0.3 * omega,
            ]
        )

    start = [1.0, -2.0, 0.7, 0.6, -0.2]
    controls = np.random.default_rng(0).uniform(-0.5, [0.8, 0.5], (40, 2))
    exact = solve(drive, start, controls, 0.05)
    # Within the bounds all the way, where clipping changes nothing.
    assert 0.0 < exact[:, 3].min() < exact[:, 3].max() < 1.5
    assert np.abs(exact[:, 4]).max() < 1.2
    errors = {}
    for integrator in (Euler(), RK4()):
        robot = DifferentialDrive(1.5, 1.2, drag=0.3, integrator=integrator)
        errors[type(integrator)] = np.abs(fly(robot, start, controls, 0.05) - exact).max()
    assert errors[RK4] < 1e-5
    assert 1e-3 < errors[Euler] < 0.1


@pytest.mark.parametrize(("v", "omega"), [(1.0, 0.8), (0.4, -1.1), (1.5, 0.0)])
def test_held_speeds_drive_an_arc(v: float, omega: float, fly) -> None:
    robot = DifferentialDrive(1.5, 1.2, drag=0.0, integrator=RK4())
    x, y, yaw, speed, turn_rate = fly(robot, [1.0, -2.0, 0.7, v, omega], np.zeros((100, 2)), 0.05).T
    times = 0.05 * np.arange(1, 101)
    np.testing.assert_allclose(yaw, 0.7 + omega * times, atol=1e-5)
    # The chord of an arc: as long as it is turned less by half its angle.
    half = 0.5 * omega * times
    chord = v * times * np.sinc(half / math.pi)
    np.testing.assert_allclose(x, 1.0 + chord * np.cos(0.7 + half), rtol=1e-5, atol=2e-5)
    np.testing.assert_allclose(y, -2.0 + chord * np.sin(0.7 + half), rtol=1e-5, atol=2e-5)
    np.testing.assert_array_equal(speed, np.float32(v))
    np.testing.assert_array_equal(turn_rate, np.float32(omega))


def test_speeds_stop_at_their_bounds(fly) -> None:
    reached = fly(ROBOT, np.zeros(5), np.tile([1.0, 2.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.max(axis=0), [1.5, 1.2], rtol=1e-6)
    reached = fly(ROBOT, np.zeros(5), np.tile([-1.0, -2.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.min(axis=0), [0.0, -1.2], rtol=1e-6)


def test_state_is_read_by_name() -> None:
    state = State(jnp.asarray([1.0, 2.0, 0.5, 0.7, -0.1]), ROBOT)
    np.testing.assert_array_equal(state.position, [1.0, 2.0])
    assert float(state.heading) == 0.5
    assert float(state.speed) == pytest.approx(0.7)
    assert float(state["omega"]) == pytest.approx(-0.1)
    with pytest.raises(ValueError, match="no state component 'phi'; accepted: x, y, yaw"):
        state["phi"]


def test_pose_and_contact() -> None:
    at_rest = ROBOT.at_pose(1.0, 2.0, 0.5)
    np.testing.assert_array_equal(at_rest, [1.0, 2.0, 0.5, 0.0, 0.0])
    blocked = ROBOT.resolve_collision(at_rest, jnp.asarray([1.1, 2.1, 0.6, 0.7, 0.2]))
    np.testing.assert_allclose(blocked, [1.0, 2.0, 0.6, 0.0, 0.2])
