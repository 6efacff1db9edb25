"""What tests of models share: the model's flight, and the exact one in double precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp


@eqx.filter_jit
def _fly(robot, state, controls, dt):
    def advance(state, control):
        reached = robot.step(state, control, dt)
        return reached, reached

    return jax.lax.scan(advance, state, controls)[1]


@pytest.fixture(scope="session")
def fly():
    """Return `fly(robot, state, controls, dt)`: states (T, nx) under controls (T, nu)."""

    def flight(robot, state, controls, dt):
        steps, size = np.shape(controls)
        # Of few lengths, so that few are compiled.
        padded = np.zeros((200 if steps <= 200 else 1000, size))
        padded[:steps] = controls
        states = _fly(robot, *(jnp.asarray(given, jnp.float32) for given in (state, padded, dt)))
        return np.asarray(states, np.float64)[:steps]

    return flight


@pytest.fixture(scope="session")
def solve():
    """Return `solve(derivative, state, controls, dt)`: the same by DOP853, not by the library.

    Controls are held over a step; `derivative(state, control)` is in NumPy.
    """

    def solution(derivative, state, controls, dt):
        states = [np.asarray(state, np.float64)]
        for control in np.asarray(controls, np.float64):
            solved = solve_ivp(
                lambda _, x, u=control: derivative(x, u),
                (0.0, dt),
                states[-1],
                method="DOP853",
                rtol=1e-10,
                atol=1e-12,
            )
            states.append(solved.y[:, -1])
        return np.array(states[1:])

    return solution
