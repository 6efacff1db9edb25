"""Portfolios of ground vehicles: what they weigh, how they divide, fusion and a loop in worlds."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    ControlCost,
    DifferentialDrive,
    ExplorationScenario,
    GoalCost,
    Knots,
    Lidar,
    Mission,
    OccupancyGrid,
    Perception,
    Smooth,
    State,
    Unicycle,
    ground_portfolio,
)
from jaxplore.belief import Belief
from jaxplore.control import Members, rollout_objectives
from jaxplore.costs import CollisionCost, ToGoalCost
from jaxplore.costs.heading_for import RegionCost
from jaxplore.maps.clearance import clearance_field
from jaxplore.planning import Average, Candidates, SafeFusion, Situation
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.fusion import Fused
from jaxplore.planning.presets.ground_vehicle import COLLISION, REGIONS, ROLE_WEIGHTS, objectives
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

DRIVE = DifferentialDrive(max_speed=1.0)
SMALL = {"horizon": 12, "num_samples": 64, "parameterisation": "direct"}
START, GOAL = (1.5, 3.0), (6.8, 4.8)


# What they weigh


def rows(portfolio) -> dict[str, dict[str, float]]:
    """Return the weights by member and objective."""
    return {
        member: dict(zip(portfolio.objective_names, map(float, row), strict=True))
        for member, row in zip(
            portfolio.member_names, np.asarray(portfolio.members.weights), strict=True
        )
    }


def normal(**row: float) -> dict[str, float]:
    total = sum(row.values())
    return {name: pytest.approx(value / total, rel=1e-5) for name, value in row.items()}


def test_a_robot_may_drive_where_paths_lead_through_narrow_passages() -> None:
    perception = Perception(Lidar(num_beams=8, max_range=2.0), 0.1, DRIVE.radius)
    least = float(perception.locomotion.narrow) - float(DRIVE.radius)
    margin = float(ground_portfolio(DRIVE, **SMALL).members.mppi.cost.cost.margin)
    # The rest is for the speed; at 0.15 m/s a robot still gets on.
    assert margin + 0.15 * float(CollisionCost().reaction_time) < least


def test_role_weights_are_those_of_the_design_notes() -> None:
    assert ROLE_WEIGHTS == {
        "explorer": {"information": 0.7, "goal": 0.1, "safety": 0.2},
        "balanced": {"information": 0.4, "goal": 0.4, "safety": 0.2},
        "exploiter": {"information": 0.1, "goal": 0.7, "safety": 0.2},
        "cautious": {"information": 0.2, "goal": 0.2, "safety": 0.4, "terrain": 0.2},
    }
    for row in ROLE_WEIGHTS.values():
        assert sum(row.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("terrain", [False, True])
@pytest.mark.parametrize("movers", [False, True])
@pytest.mark.parametrize("goal", [None, GOAL])
def test_objectives_follow_the_mission(goal, terrain: bool, movers: bool) -> None:
    mission = Mission(goal, terrain, movers)
    found = objectives(mission)
    expected = {"information", "goal", "safety", "effort"}
    expected |= {"terrain"} if terrain else set()
    expected |= {"movers"} if movers else set()
    assert set(found) == expected
    kinds = [type(cost).__name__ for cost in found.values()]
    assert isinstance(found["goal"], ToGoalCost) is (goal is not None)
    assert [name for name, _ in found["information"].terms()] == [
        "InformationCost",
        "GuidanceCost",
    ]
    alone = objectives(mission, is_guided=False)["information"]
    assert [name for name, _ in alone.terms()] == ["InformationCost"]
    assert isinstance(found["effort"], ControlCost)
    assert ("MovingObstacleCost" in kinds) is movers
    # What all pay alike is no member's objective.
    assert float(found["safety"].collision) == 0.0
    assert not movers or found["movers"].collision is None
    cautious = rows(ground_portfolio(DRIVE, mission, **SMALL))["cautious"]
    row = {"information": 0.2, "goal": 0.2, "safety": 0.4 if terrain else 0.6, "effort": 0.02}
    row |= {"terrain": 0.2} if terrain else {}
    row |= {"movers": 0.4} if movers else {}
    assert cautious == normal(**row)


def test_roles_are_normal_with_the_effort_of_all() -> None:
    found = rows(ground_portfolio(DRIVE, Mission(GOAL), effort=0.05, **SMALL))
    assert list(found) == ["explorer", "balanced", "exploiter", "cautious"]
    for name in ("explorer", "balanced", "exploiter"):
        assert found[name] == normal(**ROLE_WEIGHTS[name], effort=0.05)
    some = ground_portfolio(DRIVE, members=("exploiter", "explorer"), **SMALL)
    assert some.member_names == ("exploiter", "explorer")
    mine = {"quick": {"goal": 1.0, "effort": 0.5}, "shy": {"safety": 3.0}}
    found = rows(ground_portfolio(DRIVE, members=mine, **SMALL))
    assert found["quick"] == normal(information=0.0, goal=1.0, safety=0.0, effort=0.5)
    assert found["shy"] == normal(information=0.0, goal=0.0, safety=3.0, effort=0.02)


@pytest.mark.parametrize(
    ("mission", "members", "is_guided"),
    [
        (Mission(), None, False),
        (Mission(GOAL), None, True),
        (Mission(), {"a": {"information": 1.0}, "b": {"goal": 1.0}}, True),
        (Mission(), {"a": {"information": 1.0, "goal": 0.1}, "b": {"goal": 1.0}}, False),
    ],
    ids=["roles", "goal", "a member without a goal", "own"],
)
def test_guidance_is_one_objective_where_all_weigh_it(mission, members, is_guided: bool) -> None:
    """Else an explorer and an exploiter without a goal would both follow the guidance."""
    found = ground_portfolio(DRIVE, mission, members=members, **SMALL).members.shared
    information, goal = found[:2]
    assert ("GuidanceCost" in [name for name, _ in information.terms()]) is is_guided
    assert ("GuidanceCost" in [name for name, _ in goal.terms()]) is (mission.goal is None)


def test_horizons_of_a_temporal_decomposition() -> None:
    found = ground_portfolio(DRIVE, decomposition="temporal", dt=0.1, **SMALL)
    assert found.member_names == ("short", "middle", "long")
    np.testing.assert_allclose(found.members.horizons, [0.6, 1.2, 2.4], rtol=1e-6)
    for row in rows(found).values():
        assert row == normal(**ROLE_WEIGHTS["balanced"], effort=0.02)


def test_regions_of_a_regional_decomposition() -> None:
    found = ground_portfolio(DRIVE, decomposition="regional", **SMALL)
    assert found.member_names == ("left", "forward", "right")
    region = found.members.own[found.objective_names.index("region")]
    assert isinstance(region, RegionCost)
    np.testing.assert_allclose(region.direction, [math.pi / 2, 0.0, -math.pi / 2], rtol=1e-6)
    assert list(REGIONS) == ["left", "forward", "right"]
    for row in rows(found).values():
        assert row == normal(**ROLE_WEIGHTS["balanced"], effort=0.02, region=0.3)
    assert float(found.common[found.objective_names.index("region")]) == 0.0


@pytest.mark.parametrize("goal", [None, GOAL])
@pytest.mark.parametrize("decomposition", ["roles", "regional"])
def test_plans_compare_by_what_the_exploiter_wants(goal, decomposition: str) -> None:
    found = ground_portfolio(DRIVE, Mission(goal), decomposition=decomposition, **SMALL)
    common = dict(zip(found.objective_names, found.common.tolist(), strict=True))
    common.pop("region", None)
    assert {name: pytest.approx(value) for name, value in common.items()} == normal(
        **ROLE_WEIGHTS["exploiter"], effort=0.02
    )
    # Of members that want none of it, the mean of what they want.
    own = {"a": {"safety": 1.0, "effort": 0.0}, "b": {"goal": 1.0, "effort": 1.0}}
    found = ground_portfolio(DRIVE, Mission(goal), members=own, **SMALL)
    common = dict(zip(found.objective_names, found.common.tolist(), strict=True))
    assert common["information"] == 0.0
    assert common["goal"] > common["safety"] > common["effort"] > 0.0


def test_parts_of_the_template() -> None:
    found = ground_portfolio(DRIVE, noise_share=0.5, temperature=0.2, margin=0.1, **SMALL)
    np.testing.assert_allclose(found.members.mppi.proposal.noise_std, [0.5, 1.0])
    assert float(found.members.mppi.weighting.temperature) == pytest.approx(0.2)
    assert float(found.members.mppi.cost.weight) == pytest.approx(COLLISION / 12)
    assert isinstance(found.members.mppi.cost.cost, CollisionCost)
    assert float(found.members.mppi.cost.cost.margin) == pytest.approx(0.1)
    smooth = ground_portfolio(DRIVE, dt=0.1, **{**SMALL, "parameterisation": Smooth()})
    np.testing.assert_allclose(
        smooth.members.mppi.proposal.noise_std,
        np.array([0.5, 1.0]) / (0.1 * math.sqrt(6.0)),
        rtol=1e-5,
    )
    knots = ground_portfolio(DRIVE, **{**SMALL, "parameterisation": Knots(3)})
    np.testing.assert_allclose(knots.members.mppi.proposal.noise_std, [0.25, 0.5], rtol=1e-5)
    contextual = ground_portfolio(
        DRIVE,
        Mission(GOAL),
        members=("cautious", "exploiter", "explorer", "balanced"),
        fusion="contextual",
        **SMALL,
    ).fusion
    assert isinstance(contextual, Contextual)
    np.testing.assert_allclose(contextual.goal, GOAL)
    assert contextual.members == (2, 3, 1, 0)
    assert isinstance(ground_portfolio(DRIVE, **SMALL).fusion, SafeFusion)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"decomposition": "temporal", "members": ("balanced",)}, r"accepted: short, middle, long"),
        ({"decomposition": "regional", "members": ("short",)}, r"accepted: left, forward, right"),
        ({"members": ()}, r"members is \(\); accepted: at least one of"),
        ({"members": {"a": {"terrain": 1.0}}}, r"objective is 'terrain'; accepted: information"),
        ({"members": {"a": {"goal": 1.0}}, "decomposition": "temporal"}, r"members is .*'roles'"),
        ({"common": {"region": 1.0}, "decomposition": "regional"}, r"differs between members"),
        ({"common": {"movers": 1.0}}, r"objective is 'movers'"),
        ({"fusion": "contextual", "members": ("explorer",)}, r"without 'balanced'"),
    ],
)
def test_bad_arguments(arguments, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ground_portfolio(DRIVE, **arguments)


# Fusion in worlds

ROBOT, STEP, STEPS = Unicycle(max_speed=1.0, max_turn_rate=3.0), 0.1, 24
WIDTH, HEIGHT, CELL = 40, 30, 0.1


def world(*blocks: tuple[float, float, float, float]) -> np.ndarray:
    """Return cells (H, W) of 4 x 3 m with blocks (x from, x to, y from, y to) [m]."""
    cells = np.zeros((HEIGHT, WIDTH), np.float32)
    for block in blocks:
        left, right, low, high = (round(value / CELL) for value in block)
        cells[low:high, left:right] = 1.0
    return cells


def known(belief: Belief, cells: np.ndarray) -> Belief:
    """Return a belief that knows all of the world."""
    grid = OccupancyGrid(cells, CELL)
    field = clearance_field(~grid.is_free, grid.frame, 1.0)
    return dataclasses.replace(belief, clearance=field)


def plan(*parts: tuple[int, float, float]) -> np.ndarray:
    """Return controls (T, 2) from parts of so many steps of (v, omega)."""
    controls = np.concatenate([np.tile([v, omega], (n, 1)) for n, v, omega in parts])
    assert len(controls) == STEPS
    return controls.astype(np.float32)


def gap(cells: np.ndarray, controls, start) -> float:
    """Return the least distance of the robot's centre from what is blocked along a plan [m]."""
    x, y, yaw = start
    low = np.argwhere(cells > 0.5)[:, ::-1] * CELL
    least = np.inf
    for v, omega in np.asarray(controls, np.float64):
        for _ in range(20):
            middle = yaw + 0.5 * omega * STEP / 20
            x, y = x + v * STEP / 20 * math.cos(middle), y + v * STEP / 20 * math.sin(middle)
            yaw += omega * STEP / 20
        away = np.maximum(np.maximum(low - [x, y], [x, y] - (low + CELL)), 0.0)
        edge = min(x, WIDTH * CELL - x, y, HEIGHT * CELL - y)
        least = min(least, edge, np.hypot(*away.T).min() if len(away) else np.inf)
    return least


