import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import RK4, Euler

START = np.array([1.2, -0.4])
CONTROL = np.array([0.5])
FORWARD = st.floats(-3, 3, width=32)


def swing(state, control):
    """A driven, damped pendulum: not linear, so that no order comes for free."""
    angle, rate = state
    return jnp.stack([rate, -jnp.sin(angle) - 0.3 * rate + control[0]])


def swing_in_numpy(state, control):
    return np.array([state[1], -np.sin(state[0]) - 0.3 * state[1] + control[0]])


def chain(state, control):
    """Position, velocity, acceleration, driven by jerk: a cubic polynomial in time."""
    _, velocity, acceleration = state
    return jnp.stack([velocity, acceleration, control[0]])


@pytest.mark.parametrize(
    ("integrator", "order", "steps"),
    # Steps so long that float32 rounding, 1e-7, is far below the errors compared: 1e-4 at least.
    [(Euler(), 1, (40, 80)), (RK4(), 4, (4, 8))],
    ids=["Euler", "RK4"],
)
def test_order_of_the_error(integrator, order: int, steps, solve) -> None:
    duration = 4.0
    exact = solve(swing_in_numpy, START, [CONTROL], duration)[-1]
    step = jax.jit(lambda state, dt: integrator(swing, state, jnp.asarray(CONTROL), dt))
    errors = []
    for count in steps:
        state = jnp.asarray(START)
        for _ in range(count):
            state = step(state, jnp.asarray(duration / count))
        errors.append(np.linalg.norm(np.asarray(state) - exact))
    assert errors[1] > 1e-4
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.2)


@given(st.lists(FORWARD, min_size=2, max_size=2), FORWARD, st.floats(0.0078125, 0.5, width=32))
def test_rk4_is_the_textbook_s(state, control, dt: float) -> None:
    x, u = np.array(state), np.array([control])
    k1 = swing_in_numpy(x, u)
    k2 = swing_in_numpy(x + dt / 2 * k1, u)
    k3 = swing_in_numpy(x + dt / 2 * k2, u)
    k4 = swing_in_numpy(x + dt * k3, u)
    expected = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    found = RK4()(swing, jnp.asarray(state), jnp.asarray([control]), jnp.asarray(dt))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-6)


@given(st.lists(FORWARD, min_size=3, max_size=3), FORWARD, st.floats(0.0078125, 2.0, width=32))
def test_rk4_is_exact_for_a_cubic(state, jerk: float, dt: float) -> None:
    p, v, a = state
    expected = [
        p + v * dt + a * dt**2 / 2 + jerk * dt**3 / 6,
        v + a * dt + jerk * dt**2 / 2,
        a + jerk * dt,
    ]
    found = RK4()(chain, jnp.asarray(state), jnp.asarray([jerk]), jnp.asarray(dt))
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("integrator", "growth"),
    [(Euler(), lambda z: 1 + z), (RK4(), lambda z: 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)],
    ids=["Euler", "RK4"],
)
@pytest.mark.parametrize("z", [-2.5, -1.0, -0.1, 0.3, 1.0])
def test_growth_of_a_linear_system(integrator, growth, z: float) -> None:
    def decay(state, control):
        return z * state

    def step(state):
        return integrator(decay, state, jnp.zeros(1), jnp.ones(()))

    start = jnp.asarray([3.0])
    np.testing.assert_allclose(step(start), 3.0 * growth(z), rtol=1e-6, atol=1e-6)
    # The gradient of a linear step is its growth: it passes through what is cut for speed.
    np.testing.assert_allclose(jax.jacrev(step)(start), [[growth(z)]], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(jax.jacfwd(step)(start), [[growth(z)]], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("integrator", [Euler(), RK4()], ids=["Euler", "RK4"])
def test_no_time_changes_nothing(integrator) -> None:
    state = jnp.asarray([0.1, -7.3])
    found = integrator(swing, state, jnp.asarray([0.7]), jnp.zeros(()))
    np.testing.assert_array_equal(found, state)


@pytest.mark.parametrize("integrator", [Euler(), RK4()], ids=["Euler", "RK4"])
def test_samples_on_the_last_axis(integrator) -> None:
    states = jnp.asarray(np.random.default_rng(0).normal(size=(2, 7)), jnp.float32)
    controls = jnp.asarray(np.random.default_rng(1).normal(size=(1, 7)), jnp.float32)
    dt = jnp.asarray(0.1)

    def step(state, control):
        return integrator(swing, state, control, dt)

    together = jax.vmap(step, in_axes=-1, out_axes=-1)(states, controls)
    alone = [step(states[:, k], controls[:, k]) for k in range(7)]
    np.testing.assert_allclose(together, np.stack(alone, axis=-1), rtol=1e-6, atol=1e-7)
