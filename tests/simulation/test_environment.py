import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Faults, Lidar, Perception, Quadrotor
from jaxplore.control.base import Controller
from jaxplore.planning import waypoint_mppi
from jaxplore.simulation.environment.action_modes import (
    ControlMode,
    WaypointMode,
)
from jaxplore.simulation.environment.environment import Environment
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import record_run

pytestmark = pytest.mark.long

KEY = jax.random.key(5)
FIRST = jnp.asarray(0, jnp.int32)
AHEAD = jnp.asarray([1.0, 0.0])


@eqx.filter_jit
def begin(environment, key=KEY, choice=FIRST):
    return environment.init(key, choice)


@eqx.filter_jit
def step(environment, state, action, num_steps):
    return environment.step(state, action, num_steps)


def reset(environment, key=KEY, choice=FIRST):
    """Reset with the program that steps, so that there is one less to compile."""
    return step(
        environment, begin(environment, key, choice), environment.mode.low, jnp.zeros((), jnp.int32)
    )


def advance(environment, state, action):
    return step(environment, state, action, environment.steps_per_action)


@pytest.fixture(scope="module")
def scenario(make):
    return make()[1]


@pytest.fixture(scope="module")
def controls(scenario):
    """Return a maker of environments that all share one compiled step."""

    def environment(given=scenario, **options):
        return Environment(given, ControlMode(scenario.robot), **options)

    return environment


@pytest.fixture(scope="module")
def wander(scenario):
    """Random controls that go ahead more often than not."""
    rng = np.random.default_rng(0)
    low, high = np.asarray(scenario.robot.control_min), np.asarray(scenario.robot.control_max)
    return [jnp.asarray(rng.uniform([-0.2, low[1]], high), jnp.float32) for _ in range(40)]


def test_the_explorer_sees_and_does_in_it_what_it_does_in_a_run(make, controls) -> None:
    controller, scenario = make()
    recording = record_run(controller, scenario, 60, key=KEY, num_trajectories=0)
    controller = controller.at_period(scenario.control_period)
    environment = controls(action_period=0.02)
    state, outcome = reset(environment)

    @eqx.filter_jit
    def decide(controller: Controller, memory, state):
        _, key = jax.random.split(jax.random.fold_in(state.key, state.loop.step))
        control, memory, _ = controller.step(memory, state.moment.observed, state.belief, key=key)
        return control, memory

    memory = controller.init()
    for k in range(60):
        np.testing.assert_allclose(
            outcome.facts["coverage"], recording.records.coverage[k], rtol=1e-6
        )
        np.testing.assert_allclose(
            outcome.facts["entropy"], recording.records.entropy[k], rtol=1e-6
        )
        control, memory = decide(controller, memory, state)
        # Two programs round in two ways, of which the softmax makes more.
        np.testing.assert_allclose(control, recording.records.control[k], atol=5e-3)
        # The very same command, so that nothing adds up.
        state, outcome = advance(environment, state, jnp.asarray(recording.records.control[k]))
        np.testing.assert_array_equal(state.loop.task.robot, recording.records.state[k])
    moves = np.linalg.norm(np.diff(recording.positions, axis=0), axis=1)
    np.testing.assert_allclose(outcome.statistics.path_length, moves.sum(), rtol=1e-5)


