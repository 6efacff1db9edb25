"""The environment with Gymnasium's interface. Importing this module needs Gymnasium."""

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore.belief.belief import Belief
from jaxplore.gym.build import build_environment
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
    step,
)
from jaxplore.simulation.environment.environment import Environment, EnvironmentState, StepResult


class ScenarioEnvironment(gymnasium.Env[Observed, np.ndarray]):
    """A scenario as a Gymnasium environment.

    It is registered as `jaxplore/Exploration-v0` and `jaxplore/PathFollowing-v0`.

    `reset(seed=s)` begins the run of `simulate` with the key `jax.random.key(s)`; without a seed,
    one is drawn. `reset(options={"scenario": k})` selects one of several scenarios; without it, one
    is drawn. Spaces, reward and end of an episode are those of `Environment`; an episode is
    truncated at the time limit. `info` contains:

    | name | value |
    | --- | --- |
    | time | time since the start [s] |
    | coverage | of exploration: share of the reachable cells known to be free |
    | entropy | of exploration: of the belief over the reachable cells [nat] |
    | progress | of path following: arc length passed [m] |
    | path_length | distance travelled [m] |
    | is_collision | whether the robot touched something during the action |
    | collisions, collision_steps | contacts, and control periods in contact, since the start |
    | scenario | index of the scenario |

    Args:
        render_mode: "rgb_array" or None.
        options: those of `build_environment`.

    Raises:
        ValueError: an unknown render mode, or arguments that `build_environment` rejects.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        self.render_mode = check_render_mode(render_mode)
        self.environment = build_environment(**options)
        self.metadata = environment_metadata(self.environment, type(self).metadata)
        self.action_space = action_space(self.environment)
        self._observation_space = observation_space(self.environment)
        self.observation_space: gymnasium.Space[Any] = self._observation_space
        self._state: EnvironmentState | None = None
        self._outcome: StepResult | None = None
        self._path: list[np.ndarray] = []

    @property
    def state(self) -> EnvironmentState:
        """The state of the environment; `gymnasium.error.ResetNeeded` before the first reset."""
        return require_state(self._state)

    @property
    def belief(self) -> Belief:
        """The robot's belief, as jaxplore's controllers read it."""
        belief: Belief = self.state.belief
        return belief

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode; return the observation and the info."""
        super().reset(seed=seed)
        choice = None if options is None else options.get("scenario")
        key, number = draw(self.np_random, self.environment, seed, choice)
        self._path.clear()
        # A reset carries out no control period, so only the shape of its action matters.
        nothing = jnp.zeros(self.action_space.shape or (), jnp.float32)
        state = begin(self.environment, key, number)
        observation, _, _, info = self._advance(state, nothing, jnp.zeros((), jnp.int32))
        return observation, info

    def step(self, action: Any) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Carry out an action; return the observation, the reward, the two end flags and the info.

        After the end of an episode the state no longer changes.
        """
        given = check_action(action, self.action_space.shape or ())
        observation, reward, ends, info = self._advance(
            self.state, given, self.environment.steps_per_action
        )
        return observation, reward, *ends, info

    def render(self) -> np.ndarray | None:
        """Draw the belief, the path, the targets and the robot (rows, columns, 3)."""
        if self.render_mode is None or self._outcome is None:
            return None
        return picture(self.environment, self.state, self._path)

    def _advance(
        self, state: EnvironmentState, action: jax.Array, num_steps: jax.Array
    ) -> tuple[Observed, float, tuple[bool, bool], dict[str, Any]]:
        self._state, outcome = step(self.environment, state, action, num_steps)
        self._outcome = outcome
        info = {
            name: value.item() for name, value in facts(self.environment, outcome, state).items()
        }
        observation = convert_observation(outcome.observation, self._observation_space)
        if self.render_mode is not None:
            self._path.append(positions(self.environment, self._state))
        ends = bool(outcome.is_terminated), bool(outcome.is_truncated)
        return observation, float(outcome.reward), ends, info


def check_render_mode(render_mode: str | None) -> str | None:
    """Check a render mode, and return it."""
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode is {render_mode!r}; accepted: rgb_array, None")
    return render_mode


def environment_metadata(environment: Environment, general: dict[str, Any]) -> dict[str, Any]:
    """Return Gymnasium's metadata with the frame rate of an environment."""
    period = environment.control_period * int(environment.steps_per_action)
    return {**general, "render_fps": max(1, round(1.0 / period))}


def picture(
    environment: Environment, state: EnvironmentState, trail: list[np.ndarray]
) -> np.ndarray:
    """Draw one environment (rows, columns, 3); `trail` are its positions (2,) so far [m]."""
    view = environment.agent_view(state.choice)
    return view.picture(state.perceived, state.moment, np.stack(trail))
