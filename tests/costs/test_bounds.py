import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, Omnidirectional, State
from jaxplore.costs import BackwardsCost, SpeedLimitCost, StateBoundsCost

LOWER = {"x": -1.0, "v": 0.25, "z": -4.0}
UPPER = {"x": 2.0, "yaw": 0.5, "z": -1.0}
SCALE = {"x": 0.5, "yaw": 2.0}
REACH = st.floats(-8, 8, width=32)


@given(x=REACH, z=REACH, yaw=REACH, v=REACH)
def test_squared_depths_outside_the_bounds(x, z, yaw, v, price, drone, shuffled) -> None:
    expected = 0.0
    for name, value in {"x": x, "z": z, "yaw": yaw, "v": v}.items():
        below = max(LOWER.get(name, -math.inf) - value, 0.0)
        above = max(value - UPPER.get(name, math.inf), 0.0)
        expected += (below**2 + above**2) / SCALE.get(name, 1.0) ** 2
    cost = StateBoundsCost(LOWER, UPPER, SCALE)
    for make in (drone, shuffled):
        found = price(cost, make(x=x, y=99.0, z=z, yaw=yaw, v=v))
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_nothing_within_and_at_the_bounds(price, drone) -> None:
    cost = StateBoundsCost(LOWER, UPPER, SCALE)
    for x, z, yaw, v in ((0.0, -2.0, 0.0, 1.0), (-1.0, -4.0, 0.5, 0.25), (2.0, -1.0, 0.5, 0.25)):
        assert price(cost, drone(x=x, z=z, yaw=yaw, v=v)) == 0.0


def test_no_step_and_no_kink_at_the_bound(slope, drone) -> None:
    cost = StateBoundsCost(upper={"x": 2.0})
    for x, expected in ((1.9, 0.0), (2.0, 0.0), (2.5, 1.0)):
        assert slope(cost, drone(x=x))[0] == pytest.approx(expected, abs=1e-5)


def test_one_kind_of_bound_is_enough(price, drone) -> None:
    assert price(StateBoundsCost(lower={"x": 1.0}), drone(x=-1.0)) == pytest.approx(4.0)
    assert price(StateBoundsCost(upper={"x": 1.0}), drone(x=4.0)) == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({}, "lower is None and upper is None; accepted: one bound or more"),
        ({"lower": {"x": 2.0}, "upper": {"x": 1.0}}, r"lower\['x'\] is 2.0; accepted: at most .*1"),
        ({"upper": {"x": 1.0}, "scale": {"y": 1.0}}, "scale has 'y'; accepted: x"),
    ],
)
def test_bad_input_is_named(arguments, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        StateBoundsCost(**arguments)


def test_a_component_that_the_model_lacks_is_named(price, at) -> None:
    with pytest.raises(ValueError, match="DifferentialDrive has no state component 'z'; accepted"):
        price(StateBoundsCost({"z": 0.0}), at(0.0, 0.0))


def test_traced_bounds_pass() -> None:
    made = jax.jit(lambda low: StateBoundsCost({"x": low}, {"x": 1.0}))(jnp.asarray(2.0))
    assert float(made.lower["x"]) == 2.0


@pytest.mark.parametrize(
    ("speed", "expected"),
    [(0.0, 0.0), (1.5, 0.0), (2.0, 0.0), (2.25, 6.25), (3.0, 100.0), (-1.9, 0.0), (-2.5, 25.0)],
)
def test_only_excess_speed_costs_backwards_too(price, drone, at, speed, expected) -> None:
    for state in (drone(v=speed), at(0.0, 0.0, v=speed)):
        assert price(SpeedLimitCost(2.0), state) == pytest.approx(expected, rel=1e-4)
        assert price(SpeedLimitCost(2.0, 0.5), state) == pytest.approx(expected / 25.0, rel=1e-4)


def test_no_step_and_no_kink_at_the_speed_limit(slope, drone) -> None:
    for speed, expected in ((1.9, 0.0), (2.0, 0.0), (0.0, 0.0), (2.5, 4.0), (-2.5, -4.0)):
        found = slope(SpeedLimitCost(2.0, 0.5), drone(v=speed))
        assert found[-1] == pytest.approx(expected, abs=1e-5)
        np.testing.assert_array_equal(found[:-1], 0.0)


def test_a_bad_speed_limit_is_named() -> None:
    with pytest.raises(ValueError, match=r"limit has shape \(2,\); accepted: one number"):
        SpeedLimitCost(limit=np.ones(2))


@pytest.mark.parametrize(
    "robot", [Ackermann(min_speed=-1.0), Omnidirectional(min_speed=-1.0)], ids=["car", "omni"]
)
@pytest.mark.parametrize(("v", "expected"), [(-0.6, 3.0), (0.0, 0.0), (0.8, 0.0)])
def test_driving_backwards_costs_its_speed(robot, v: float, expected: float) -> None:
    state = State(jnp.zeros(robot.state_size).at[3].set(v), robot)
    cost = BackwardsCost(scale=0.2)
    paid = cost.stage(state, jnp.zeros(robot.control_size), jnp.zeros(()), None)
    assert float(paid) == pytest.approx(expected)
