"""A quadrotor that is told to stop: it comes to rest from any ordinary flight, and stays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Quadrotor

ROBOT = Quadrotor()


def flights(number: int) -> jax.Array:
    """Random states: speeds up to 4 m/s, tilts up to 50 degrees, rates up to 3 rad/s."""
    rng = np.random.default_rng(0)
    position = np.zeros((number, 3))
    velocity = rng.uniform(-1.0, 1.0, (number, 3)) * [2.8, 2.8, 1.0]
    attitude = np.concatenate([np.ones((number, 1)), rng.uniform(-0.3, 0.3, (number, 3))], axis=1)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    rates = rng.uniform(-3.0, 3.0, (number, 3))
    return jnp.asarray(np.concatenate([position, velocity, attitude, rates], axis=1), jnp.float32)


@jax.jit
def braked(states: jax.Array, dt: jax.Array, turn: jax.Array) -> jax.Array:
    """Brake for 150 steps; return the states (150, B, 13)."""

    def step(state, _):
        after = jax.vmap(lambda one: ROBOT.step(one, ROBOT.stopping_control(one, dt, turn), dt))(
            state
        )
        return after, after

    return jax.lax.scan(step, states, None, length=150)[1]


@pytest.mark.parametrize("dt", [0.02, 0.05])
@pytest.mark.parametrize("turn", [0.0, 1.0, -1.0])
def test_it_comes_to_rest_and_hovers(dt: float, turn: float) -> None:
    states = np.asarray(braked(flights(32), jnp.float32(dt), jnp.float32(turn)))
    speed = np.linalg.norm(states[:, :, 3:6], axis=-1)
    assert speed[-1].max() < (0.02 if dt == 0.05 else 0.15)
    # Level, and without rates.
    assert states[-1, :, 6].min() > 0.0 or np.abs(states[-1, :, 7:9]).max() < 0.05
    assert np.abs(states[-1, :, 7:9]).max() < 0.05
    # At most 0.8 gravity: the distance is that of a time constant and of the turn of the thrust.
    travelled = np.linalg.norm(states[-1, :, :2], axis=-1)
    start = np.linalg.norm(np.asarray(flights(32))[:, 3:5], axis=-1)
    assert (travelled <= 0.8 * start + 0.6).all()


def test_a_turn_evades_to_its_side() -> None:
    north = jnp.zeros((1, 13)).at[:, 3].set(3.0).at[:, 6].set(1.0)
    east = [
        float(braked(north, jnp.float32(0.05), jnp.float32(turn))[-1, 0, 1])
        for turn in (-1.0, 0.0, 1.0)
    ]
    assert east[1] == pytest.approx(0.0, abs=1e-3)
    assert abs(east[0]) > 0.3
    assert east[2] == pytest.approx(-east[0], abs=1e-2)


def test_at_rest_it_hovers_exactly() -> None:
    rest = ROBOT.at_pose(1.0, 2.0, 0.7)
    control = ROBOT.stopping_control(rest, jnp.float32(0.02))
    np.testing.assert_allclose(control, ROBOT.default_control, atol=1e-5)


def test_it_does_not_read_the_position() -> None:
    state = flights(1)[0]
    there = state.at[:3].set(jnp.array([5.0, -3.0, 2.0]))
    dt = jnp.float32(0.02)
    np.testing.assert_array_equal(
        ROBOT.stopping_control(state, dt), ROBOT.stopping_control(there, dt)
    )
