"""Each robot of a fleet differs from its model by a draw of its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Faults, Fleet, Variation

pytestmark = pytest.mark.long

PLACES = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4), (1.9, 1.5, 0.1))
KEY = jax.random.key(5)


def test_robots_draw_their_own_numbers_which_move_with_them(alone) -> None:
    varied = alone.with_disturbances([Variation(gain=(0.5, 1.5), slip=(0.0, 0.3))])
    fleet = Fleet(varied, PLACES)
    drawn = fleet.disturbances.draw(KEY, fleet.robot)
    gains = np.stack([each["variation"].gain for each in drawn])
    assert len(np.unique(gains)) == gains.size
    order = [2, 0, 1]
    moved = Fleet(varied, [PLACES[i] for i in order])
    again = moved.disturbances.draw(KEY, moved.robot)
    np.testing.assert_array_equal(
        np.stack([each["variation"].gain for each in again]), gains[order]
    )
    # A robot moves by its own motors and slip: those of its model, as a robot alone computes them.
    true = fleet.disturbances.true_robot(fleet.robot, drawn, KEY, jnp.int32(3))
    control = jnp.asarray([0.3, 0.2, -0.4, 0.1, 0.5, -0.6])
    after = true.step(fleet.start, control, jnp.float32(0.05))
    states, controls = fleet.robot.split_state(fleet.start), fleet.robot.split_control(control)
    for robot, state, own, each in zip(
        true.split_state(after), states, controls, drawn, strict=True
    ):
        mine = each["variation"]
        model = alone.robot.step(state, mine.gain * own, jnp.float32(0.05))
        lost = np.where([name in ("x", "y") for name in alone.robot.state_names], mine.slip, 0.0)
        np.testing.assert_allclose(robot, state + (1.0 - lost) * (model - state), atol=1e-6)
    # Without a key nothing is random: the middle of each interval.
    middle = fleet.disturbances.draw(None, fleet.robot)
    assert [float(each["variation"].slip) for each in middle] == pytest.approx([0.15] * 3)


def test_each_robot_has_its_own_delay_beside_that_of_the_faults(alone) -> None:
    """The first varies by up to 3 periods, the second not at all, the third by up to 1."""
    late = Faults(control_delay=2)
    others = [[Variation(control_delay=(3, 3))], [], [Variation(control_delay=(0, 1))]]
    fleet = Fleet([alone.with_disturbances([*each, late]) for each in others], PLACES)
    together = fleet.disturbances
    assert together.longest_delay == 5
    drawn = together.draw(KEY, fleet.robot)
    assert drawn[1] == {}
    pending = jnp.zeros((5, 6))
    given = np.arange(1.0, 10.0, dtype=np.float32)
    taken = []
    for number in given:
        pending, control = together.delay(pending, jnp.full(6, number), drawn)
        taken.append(np.asarray(control)[::2])
    periods = [5, 2, 2 + int(drawn[2]["variation"].control_delay)]
    expected = [[max(number - each, 0.0) for each in periods] for number in given]
    np.testing.assert_array_equal(taken, expected)


def test_a_variation_of_what_robots_do_not_have_is_named(alone) -> None:
    fleet = Fleet(alone, PLACES[:2])
    assert fleet.disturbances.draw(KEY, fleet.robot) == ({}, {})
    varied = fleet.with_disturbances([Variation(gain=(0.8, 0.9))])
    assert all(varied.disturbances.draw(KEY, varied.robot))
    with pytest.raises(ValueError, match=r"mass"):
        fleet.with_disturbances([Variation({"mass": (0.9, 1.1)})])
