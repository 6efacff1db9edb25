"""Disturbances of one's own, one after the other."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.simulation import Disturbance
from jaxplore.simulation.disturbances import Disturbances

ROBOT = jx.DifferentialDrive(max_speed=1.0)


class Late(Disturbance):
    """Commands come late by what an episode draws, 2 or 3 periods, and yaw is off by 0.1 rad."""

    name = "late"
    is_varying = True

    @property
    def longest_delay(self):
        return 3

    def draw(self, key, model):
        return jnp.int32(2) if key is None else jnp.int32(3)

    def observe(self, model, state, last, drawn, time, period, key):
        return state.at[2].add(0.1)

    def delay(self, drawn):
        return drawn


class Doubled(Disturbance):
    """The robot takes its state for twice as much from 1 s on."""

    name = "doubled"

    def observe(self, model, state, last, drawn, time, period, key):
        return jnp.where(time >= 1.0, 2.0 * state, state)

    def is_active(self, time):
        return time >= 1.0


@pytest.mark.parametrize("key", [None, jax.random.key(0)])
def test_delays_add_up(key) -> None:
    both = Disturbances((Late(), jx.Faults(control_delay=2)))
    assert both.longest_delay == 5
    drawn = both.draw(key, ROBOT)
    assert set(drawn) == {"late"}
    expected = collections.deque([0.0] * (4 if key is None else 5))
    pending = jnp.zeros((5, 2))
    for number in np.arange(1.0, 9.0, dtype=np.float32):
        pending, control = both.delay(pending, jnp.full(2, number), drawn)
        expected.append(float(number))
        np.testing.assert_array_equal(control, [expected.popleft()] * 2)


@pytest.mark.parametrize("time", [0.5, 1.5])
def test_measurements_pass_through_all_in_their_order(time: float) -> None:
    state, keys = jnp.arange(5.0), jax.random.key(0)
    shift = np.array([0.0, 0.0, 0.1, 0.0, 0.0])
    factor = 1.0 if time < 1.0 else 2.0
    for each, expected in (
        ((Late(), Doubled()), factor * (np.arange(5.0) + shift)),
        ((Doubled(), Late()), factor * np.arange(5.0) + shift),
    ):
        several = Disturbances(each)
        assert several.is_varying
        given = state, several.draw(None, ROBOT), jnp.asarray(time), jnp.asarray(0.1), keys
        seen, is_blind, is_active = several.observe(ROBOT, state, *given)
        np.testing.assert_allclose(seen, expected, rtol=1e-6)
        assert (bool(is_blind), bool(is_active)) == (False, time >= 1.0)


def test_without_any_nothing_is_disturbed() -> None:
    none = Disturbances(())
    now, state = (jnp.zeros(()), jnp.asarray(0.1), jax.random.key(0)), jnp.arange(5.0)
    seen, is_blind, is_active = none.observe(ROBOT, state, state, {}, *now)
    np.testing.assert_array_equal(seen, state)
    assert not bool(is_blind)
    assert not bool(is_active)
    assert none.true_robot(ROBOT, {}, jax.random.key(0), jnp.int32(0)) is ROBOT
    assert not bool(none.is_carried(jnp.zeros(()), jnp.asarray(0.1)))
    pending, control = none.delay(jnp.zeros((0, 2)), jnp.ones(2), {})
    assert pending.shape == (0, 2)
    np.testing.assert_array_equal(control, 1.0)
