import math

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from jaxplore import DifferentialDrive, GoalCost, State, StateCost, WaypointCost
from jaxplore.control import rollout_costs
from jaxplore.costs import PathCost, ReferenceCost

REACH = st.floats(-10, 10, width=32)
ANGLE = st.floats(-7, 7, width=32)
POINT = st.tuples(REACH, REACH)


def corners(count: int):
    return hnp.arrays(np.float32, (count, 2), elements=st.floats(-5, 5, width=32))


# GoalCost


@given(goal=POINT, here=POINT)
def test_goal_cost_is_the_distance_to_go(goal, here, price, drone) -> None:
    distance = math.dist(goal, here)
    state = drone(x=here[0], y=here[1], z=50.0)
    assert price(GoalCost(goal), state) == pytest.approx(distance, rel=1e-5, abs=1e-6)
    saturated = 3.0 * distance / (3.0 + distance)
    assert price(GoalCost(goal, 3.0), state) == pytest.approx(saturated, rel=1e-5, abs=1e-6)


def test_a_goal_in_space_is_compared_with_z(price, drone, shuffled) -> None:
    goal, here = (1.0, 2.0, -3.0), {"x": 3.0, "y": -1.0, "z": 3.0}
    for make in (drone, shuffled):
        assert price(GoalCost(goal), make(**here)) == pytest.approx(7.0)
        assert price(WaypointCost(goal), make(**here)) == pytest.approx(49.0)


def test_a_saturated_goal_still_pulls_from_afar(price, drone) -> None:
    cost = GoalCost([0.0, 0.0], saturation=2.0)
    values = [price(cost, drone(x=x)) for x in (0.001, 1.0, 10.0, 100.0, 1000.0)]
    assert values[0] == pytest.approx(0.001, rel=1e-3)
    assert (np.diff(values) > 0).all()
    assert values[-1] < 2.0


@pytest.mark.parametrize(
    "make",
    [
        lambda weight: GoalCost([1.0, 1.0], 2.0, weight),
        lambda weight: WaypointCost([1.0, 1.0], 0.3, terminal_weight=weight),
        lambda weight: StateCost({"x": 2.0, "yaw": 1.0}, {"x": 3.0}, ("yaw",), weight),
    ],
)
def test_the_last_state_pays_a_multiple_on_top(make, price, drone) -> None:
    state = drone(x=3.0, y=-1.0, yaw=1.0)
    once = price(make(0.0), state)
    assert once > 0.1
    assert float(make(0.0).terminal(state, None)) == 0.0
    assert float(make(7.0).terminal(state, None)) == pytest.approx(7.0 * once, rel=1e-5)
    assert price(make(7.0), state) == once


@given(here=POINT, v=st.floats(0.0, 2.0, width=32))
def test_a_robot_that_is_too_fast_to_stop_pays_what_it_would_overrun(here, v, price) -> None:
    """With half of a deceleration of 0.3 m/s^2, whose braking distance is v^2 / 0.3."""
    robot = DifferentialDrive(max_speed=2.0, max_acceleration=0.3, drag=0.0)
    state = State(jnp.asarray([*here, 0.4, v, 0.0], jnp.float32), robot)
    distance = math.hypot(here[0] - 1.0, here[1] + 2.0)
    over = max(v * v / 0.3 - distance, 0.0)
    expected = distance + 2.0 * over
    assert price(GoalCost([1.0, -2.0]), state) == pytest.approx(expected, rel=1e-3, abs=1e-5)
    settled = distance**2 + 4.0 * over * max(distance, 1.0)
    assert price(WaypointCost([1.0, -2.0]), state) == pytest.approx(settled, rel=1e-3, abs=1e-5)


# WaypointCost


@given(here=POINT, yaw=ANGLE, heading=ANGLE)
def test_waypoint_cost(here, yaw, heading, price, drone) -> None:
    square = (here[0] - 1.0) ** 2 + (here[1] + 2.0) ** 2
    turned = 2.5 * math.exp(-square / 1.5**2) * (1.0 - math.cos(yaw - heading))
    cost = WaypointCost([1.0, -2.0], heading, heading_weight=2.5, decay=1.5)
    state = drone(x=here[0], y=here[1], yaw=yaw)
    assert price(cost, state) == pytest.approx(square + turned, rel=1e-5, abs=1e-5)
    assert price(WaypointCost([1.0, -2.0]), state) == pytest.approx(square, rel=1e-5, abs=1e-5)


