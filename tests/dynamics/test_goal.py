"""Goals: when one is reached, and how far a robot still goes before it stands."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.dynamics.goal import STANDING, Goal, Motion

CAR = {"max_speed": 3.0, "max_acceleration": 1.5}
ROBOTS = {
    "differential drive": jx.DifferentialDrive(drag=0.0),
    "weak brakes": jx.DifferentialDrive(max_acceleration=0.3, drag=0.0),
    "brakes that differ": jx.DifferentialDrive(max_deceleration=0.4, drag=0.0),
    "car": jx.Ackermann(**CAR, min_speed=-1.0, max_deceleration=0.7, drag=0.0),
    "bicycle": jx.KinematicBicycle(**CAR),
    "omnidirectional": jx.Omnidirectional(drag=0.0),
}
near = st.floats(-0.4, 0.4)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_deceleration_is_that_of_the_hardest_braking(name: str) -> None:
    robot, speed, dt = ROBOTS[name], 0.8, jnp.asarray(0.01)
    key = "vx" if "vx" in robot.state_names else "v"
    state = robot.with_component(robot.at_pose(0.0, 0.0, 0.7), key, speed)

    def brake(state, _):
        return robot.step(state, robot.stopping_control(state, dt), dt), None

    rest, _ = jax.lax.scan(brake, state, None, length=400)
    way = float(jnp.linalg.norm(robot.position(rest)))
    expected = speed**2 / (2.0 * float(robot.deceleration))
    if key == "v":
        # What a model of a user's own has by default.
        default = jx.Dynamics.deceleration.fget(robot)
        assert float(default) == pytest.approx(float(robot.deceleration), rel=1e-3)
    assert way == pytest.approx(expected, abs=0.005)
    assert float(jx.dynamics.State(state, robot).stopping_distance) == pytest.approx(
        expected, rel=1e-4
    )


def test_a_speed_that_is_a_control_needs_no_distance() -> None:
    robot = jx.Unicycle()
    state = jx.dynamics.State(robot.at_pose(0.0, 0.0, 0.0), robot, jnp.asarray([1.0, 0.0]))
    assert float(robot.deceleration) == math.inf
    assert float(state.stopping_distance) == 0.0


@given(x=near, y=near, yaw=st.floats(-9.0, 9.0), v=st.floats(-0.1, 0.1), w=st.floats(-0.2, 0.2))
def test_a_goal_is_reached_at_rest_within_its_radius_and_heading(x, y, yaw, v, w) -> None:
    pose, heading = np.array([5.0 + x, -3.0 + y, yaw]), 0.5
    off = math.remainder(yaw - heading, math.tau)
    margins = (math.hypot(x, y) - 0.15, abs(v) - 0.05, abs(w) - 0.1, abs(off) - 0.1)
    if min(map(abs, margins)) < 1e-4:
        return
    is_there = all(each < 0.0 for each in margins[:3])
    goal = np.array([5.0, -3.0])
    for array in (np.asarray, lambda each: jnp.asarray(each, jnp.float32)):
        given, motion = array(pose), Motion(array(v), array(w))
        free, facing = Goal.of(goal), Goal.of(goal, heading=heading)
        assert bool(free.is_reached(given, motion)) == is_there
        assert bool(facing.is_reached(given, motion)) == (is_there and margins[3] < 0.0)


def test_motion_is_that_of_the_step_also_upwards_and_across_a_full_turn() -> None:
    flyer, dt = jx.Quadrotor(), jnp.asarray(0.1)
    before = flyer.at_pose(1.0, 2.0, math.pi - 0.01)
    after = flyer.with_component(flyer.at_pose(1.02, 2.03, -math.pi + 0.02), "z", 0.06)
    speed, rate = Motion.between(flyer, before, after, dt)
    assert float(speed) == pytest.approx(0.7, rel=1e-3)
    assert float(rate) == pytest.approx(0.3, rel=1e-2)
    assert bool(STANDING.is_within(0.05))
    # The heading of a point mass, its direction of travel, turns round where it stands.
    mass = jx.PointMass()
    before, after = jnp.asarray([0.0, 0.0, 0.01, 0.0]), jnp.asarray([0.0, 0.0, -0.01, 0.0])
    assert [float(each) for each in Motion.between(mass, before, after, dt)] == [0.0, 0.0]


@pytest.mark.parametrize("name", ["radius", "tolerance", "speed"])
def test_numbers_that_are_no_bounds_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"goal_{name} is 0.0; accepted"):
        Goal.of((0.0, 0.0), **{name: 0.0})


def test_a_goal_in_a_volume_has_a_height_and_a_heading_behind_it() -> None:
    check = Goal.of([5.0, -3.0, 1.5], heading=0.5, dimensions=3)
    there = np.array([5.0, -3.0, 1.6, 0.55])
    assert check.is_reached(there, STANDING)
    assert not check.is_reached(there + np.array([0.0, 0.0, 0.1, 0.0]), STANDING)
    assert not check.is_reached(there + np.array([0.0, 0.0, 0.0, 0.2]), STANDING)
    assert not check.is_reached(there, Motion(0.06, 0.0))
    with pytest.raises(ValueError, match="accepted: 3 finite numbers"):
        Goal.of([5.0, -3.0], dimensions=3)
