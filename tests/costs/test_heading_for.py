import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import State
from jaxplore.costs import RegionCost, ToGoalCost

REACH = st.floats(-6, 6, width=32)
ANGLE = st.floats(-7, 7, width=32)


@eqx.filter_jit
def _price(cost, state, belief):
    return cost.stage(state, jnp.zeros(2), jnp.zeros(()), belief)


def posed(belief, x: float, y: float, yaw: float):
    return dataclasses.replace(belief, pose=jnp.asarray([x, y, yaw], jnp.float32))


# RegionCost


@given(x=REACH, y=REACH, yaw=ANGLE, direction=ANGLE, there=st.tuples(REACH, REACH), v=REACH)
def test_it_is_the_way_that_was_not_gone_in_the_direction(
    x, y, yaw, direction, there, v, belief, at
) -> None:
    away = np.asarray(there, np.float64) - (x, y)
    angle = float(yaw) + direction
    expected = math.hypot(*away) - away @ (math.cos(angle), math.sin(angle))
    # The heading on the way does not matter, nor does the speed.
    found = float(_price(RegionCost(direction), at(*there, 1.3, v), posed(belief, x, y, yaw)))
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert found >= -1e-5


@pytest.mark.parametrize("direction", [0.0, math.pi / 2, -math.pi / 2, 2.5])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_nothing_straight_that_way_and_twice_the_distance_the_other_way(
    belief, at, direction: float, yaw: float
) -> None:
    here = posed(belief, 1.0, -2.0, yaw)
    way = np.array([math.cos(yaw + direction), math.sin(yaw + direction)])
    across = np.array([-way[1], way[0]])
    cost = RegionCost(direction)
    for distance in (0.5, 3.0):
        prices = [
            float(_price(cost, at(*((1.0, -2.0) + distance * each)), here))
            for each in (way, -way, across)
        ]
        assert prices == pytest.approx([0.0, 2 * distance, distance], abs=1e-5)


def test_default_is_ahead(belief, at) -> None:
    here = posed(belief, 0.0, 0.0, math.pi / 2)
    assert float(_price(RegionCost(), at(0.0, 2.0), here)) == pytest.approx(0.0, abs=1e-6)
    assert float(_price(RegionCost(), at(0.0, -2.0), here)) == pytest.approx(4.0)


def test_where_the_robot_is_the_slope_is_finite(belief, at) -> None:
    robot = at(0.0, 0.0).dynamics
    here = posed(belief, 2.0, 3.0, 0.4)

    @jax.jit
    def slope(values):
        def along(values):
            return RegionCost(0.3).stage(State(values, robot), jnp.zeros(2), jnp.zeros(()), here)

        return jax.value_and_grad(along)(values)

    for there in ((2.0, 3.0), (2.0 + 1e-20, 3.0), (2.0, 3.0 + 1e-6), (1e6, -1e6)):
        value, along = slope(jnp.asarray([*there, 0.0, 0.0, 0.0]))
        assert np.isfinite(value)
        assert np.isfinite(along).all(), there
    assert float(slope(jnp.asarray([2.0, 3.0, 0.0, 0.0, 0.0]))[0]) == 0.0


# ToGoalCost


@pytest.fixture(scope="module")
def homing(belief):
    """A goal's field that differs from the guidance: U = 2 x - y - 0.5, the way is (0.6, 0.8)."""
    flat = jax.tree.map(jnp.zeros_like, belief.guidance)
    return dataclasses.replace(belief, to_goal=belief.guidance, guidance=flat)


@pytest.mark.parametrize("turning", [0.0, 0.3, 2.0])
def test_it_is_the_way_to_go_and_not_facing_it(homing, at, turning: float) -> None:
    for x, y, yaw in ((1.0, 1.0, 0.0), (3.3, 6.2, 2.0), (7.0, 2.5, -1.0)):
        facing = 0.6 * math.cos(yaw) + 0.8 * math.sin(yaw)
        expected = 2.0 * x - y - 0.5 + turning * (1.0 - facing)
        found = float(_price(ToGoalCost(turning), at(x, y, yaw), homing))
        assert found == pytest.approx(expected, rel=1e-4, abs=1e-5)
    ahead = math.atan2(0.8, 0.6)
    found = float(_price(ToGoalCost(), at(2.0, 2.0, ahead), homing))
    assert found == pytest.approx(1.5, abs=1e-5)
    found = float(_price(ToGoalCost(), at(2.0, 2.0, ahead + math.pi), homing))
    assert found == pytest.approx(1.5 + 0.6, abs=1e-5)


def test_where_there_is_no_way_to_go_no_heading_is_better(homing, at) -> None:
    """So that to stop at the goal costs nothing, as all around it directions cancel there."""
    shares = jnp.asarray([1.0, 0.4, 0.0])
    for share in shares:
        field = dataclasses.replace(homing.to_goal, descent=share * homing.to_goal.descent)
        there = dataclasses.replace(homing, to_goal=field)
        for yaw in (0.0, 2.0, -1.0):
            facing = share * (0.6 * math.cos(yaw) + 0.8 * math.sin(yaw))
            found = float(_price(ToGoalCost(), at(2.0, 2.0, yaw), there))
            assert found == pytest.approx(1.5 + 0.3 * float(share - facing), abs=1e-5)


def test_without_the_field_it_says_what_is_missing_when_traced(belief, at) -> None:
    assert belief.to_goal is None
    message = "belief has no to_goal; accepted: the belief of a Perception with a goal apart"
    with pytest.raises(ValueError, match=message):
        jax.jit(lambda values: ToGoalCost().stage(
            State(values, at(0.0, 0.0).dynamics), jnp.zeros(2), jnp.zeros(()), belief
        ))(jnp.zeros(5))  # fmt: skip


def test_several_directions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^direction has shape .*; accepted: "):
        RegionCost(np.zeros(2))
