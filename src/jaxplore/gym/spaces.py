"""Conversions between an environment and Gymnasium: spaces, random draws, arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import error, spaces
from jax import Array

from jaxplore._types import Count, Key
from jaxplore.simulation.environment.environment import Environment, EnvironmentState, StepResult

Observed = dict[str, np.ndarray]


@eqx.filter_jit
def begin(environment: Environment, key: Key, choice: Count) -> EnvironmentState:
    """Compiled `Environment.init`."""
    return environment.init(key, choice)


@eqx.filter_jit
def step(
    environment: Environment, state: EnvironmentState, action: Array, num_steps: Count
) -> tuple[EnvironmentState, StepResult]:
    """Compiled `Environment.step`."""
    return environment.step(state, action, num_steps)


def require_state(state: EnvironmentState | None) -> EnvironmentState:
    """Return the state of an environment; raise `ResetNeeded` if it was not reset."""
    if state is None:
        raise error.ResetNeeded("the environment has no state; accepted: reset first")
    return state


def action_space(environment: Environment) -> spaces.Box:
    """Return the action space, in physical units."""
    low, high = (np.asarray(bound) for bound in (environment.mode.low, environment.mode.high))
    return spaces.Box(low, high, dtype=np.float32)


def observation_space(environment: Environment) -> spaces.Dict:
    """Return the observation space: the common bounds of all scenarios."""
    bounds = [
        environment.agent_view(index).observation_bounds()
        for index in range(environment.num_scenarios)
    ]
    return spaces.Dict(
        {
            name: _box(
                np.min([each[name][0] for each in bounds], axis=0),
                np.max([each[name][1] for each in bounds], axis=0),
            )
            for name in bounds[0]
        }
    )


def convert_observation(observation: dict[str, Array], space: spaces.Dict) -> Observed:
    """Convert one or more observations to new NumPy arrays within the bounds of the space."""
    arrays = jax.device_get(observation)
    boxes = {name: box for name, box in space.items() if isinstance(box, spaces.Box)}
    # Rounding may lead out of the bounds, which Gymnasium does not accept.
    return {name: np.clip(arrays[name], box.low, box.high) for name, box in boxes.items()}


def draw(
    generator: np.random.Generator, environment: Environment, seed: int | None, choice: Any
) -> tuple[Key, Count]:
    """Draw the key and the scenario of an episode, unless they are given.

    `seed` is the argument of `jax.random.key`; the run equals that of `simulate` with this key.
    """
    # JAX takes seeds of 32 bits, unless 64-bit numbers are turned on.
    number = int(generator.integers(2**32)) if seed is None else seed % 2**32
    if choice is None:
        several = environment.num_scenarios > 1
        choice = int(generator.integers(environment.num_scenarios)) if several else 0
    if not isinstance(choice, int | np.integer) or not 0 <= choice < environment.num_scenarios:
        raise ValueError(
            f"option scenario is {choice!r}; accepted: a whole number below "
            f"{environment.num_scenarios}"
        )
    # The number is an array, so that another scenario does not compile again.
    return jax.random.key(number), jnp.asarray(choice, jnp.int32)


def check_action(action: Any, shape: tuple[int, ...]) -> Array:
    """Check one or more actions, and convert them to an array of finite numbers."""
    given = np.asarray(action, np.float32)
    if given.shape != shape or not np.isfinite(given).all():
        raise ValueError(f"action is {action!r}; accepted: finite numbers of shape {shape}")
    return jnp.asarray(given)


def facts(environment: Environment, outcome: StepResult, state: EnvironmentState) -> dict[str, Any]:
    """Return the entries of Gymnasium's `info`, for one or more environments."""
    statistics = outcome.statistics
    arrays = jax.device_get(
        {
            **outcome.facts,
            "path_length": statistics.path_length,
            "is_collision": outcome.is_collision,
            "collisions": statistics.collisions,
            "collision_steps": statistics.collision_steps,
            "scenario": state.choice,
        }
    )
    steps = np.asarray(outcome.num_steps, np.int64)
    return {"time": np.round(steps * environment.control_period, 7), **arrays}


def positions(environment: Environment, state: EnvironmentState) -> np.ndarray:
    """Return the robot's observed position (2,), or one row per environment [m]."""
    names = environment.scenario(0).robot.state_names
    columns = [names.index("x"), names.index("y")]
    return np.asarray(state.moment.observed)[..., columns]


def _box(low: np.ndarray, high: np.ndarray) -> spaces.Box:
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
