import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, State
from jaxplore.geometry.footprint import Disc, Rectangle

ROBOT = Ackermann(
    wheelbase=0.5, max_speed=2.0, max_steering=0.6, min_speed=-1.0, drag=0.3, max_acceleration=3.0
)


def car(state, control, wheelbase: float = 0.5, drag: float = 0.3):
    _, _, yaw, v, steering = state
    a, steering_rate = control
    return np.array(
        [
            v * np.cos(yaw),
            v * np.sin(yaw),
            v / wheelbase * np.tan(steering),
            a - drag * v,
            steering_rate,
        ]
    )


def test_drive(fly, solve) -> None:
    start = [1.0, -2.0, 0.7, 0.4, 0.1]
    controls = np.random.default_rng(0).uniform([-0.6, -0.5], [0.8, 0.5], (60, 2))
    expected = solve(car, start, controls, 0.05)
    # Within the bounds all the way: what happens at them is tested below.
    assert expected[:, 3].min() > 0.0
    assert np.abs(expected[:, 4]).max() < 0.6
    np.testing.assert_allclose(fly(ROBOT, start, controls, 0.05), expected, atol=2e-5)


@pytest.mark.parametrize("steering", [-0.4, 0.25, 0.6])
def test_held_steering_drives_a_circle(steering: float, fly) -> None:
    radius = 0.5 / math.tan(steering)
    speed, steps = 1.0, 200
    period = 2 * math.pi * abs(radius) / speed
    robot = Ackermann(wheelbase=0.5, max_steering=0.6)
    x, y, yaw, v, held = fly(
        robot, [0.0, 0.0, 0.0, speed, steering], np.zeros((steps, 2)), period / steps
    ).T
    np.testing.assert_allclose(np.hypot(x, y - radius), abs(radius), atol=2e-5)
    np.testing.assert_allclose([x[-1], y[-1]], 0.0, atol=1e-4)
    assert yaw[-1] == pytest.approx(math.copysign(2 * math.pi, steering), abs=1e-4)
    np.testing.assert_allclose(v, speed)
    np.testing.assert_allclose(held, steering, rtol=1e-6)


@given(
    st.floats(-3, 3, width=32),
    st.floats(-0.875, 2, width=32),
    st.floats(-0.5625, 0.5625, width=32),
)
def test_no_wheel_slips(yaw: float, v: float, steering: float) -> None:
    # The middles of both axles, from where they are: neither moves across its wheels.
    state = jnp.asarray([0.3, -0.2, yaw, v, steering])
    rate = _derivative(state, jnp.asarray([1.0, 0.2]))

    def front(values):
        x, y, heading, _, _ = values
        return jnp.stack([x + 0.5 * jnp.cos(heading), y + 0.5 * jnp.sin(heading)])

    _, velocity = jax.jvp(front, (state,), (rate,))
    across = np.array([-np.sin(yaw + steering), np.cos(yaw + steering)])
    assert across @ np.asarray(velocity) == pytest.approx(0.0, abs=2e-6)
    assert np.array([-np.sin(yaw), np.cos(yaw)]) @ np.asarray(rate[:2]) == pytest.approx(
        0.0, abs=1e-6
    )
    assert np.array([np.cos(yaw), np.sin(yaw)]) @ np.asarray(rate[:2]) == pytest.approx(v, abs=1e-6)


_derivative = eqx.filter_jit(ROBOT.derivative)


def test_drag_takes_its_share(fly) -> None:
    times = 0.1 * np.arange(1, 51)
    states = fly(ROBOT, [0.0, 0.0, 0.0, 1.5, 0.0], np.zeros((50, 2)), 0.1)
    np.testing.assert_allclose(states[:, 3], 1.5 * np.exp(-0.3 * times), atol=1e-5)
    np.testing.assert_allclose(states[:, 0], 5.0 * (1 - np.exp(-0.3 * times)), atol=1e-5)


def test_at_its_bounds_it_drives_as_fast_and_as_tight_as_they_say(fly) -> None:
    # Full acceleration and steering rate on top: nothing is gained within a step either.
    steps, dt = 20, 0.1
    start = [0.0, 0.0, 0.0, 2.0, 0.6]
    states = fly(ROBOT, start, np.tile([3.0, 3.0], (steps, 1)), dt)
    turn_rate = 2.0 * math.tan(0.6) / 0.5
    angle = turn_rate * dt * np.arange(1, steps + 1)
    np.testing.assert_allclose(states[:, 2], angle, rtol=1e-5)
    np.testing.assert_allclose(states[:, 3:], np.tile([2.0, 0.6], (steps, 1)), rtol=1e-6)
    radius = 2.0 / turn_rate
    circle = np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle))], axis=-1)
    np.testing.assert_allclose(states[:, :2], circle, atol=1e-3)  # RK4 at 0.27 rad a step


