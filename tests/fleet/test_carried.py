"""Robots of a fleet are carried away, each to a place of its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import STARTS

from jaxplore import ExplorationScenario, Faults, Fleet
from jaxplore.control.base import Info
from jaxplore.simulation.state import Moment

pytestmark = pytest.mark.long


def carried(alone, **faults) -> Fleet:
    one = ExplorationScenario(
        alone.world,
        alone.robot,
        alone.sensors,
        STARTS[0],
        perception=alone.perception,
        control_rate=20.0,
        field_rate=4.0,
    ).with_disturbances([Faults(**faults)])
    return Fleet(one, STARTS[:2], plan_length=10)


def test_each_robot_is_put_down_at_a_place_of_its_own(alone) -> None:
    two = carried(alone, carried_at=0.0)
    state, _ = two.init(jax.random.key(4))
    drawn = [np.asarray(each.landing) for each in state.members]
    assert np.hypot(*(drawn[0] - drawn[1])[:2]) > 0.3, "each has a draw of its own"
    landings = np.array([[2.8, 2.8, 1.0], [5.5, 2.6, -1.0]], np.float32)
    pairs = zip(state.members, landings, strict=True)
    members = tuple(each._replace(landing=jnp.asarray(place)) for each, place in pairs)
    state = state._replace(members=members)
    off, nothing = jnp.array(False), jnp.zeros(())
    moment = Moment(jnp.int32(0), nothing, state.robot, off, off)
    control = two.robot.default_control
    info = Info(control[None], nothing[None], nothing[None], nothing, jnp.array(True))
    after, record = two.advance(state, control, moment, info)
    np.testing.assert_array_equal(record.is_carried, [True, True])
    np.testing.assert_allclose(two.robot.positions(after.robot), landings[:, :2], atol=1e-6)
    # Where both would be put down at one place, neither is.
    same = state.members[1]._replace(landing=state.members[0].landing)
    state = state._replace(members=(state.members[0], same))
    after, record = two.advance(state, control, moment, info)
    np.testing.assert_array_equal(record.is_carried, [False, False])
    starts = np.array(STARTS[:2])[:, :2]
    np.testing.assert_allclose(two.robot.positions(after.robot), starts, atol=1e-6)


def test_what_a_fleet_cannot_be_carried_to_is_refused(alone) -> None:
    with pytest.raises(ValueError, match=r"faults.carried_to is .* for 2 robots; accepted: with"):
        carried(alone, carried_at=1.0, carried_to=(1.0, 1.0, 0.0))
