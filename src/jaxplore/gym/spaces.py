"""What Gymnasium is told of an environment: its spaces, its random draws, its arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import error, spaces
from jax import Array

from jaxplore._types import Count, Key
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.simulation.environment.environment import Environment, EnvironmentState, Outcome
from jaxplore.simulation.environment.observation import Observation

Observed = dict[str, np.ndarray]

FAR = 1e6
"""A state component that a model does not bring back from there has no bound."""


@eqx.filter_jit
def begin(environment: Environment, key: Key, choice: Count) -> EnvironmentState:
    """Return the state of `Environment.init`."""
    return environment.init(key, choice)


@eqx.filter_jit
def step(
    environment: Environment, state: EnvironmentState, action: Array, num_steps: Count
) -> tuple[EnvironmentState, Outcome]:
    """Return what `Environment.step` does."""
    return environment.step(state, action, num_steps)


def begun(state: EnvironmentState | None) -> EnvironmentState:
    """Return the state of an environment that was reset.

    Raises:
        gymnasium.error.ResetNeeded: it was not.
    """
    if state is None:
        raise error.ResetNeeded("the environment has no state; accepted: reset first")
    return state


def action_space(environment: Environment) -> spaces.Box:
    """Return the space of actions, in their own units."""
    low, high = (np.asarray(bound) for bound in (environment.mode.low, environment.mode.high))
    return spaces.Box(low, high, dtype=np.float32)


def observation_space(environment: Environment) -> spaces.Dict:
    """Return the space of observations.

    Bounded but for state components that the robot's model does not bound.
    """
    scenarios = [
        environment.scenario(jnp.asarray(index, jnp.int32))
        for index in range(environment.num_scenarios)
    ]
    first = scenarios[0]
    corners = np.concatenate(
        [
            np.asarray(each.world.frame.to_world(jnp.asarray(_corners(each.world.shape))))
            for each in scenarios
        ]
    )
    least, greatest = corners.min(axis=0), corners.max(axis=0)
    pose_low, pose_high = np.append(least, -np.pi), np.append(greatest, np.pi)
    low, high = _state_bounds(first.robot)
    for name, at, to in zip(("x", "y", "yaw"), pose_low, pose_high, strict=True):
        if name in first.robot.state_names:
            column = first.robot.state_names.index(name)
            low[column], high[column] = at, to
    size = environment.view_cells
    shape = first.world.shape if size is None else (size, size)
    reach = np.concatenate(
        [np.full(sensor.num_beams, sensor.max_range, np.float32) for sensor in first.sensors]
    )
    return spaces.Dict(
        {
            "belief": spaces.Box(0.0, 1.0, shape, np.float32),
            "pose": _box(pose_low, pose_high),
            "scan": _box(np.zeros_like(reach), reach),
            "state": _box(low, high),
        }
    )


def observed(observation: Observation, space: spaces.Dict) -> Observed:
    """Return an observation, or rows of them, as new arrays within the bounds of the space."""
    arrays = jax.device_get(observation._asdict())
    boxes = {name: box for name, box in space.items() if isinstance(box, spaces.Box)}
    return {name: np.clip(arrays[name], box.low, box.high) for name, box in boxes.items()}


def draw(
    generator: np.random.Generator, environment: Environment, seed: int | None, choice: Any
) -> tuple[Key, Count]:
    """Return the key and the scenario of an episode.

    Args:
        generator: draws what is not given.
        environment: of the episode.
        seed: of `jax.random.key`, so that the run is that of `simulate` with this key.
        choice: number of the scenario.

    Raises:
        ValueError: a scenario that there is not.
    """
    number = int(generator.integers(2**32)) if seed is None else seed % 2**32
    if choice is None:
        several = environment.num_scenarios > 1
        choice = int(generator.integers(environment.num_scenarios)) if several else 0
    if not isinstance(choice, int | np.integer) or not 0 <= choice < environment.num_scenarios:
        raise ValueError(
            f"option scenario is {choice!r}; accepted: a whole number below "
            f"{environment.num_scenarios}"
        )
    return jax.random.key(number), jnp.asarray(choice, jnp.int32)


def checked_action(action: Any, shape: tuple[int, ...]) -> Array:
    """Return an action, or rows of them, as an array.

    Raises:
        ValueError: another shape, or numbers that are not finite.
    """
    given = np.asarray(action, np.float32)
    if given.shape != shape or not np.isfinite(given).all():
        raise ValueError(f"action is {action!r}; accepted: finite numbers of shape {shape}")
    return jnp.asarray(given)


def facts(environment: Environment, outcome: Outcome, state: EnvironmentState) -> dict[str, Any]:
    """Return what came of an action by name, in NumPy: numbers, or rows of them."""
    period = round(float(environment.shared.control_period), 7)  # 0.02, not the nearest float32
    tally = outcome.tally
    arrays = jax.device_get(
        {
            "coverage": outcome.coverage,
            "entropy": outcome.entropy,
            "path_length": tally.path_length,
            "is_collision": outcome.is_collision,
            "collisions": tally.collisions,
            "collision_steps": tally.collision_steps,
            "scenario": state.choice,
        }
    )
    steps = np.asarray(outcome.num_steps, np.int64)
    return {"time": np.round(steps * period, 7), **arrays}


def _box(low: np.ndarray, high: np.ndarray) -> spaces.Box:
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _corners(shape: tuple[int, int]) -> np.ndarray:
    rows, columns = shape
    return np.array([(0, 0), (0, columns), (rows, 0), (rows, columns)], np.float32)


def _state_bounds(robot: Dynamics) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds (nx,) to which the model projects each component; infinite without."""
    size = robot.state_size
    low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
    if isinstance(robot, ContinuousDynamics):
        for bound, far in ((low, -FAR), (high, FAR)):
            held = np.diagonal(jax.vmap(robot.project)(far * jnp.eye(size)))
            is_bound = np.abs(held) < FAR
            bound[is_bound] = held[is_bound]
    return low, high
