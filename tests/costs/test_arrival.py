"""The cost of coming to rest at a goal, against its formula in float64, and that it leads there."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import DifferentialDrive, State
from jaxplore.costs._arrival import homing_cost

ANGLE = st.floats(-3.25, 3.25, width=32)
ROBOT = DifferentialDrive()
TURNING, GOAL = 0.3, (1.0, -2.0)


@eqx.filter_jit
def _homing(field, pose, speed, heading):
    state = State(jnp.concatenate([pose, jnp.stack([speed, jnp.zeros(())])]), ROBOT)
    goal = jnp.asarray(GOAL)
    distance = jnp.hypot(*(state.position - goal))
    return homing_cost(state, field, distance, goal, heading, jnp.asarray(TURNING))


def homing(belief, x: float, y: float, yaw: float, speed: float, heading: float | None) -> float:
    pose = jnp.asarray([GOAL[0] + x, GOAL[1] + y, yaw], jnp.float32)
    end = None if heading is None else jnp.asarray(heading, jnp.float32)
    return float(_homing(belief.guidance, pose, jnp.asarray(speed, jnp.float32), end))


def expected(x: float, y: float, yaw: float, speed: float, heading: float | None) -> float:
    """Return the formula of a straight way, within 0.75 m of the goal."""
    distance = math.hypot(x, y)
    stopping = speed**2 / (2.0 * float(ROBOT.deceleration))
    overrun = max(2.0 * stopping - distance, 0.0)
    facing = -(math.cos(yaw) * x + math.sin(yaw) * y) / max(distance, 1e-3)
    missing = math.hypot(x, y) / max(distance, 1e-3) - facing
    total = distance + 2.0 * overrun + TURNING * min(distance / 0.3, 1.0) * missing
    total += 0.3 * math.exp(-((distance / 0.3) ** 2)) * speed**2
    if heading is not None:
        away = abs(math.atan2(math.sin(yaw - heading), math.cos(yaw - heading)))
        total += 0.3 * math.exp(-((distance / 0.4) ** 2)) * away / math.pi
    return total


@given(
    direction=ANGLE,
    distance=st.floats(0.0, 0.6875, width=32),
    yaw=ANGLE,
    speed=st.floats(0.0, 1.0, width=32),
    heading=ANGLE,
)
def test_it_is_the_formula_near_the_goal(belief, direction, distance, yaw, speed, heading) -> None:
    x, y = distance * math.cos(direction), distance * math.sin(direction)
    for end in (None, heading):
        given = (x, y, yaw, speed, end)
        assert homing(belief, *given) == pytest.approx(expected(*given), rel=1e-4, abs=1e-4)


@given(direction=ANGLE, heading=ANGLE)
def test_from_every_side_it_leads_to_the_goal_and_then_to_its_heading(
    belief, direction, heading
) -> None:
    """A robot that had to stand the other way round stood 0.4 m from the goal for ever."""
    ahead = direction + math.pi
    x, y = math.cos(direction), math.sin(direction)
    drive = [
        homing(belief, each * x, each * y, ahead, 0.0, heading)
        for each in np.linspace(0.7, 0.0, 29)
    ]
    assert (np.diff(drive) < -0.25 * 0.025).all()
    away = math.atan2(math.sin(ahead - heading), math.cos(ahead - heading))
    turn = [
        homing(belief, 0.0, 0.0, heading + each * away, 0.0, heading)
        for each in np.linspace(1.0, 0.0, 9)
    ]
    # A constant slope: the last tenth of a radian is worth as much as the first.
    assert np.diff(turn) == pytest.approx(-0.3 * abs(away) / math.pi / 8.0, abs=1e-5)
    assert turn[-1] == pytest.approx(0.0, abs=1e-5)
