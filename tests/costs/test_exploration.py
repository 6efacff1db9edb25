import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    Cost,
    DifferentialDrive,
    GuidanceCost,
    InformationCost,
    Omnidirectional,
    Quadrotor,
    State,
)
from jaxplore.belief.belief import StrategicBelief
from jaxplore.costs import HomingCost, LocalInformationCost, PotentialCost, StrategyReferenceCost
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.frame import GridFrame


def test_information_cost_is_per_beam(stage, at) -> None:
    assert stage(InformationCost(), at(4.0, 3.5)) == pytest.approx(-3 * 3.0 / 10)
    assert stage(InformationCost(), at(-4.0, 3.5)) == 0.0


def test_information_fades_where_the_robot_stays(belief, at) -> None:
    _, columns = np.mgrid[:9, :9].astype(np.float32)
    dwelt = dataclasses.replace(belief, dwell=jnp.asarray(columns), patience=jnp.asarray(2.0))
    cost, nothing = InformationCost(is_fading=True), (jnp.zeros(2), jnp.asarray(0.0))
    for x, dwell in ((4.0, 3.5), (1.5, 1.0)):  # between nodes it is linear in the time
        found = float(cost.stage(at(x, 3.5), *nothing, dwelt))
        assert found == pytest.approx(-3 * 3.0 / 10 * math.exp(-dwell / 2.0), rel=1e-5)
        assert float(cost.stage(at(x, 3.5), *nothing, belief)) == pytest.approx(-3 * 3.0 / 10)
    assert float(cost.stage(at(-4.0, 3.5), *nothing, dwelt)) == 0.0


def test_guidance_cost_is_the_cost_to_go_and_of_facing_elsewhere(stage, at) -> None:
    for yaw in (0.0, 1.0, math.pi, -2.0):
        facing = 0.6 * math.cos(yaw) + 0.8 * math.sin(yaw)
        expected = 2.0 * 3.5 - 2.5 + 0.5 * (1.0 - facing)
        found = stage(GuidanceCost(turning=0.5), at(4.0, 3.0, yaw))
        assert found == pytest.approx(expected, abs=1e-4)


def test_guidance_cost_counts_no_deeper_than_its_reach_below_the_robot(belief, at) -> None:
    cost, nothing = GuidanceCost(turning=0.0, reach=3.0), (jnp.zeros(2), jnp.asarray(0.0))

    def price(x: float, pose) -> float:
        return float(cost.stage(at(x, 3.0), *nothing, dataclasses.replace(belief, pose=pose)))

    here = jnp.asarray([4.0, 3.0, 0.0])
    for x, fall in ((4.0, 0.0), (3.0, 2.0), (2.5, 3.0), (2.0, 3.0), (1.0, 3.0)):
        assert price(x, here) == pytest.approx(2.0 * 3.5 - 2.5 - fall, abs=1e-4)
    assert price(5.0, here) == pytest.approx(2.0 * 4.5 - 2.5, abs=1e-4)
    # A robot off the lattice has nothing to compare with.
    assert price(1.0, jnp.asarray([-50.0, 3.0, 0.0])) == pytest.approx(2.0 * 0.5 - 2.5, abs=1e-4)


@pytest.mark.parametrize("robot", [Quadrotor(), Omnidirectional(), DifferentialDrive()])
def test_at_a_goal_every_motion_costs_that_a_robot_must_stop(belief, robot) -> None:
    """By the formula, where the goal is and the cost to go is that of the goal alone."""
    goal = jnp.asarray([4.0, 3.0])
    home = dataclasses.replace(belief, goal=goal, is_explored=jnp.array(True), pose=jnp.zeros(3))
    cost, control = GuidanceCost(turning=0.0), jnp.zeros(robot.control_size)
    rest = robot.at_pose(4.0, 3.0, 0.0)

    def price(name: str, value: float) -> float:
        state = State(robot.with_component(rest, name, value), robot)
        return float(cost.stage(state, control, jnp.asarray(0.1), home))

    still = price("x", 4.0)
    for name in sorted(set(robot.state_names) & {"v", "vx", "vy", "vz", "omega", "wx", "wy", "wz"}):
        turns = name not in {"v", "vx", "vy", "vz"}
        squared = (0.5 * 0.2) ** 2 if turns else 0.2**2
        # On the ground the distance by which the goal would be overrun is paid as well.
        overrun = 0.0 if turns or name == "vz" else 2.0 * 0.2**2 / float(robot.deceleration)
        assert price(name, 0.2) - still == pytest.approx(0.3 * squared + overrun, rel=1e-4)


@pytest.mark.parametrize("cost", [InformationCost(), GuidanceCost()])
def test_the_same_cost_serves_another_model(cost: Cost, stage, at, sled, belief) -> None:
    expected = stage(cost, at(4.0, 3.0, v=0.7))
    found = cost.stage(sled(4.0, 3.0, 0.7), jnp.zeros(1), jnp.asarray(0.1), belief)
    assert float(found) == pytest.approx(expected)


REFERENCE = [[1.0, 0.0, -9.0], [2.0, 1.0, -9.0], [4.0, 1.0, -7.0]]


@pytest.fixture(scope="session")
def strategic(belief) -> StrategicBelief:
    """Fields that are linear in the position and in between four headings.

    At (x, y) and heading n pi / 2 the potential is x + 10 n (from the first nodes, at 0.5), what is
    near 2 y + n; the reference is 0.1 s old, its rows 0.5 s apart.
    """
    rows, columns, turn = np.mgrid[:9, :9, :4].astype(np.float32)
    frame = GridFrame(1.0)
    potential = HeadingField(jnp.asarray(columns + 0.5 + 10.0 * turn), frame)
    known = {field.name: getattr(belief, field.name) for field in dataclasses.fields(belief)}
    return StrategicBelief(
        **known,
        potential=potential,
        best=potential.best,
        local=HeadingField(jnp.asarray(2.0 * (rows + 0.5) + turn), frame),
        reference=jnp.asarray(REFERENCE),
        reference_period=jnp.asarray(0.5),
        reference_age=jnp.asarray(0.1),
    )


