import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import PointMass, State

every_dimension = pytest.mark.parametrize("dimensions", [1, 2, 3])


@every_dimension
def test_names_and_bounds(dimensions: int) -> None:
    robot = PointMass(dimensions, max_acceleration=1.5)
    names = "xyz"[:dimensions]
    assert robot.state_names == (*names, *(f"v{name}" for name in names))
    assert robot.control_names == tuple(f"a{name}" for name in names)
    assert (robot.state_size, robot.control_size) == (2 * dimensions, dimensions)
    np.testing.assert_array_equal(robot.control_max, [1.5] * dimensions)
    np.testing.assert_array_equal(robot.control_min, [-1.5] * dimensions)
    each = np.arange(1.0, dimensions + 1)
    np.testing.assert_array_equal(PointMass(dimensions, max_acceleration=each).control_min, -each)


@every_dimension
@pytest.mark.parametrize("drag", [0.0, 0.8])
def test_flight_in_closed_form(dimensions: int, drag: float, fly) -> None:
    rng = np.random.default_rng(dimensions)
    p, v, a = rng.normal(size=(3, dimensions))
    t = 0.1 * np.arange(1, 31)[:, None]
    if drag == 0.0:
        expected = [p + v * t + a * t**2 / 2, v + a * t]
    else:
        fading = np.exp(-drag * t)
        limit = a / drag
        expected = [p + limit * t + (v - limit) * (1 - fading) / drag, limit + (v - limit) * fading]
    robot = PointMass(dimensions, max_acceleration=5.0, drag=drag)
    found = fly(robot, np.concatenate([p, v]), np.tile(a, (30, 1)), 0.1)
    np.testing.assert_allclose(found, np.concatenate(expected, axis=1), atol=3e-5)


@given(st.lists(st.floats(-4, 4, width=32), min_size=6, max_size=6))
def test_velocity_is_shortened_not_turned(state) -> None:
    position, velocity = np.split(np.array(state), 2)
    length = np.linalg.norm(velocity)
    expected = velocity * min(1.0, 1.5 / length) if length > 0 else velocity
    found = PointMass(3, max_speed=1.5).project(jnp.asarray(state))
    np.testing.assert_array_equal(found[:3], position)
    np.testing.assert_allclose(found[3:], expected, atol=1e-6)
    np.testing.assert_array_equal(PointMass(3).project(jnp.asarray(state)), state)


def test_at_its_greatest_speed_it_gains_none_within_a_step(fly) -> None:
    robot = PointMass(2, max_speed=2.0, max_acceleration=3.0)
    direction = np.array([0.6, 0.8])
    states = fly(robot, [0.0, 0.0, 1.2, 1.6], np.tile(3.0 * direction, (40, 1)), 0.05)
    expected = 0.1 * np.arange(1, 41)[:, None] * direction
    np.testing.assert_allclose(states[:, :2], expected, rtol=1e-5)
    np.testing.assert_allclose(states[:, 2:], np.tile(2.0 * direction, (40, 1)), rtol=1e-5)


@every_dimension
def test_position_heading_and_speed(dimensions: int) -> None:
    robot = PointMass(dimensions)
    place, velocity = np.array([1.0, 2.0, 3.0]), np.array([-0.3, 0.4, 1.2])
    values = np.concatenate([place[:dimensions], velocity[:dimensions]])
    state = State(jnp.asarray(values), robot)
    np.testing.assert_array_equal(state.position, [1.0, 2.0 if dimensions > 1 else 0.0])
    heading = math.atan2(0.4, -0.3) if dimensions > 1 else math.pi
    assert float(state.heading) == pytest.approx(heading)
    assert float(state.speed) == pytest.approx({1: 0.3, 2: 0.5, 3: 1.3}[dimensions])


@every_dimension
def test_at_rest_heading_and_speed_are_0_and_flat(dimensions: int) -> None:
    robot = PointMass(dimensions)
    for read in (robot.heading, robot.speed):
        value, gradient = jax.value_and_grad(read)(jnp.zeros(2 * dimensions))
        assert float(value) == 0.0
        np.testing.assert_array_equal(gradient, 0.0)


def test_gradients_of_heading_and_speed_in_motion() -> None:
    robot, state = PointMass(2), jnp.asarray([0.0, 0.0, 3.0, 4.0])
    np.testing.assert_allclose(jax.grad(robot.speed)(state), [0, 0, 0.6, 0.8], rtol=1e-6)
    np.testing.assert_allclose(jax.grad(robot.heading)(state), [0, 0, -0.16, 0.12], rtol=1e-6)


def test_it_has_no_yaw_to_be_placed_at() -> None:
    np.testing.assert_array_equal(PointMass(2).at_pose(1.0, 2.0, 0.5), [1.0, 2.0, 0.0, 0.0])
    np.testing.assert_array_equal(PointMass(1).at_pose(1.0, 2.0, 0.5), [1.0, 0.0])
    np.testing.assert_array_equal(PointMass(3).at_pose(1.0, 2.0, 0.5), [1.0, 2.0, 0, 0, 0, 0])


@pytest.mark.parametrize("dimensions", [0, 4, -1, True])
def test_dimensions_are_named(dimensions: object) -> None:
    with pytest.raises(ValueError, match=f"^dimensions is {dimensions}; accepted: 1, 2 or 3$"):
        PointMass(dimensions)


@pytest.mark.parametrize("value", [[1.0], [1.0, 2.0, 3.0]])
def test_accelerations_are_named(value: list[float]) -> None:
    with pytest.raises(ValueError, match=r"^max_acceleration is \[.*one positive number, or 2$"):
        PointMass(2, max_acceleration=value)