@eqx.filter_jit
def fuse(fusion: SafeFusion, belief: Belief, plans, start, goal) -> tuple[Fused, Candidates]:
    costs = ((10.0 / STEPS) * CollisionCost(), GoalCost(jnp.zeros(2)))
    costs = eqx.tree_at(lambda some: some[1].goal, costs, goal)

    def evaluate(controls):
        given = (jnp.moveaxis(controls, 0, -1), jnp.asarray(STEP), belief)
        hard, away = rollout_objectives(ROBOT, costs, start, *given)
        return hard + away, hard

    candidates = Candidates(plans, *evaluate(plans), jnp.full(len(plans), 0.1))
    fused, _ = fusion((), candidates, Situation(State(start, ROBOT), belief, evaluate))
    return fused, candidates


def fused_in(belief, cells, plans, start, goal=(3.5, 1.8)) -> tuple[Fused, Candidates]:
    given = (jnp.asarray(np.stack(plans)), jnp.asarray(start), jnp.asarray(goal))
    return fuse(SafeFusion(Average()), known(belief, cells), *given)


def around(side: float) -> np.ndarray:
    return plan((6, 1.0, side), (12, 1.0, -side), (6, 1.0, side))


def test_between_left_and_right_of_a_pillar_is_the_better_one(empty_belief) -> None:
    cells, start = world((1.3, 1.5, 1.4, 1.6)), (0.4, 1.5, 0.0)
    left, right = around(1.5), around(-1.5)
    radius = float(ROBOT.radius)
    assert gap(cells, 0.5 * (left + right), start) == 0.0
    assert min(gap(cells, left, start), gap(cells, right, start)) > radius + 0.1
    for goal, better in ((1.8, 0), (1.2, 1)):
        found, said = fused_in(empty_belief, cells, [left, right], start, (3.5, goal))
        assert bool(found.is_replaced)
        np.testing.assert_array_equal(said.hazards, [0.0, 0.0])
        np.testing.assert_array_equal(found.shares, np.eye(2)[better])
        np.testing.assert_array_equal(found.controls, (left, right)[better])
        assert gap(cells, found.controls, start) > radius