@given(error=st.floats(-0.5, 0.5), turns=st.integers(-3, 3))
def test_the_heading_wraps(error: float, turns: int, price, drone) -> None:
    cost = WaypointCost([0.0, 0.0], math.pi - 0.1)
    found = price(cost, drone(yaw=math.pi - 0.1 + error + 2 * math.pi * turns))
    assert found == pytest.approx(1.0 - math.cos(error), abs=1e-5)


def test_the_heading_matters_near_the_waypoint_only(price, drone) -> None:
    cost = WaypointCost([0.0, 0.0], 0.0, heading_weight=1.0, decay=2.0)
    there = price(cost, drone(yaw=math.pi))
    assert there == pytest.approx(2.0)
    at_decay = price(cost, drone(x=2.0, yaw=math.pi)) - price(cost, drone(x=2.0))
    assert at_decay == pytest.approx(2.0 / math.e, rel=1e-5)
    assert price(cost, drone(x=20.0, yaw=math.pi)) == price(cost, drone(x=20.0))


@given(error=st.floats(-7, 7))
def test_a_robot_with_two_fronts_may_face_either_way(error: float, price, drone) -> None:
    cost = WaypointCost([0.0, 0.0], 0.4, heading_weight=2.0, is_symmetric=True)
    found = price(cost, drone(yaw=0.4 + error))
    assert found == pytest.approx(2.0 * 0.5 * math.sin(error) ** 2, abs=1e-5)
    assert found == pytest.approx(price(cost, drone(yaw=0.4 + error + math.pi)), abs=1e-5)


def test_near_a_heading_two_fronts_cost_as_one(price, drone) -> None:
    state = drone(yaw=0.05)
    both = [WaypointCost([0.0, 0.0], 0.0, is_symmetric=each) for each in (False, True)]
    assert price(both[1], state) == pytest.approx(price(both[0], state), rel=1e-2)


# ReferenceCost


@given(reference=corners(5), t=st.floats(0, 4, width=32))
def test_the_reference_is_linear_in_time_and_its_last_point_is_held(
    reference, t: float, price, drone
) -> None:
    times = 0.4 * np.arange(5)
    wanted = [np.interp(t, times, reference[:, i].astype(np.float64)) for i in range(2)]
    expected = (2.0 - wanted[0]) ** 2 + (-1.0 - wanted[1]) ** 2
    found = price(ReferenceCost(reference, 0.4), drone(x=2.0, y=-1.0), t)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-3)


def test_one_row_is_a_point_for_all_times(price, drone) -> None:
    for t in (0.0, 0.1, 1e6):
        assert price(ReferenceCost([[3.0, 4.0]], 0.1), drone(), t) == pytest.approx(25.0)


def test_a_reference_in_space_is_compared_with_z(price, drone) -> None:
    cost = ReferenceCost([[0.0, 0.0, 0.0], [0.0, 0.0, 4.0]], 1.0)
    assert price(cost, drone(z=5.0), 0.5) == pytest.approx(9.0)


def test_a_robot_that_is_on_time_pays_nothing(belief) -> None:
    # The model goes on at 1 m/s: after t seconds it is at t.
    robot = DifferentialDrive(drag=0.0)
    start = jnp.asarray([0.0, 0.0, 0.0, 1.0, 0.0])
    rows = np.stack([0.1 * np.arange(9), np.zeros(9)], axis=1)
    controls = jnp.zeros((8, 2, 1))

    def total(reference) -> float:
        cost = ReferenceCost(reference, 0.1)
        return float(rollout_costs(robot, cost, start, controls, jnp.asarray(0.1), belief)[0])

    assert total(rows) == pytest.approx(0.0, abs=1e-9)
    # One row ahead of it all the way; the last row holds.
    assert total(np.vstack([rows[1:], rows[-1:]])) == pytest.approx(7 * 0.01, rel=1e-4)


# PathCost


def segment_distances(points: np.ndarray, here: np.ndarray, per_segment: int = 4001) -> np.ndarray:
    """Distance of each segment in double precision, from many points on it."""
    share = np.linspace(0.0, 1.0, per_segment)[:, None, None]
    on_path = points[:-1] + share * (points[1:] - points[:-1])
    return np.linalg.norm(on_path - here, axis=-1).min(axis=0)


@given(points=corners(6), here=POINT)
def test_path_cost_is_the_squared_distance_to_the_nearest_point(points, here, price, drone) -> None:
    expected = segment_distances(points.astype(np.float64), np.asarray(here)).min()
    found = math.sqrt(price(PathCost(points), drone(x=here[0], y=here[1])))
    assert found == pytest.approx(expected, abs=3e-3)


