"""Distance kept from outlines, against discs and by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, DiscObstacleCost, ObstacleDistanceCost, Obstacles, Outlines
from jaxplore.geometry.footprint import Rectangle

POINT = st.tuples(st.floats(-6, 6, width=32), st.floats(-6, 6, width=32))
SETTINGS = {"clearance": 0.5, "collision": 7.0, "margin": 0.05, "reaction_time": 0.1}
CENTRES = np.array([[1.0, 0.5], [-2.0, 1.0], [0.0, -3.0]])
RADII = [0.5, 0.3, 1.0]
VELOCITIES = np.array([[0.5, 0.0], [0.0, -1.0], [0.0, 0.0]])
SQUARE = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])


@given(here=POINT, t=st.floats(0, 3, width=32), v=st.floats(0, 2, width=32))
def test_discs_cost_what_discs_cost_where_they_are_by_then(here, t, v, price, drone) -> None:
    moving = ObstacleDistanceCost(Obstacles(Outlines.discs(CENTRES, RADII), VELOCITIES), **SETTINGS)
    there = DiscObstacleCost(CENTRES + t * VELOCITIES, RADII, **SETTINGS)
    state = drone(x=here[0], y=here[1], v=v)
    assert price(moving, state, t) == pytest.approx(price(there, state), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("x", "y", "gap"), [(0.6, 1.5, 0.4), (1.5, 2.6, 0.6), (1.5, 1.75, -0.25), (0.7, 0.6, 0.5)]
)
def test_polygons_by_hand(x, y, gap, price, drone) -> None:
    cost = ObstacleDistanceCost(Obstacles(Outlines.polygons([SQUARE])), 1.0, 7.0, 0.05, 0.0)
    too_close = float(drone().dynamics.radius) + 0.05
    expected = max(1.0 - gap, 0.0) ** 2 + 7.0 * (max(too_close - gap, 0.0) / 0.05) ** 2
    assert price(cost, drone(x=x, y=y)) == pytest.approx(expected, rel=1e-4)


def test_an_obstacle_that_turns_takes_its_corners_with_it(drone) -> None:
    bar = Outlines.polygons([[[-2.0, -0.1], [2.0, -0.1], [2.0, 0.1], [-2.0, 0.1]]])
    turning = Obstacles(bar, None, np.pi / 2)
    cost = ObstacleDistanceCost()
    state = drone(x=0.0, y=2.5)
    now, later = (float(cost.distance(state, jnp.asarray(t), turning)) for t in (0.0, 1.0))
    assert now == pytest.approx(2.4)
    assert later == pytest.approx(0.5, abs=1e-5)
    assert float(cost.room(state, turning)) == pytest.approx(2.4 - float(state.dynamics.radius))


def test_what_is_uncertain_along_the_way_is_kept_free(drone) -> None:
    covariance = np.array([[0.09, 0.0], [0.0, 0.01]])
    obstacle = Obstacles(
        Outlines.discs([[0.0, 0.0]], 0.5), covariance=covariance, growth=0.2, velocities=[[0, 0]]
    )
    cost = ObstacleDistanceCost(caution=2.0)
    for x, y, variance in ((3.0, 0.0, 0.09), (0.0, 3.0, 0.01), (3.0, 3.0, 0.05)):
        expected = np.hypot(x, y) - 0.5 - 2.0 * np.sqrt(variance + 0.16)
        found = cost.distance(drone(x=x, y=y), jnp.asarray(2.0), obstacle)
        assert float(found) == pytest.approx(expected, rel=1e-5)


def test_every_disc_of_a_robot_counts() -> None:
    from jaxplore import State

    robot = Ackermann(footprint=Rectangle(2.0, 0.0, 0.5, num_discs=2))
    state = State(robot.at_pose(0.0, 0.0, 0.0), robot)
    obstacles = Obstacles(Outlines.discs([[1.5, 2.0]], 0.5))
    room = float(ObstacleDistanceCost().room(state, obstacles))
    assert room == pytest.approx(2.0 - 0.5 - float(robot.radius), rel=1e-5)


def test_obstacles_come_with_the_belief_too(drone) -> None:
    from types import SimpleNamespace

    obstacles = Obstacles(Outlines.discs(CENTRES, RADII))
    own, read = ObstacleDistanceCost(obstacles), ObstacleDistanceCost()
    state, control, t = drone(x=0.3, y=0.2), jnp.zeros(3), jnp.zeros(())
    expected = own.stage(state, control, t, None)
    assert expected > 0.0
    for belief in (obstacles, SimpleNamespace(obstacles=obstacles)):
        assert read.stage(state, control, t, belief) == expected


@pytest.mark.parametrize("name", ["clearance", "collision", "margin", "reaction_time", "caution"])
def test_negative_numbers_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        ObstacleDistanceCost(**{name: -1.0})
