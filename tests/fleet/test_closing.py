"""A robot of a fleet that closes a loop tells its map anew, and keeps what it has heard."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import ExplorationScenario, Fleet, Perception
from jaxplore.control.fleet_share import Share
from jaxplore.control.guard import MotionGuard
from jaxplore.localisation import Localiser, Odometry
from jaxplore.robot.localisation import Localisation
from jaxplore.simulation.fleet.closing import close_loops
from jaxplore.simulation.loop import initial_loop_state

pytestmark = pytest.mark.long

STARTS = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4))
SHIFT = (0.2, -0.1, 0.3)


class Shifted(ExplorationScenario):
    """An exploration whose robot finds itself elsewhere, with the map of its scans there."""

    def close_loops(self, task):
        place = task.own.place
        known = place.known._replace(pose=place.known.pose + jnp.asarray(SHIFT))
        probability = task.belief.grid.probability.at[20:24, 5:9].set(0.9)
        probability = probability.at[0:3, :50].set(0.2)
        belief = dataclasses.replace(
            task.belief, grid=task.belief.grid.with_probability(probability)
        )
        own = task.own._replace(place=place._replace(known=known), belief=belief)
        return task._replace(own=own)


@pytest.fixture(scope="module")
def located(alone):
    perception = Perception(
        alone.sensors, 0.1, 0.15, num_directions=4, max_clearance=0.5, is_localising=True
    )
    return Shifted(
        alone.world,
        alone.robot,
        alone.sensors,
        STARTS[0],
        perception=perception,
        control_rate=20.0,
        field_rate=4.0,
        localisation=Localisation(Odometry(), Localiser(capacity=16)),
    ).with_guard(MotionGuard())


def test_a_map_that_has_moved_takes_the_place_of_what_was_told(located, fleet) -> None:
    controller, two = fleet()
    two = Fleet(located, STARTS, plan_length=10)
    state = initial_loop_state(controller, two, jax.random.key(0))
    rng = np.random.default_rng(2)
    heard = state.task.team.heard
    shape = heard.log_odds.shape
    told = np.where(rng.random(shape) < 0.3, rng.normal(0.0, 2.0, shape), 0.0).astype(np.float32)
    team = state.task.team._replace(heard=heard._replace(log_odds=jnp.asarray(told)))
    state = state._replace(task=state.task._replace(team=team))
    after = close_loops(two.members, two.robot, two.identity, state, 0)

    # In float64: the own contribution is that of the new map, the other's is as it was heard.
    scenario = two.members[0]
    own = np.asarray(scenario.close_loops(state.task.members[0]).belief.grid.probability, float)
    prior = np.asarray(scenario.map_arrays.prior.probability, float)

    def log_odds(values):
        values = np.clip(values, 1e-6, 1.0 - 1e-6)
        return np.log(values / (1.0 - values))

    mine = log_odds(own) - log_odds(prior)
    found = np.asarray(after.task.team.heard.log_odds)
    np.testing.assert_allclose(found[0, 0], mine, atol=1e-4)
    np.testing.assert_array_equal(found[[0, 1, 1], [1, 0, 1]], told[[0, 1, 1], [1, 0, 1]])
    model = scenario.perception.sensor_model
    total = np.clip(log_odds(prior) + mine + told[0, 1], model.minimum, model.maximum)
    merged = np.asarray(after.task.team.merged[0])
    # Nobody sees beyond the map, where its array is filled up with walls.
    on_map = prior < 0.99
    exact = 1.0 / (1.0 + np.exp(-total))
    np.testing.assert_allclose(merged[on_map], exact[on_map], atol=2e-5)
    belief = after.task.members[0].belief
    np.testing.assert_array_equal(belief.grid.probability, merged)
    # The clearance is that of the merged map.
    assert (np.asarray(belief.clearance.values)[~np.asarray(belief.grid.is_free)] == 0.0).all()

    # The pose has moved, and the guard does not take that for a jump of the robot.
    poses = [located.robot.pose(each) for each in two.robot.split_state(after.observed)]
    np.testing.assert_allclose(poses[0], np.add(STARTS[0], SHIFT), atol=1e-5)
    np.testing.assert_allclose(poses[1], STARTS[1], atol=1e-6)
    expected = located.robot.pose(after.guard.robots[0].expected)
    np.testing.assert_allclose(expected, poses[0], atol=1e-5)
    # The loop gives the memory of its state away, so nothing in it is there twice.
    leaves = [leaf for leaf in jax.tree.leaves(after) if isinstance(leaf, jax.Array)]
    places = [leaf.unsafe_buffer_pointer() for leaf in leaves if leaf.size > 100]
    assert len(set(places)) == len(places)
    # The true state and the other robot stay as they were.
    np.testing.assert_array_equal(after.task.robot, state.task.robot)
    np.testing.assert_array_equal(after.task.team.merged[1], state.task.team.merged[1])


def test_robots_find_their_poses_or_none_does(located, alone) -> None:
    with pytest.raises(ValueError, match=r"localisation of robots\[1\] differs; accepted: as"):
        Fleet([located, alone.with_guard(MotionGuard())], STARTS)
    with pytest.raises(ValueError, match="localisation of the robots is given; accepted in sev"):
        Fleet(located, STARTS).with_share(Share((0,), 2, lambda mine: mine))
