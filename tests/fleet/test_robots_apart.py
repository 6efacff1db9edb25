"""Robots stop before they touch one another, and foresee plans that they were told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive
from jaxplore.belief.obstacles import FRESH, Plans
from jaxplore.dynamics import Formation
from jaxplore.simulation.fleet.contact import find_room, predict_positions, stop_touching

ROBOT = DifferentialDrive(max_speed=1.0, radius=0.2)
THREE = Formation([ROBOT] * 3)
RADII = jnp.full(3, 0.2)
stop = jax.jit(lambda before, moved: stop_touching(THREE, RADII, before, moved))


def states(*places):
    return tuple(ROBOT.at_pose(*place, 0.0) for place in places)


def test_those_that_would_touch_stop_and_the_others_move() -> None:
    before = states((0.0, 0.0), (0.42, 0.0), (3.0, 0.0))
    after = stop(before, states((0.02, 0.0), (0.40, 0.0), (3.1, 0.0)))
    np.testing.assert_array_equal(after.is_contact, [True, True, False])
    places = THREE.positions(jnp.concatenate(after.states))
    np.testing.assert_allclose(places, [[0.0, 0.0], [0.42, 0.0], [3.1, 0.0]], atol=1e-6)
    np.testing.assert_allclose(after.gap, [0.02, 0.02, 2.28], atol=1e-5)


def test_a_robot_is_put_down_where_it_touches_no_other() -> None:
    here = jnp.array([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]])

    def rooms(*landings):
        put = [None if each is None else jnp.array([*each, 1.0]) for each in landings]
        return np.asarray(find_room(put, here, RADII)).tolist()

    assert rooms((9.0, 0.0), (12.0, 0.0), (0.0, 2.0)) == [True] * 3
    # On one that stays, on one that is put down beside it, and where the robot itself stands.
    assert rooms((2.7, 0.0), None, None)[0] is False
    assert rooms((9.0, 0.0), (9.0, 0.39), (6.0, 0.2)) == [False, False, True]
    assert rooms((9.0, 0.0), (9.0, 0.41), None) == [True] * 3


def test_a_robot_that_would_drive_into_one_that_has_stopped_stops_as_well() -> None:
    """The first two meet head on; the third follows the second, which would have made room."""
    before = states((0.0, 0.0), (0.41, 0.0), (0.82, 0.0))
    after = stop(before, states((0.02, 0.0), (0.39, 0.0), (0.80, 0.0)))
    np.testing.assert_array_equal(after.is_contact, [True] * 3)
    moved = stop(before, states((-0.02, 0.0), (0.39, 0.0), (0.80, 0.0)))
    assert not moved.is_contact.any()


def test_the_order_of_the_robots_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        old = np.array([[0.0, 0.0], [0.45, 0.0], [0.2, 0.42]])
        new = old + rng.uniform(-0.05, 0.05, (3, 2))
        order = rng.permutation(3)
        one = stop(states(*old), states(*new))
        other = stop(states(*old[order]), states(*new[order]))
        np.testing.assert_array_equal(np.asarray(one.is_contact)[order], other.is_contact)
        np.testing.assert_array_equal(jnp.stack(one.states)[order], jnp.stack(other.states))
        assert (np.asarray(one.gap) >= 0.0).all()


def test_planned_positions_are_those_of_steps_of_the_model() -> None:
    begin = states((0.0, 0.0), (1.0, 0.0), (2.0, 0.0))
    controls = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (4, 6)), jnp.float32)
    dt = jnp.float32(0.1)
    found = jax.jit(lambda: predict_positions(THREE, begin, controls, 7, dt))()
    assert found.shape == (3, 7, 2)
    for i in range(3):
        now = begin[i]
        for k in range(7):
            np.testing.assert_allclose(found[i, k], ROBOT.position(now), atol=1e-5)
            # After the last planned control it is kept.
            now = ROBOT.step(now, controls[min(k, 3), 2 * i : 2 * i + 2], dt)


def test_a_plan_shifts_an_obstacle_as_long_as_it_is_fresh() -> None:
    line = jnp.stack([jnp.arange(5.0), jnp.zeros(5)], axis=-1)[None]
    plans = Plans.unknown(1, 5, jnp.float32(0.1)).update(line, jnp.array([True]))
    np.testing.assert_allclose(plans.shift(jnp.float32(0.25)), [[2.5, 0.0]], atol=1e-5)
    np.testing.assert_allclose(plans.shift(jnp.float32(9.0)), [[4.0, 0.0]], atol=1e-5)
    older = plans.advance(jnp.float32(0.1))
    np.testing.assert_allclose(older.shift(jnp.float32(0.25)), [[2.5, 0.0]], atol=1e-5)
    assert not plans.advance(jnp.float32(FRESH)).is_fresh.any()
    assert not Plans.unknown(2, 5, jnp.float32(0.1)).is_fresh.any()


def test_a_formation_is_its_robots_side_by_side() -> None:
    assert THREE.state_names[:3] == ("x_1", "y_1", "yaw_1")
    assert THREE.control_size == 3 * ROBOT.control_size
    state = jnp.concatenate(states((0.0, 1.0), (2.0, 3.0), (4.0, 5.0)))
    control = jnp.arange(6.0) / 6.0
    after = THREE.step(state, control, jnp.float32(0.05))
    for i, part in enumerate(THREE.split_state(after)):
        own = THREE.split_state(state)[i], THREE.split_control(control)[i]
        np.testing.assert_array_equal(part, ROBOT.step(*own, jnp.float32(0.05)))
    with pytest.raises(ValueError, match="robots is empty"):
        Formation([])
