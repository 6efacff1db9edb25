"""A fleet with a goal: it ends when one robot is there, and not before it has explored."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from tests import kinds

from jaxplore import ExplorationScenario, Fleet, Perception
from jaxplore.control.fleet_share import Share
from jaxplore.dynamics.goal import Motion

pytestmark = pytest.mark.long

STARTS = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4))
GOAL = (2.3, 2.2)


def to_goal(alone, goal=GOAL, **given):
    perception = Perception(
        alone.sensors, 0.1, 0.15, num_directions=4, max_clearance=0.5, goal=goal
    )
    return ExplorationScenario(
        alone.world, alone.robot, alone.sensors, STARTS[0], perception=perception,
        control_rate=20.0, field_rate=4.0, goal=goal, **given,
    )  # fmt: skip


@pytest.fixture(scope="module")
def driven(alone, run):
    """Return a fleet that knows the map, and its run to the goal."""
    one = to_goal(alone, prior=alone.world)
    controller, fleet = kinds.fleet(one, STARTS)
    return fleet, *run(controller, fleet, 120)


def test_the_run_ends_when_one_robot_is_at_the_goal(driven) -> None:
    fleet, state, records = driven
    places = np.stack([each[:, :2] for each in np.split(records.state, 2, axis=1)])
    away = np.hypot(*(places - np.asarray(GOAL)).transpose(2, 0, 1))
    used = int(state.step)
    assert 20 < used < 120
    assert not bool(fleet.is_unfinished(state.task))
    # At rest within 0.15 m: one of them, and the other was on its way.
    assert away[:, used - 1].min() <= 0.15
    assert (away[:, : used - 1] > 0.15).all(axis=0)[: used // 2].all()
    assert not records.parts["team"].is_contact.any()


def test_a_fleet_explores_before_it_is_finished_at_the_goal(driven) -> None:
    fleet, state, _ = driven
    task = state.task
    explored = [
        dataclasses.replace(each.belief, is_explored=jnp.array(False)) for each in task.members
    ]
    members = tuple(each.with_belief(b) for each, b in zip(task.members, explored, strict=True))
    unknown = task._replace(members=members, coverage=jnp.asarray(0.5))
    assert not bool(fleet.is_finished(unknown))
    # What another robot knows counts for all, and so does what this one has left to explore.
    assert bool(fleet.is_finished(unknown._replace(coverage=jnp.asarray(0.995))))
    assert bool(fleet.is_finished(task._replace(coverage=jnp.asarray(0.5))))
    fast = [each._replace(motion=Motion(jnp.asarray(0.5), jnp.zeros(()))) for each in task.members]
    assert not bool(fleet.is_finished(task._replace(members=tuple(fast))))
    gain = task.gain._replace(since=jnp.asarray(1e6))
    assert not bool(fleet.is_given_up(task._replace(gain=gain)))


def test_robots_have_one_goal(alone) -> None:
    one, other = to_goal(alone), to_goal(alone, (1.5, 1.5))
    with pytest.raises(
        ValueError, match=r"goal of robots\[1\] is \[1\.5, 1\.5\]; accepted: that of"
    ):
        Fleet([one, other], STARTS)
    with pytest.raises(ValueError, match="goal of the robots is given; accepted in several proc"):
        Fleet(one, STARTS).with_share(Share((0,), 2, lambda mine: mine))