def test_in_a_corridor_the_mixture_stays(empty_belief) -> None:
    cells, start = world((0.0, 4.0, 0.7, 0.9), (0.0, 4.0, 2.1, 2.3)), (0.4, 1.5, 0.0)
    plans = [around(0.6), around(-0.6), around(0.0)]
    assert min(gap(cells, one, start) for one in plans) > float(ROBOT.radius) + 0.1
    found, said = fused_in(empty_belief, cells, plans, start)
    np.testing.assert_array_equal(said.hazards, [0.0] * 3)
    assert not bool(found.is_replaced)
    np.testing.assert_allclose(found.shares, [1 / 3] * 3, rtol=1e-6)
    np.testing.assert_allclose(found.controls, np.mean(plans, axis=0), atol=1e-6)


def test_out_of_a_trap_goes_who_leaves(empty_belief) -> None:
    walls = (2.0, 2.2, 0.6, 2.4), (0.8, 2.2, 0.5, 0.7), (0.8, 2.2, 2.3, 2.5)
    cells, start = world(*walls), (1.4, 1.5, 0.0)
    on, out = plan((24, 0.8, 0.0)), plan((12, 0.1, 0.5 * math.pi * 5 / 3), (12, 0.8, 0.0))
    assert gap(cells, on, start) == 0.0
    assert gap(cells, out, start) > float(ROBOT.radius) + 0.1
    assert gap(cells, np.mean([on, on, out], axis=0), start) < float(ROBOT.radius)
    # The goal is behind the wall: to those who run into it all else is cheaper.
    found, said = fused_in(empty_belief, cells, [on, on, out], start)
    assert bool(found.is_replaced)
    np.testing.assert_array_equal(found.shares, [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(said.hazards > 0.0, [True, True, False])


def test_if_all_collide_the_least_deep_one_counts(empty_belief) -> None:
    cells, start = world((1.6, 4.0, 0.0, 3.0)), (0.6, 1.5, 0.0)
    plans = [plan((24, v, 0.0)) for v in (1.0, 0.55, 0.8)]
    found, said = fused_in(empty_belief, cells, plans, start)
    assert (np.asarray(said.hazards) > 1.0).all()
    assert bool(found.is_replaced)
    np.testing.assert_array_equal(found.shares, [0.0, 1.0, 0.0])


# The loop


@pytest.fixture(scope="module")
def scenario() -> ExplorationScenario:
    cells = np.zeros((30, 40), np.float32)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 1.0, 1.0, 1.0, 1.0
    cells[14:17, 18:21] = cells[:10, 30:32] = 1.0
    lidar = Lidar(num_beams=24, max_range=2.5, range_noise=0.01)
    perception = Perception(lidar, 0.2, 0.2, num_directions=4, goal=GOAL, is_goal_apart=True)
    grid = OccupancyGrid(cells, 0.2)
    return ExplorationScenario(grid, DRIVE, lidar, (*START, 0.0), perception=perception, goal=GOAL)


STEPS_OF_LOOP = 100


def check_members(members: Members, number: int) -> None:
    """What each member says of each step is there, finite and within its bounds."""
    steps = STEPS_OF_LOOP
    assert members.controls.shape == (steps, number, 2)
    for rows in (members.costs, members.uncertainties, members.effective_sample_sizes):
        assert rows.shape == (steps, number)
        assert np.isfinite(rows).all()
    np.testing.assert_allclose(members.shares.sum(axis=1), np.ones(steps), atol=1e-5)
    assert (np.asarray(members.shares) >= 0.0).all()
    assert members.diversity.shape == members.is_replaced.shape == (steps,)
    assert (np.asarray(members.diversity) > 0.0).any()
    assert ((members.effective_sample_sizes >= 1.0) & (members.effective_sample_sizes <= 64)).all()


def test_two_seconds_without_a_collision(scenario) -> None:
    portfolio = ground_portfolio(DRIVE, Mission(GOAL), **SMALL)
    portfolio = portfolio.at_period(scenario.control_period)
    key, steps = jax.random.key(0), STEPS_OF_LOOP
    state = initial_loop_state(portfolio, scenario, key)
    count = jnp.asarray(steps, jnp.int32)
    _, record, done = run_chunk((portfolio, scenario, key, count), copy_tree(state), steps)
    assert int(done) == steps
    assert not record.is_collision.any()
    assert record.is_finite.all()
    assert math.dist(record.state[-1, :2], START) > 0.3
    check_members(record.members, 4)


@pytest.mark.parametrize("decomposition", ["temporal", "regional"])
def test_members_that_differ_otherwise_get_on_as_well(scenario, decomposition: str) -> None:
    """Without sensors: where everything is known the loop is the step and the model."""
    portfolio = ground_portfolio(DRIVE, Mission(GOAL), decomposition=decomposition, **SMALL)
    period = scenario.control_period
    portfolio = portfolio.at_period(period)

    def drive(perception, grid, start):
        belief = perception.init(grid, start[:3])

        def advance(carry, key):
            robot, memory = carry
            control, memory, info = portfolio.step(memory, robot, belief, key=key)
            robot = DRIVE.step(robot, control, period)
            return (robot, memory), (robot, info.members)

        keys = jax.random.split(jax.random.key(0), STEPS_OF_LOOP)
        return jax.lax.scan(advance, (start, portfolio.init()), keys)[1]

    states, members = eqx.filter_jit(drive)(
        scenario.perception, scenario.world, DRIVE.at_pose(*START, 0.0)
    )
    low = 0.2 * np.argwhere(np.asarray(scenario.world.probability) > 0.5)[:, ::-1]
    places = np.asarray(states)[:, None, :2]
    away = np.maximum(np.maximum(low - places, places - (low + 0.2)), 0.0)
    assert np.hypot(away[..., 0], away[..., 1]).min() > float(DRIVE.radius)
    assert math.dist(states[-1, :2], GOAL) < math.dist(START, GOAL) - 0.3
    check_members(members, 3)
