"""The temperature of MPPI on a linear-quadratic problem, against a grid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.study.tuning import VectorEpisodes, tune

STEPS, DT = 20, 0.1


@pytest.fixture(scope="module")
def controller() -> jx.MPPI:
    """A point mass that is to be at the origin: x' = v, v' = u, costs x^2 + 0.1 u^2."""
    robot = jx.PointMass(2, max_acceleration=4.0)
    cost = jx.StateCost({"x": 1.0, "y": 1.0}) + 0.1 * jx.costs.QuadraticControlCost([1.0, 1.0])
    return jx.MPPI(
        robot, cost, horizon=10, num_samples=64, temperature=1.0, noise_std=[1.0, 1.0], dt=DT
    )


@eqx.filter_jit
def closed_loop_cost(controller, temperature, key):
    controller = jx.set_parameters(controller, {"weighting.temperature": temperature})

    def step(carry, key):
        memory, state = carry
        control, memory, _ = controller.step(memory, state, key=key)
        state = controller.dynamics.step(state, control, controller.dt)
        return (memory, state), jnp.sum(state[:2] ** 2) + 0.1 * jnp.sum(control**2)

    start = jnp.array([1.0, -0.5, 0.0, 0.0])
    return jax.lax.scan(step, (controller.init(), start), jax.random.split(key, STEPS))[1].mean()


def test_the_tuned_temperature_is_that_of_a_grid_search(controller) -> None:
    seeds = range(6)
    grid = np.geomspace(1e-3, 1e2, 41).astype(np.float32)
    over_grid = jax.vmap(closed_loop_cost, in_axes=(None, 0, None))
    costs = np.mean(
        [over_grid(controller, jnp.asarray(grid), jax.random.key(seed)) for seed in seeds], axis=0
    )
    best = int(costs.argmin())
    # Inside of the grid, and not flat: both ends are clearly worse.
    assert 3 < best < 37
    assert min(costs[0], costs[-1]) > 1.1 * costs[best]
    episodes = VectorEpisodes(
        lambda values, key: {"cost": closed_loop_cost(controller, values["temperature"], key)},
        {"temperature": 80.0},
    )
    for optimizer in ("cma-es", "tpe"):
        found = tune(
            episodes,
            ["temperature=0.001:100:log"],
            "cost",
            budget=64,
            seeds=len(seeds),
            unseen=1,
            optimizer=optimizer,
            gives_up=False,
        )
        least = min((each for each in found.trials), key=lambda each: each.values[0])
        # As good as the grid's best, at a temperature where the grid is as good.
        assert least.values[0] <= costs[best] * 1.01
        fine = grid[costs <= 1.02 * costs[best]]
        assert fine.min() * 0.9 <= least.candidate["temperature"] <= fine.max() * 1.1
