"""The closed loop seen from outside: an action in, an observation and a reward out.

Nothing of the loop is here again. An action becomes a controller (`ActionMode`), and
`closed_loop_step` senses, maps, decides and moves as in any run.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Count, Flag, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.simulation.environment.action_modes import ActionMode, ActionVector
from jaxplore.simulation.environment.observation import Observation, last_scan, observe
from jaxplore.simulation.environment.scenario_rows import picked, stacked
from jaxplore.simulation.exploration.closed_loop import (
    LoopState,
    closed_loop_step,
    initial_loop_state,
    robot_pose,
)
from jaxplore.simulation.exploration.record import Progress
from jaxplore.simulation.exploration.scenario import Scenario

WHOLE_MAP = 100.0
"""Reward for making an unknown map certain."""


class Tally(NamedTuple):
    """What has happened since the start.

    Args:
        path_length: distance travelled [m].
        collisions: contacts; successive steps count once.
        collision_steps: control periods in contact.
        is_contact: whether the last control period was one.
    """

    path_length: Scalar
    collisions: Count
    collision_steps: Count
    is_contact: Flag


class EnvironmentState(NamedTuple):
    """All that changes.

    Args:
        loop: of the closed loop, before it senses what was observed.
        belief: what the robot knows, with what it has just sensed.
        progress: how much that is.
        told: (nx,) the state that the robot takes for its own.
        sensed_state: (nx,) where the last scan was taken.
        sensed_step: and when, in control periods.
        tally: what has happened.
        key: of the whole run.
        choice: number of the scenario.
    """

    loop: LoopState
    belief: Belief
    progress: Progress
    told: StateVector
    sensed_state: StateVector
    sensed_step: Count
    tally: Tally
    key: Key
    choice: Count


class Outcome(NamedTuple):
    """What came of an action.

    Args:
        observation: what the robot knows now.
        reward: for the action.
        is_terminated: the scenario is finished: there is nothing left to do.
        is_truncated: its time is up before.
        is_collision: whether the robot touched something meanwhile.
        coverage: share of the reachable cells known to be free.
        entropy: of the belief over the reachable cells [nat].
        num_steps: control periods since the start.
        tally: what has happened since the start.
    """

    observation: Observation
    reward: Scalar
    is_terminated: Flag
    is_truncated: Flag
    is_collision: Flag
    coverage: Scalar
    entropy: Scalar
    num_steps: Count
    tally: Tally


class Environment(eqx.Module):
    """A scenario, or several of one size, as an environment.

    A robot senses, decides and moves, in this order. An environment stands still where it is to
    decide: what it observes holds the scan from where it is now, as a controller of the closed loop
    would see it. The same key and the same controls give the states of `simulate`.

        reward = 100 (H_before - H_after) / (ln 2 * reachable cells)
                 - collision_penalty * (time in contact)

    with H the entropy of the belief over the reachable cells [nat]. Added up it is about 100 for a
    map that was unknown, less what the first scan tells, whatever the time between actions. It may
    be negative without a contact: noise can make cells less certain.

    Args:
        scenarios: one, or several that differ in the values of their arrays only, such as floors
            of one size.
        mode: what an action means.
        action_period: time between actions [s]; rounded to control periods. A sensing period when
            absent.
        time_limit: simulated time after which an episode is truncated [s].
        collision_penalty: taken off the reward for contact [1/s].
        view: side of the square around the robot that is observed of the belief [m]; all of the
            map when absent.

    Raises:
        ValueError: no scenario, scenarios that differ in size or structure, a value that is out of
            its range.
    """

    shared: Scenario
    several: Scenario | None
    mode: ActionMode
    steps_per_action: Count
    max_steps: Count
    collision_penalty: Scalar
    num_scenarios: int = eqx.field(static=True)
    view_cells: int | None = eqx.field(static=True)

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
        given = (scenarios,) if isinstance(scenarios, Scenario) else tuple(scenarios)
        self.shared, self.several = stacked(given)
        self.num_scenarios = len(given)
        period = float(given[0].control_period)
        self.mode = mode.at_period(given[0].control_period)
        steps = int(given[0].steps_per_scan)
        if action_period is not None:
            steps = max(
                1, round(_checks.number("action_period", action_period, above=0.0) / period)
            )
        self.steps_per_action = jnp.asarray(steps, jnp.int32)
        limit = _checks.number("time_limit", time_limit, above=0.0)
        self.max_steps = jnp.asarray(max(1, round(limit / period)), jnp.int32)
        self.collision_penalty = _checks.scalar(
            "collision_penalty", collision_penalty, at_least=0.0
        )
        self.view_cells = None
        if view is not None:
            cells = _checks.number("view", view, above=0.0) / given[0].world.resolution
            self.view_cells = max(1, round(cells))

    def scenario(self, choice: Count) -> Scenario:
        """Return one of the scenarios."""
        return picked(self.shared, self.several, choice)

    def init(self, key: Key, choice: Count) -> EnvironmentState:
        """Return the state of a robot that has not opened its eyes yet: see `reset`.

        Args:
            key: of the whole run.
            choice: number of the scenario, below `num_scenarios`.
        """
        scenario = self.scenario(choice)
        loop = initial_loop_state(self.mode.initial_controller, scenario, key)
        zero = jnp.zeros((), jnp.int32)
        return EnvironmentState(
            loop=loop,
            belief=loop.belief,
            progress=loop.progress,
            told=scenario.start,
            sensed_state=scenario.start,
            sensed_step=zero,
            tally=Tally(jnp.zeros(()), zero, zero, jnp.array(False)),
            key=key,
            choice=choice,
        )

    def reset(self, key: Key, choice: Count) -> tuple[EnvironmentState, Outcome]:
        """Return the state at the start of an episode, and what is observed there.

        Args:
            key: of the whole run.
            choice: number of the scenario, below `num_scenarios`.
        """
        return self.step(self.init(key, choice), self.mode.low, jnp.zeros((), jnp.int32))

    def step(
        self, state: EnvironmentState, action: ActionVector, num_steps: Count | None = None
    ) -> tuple[EnvironmentState, Outcome]:
        """Return the state after an action, and what came of it.

        Args:
            state: before.
            action: (A,); what is out of bounds is clipped.
            num_steps: control periods for which it is carried out, fewer where the episode ends;
                with 0 the robot only looks. Those between actions when absent.
        """
        scenario, before = self.scenario(state.choice), state.tally
        steps = self.steps_per_action if num_steps is None else num_steps
        pose = robot_pose(scenario.robot, state.told)
        controller = self.mode.controller(action, pose, state.belief, scenario.perception)

        # What a controller would see where the actions ends is known after one more step of the
        # loop, which senses before it decides. That step is not made: the next action makes it.
        def advance(course: _Course) -> _Course:
            at, tally = course.ahead, course.tally
            ahead, record = closed_loop_step(controller, scenario, at, state.key)
            moved = scenario.robot.position(at.robot) - scenario.robot.position(course.at.robot)
            hit = course.is_hit.astype(jnp.int32)
            is_new = course.is_hit & ~tally.is_contact
            is_sensed = _senses(scenario, at.step)
            return _Course(
                done=course.done + 1,
                at=at,
                ahead=ahead,
                is_hit=record.is_collision,
                sensed_state=jnp.where(is_sensed, at.robot, course.sensed_state),
                sensed_step=jnp.where(is_sensed, at.step, course.sensed_step),
                tally=Tally(
                    path_length=tally.path_length + jnp.sqrt(jnp.sum(moved * moved)),
                    collisions=tally.collisions + is_new.astype(jnp.int32),
                    collision_steps=tally.collision_steps + hit,
                    is_contact=jnp.where(course.done == 0, tally.is_contact, course.is_hit),
                ),
            )

        def goes_on(course: _Course) -> Flag:
            is_over = _is_over(scenario, course) | (course.at.step >= self.max_steps)
            return (course.done == 0) | ((course.done <= steps) & ~is_over)

        course = jax.lax.while_loop(
            goes_on,
            advance,
            _Course(
                done=jnp.zeros((), jnp.int32),
                at=state.loop,
                ahead=state.loop,
                is_hit=jnp.array(False),
                sensed_state=state.sensed_state,
                sensed_step=state.sensed_step,
                tally=before,
            ),
        )
        after = EnvironmentState(
            loop=course.at,
            belief=course.ahead.belief,
            progress=course.ahead.progress,
            told=course.ahead.observed,
            sensed_state=course.sensed_state,
            sensed_step=course.sensed_step,
            tally=course.tally,
            key=state.key,
            choice=state.choice,
        )
        scan = last_scan(
            scenario, after.sensed_state, after.sensed_step, after.loop.movers, state.key
        )
        contact = (course.tally.collision_steps - before.collision_steps).astype(jnp.float32)
        most = math.log(2.0) * jnp.sum(scenario.reachable, dtype=jnp.float32)
        learned = WHOLE_MAP / most * (state.progress.entropy - after.progress.entropy)
        penalty = self.collision_penalty * scenario.control_period * contact
        is_terminated = _is_over(scenario, course)
        return after, Outcome(
            observation=observe(scenario, after.belief.grid, after.told, scan, self.view_cells),
            reward=jnp.where(steps > 0, learned - penalty, 0.0),
            is_terminated=is_terminated,
            is_truncated=(course.at.step >= self.max_steps) & ~is_terminated,
            is_collision=contact > 0.0,
            coverage=after.progress.coverage,
            entropy=after.progress.entropy,
            num_steps=course.at.step,
            tally=course.tally,
        )


class _Course(NamedTuple):
    """The way of an action: the loop as it is (`at`) and one step `ahead`, which touched something
    or not, after so many steps of the loop."""

    done: Count
    at: LoopState
    ahead: LoopState
    is_hit: Flag
    sensed_state: StateVector
    sensed_step: Count
    tally: Tally


def _is_over(scenario: Scenario, course: _Course) -> Flag:
    """Say whether the scenario is finished where the robot is."""
    # The step ahead knows what was just sensed; but it has moved, so it is not asked about a goal.
    known = course.ahead if scenario.goal is None else course.at
    return known.finished > scenario.hover_steps


def _senses(scenario: Scenario, step: Count) -> Flag:
    """Say whether scans arrive in a step."""
    is_due = step % scenario.steps_per_scan == 0
    if scenario.faults is None:
        return is_due
    time = scenario.control_period * step.astype(jnp.float32)
    return is_due & ~scenario.faults.is_blind(time)