@pytest.fixture(scope="session")
def price_of(strategic):
    """Return what evaluates a stage cost on the strategic belief, or on another."""

    def evaluate(cost, state, t: float = 0.1, known=strategic) -> float:
        return float(cost.stage(state, jnp.zeros(2), jnp.asarray(t), known))

    return evaluate


@pytest.mark.parametrize(
    ("yaw", "potential", "local"),
    [
        (0.0, 4.25, 7.0),
        (math.pi / 2, 14.25, 8.0),
        (math.pi / 4, 9.25, 7.5),
        (-math.pi / 2, 34.25, 10.0),
        (-math.pi / 4, 0.5 * (34.25 + 4.25), 8.5),  # from the last heading back to the first
        (2.0 * math.pi + 0.1 * math.pi, 4.25 + 2.0, 7.2),
    ],
)
def test_information_at_a_pose_is_read_between_positions_and_headings(
    price_of, at, yaw: float, potential: float, local: float
) -> None:
    here = at(4.25, 3.5, yaw)
    assert price_of(PotentialCost(by_heading=True), here) == pytest.approx(-potential, abs=1e-4)
    assert price_of(LocalInformationCost(), here) == pytest.approx(-local, abs=1e-4)
    # The best heading's, whatever the robot's own is.
    assert price_of(PotentialCost(), here) == pytest.approx(-34.25, abs=1e-4)


@pytest.mark.parametrize(
    "cost", [PotentialCost(), PotentialCost(by_heading=True), LocalInformationCost()]
)
def test_there_is_nothing_outside_the_window(price_of, at, cost: Cost) -> None:
    for x, y in ((-1.0, 3.0), (3.0, 9.2), (0.4, 3.0), (1e9, 1e9), (math.nan, 3.0)):
        assert price_of(cost, at(x, y)) == 0.0


@pytest.mark.parametrize(
    ("t", "expected"),
    [
        (0.0, (1.0, 0.0, -9.0)),  # before the first row
        (0.4, (1.0, 0.0, -9.0)),  # at it
        (0.65, (1.5, 0.5, -9.0)),
        (0.9, (2.0, 1.0, -9.0)),
        (1.0, (2.4, 1.0, -8.6)),
        (1.4, (4.0, 1.0, -7.0)),
        (9.0, (4.0, 1.0, -7.0)),  # beyond the last one
    ],
)
def test_the_reference_is_read_between_rows_and_its_ends_hold(
    strategic, price_of, at, t: float, expected: tuple[float, float, float]
) -> None:
    found = strategic.reference_at(jnp.asarray(t))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    # Only over ground.
    squared = (3.0 - expected[0]) ** 2 + (0.25 - expected[1]) ** 2
    assert price_of(StrategyReferenceCost(), at(3.0, 0.25), t) == pytest.approx(squared, abs=1e-4)


def test_an_older_reference_is_read_farther_on(strategic) -> None:
    for age, expected in ((0.0, 1.2), (0.4, 2.0), (0.65, 3.0), (5.0, 4.0)):
        older = dataclasses.replace(strategic, reference_age=jnp.asarray(age))
        assert float(older.reference_at(jnp.asarray(0.6))[0]) == pytest.approx(expected, abs=1e-5)


def test_a_reference_of_one_row_stays_there(strategic) -> None:
    single = dataclasses.replace(strategic, reference=jnp.asarray([[1.0, 2.0, 3.0]]))
    for t in (0.0, 0.4, 0.7, 10.0):
        np.testing.assert_array_equal(single.reference_at(jnp.asarray(t)), [1.0, 2.0, 3.0])


def test_home_attracts_only_when_all_is_explored(belief, strategic, price_of, at, drone) -> None:
    cost, spatial = HomingCost((1.0, 7.0)), HomingCost((1.0, 7.0, -2.0))
    for known in (belief, strategic):
        assert price_of(cost, at(4.0, 3.0), known=known) == 0.0
        spent = dataclasses.replace(known, is_explored=jnp.array(True))
        assert price_of(cost, at(4.0, 3.0), known=spent) == pytest.approx(5.0)
        assert price_of(cost, at(1.0, 7.0), known=spent) == 0.0
        assert price_of(spatial, drone(x=4.0, y=3.0, z=-14.0), known=spent) == pytest.approx(13.0)
        assert price_of(cost, drone(x=4.0, y=3.0, z=-14.0), known=spent) == pytest.approx(5.0)


def test_the_way_home_has_a_slope_at_the_goal_too(strategic, drone) -> None:
    spent = dataclasses.replace(strategic, is_explored=jnp.array(True))

    def along(values: jax.Array) -> jax.Array:
        state = dataclasses.replace(drone(), values=values)
        return HomingCost((1.0, 7.0)).stage(state, jnp.zeros(3), jnp.zeros(()), spent)

    there = jax.grad(along)(drone(x=1.0, y=7.0).values)
    assert np.isfinite(there).all()
    np.testing.assert_allclose(jax.grad(along)(drone(x=4.0, y=3.0).values)[:2], [0.6, -0.8])


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ((1.0,), r"goal has shape \(1,\); accepted: \(2,\) or \(3,\)"),
        ((1.0, 2.0, 3.0, 4.0), r"goal has shape \(4,\); accepted"),
        (np.ones((1, 2)), r"goal has shape \(1, 2\); accepted"),
    ],
)
def test_a_bad_goal_is_named(goal, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HomingCost(goal)