@given(points=corners(6), index=st.integers(0, 4), share=st.floats(0, 1))
def test_on_the_path_nothing_is_paid(points, index: int, share: float, price, drone) -> None:
    x, y = points[index] + share * (points[index + 1] - points[index])
    assert price(PathCost(points), drone(x=x, y=y)) == pytest.approx(0.0, abs=1e-9)


@given(points=corners(5), here=POINT, yaw=ANGLE, v=st.floats(-2, 2, width=32))
def test_heading_and_speed_are_along_the_nearest_segment(
    points, here, yaw, v, price, drone
) -> None:
    points = points.astype(np.float64)
    distances = segment_distances(points, np.asarray(here))
    nearest, second = np.sort(distances)[:2]
    along = (points[1:] - points[:-1])[np.argmin(distances)]
    # Where two segments are equally near, either may be meant.
    assume(second - nearest > 1e-2)
    assume(np.linalg.norm(along) > 1e-2)
    facing = math.cos(yaw - math.atan2(along[1], along[0]))
    state = drone(x=here[0], y=here[1], yaw=yaw, v=v)
    off = price(PathCost(points), state)
    heading = price(PathCost(points, heading_weight=2.0), state) - off
    assert heading == pytest.approx(2.0 * (1.0 - facing), rel=1e-4, abs=1e-4)
    speed = price(PathCost(points, speed=0.5, speed_weight=3.0), state) - off
    assert speed == pytest.approx(3.0 * (v * facing - 0.5) ** 2, rel=1e-4, abs=1e-3)
    both = price(PathCost(points, heading_weight=2.0, speed=0.5, speed_weight=3.0), state)
    assert both == pytest.approx(off + heading + speed, rel=1e-4, abs=1e-3)


def test_repeated_corners_change_nothing(price, drone) -> None:
    plain = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]])
    for repeats in ([3, 1, 1], [1, 3, 1], [1, 1, 3], [2, 2, 2]):
        repeated = np.repeat(plain, repeats, axis=0)
        for x, y, yaw in ((-1.0, 0.5, 0.4), (1.0, 0.3, 2.0), (2.5, 1.0, -1.0), (2.0, 4.0, 1.0)):
            state = drone(x=x, y=y, yaw=yaw, v=0.7)
            expected = price(PathCost(plain, 1.0, 0.5), state)
            found = price(PathCost(repeated, 1.0, 0.5), state)
            assert found == pytest.approx(expected, rel=1e-6)


def test_a_corner_has_the_direction_of_the_segment_before_it(price, drone) -> None:
    cost = PathCost([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]], heading_weight=1.0)
    assert price(cost, drone(x=2.0, y=0.0, yaw=0.0)) == pytest.approx(0.0, abs=1e-6)
    assert price(cost, drone(x=2.0, y=0.0, yaw=math.pi / 2)) == pytest.approx(1.0, abs=1e-6)


def test_a_path_of_one_point_over_and_over_is_that_point(price, drone) -> None:
    cost = PathCost([[1.0, 1.0]] * 3, heading_weight=1.0)
    assert price(cost, drone(x=4.0, y=5.0)) == pytest.approx(25.0 + 1.0)


# StateCost


@given(x=REACH, v=REACH, yaw=ANGLE)
def test_state_cost_is_quadratic_and_angles_wrap(x, v, yaw, price, drone, shuffled) -> None:
    cost = StateCost({"v": 2.0, "x": 0.5, "yaw": 3.0}, {"x": 1.5, "yaw": 3.0}, angles=("yaw",))
    expected = 2.0 * v**2 + 0.5 * (x - 1.5) ** 2 + 3.0 * 2.0 * (1.0 - math.cos(yaw - 3.0))
    for make in (drone, shuffled):
        found = price(cost, make(x=x, y=4.0, v=v, yaw=yaw))
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-4)


def test_a_small_angle_costs_its_square(price, drone) -> None:
    angle = StateCost({"yaw": 1.0}, {"yaw": 0.2}, angles=["yaw"])
    number = StateCost({"yaw": 1.0}, {"yaw": 0.2})
    assert price(angle, drone(yaw=0.3)) == pytest.approx(0.01, rel=2e-3)
    assert price(number, drone(yaw=0.3)) == pytest.approx(0.01, rel=1e-5)
    assert price(angle, drone(yaw=0.3 + 2 * math.pi)) == pytest.approx(0.01, rel=2e-3)
    assert price(number, drone(yaw=0.3 + 2 * math.pi)) > 30.0


