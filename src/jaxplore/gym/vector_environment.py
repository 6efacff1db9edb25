"""Vector environments with Gymnasium's interface. Importing this module needs Gymnasium."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jax import Array

from jaxplore import _checks
from jaxplore._limits import MOST_AT_ONCE
from jaxplore._trees import stack_trees
from jaxplore._types import Count
from jaxplore.gym.build import build_environment
from jaxplore.gym.environment import check_render_mode, environment_metadata, picture
from jaxplore.gym.spaces import (
    Observed,
    action_space,
    begin,
    check_action,
    convert_observation,
    draw,
    facts,
    observation_space,
    positions,
    require_state,
)
from jaxplore.simulation.environment.environment import Environment, EnvironmentState, StepResult


class ScenarioVectorEnvironment(VectorEnv[Observed, np.ndarray, np.ndarray]):
    """N environments in one, whose step is a single compiled call.

    Each is a `ScenarioEnvironment`: the same seeds and actions give the same observations as
    Gymnasium's `SyncVectorEnv`. `reset(seed=s)` gives environment i the seed s + i; a list gives
    one seed to each. An environment whose episode has ended begins the next one at the next step,
    which ignores its action and has reward 0 (`AutoresetMode.NEXT_STEP`).

    Args:
        num_envs: number of environments, N.
        is_vmapped: whether the environments run in one `jax.vmap`, or one after the other within
            the call. When absent, not on a CPU: there a batch does every branch that any of its
            environments takes, and is several times slower.
        render_mode: "rgb_array" or None.
        options: those of `build_environment`.

    Raises:
        ValueError: fewer than one environment, an unknown render mode, or arguments that
            `build_environment` rejects.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        is_vmapped: bool | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.num_envs = _checks.positive_int("num_envs", num_envs, at_most=MOST_AT_ONCE)
        self.is_vmapped = jax.default_backend() != "cpu" if is_vmapped is None else is_vmapped
        self.render_mode = check_render_mode(render_mode)
        self.environment = build_environment(**options)
        self.metadata = environment_metadata(self.environment, type(self).metadata)
        self.single_action_space = action_space(self.environment)
        self._single_observation_space = observation_space(self.environment)
        self.single_observation_space = self._single_observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._states: EnvironmentState | None = None
        self._outcomes: StepResult | None = None
        self._has_ended = np.zeros(num_envs, bool)
        self._paths: list[list[np.ndarray]] = [[] for _ in range(num_envs)]

    @property
    def states(self) -> EnvironmentState:
        """States of the environments, with a leading axis of environments."""
        return require_state(self._states)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode in each environment; return the observations and the info.

        The seed is that of the first environment, from which the others count up, or one for each.
        Of the options "scenario" selects one of several for all, and "reset_mask" (N,) those to
        reset.
        """
        seeds = self._seeds(seed)
        chosen = options or {}
        mask = np.asarray(chosen.get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ValueError(f"option reset_mask is {mask!r}; accepted: {self.num_envs} booleans")
        if self._states is None and not mask.all():
            raise gymnasium.error.ResetNeeded("some environments have no state; accepted: all")
        self._begin(mask, seeds, chosen.get("scenario"))
        # No environment takes a step here, neither those that the mask selects nor the others.
        nothing = jnp.zeros(self.action_space.shape or (), jnp.float32)
        observation, _, _, info = self._advance(nothing, np.ones(self.num_envs, bool))
        return observation, info

    def step(
        self, actions: Any
    ) -> tuple[Observed, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out an action (N, A) in each environment; reset those whose episode has ended.

        Return observations, rewards, terminated and truncated flags (N,), and the info.
        """
        given = check_action(actions, self.action_space.shape or ())
        ended = self._has_ended
        if self._states is not None and ended.any():
            self._begin(ended, [None] * self.num_envs, None)
        observation, rewards, ends, info = self._advance(given, ended)
        return observation, rewards, *ends, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draw each environment (rows, columns, 3)."""
        if self.render_mode is None or self._outcomes is None:
            return None
        rows = [jax.tree.map(lambda leaf, i=i: leaf[i], self.states) for i in range(self.num_envs)]
        return tuple(
            picture(self.environment, state, path)
            for state, path in zip(rows, self._paths, strict=True)
        )

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + index for index in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed has {len(seed)} values; accepted: {self.num_envs}, or one")
        return list(seed)

    def _begin(self, mask: np.ndarray, seeds: list[int | None], choice: Any) -> None:
        fresh: list[EnvironmentState] = []
        places = [int(index) for index in np.flatnonzero(mask)]
        for place in places:
            generator, seed = self._generators[place], seeds[place]
            # As in Gymnasium, a seed makes a new generator, and without one the former continues.
            if generator is None or seed is not None:
                generator, _ = seeding.np_random(seed)
                self._generators[place] = generator
            fresh.append(begin(self.environment, *draw(generator, self.environment, seed, choice)))
            self._paths[place].clear()
        if len(fresh) == self.num_envs:
            self._states = _rows(fresh)
            return
        # Another number of environments to reset would be another program, so each is placed alone.
        for place, state in zip(places, fresh, strict=True):
            self._states = _place(self.states, jnp.asarray(place, jnp.int32), state)

    def _advance(
        self, actions: Array, is_new: np.ndarray
    ) -> tuple[Observed, np.ndarray, tuple[np.ndarray, np.ndarray], dict[str, Any]]:
        """Step all environments; those that were just reset only perceive."""
        num_steps = jnp.where(jnp.asarray(is_new), 0, self.environment.steps_per_action)
        self._states, outcomes = _step_each(
            self.environment, self.states, actions, num_steps, self.is_vmapped
        )
        self._outcomes = outcomes
        observation = convert_observation(outcomes.observation, self._single_observation_space)
        if self.render_mode is not None:
            now = positions(self.environment, self._states)
            for path, position in zip(self._paths, now, strict=True):
                path.append(position.copy())
        terminated, truncated = np.array(outcomes.is_terminated), np.array(outcomes.is_truncated)
        self._has_ended = terminated | truncated
        rewards = np.asarray(outcomes.reward, np.float64)
        info: dict[str, Any] = {}
        for name, values in facts(self.environment, outcomes, self._states).items():
            # Gymnasium's vector environments mark in `_NAME` which environments have an entry.
            info[name], info[f"_{name}"] = np.array(values), np.ones(self.num_envs, bool)
        return observation, rewards, (terminated, truncated), info


@eqx.filter_jit
def _step_each(
    environment: Environment,
    states: EnvironmentState,
    actions: Array,
    num_steps: Array,
    is_vmapped: bool,
) -> tuple[EnvironmentState, StepResult]:
    if is_vmapped:
        together: tuple[EnvironmentState, StepResult] = jax.vmap(environment.step)(
            states, actions, num_steps
        )
        return together
    in_turn: tuple[EnvironmentState, StepResult] = jax.lax.map(
        lambda row: environment.step(*row), (states, actions, num_steps)
    )
    return in_turn


@eqx.filter_jit
def _rows(states: list[EnvironmentState]) -> EnvironmentState:
    return stack_trees(states)


@eqx.filter_jit
def _place(rows: EnvironmentState, place: Count, state: EnvironmentState) -> EnvironmentState:
    placed: EnvironmentState = jax.tree.map(
        lambda column, leaf: column.at[place].set(leaf), rows, state
    )
    return placed