def test_an_action_is_as_many_shorter_ones(controls, wander) -> None:
    long, short = controls(action_period=0.14), controls(action_period=0.02)
    assert int(long.steps_per_action) == 7
    (state, _), (pieces, _) = reset(long), reset(short)
    for action in wander[:6]:
        state, whole = advance(long, state, action)
        reward = 0.0
        for _ in range(7):
            pieces, part = advance(short, pieces, action)
            reward += float(part.reward)
        for a, b in zip(jax.tree.leaves(state.loop), jax.tree.leaves(pieces.loop), strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(whole.observation["scan"], part.observation["scan"])
        np.testing.assert_array_equal(whole.observation["belief"], part.observation["belief"])
        np.testing.assert_allclose(whole.reward, reward, atol=1e-4)


def test_rewards_add_up_to_the_entropy_that_was_lost(controls, scenario, wander) -> None:
    environment = controls(collision_penalty=0.0)
    assert int(environment.steps_per_action) == int(scenario.steps_per_scan) == 5
    state, first = reset(environment)
    assert float(first.reward) == 0.0
    rewards = []
    for action in wander:
        state, outcome = advance(environment, state, action)
        rewards.append(float(outcome.reward))
    p = np.clip(np.asarray(state.belief.grid.unpad().probability, np.float64), 1e-12, 1 - 1e-12)
    cells = np.asarray(scenario.reachable)
    entropy = -(p * np.log(p) + (1 - p) * np.log(1 - p))[cells].sum()
    np.testing.assert_allclose(outcome.facts["entropy"], entropy, rtol=1e-4)
    lost = (float(first.facts["entropy"]) - entropy) / (math.log(2.0) * cells.sum())
    np.testing.assert_allclose(sum(rewards), 100.0 * lost, rtol=1e-3)
    assert sum(rewards) > 3.0


def test_a_contact_costs_by_the_second_and_successive_steps_are_one(controls) -> None:
    free = controls(collision_penalty=0.0)
    dear, fine = controls(collision_penalty=2.0), controls(action_period=0.02)
    (state, _), (fined, _), (slow, _) = reset(free), reset(dear), reset(fine)
    is_contact, statistics = [False], []
    for _ in range(20):
        state, outcome = advance(free, state, AHEAD)
        fined, paid = advance(dear, fined, AHEAD)
        for _ in range(5):
            slow, step = advance(fine, slow, AHEAD)
            is_contact.append(bool(step.is_collision))
        contact = np.array(is_contact[-5:])
        assert bool(outcome.is_collision) == contact.any()
        np.testing.assert_allclose(
            outcome.reward - paid.reward, 2.0 * 0.02 * contact.sum(), atol=1e-5
        )
        statistics.append(outcome.statistics)
    assert any(is_contact)
    assert int(statistics[-1].collision_steps) == sum(is_contact)
    assert int(statistics[-1].collisions) == (np.diff(np.array(is_contact, int)) == 1).sum()


def test_the_observation_is_of_where_the_robot_is(controls, scenario, wander) -> None:
    environment = controls()
    state, outcome = reset(environment)
    for action in wander[:20]:
        state, outcome = advance(environment, state, action)
    seen = outcome.observation
    pose = np.asarray(state.loop.task.robot[:3])
    np.testing.assert_allclose(seen["pose"][:2], pose[:2])
    turns = (float(seen["pose"][2]) - float(pose[2])) / (2.0 * math.pi)
    np.testing.assert_allclose(turns, round(turns), atol=1e-6)
    assert abs(float(seen["pose"][2])) <= math.pi
    np.testing.assert_array_equal(seen["state"][:3], seen["pose"])
    np.testing.assert_array_equal(seen["state"][3:], state.loop.task.robot[3:])
    # By hand: beams of the lidar in the true world, but for its noise of 1 cm.
    exact = Lidar(72, 1.5, range_noise=0.0)
    true = eqx.filter_jit(exact.scan)(scenario.world, jnp.asarray(pose), key=KEY).ranges
    np.testing.assert_allclose(seen["scan"], true, atol=0.06)
    np.testing.assert_array_equal(seen["belief"], state.belief.grid.unpad().probability)


def test_a_view_is_the_belief_around_the_robot(make, controls) -> None:
    scenario = make(start=(3.13, 2.04, 0.7))[1]
    state, _ = reset(controls(scenario))
    # What it observes; the step that leads there is that of all.
    observation = controls(scenario, view=1.6).agent_view(0).observation
    seen = eqx.filter_jit(observation)(state.perceived, state.moment, state.belief)
    view, (x, y, yaw) = np.asarray(seen["belief"]), np.asarray(seen["pose"])
    assert view.shape == (16, 16)
    belief = np.asarray(state.belief.grid.probability)
    differing = 0
    for row in range(16):
        for column in range(16):
            ahead, left = (column - 7.5) * 0.1, (row - 7.5) * 0.1
            px = x + math.cos(yaw) * ahead - math.sin(yaw) * left
            py = y + math.sin(yaw) * ahead + math.cos(yaw) * left
            differing += view[row, column] != belief[math.floor(py / 0.1), math.floor(px / 0.1)]
    assert differing <= 1  # on an edge between two cells


def test_an_episode_ends_where_it_is_covered_or_its_time_is_up(make, controls) -> None:
    environment = controls(make(start=(3.0, 2.0, math.pi), target=0.35)[1])
    state, outcome = reset(environment)
    assert float(outcome.facts["coverage"]) < 0.35
    for _ in range(40):
        state, outcome = advance(environment, state, AHEAD)
        assert bool(outcome.is_terminated) == (float(outcome.facts["coverage"]) >= 0.35)
        assert not bool(outcome.is_truncated)
        if outcome.is_terminated:
            break
    assert bool(outcome.is_terminated)
    again, after = advance(environment, state, AHEAD)
    np.testing.assert_array_equal(again.loop.task.robot, state.loop.task.robot)
    assert bool(after.is_terminated)
    assert int(after.num_steps) == int(outcome.num_steps)

    environment = controls(time_limit=0.46)
    state, outcome = reset(environment)
    for _ in range(5):
        assert not bool(outcome.is_truncated)
        state, outcome = advance(environment, state, AHEAD)
    assert bool(outcome.is_truncated)
    assert not bool(outcome.is_terminated)
    assert int(outcome.num_steps) == 23


def test_the_end_may_come_within_an_action(make, controls) -> None:
    _, scenario = make(start=(3.0, 2.0, math.pi), target=0.35)
    short, long = controls(scenario), controls(scenario, action_period=30.0)
    state, outcome = reset(short)
    while not outcome.is_terminated:
        state, outcome = advance(short, state, AHEAD)
        assert int(outcome.num_steps) < 1000
    _, whole = advance(long, reset(long)[0], AHEAD)
    assert bool(whole.is_terminated)
    assert int(whole.num_steps) == int(outcome.num_steps)


def test_one_of_several_scenarios_is_as_it_is_alone(make, controls, other_world, wander) -> None:
    scenarios = [make()[1], make(other_world, start=(1.0, 1.0, 0.5))[1]]
    both = controls(scenarios)
    assert both.num_scenarios == 2
    for index, alone in enumerate(scenarios):
        one = controls(alone)
        state, _ = reset(both, choice=jnp.asarray(index, jnp.int32))
        same, _ = reset(one)
        for action in wander[:5]:
            state, outcome = advance(both, state, action)
            same, other = advance(one, same, action)
        for a, b in zip(jax.tree.leaves(outcome), jax.tree.leaves(other), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)
        np.testing.assert_array_equal(both.scenario(jnp.asarray(index)).start, alone.start)


def test_a_blind_robot_keeps_its_last_scan(make, controls) -> None:
    _, faulty = make(faults=Faults(scan_dropout=(0.15, 0.35)))
    environment = controls(faulty)
    state, outcome = reset(environment)
    scans = [np.asarray(outcome.observation["scan"])]
    for _ in range(5):
        state, outcome = advance(environment, state, AHEAD)
        scans.append(np.asarray(outcome.observation["scan"]))
    is_same = [np.array_equal(a, b) for a, b in itertools.pairwise(scans)]
    assert is_same == [False, True, True, False, False]


def test_waypoints_are_reached_around_walls_without_touching_and_end_at_the_goal(scenario) -> None:
    lidar = scenario.sensors[0]
    goal, radius = np.array([5.0, 2.0]), 0.3  # behind the wall of the U, which is not known yet
    to_goal = ExplorationScenario(
        scenario.world,
        scenario.robot,
        lidar,
        (3.0, 2.0, 0.0),
        perception=Perception(lidar, 0.1, 0.2, num_directions=16, goal=goal, max_unknown=1.0),
        goal=goal,
        goal_radius=radius,
        goal_speed=10.0,  # in motion, so that the step in which it gets there is known
        max_unknown=1.0,
    )
    environment = Environment(
        to_goal,
        WaypointMode(waypoint_mppi(scenario.robot, num_samples=128), 6.0),
        action_period=1.0,
    )
    state, outcome = reset(environment)
    distances = []
    for _ in range(30):
        x, y, yaw = np.asarray(outcome.observation["pose"])
        offset = goal - [x, y]
        distances.append(float(np.hypot(*offset)))
        assert bool(outcome.is_terminated) == (distances[-1] < radius)
        if outcome.is_terminated:
            break
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        state, outcome = advance(environment, state, jnp.asarray(turn @ offset, jnp.float32))
    # The episode ends in the step of 0.02 s in which it gets there.
    assert radius - 0.02 - 1e-3 < distances[-1] < radius
    assert max(distances) > distances[0] + 0.3  # it had to go back first
    assert int(outcome.statistics.collision_steps) == 0


def test_bad_input_is_refused(make, controls, scenario) -> None:
    mode = ControlMode(scenario.robot)
    with pytest.raises(ValueError, match="scenarios is"):
        Environment([], mode)
    with pytest.raises(ValueError, match="on the ground"):
        waypoint_mppi(Quadrotor())
    coarse = Lidar(num_beams=36, max_range=1.5)
    other = ExplorationScenario(
        scenario.world,
        scenario.robot,
        coarse,
        (3.0, 2.0, 0.0),
        perception=Perception(coarse, 0.1, 0.2, num_directions=16),
    )
    with pytest.raises(ValueError, match=r"scenarios\[1\] differs"):
        Environment([scenario, other], mode)