# All of them


@given(
    here=POINT,
    aim=POINT,
    points=corners(4),
    yaw=ANGLE,
    angle=ANGLE,
    shift=POINT,
    t=st.floats(0, 1, width=32),
)
def test_where_the_world_is_does_not_matter(
    here, aim, points, yaw, angle, shift, t, price, drone, moved
) -> None:
    distances = np.sort(segment_distances(points.astype(np.float64), np.asarray(here), 101))
    assume(distances[1] - distances[0] > 0.1)

    def costs(angle: float, shift) -> list[float]:
        x, y = moved(here, angle, shift)
        state = drone(x=x, y=y, yaw=yaw + angle, v=1.0)
        goal, line = moved(aim, angle, shift), moved(points, angle, shift)
        return [
            price(cost, state, t)
            for cost in (
                GoalCost(goal, 5.0),
                WaypointCost(goal, 0.3 + angle),
                ReferenceCost(line, 0.2),
                PathCost(line, 2.0, 0.7),
            )
        ]

    assert costs(angle, shift) == pytest.approx(costs(0.0, (0.0, 0.0)), rel=1e-3, abs=2e-3)


@pytest.mark.parametrize(
    ("cost", "x", "expected"),
    [
        (GoalCost([1.0, 0.0]), 1.0, 0.0),
        (GoalCost([1.0, 0.0]), 3.0, 1.0),
        (GoalCost([1.0, 0.0], 2.0), 3.0, 0.25),
        (WaypointCost([1.0, 0.0], 0.0), 1.0, 0.0),
        (WaypointCost([1.0, 0.0]), 3.0, 4.0),
        (ReferenceCost([[1.0, 0.0]], 0.1), 1.0, 0.0),
        (PathCost([[0.0, 0.0], [1.0, 0.0]]), 1.0, 0.0),
        (PathCost([[0.0, 0.0], [1.0, 0.0]]), 3.0, 4.0),
        (StateCost({"x": 1.0}, {"x": 1.0}, ["x"]), 1.0, 0.0),
    ],
)
def test_slopes_at_and_beyond_the_goal(cost, x: float, expected: float, slope, drone) -> None:
    np.testing.assert_allclose(slope(cost, drone(x=x)), [expected, 0, 0, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "culprit"),
    [
        (lambda: GoalCost([1.0]), r"goal has shape \(1,\); accepted: \(2,\) or \(3,\)"),
        (lambda: WaypointCost(np.zeros((2, 2))), r"waypoint has shape \(2, 2\); accepted"),
        (lambda: ReferenceCost(np.zeros((0, 2)), 0.1), r"reference has shape \(0, 2\); accepted"),
        (lambda: ReferenceCost(np.zeros((4, 4)), 0.1), r"accepted: \(T, 2\) or \(T, 3\)"),
        (lambda: PathCost([[0.0, 0.0]]), r"points has shape \(1, 2\); accepted: .* N >= 2"),
        (lambda: PathCost(np.zeros((3, 3))), r"points has shape \(3, 3\); accepted: \(N, 2\)"),
        (lambda: StateCost({"x": 1.0}, {"y": 1.0}), "target has 'y'; accepted: x"),
        (lambda: StateCost({"x": 1.0, "v": 1.0}, angles=["yaw"]), "angles has 'yaw'; .*: v, x"),
    ],
)
def test_bad_input_is_named(make, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        make()


@pytest.mark.parametrize(
    ("cost", "name"),
    [
        (GoalCost([0.0, 0.0, 0.0]), "z"),
        (WaypointCost([0.0, 0.0, 0.0]), "z"),
        (ReferenceCost([[0.0, 0.0, 0.0]], 0.1), "z"),
        (StateCost({"pitch": 1.0}), "pitch"),
    ],
)
def test_a_component_that_the_model_lacks_is_named(cost, name: str, price, at) -> None:
    with pytest.raises(ValueError, match=f"has no state component '{name}'; accepted: x, y, yaw"):
        price(cost, at(0.0, 0.0))


def test_traced_numbers_pass_and_traced_shapes_do_not() -> None:
    goal = jax.jit(lambda p, w: GoalCost(p, w))(jnp.ones(2), jnp.asarray(-1.0))
    assert float(goal.saturation) == -1.0
    with pytest.raises(ValueError, match=r"points has shape \(3, 4\); accepted: \(N, 2\)"):
        jax.jit(PathCost)(jnp.ones((3, 4)))