def test_speed_and_steering_stop_at_their_bounds(fly) -> None:
    reached = fly(ROBOT, np.zeros(5), np.tile([3.0, 3.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.max(axis=0), [2.0, 0.6], rtol=1e-6)
    reached = fly(ROBOT, np.zeros(5), np.tile([-3.0, -3.0], (100, 1)), 0.05)[:, 3:]
    np.testing.assert_allclose(reached.min(axis=0), [-1.0, -0.6], rtol=1e-6)
    forwards_only = fly(Ackermann(), np.zeros(5), np.tile([-2.0, 0.0], (100, 1)), 0.05)
    np.testing.assert_array_equal(forwards_only, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_random_controls_never_lead_beyond_the_bounds(seed: int, fly) -> None:
    robot = Ackermann(min_speed=-1.5, drag=0.2)
    # Twice the bounds of the controls: the state's hold whatever it is told.
    low, high = 2.0 * np.asarray(robot.control_min), 2.0 * np.asarray(robot.control_max)
    # Held for 20 steps each, so that the bounds are reached.
    controls = np.repeat(np.random.default_rng(seed).uniform(low, high, (50, 2)), 20, axis=0)
    states = fly(robot, robot.at_pose(0.0, 0.0, 1.0), controls, 0.1)
    v, steering = states[:, 3], states[:, 4]
    assert v.min() >= -1.5
    assert v.max() <= 5.0
    assert np.abs(steering).max() <= np.float32(0.6)
    assert (v == -1.5).any()
    assert (v == 5.0).any()
    assert (steering == np.float32(0.6)).any()
    assert (steering == -np.float32(0.6)).any()


def test_the_default_is_the_seed_s_car() -> None:
    robot = Ackermann()
    for name, value in {
        "wheelbase": 0.5,
        "min_speed": 0.0,
        "max_speed": 5.0,
        "max_steering": 0.6,
        "drag": 0.0,
    }.items():
        assert float(getattr(robot, name)) == np.float32(value)
    np.testing.assert_array_equal(robot.control_max, [2.0, 1.0])


@pytest.mark.parametrize("wheelbase", [0.5, 0.33, 2.7])
def test_it_is_a_rectangle_of_its_wheelbase(wheelbase: float) -> None:
    robot = Ackermann(wheelbase)
    outline = robot.footprint
    assert isinstance(outline, Rectangle)
    # 0.75 m x 0.4 m at 0.5 m, an eighth of a metre before and behind the axles.
    scale = wheelbase / 0.5
    found = [outline.front, outline.rear, outline.width]
    np.testing.assert_allclose(found, scale * np.array([0.625, 0.125, 0.4]), rtol=1e-6)
    assert outline.num_discs == 2
    np.testing.assert_allclose(outline.offsets, scale * np.array([0.0625, 0.4375]), rtol=1e-5)
    assert float(robot.radius) == pytest.approx(scale * math.hypot(0.1875, 0.2), rel=1e-6)


def test_another_footprint() -> None:
    assert float(Ackermann(footprint=Disc(0.4)).radius) == np.float32(0.4)
    long = Ackermann(footprint=Rectangle(1.5, 0.3, 0.8, num_discs=3))
    np.testing.assert_allclose(long.footprint.offsets, [0.0, 0.6, 1.2], atol=1e-6)
    assert float(long.radius) == pytest.approx(0.5)


def test_bounds_and_names() -> None:
    robot = Ackermann(max_acceleration=1.5, max_steering_rate=0.8)
    np.testing.assert_allclose(robot.control_max, [1.5, 0.8])
    np.testing.assert_allclose(robot.control_min, [-1.5, -0.8])
    np.testing.assert_array_equal(robot.default_control, [0.0, 0.0])
    state = State(jnp.asarray([1.0, 2.0, 0.5, -0.7, 0.1]), ROBOT)
    assert float(state.heading) == 0.5
    assert float(state.speed) == pytest.approx(-0.7)
    assert float(state["steering"]) == pytest.approx(0.1)
    blocked = ROBOT.resolve_collision(
        robot.at_pose(1.0, 2.0, 0.5), jnp.asarray([1.1, 2.1, 0.6, 0.7, 0.2])
    )
    # A rectangle that turned on the spot would turn into what it touches.
    np.testing.assert_allclose(blocked, [1.0, 2.0, 0.5, 0.0, 0.2])


@pytest.mark.parametrize(("speed", "turn"), [(1.0, 0.5), (1.0, -1.0), (-0.8, 0.5), (1.0, 0.1)])
def test_a_car_that_stops_steers_to_a_share_of_its_greatest_angle(speed, turn) -> None:
    """By what its steering may turn in a period; backwards the other way, as it turns then."""
    dt, steering = 0.1, 0.15
    state = jnp.asarray([0.0, 0.0, 0.3, speed, steering], jnp.float32)
    _, rate = ROBOT.stopping_control(state, jnp.float32(dt), turn)
    most = float(ROBOT.control_max[1])
    wanted = (math.copysign(1.0, speed) * turn * 0.6 - steering) / dt
    assert abs(wanted) > 0.5
    assert float(rate) == pytest.approx(max(-most, min(most, wanted)), rel=1e-5)
