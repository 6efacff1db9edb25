"""Scenarios as environments: an action in, an observation and a reward out.

The environment uses the closed loop of `jaxplore.simulation.loop`: an action becomes a controller
(`ActionMode`), and the loop perceives, controls and moves as in any run.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Flag, Key, Scalar
from jaxplore.simulation.environment.action_modes import ActionMode, ActionVector
from jaxplore.simulation.loop import (
    control_step,
    initial_loop_state,
    moment_at,
    step_keys,
)
from jaxplore.simulation.scenario import AgentView, Scenario
from jaxplore.simulation.stacking import Stacked
from jaxplore.simulation.state import LoopState, Moment


class EpisodeStatistics(NamedTuple):
    """Statistics of an episode so far.

    `path_length` is the distance travelled [m]. `collisions` is the number of contacts; successive
    steps count once. `collision_steps` is the number of control periods in contact. `is_contact`
    says whether the last control period was in contact.
    """

    path_length: Scalar
    collisions: Count
    collision_steps: Count
    is_contact: Flag


class EnvironmentState(NamedTuple):
    """State of an environment.

    Args:
        loop: state of the closed loop before the perception that gave the observation.
        perceived: state of the task after that perception.
        moment: time of that perception, and the state that was observed.
        belief: the robot's belief at that time.
        statistics: statistics of the episode so far.
        key: random key of the run.
        choice: number of the scenario.
    """

    loop: LoopState
    perceived: Any
    moment: Moment
    belief: Any
    statistics: EpisodeStatistics
    key: Key
    choice: Count


class StepResult(NamedTuple):
    """The result of an action: the observation, the reward and the end of the episode.

    Args:
        observation: arrays that the agent observes, by name; see `AgentView.observation`.
        reward: reward for the action.
        is_terminated: whether the scenario is finished.
        is_truncated: whether the time limit was reached before.
        is_collision: whether the robot was in contact during the action.
        facts: numbers about the task, by name; see `AgentView.facts`.
        num_steps: control periods since the start.
        statistics: statistics of the episode so far.
    """

    observation: dict[str, Array]
    reward: Scalar
    is_terminated: Flag
    is_truncated: Flag
    is_collision: Flag
    facts: dict[str, Scalar]
    num_steps: Count
    statistics: EpisodeStatistics


class Environment(eqx.Module):
    """A scenario, or several of one size, as an environment.

    A robot perceives, decides and moves, in this order. The environment pauses between perception
    and decision: the observation contains the measurement at the present position, as a controller
    of the closed loop would see it. The same key and the same controls give the states of
    `simulate`.

        reward = AgentView.reward(before, after) - collision_penalty * (time in contact)

    Args:
        scenarios: one scenario, or several that differ in the values of their arrays only, such as
            floors of one size.
        mode: meaning of an action.
        action_period: time between actions [s], rounded to control periods; the scenario's sensing
            period when absent, or a control period if it has none.
        time_limit: simulated time after which an episode is truncated [s].
        collision_penalty: reduction of the reward by contact [1/s].
        view: side of the observed square of the belief around the robot [m]; the whole map when
            absent.

    Raises:
        ValueError: no scenario, scenarios that differ in size or structure, a value that is out of
            its range.
    """

    views: Stacked
    mode: ActionMode
    steps_per_action: Count
    max_steps: Count
    collision_penalty: Scalar
    num_scenarios: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        scenarios: Scenario | Sequence[Scenario],
        mode: ActionMode,
        *,
        action_period: float | None = None,
        time_limit: float = 900.0,
        collision_penalty: ArrayLike = 1.0,
        view: float | None = None,
    ) -> None:
        given = [scenarios] if isinstance(scenarios, Scenario) else scenarios
        if not isinstance(given, (list, tuple)):
            _kinds.instance("scenarios", given, Scenario, hint="or a list of them")
        if not given:
            raise ValueError("scenarios is empty; accepted: a Scenario, or a list of them")
        _kinds.instances("scenarios", given, Scenario)
        self.num_scenarios = len(given)
        period = float(given[0].control_period)
        self.mode = mode.at_period(given[0].control_period)
        steps = given[0].steps_per_measurement
        if action_period is not None:
            steps = max(
                1, round(_checks.number("action_period", action_period, above=0.0) / period)
            )
        # The numbers of steps are arrays, so that another period or limit does not compile again.
        self.steps_per_action = jnp.asarray(steps, jnp.int32)
        limit = _checks.number("time_limit", time_limit, above=0.0)
        self.max_steps = jnp.asarray(max(1, round(limit / period)), jnp.int32)
        self.collision_penalty = _checks.scalar(
            "collision_penalty", collision_penalty, at_least=0.0
        )
        cells = None
        if view is not None:
            side = _checks.number("view", view, above=0.0)
            cells = max(1, round(side / given[0].cell_size))
        # The views have the scenarios in them, and sizes that are known here and not when traced.
        views = tuple(scenario.agent_view(cells) for scenario in given)
        self.views = Stacked.from_trees(views, name="scenarios")

    @property
    def control_period(self) -> float:
        """Time between controls [s]."""
        return self.scenario(0).period

    def scenario(self, choice: int | Count) -> Scenario:
        """Return one of the scenarios."""
        return self.agent_view(choice).scenario

    def agent_view(self, choice: int | Count) -> AgentView:
        """Return one of the scenarios as the agent sees it."""
        chosen: AgentView = self.views.at(choice)
        return chosen

    def init(self, key: Key, choice: Count) -> EnvironmentState:
        """Return the state before the first perception; see `reset`.

        Args:
            key: random key of the run.
            choice: number of the scenario, below `num_scenarios`.
        """
        scenario = self.scenario(choice)
        loop = initial_loop_state(self.mode.initial_controller, scenario, key)
        # The loop's initial state leaves out the belief, which the first action mode may read.
        _, belief = scenario.init(key)
        zero = jnp.zeros((), jnp.int32)
        return EnvironmentState(
            loop=loop,
            perceived=loop.task,
            moment=moment_at(scenario, loop, key),
            belief=belief,
            statistics=EpisodeStatistics(jnp.zeros(()), zero, zero, jnp.array(False)),
            key=key,
            choice=choice,
        )

    def reset(self, key: Key, choice: Count) -> tuple[EnvironmentState, StepResult]:
        """Return the state at the start of an episode, and the first observation.

        Args:
            key: random key of the run.
            choice: number of the scenario, below `num_scenarios`.
        """
        # With zero control periods the action has no effect, so any valid one serves.
        return self.step(self.init(key, choice), self.mode.low, jnp.zeros((), jnp.int32))

    def step(
        self, state: EnvironmentState, action: ActionVector, num_steps: Count | None = None
    ) -> tuple[EnvironmentState, StepResult]:
        """Carry out an action.

        The function has more than 60 lines because its three inner functions share the scenario,
        the controller and the limits of the loop.

        Args:
            state: state before.
            action: (A,) action; values out of bounds are clipped.
            num_steps: number of control periods of the action, fewer if the episode ends; with 0
                the robot only perceives. The periods between actions when absent.
        """
        view, before = self.agent_view(state.choice), state.statistics
        scenario = view.scenario
        steps = self.steps_per_action if num_steps is None else num_steps
        controller = self.mode.controller(action, state.moment, state.belief, scenario)

        # The observation after the action needs the perception of the next step, which comes before
        # the next decision. So the loop makes one step more and keeps its perception only; the next
        # action repeats that step.
        def advance(course: _Course) -> _Course:
            at, statistics = course.ahead, course.statistics
            measure_key, _ = step_keys(state.key, at.step)
            moment = moment_at(scenario, at, state.key)
            perceived, belief = scenario.perceive(at.task, moment, measure_key)
            ahead, record = control_step(
                controller, scenario, at._replace(task=perceived), moment, belief, state.key
            )
            # In the first iteration `at` is `course.at`, which adds neither distance nor contact.
            position = scenario.robot.position
            moved = position(at.task.robot) - position(course.at.task.robot)
            is_new = course.is_hit & ~statistics.is_contact
            return _Course(
                done=course.done + 1,
                at=at,
                ahead=ahead,
                perceived=perceived,
                moment=moment,
                belief=belief,
                is_hit=view.is_contact(record),
                statistics=EpisodeStatistics(
                    path_length=statistics.path_length + jnp.sqrt(jnp.sum(moved * moved)),
                    collisions=statistics.collisions + is_new.astype(jnp.int32),
                    collision_steps=statistics.collision_steps + course.is_hit.astype(jnp.int32),
                    is_contact=jnp.where(course.done == 0, statistics.is_contact, course.is_hit),
                ),
            )

        def has_ended(course: _Course) -> Flag:
            return view.has_ended(course.at.task, course.ahead.task)

        def continues(course: _Course) -> Flag:
            is_over = has_ended(course) | (course.at.step >= self.max_steps)
            return (course.done == 0) | ((course.done <= steps) & ~is_over)

        course = jax.lax.while_loop(
            continues,
            advance,
            _Course(
                done=jnp.zeros((), jnp.int32),
                at=state.loop,
                ahead=state.loop,
                perceived=state.perceived,
                moment=state.moment,
                belief=state.belief,
                is_hit=jnp.array(False),
                statistics=before,
            ),
        )
        after = EnvironmentState(
            loop=course.at,
            perceived=course.perceived,
            moment=course.moment,
            belief=course.belief,
            statistics=course.statistics,
            key=state.key,
            choice=state.choice,
        )
        contact = (course.statistics.collision_steps - before.collision_steps).astype(jnp.float32)
        penalty = self.collision_penalty * scenario.control_period * contact
        earned = view.reward(state.perceived, after.perceived)
        is_terminated = has_ended(course)
        return after, StepResult(
            observation=view.observation(after.perceived, after.moment, after.belief),
            # A reset only perceives, and has no reward.
            reward=jnp.where(steps > 0, earned - penalty, 0.0),
            is_terminated=is_terminated,
            is_truncated=(course.at.step >= self.max_steps) & ~is_terminated,
            is_collision=contact > 0.0,
            facts=view.facts(after.perceived),
            num_steps=course.at.step,
            statistics=course.statistics,
        )


class _Course(NamedTuple):
    """Carry of the loop over an action: the number of steps `done`, the loop state `at`, its
    perception, and the loop state one step `ahead` with its contact."""

    done: Count
    at: LoopState
    ahead: LoopState
    perceived: Any
    moment: Moment
    belief: Any
    is_hit: Flag
    statistics: EpisodeStatistics
