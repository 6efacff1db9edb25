"""Latency of commands: predict the state in which a command takes effect, and plan from there."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DELAY
from jaxplore._types import ArrayLike, ControlVector, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.dynamics.base import Dynamics

ROUNDING = 1e-3
"""Share of a step by which a whole number of float32 steps may seem to exceed itself."""


def predict_state(
    dynamics: Dynamics,
    state: StateVector,
    controls: Float[Array, "N nu"],
    durations: Float[Array, " N"],
    max_step: ArrayLike = 0.02,
) -> StateVector:
    """Return the state (nx,) after controls that are held one after the other.

    The number of slots N is static, so one compiled program serves every latency: a slot of a
    duration of zero or less changes nothing.

    Args:
        dynamics: model of the robot.
        state: state (nx,) at the start.
        controls: (N, nu) controls, the first to take effect first.
        durations: (N,) time for which each is held [s].
        max_step: longest model step [s]; longer slots are divided into equal steps.
    """

    def hold(reached: Array, slot: tuple[Array, Array]) -> tuple[Array, None]:
        control, duration = slot
        steps = jnp.ceil(jnp.maximum(duration, 0.0) / max_step - ROUNDING).astype(jnp.int32)
        steps = jnp.where(duration > 0.0, jnp.maximum(steps, 1), 0)
        dt = duration / jnp.maximum(steps, 1).astype(duration.dtype)
        return jax.lax.fori_loop(
            0, steps, lambda _, values: dynamics.step(values, control, dt), reached
        ), None

    reached, _ = jax.lax.scan(hold, state, (controls, durations))
    return reached


class LatencyState(NamedTuple):
    """State of `LatencyCompensation`.

    Args:
        controller: state of the inner controller.
        commands: (N, nu) commands that are still taking effect, oldest first.
    """

    controller: Any
    commands: Float[Array, "N nu"]


class LatencyCompensation(Controller):
    """A controller that plans for the time when its command takes effect.

    A command takes effect `latency` seconds after the state was observed that it was computed from.
    Until then the robot moves under the commands that are on their way. The state is predicted
    under them, `predict_state`, and the inner controller plans from there. Moving obstacles of a
    `Belief` are predicted to the same time.

    The oldest command on its way is held for what is left of its period, so a latency need not be a
    whole number of periods. The first commands on their way are the model's default control.

    Args:
        controller: controller that plans.
        latency: time between an observation and the effect of its command [s].
        robot: model of the robot; `controller.dynamics` when absent.
        control_period: time between commands [s]; `controller.control_period` when absent. A
            simulation sets that of its scenario.

    Raises:
        ValueError: a negative latency, a period that is not positive, no robot or period for a
            controller that has none of its own.
    """

    controller: Controller
    robot: Dynamics
    latency: Scalar
    control_period: Scalar
    num_pending: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        controller: Controller,
        latency: ArrayLike,
        robot: Dynamics | None = None,
        control_period: ArrayLike | None = None,
    ) -> None:
        self.controller = controller
        model = getattr(controller, "dynamics", None) if robot is None else robot
        _kinds.instance("robot", model, Dynamics)
        assert isinstance(model, Dynamics)
        self.robot = model
        period = control_period
        if period is None:
            period = getattr(controller, "control_period", None)
        if period is None:
            raise ValueError("control_period is None; accepted: the time between commands [s]")
        self.latency = _checks.scalar("latency", latency, at_least=0.0)
        self.control_period = _checks.scalar("control_period", period, above=0.0)
        if _kinds.is_traced(self.latency, self.control_period):
            raise ValueError(
                "latency or control_period is traced; accepted: numbers, which tell how many "
                "commands are on their way"
            )
        periods = float(self.latency) / float(self.control_period)
        pending = math.ceil(periods - ROUNDING)
        if pending > MOST_DELAY:
            raise ValueError(
                f"latency is {float(self.latency):g} s, {pending} periods; accepted: at most "
                f"{MOST_DELAY} periods"
            )
        self.num_pending = pending

    def init(self) -> LatencyState:
        """Return the initial state, with default controls on their way."""
        idle, size = self.robot.default_control, self.robot.control_size
        commands = jnp.broadcast_to(idle, (self.num_pending, size))
        return LatencyState(self.controller.init(), commands)

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members of the inner controller."""
        return self.controller.member_names

    def at_period(self, control_period: ArrayLike) -> "LatencyCompensation":
        """Return a copy of this controller that is called every `control_period` seconds."""
        inner = self.controller.at_period(control_period)
        return LatencyCompensation(inner, self.latency, self.robot, control_period)

    def step(
        self, state: LatencyState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, LatencyState, Info]:
        """Predict the state in which the command takes effect, and plan from there."""
        ahead, later = self._predict(state, observation, belief, key)
        control, memory, info = self.controller.step(state.controller, ahead, later, key=key)
        queue = jnp.concatenate([state.commands, control[None]])
        return control, LatencyState(memory, queue[queue.shape[0] - self.num_pending :]), info

    def inspect(
        self,
        state: LatencyState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of the inner controller, from the predicted state on."""
        ahead, later = self._predict(state, observation, belief, key)
        return self.controller.inspect(
            state.controller, ahead, later, key=key, num_trajectories=num_trajectories
        )

    def _predict(
        self, state: LatencyState, observation: StateVector, belief: Any, key: Key
    ) -> tuple[StateVector, Any]:
        """Return the state and the belief at the time when the coming command takes effect."""
        observation = check_call(self.robot, state, LatencyState, observation, key)
        if isinstance(belief, Belief) and belief.obstacles is not None:
            later = belief.obstacles.advance(self.latency)
            belief = dataclasses.replace(belief, obstacles=later)
        if self.num_pending == 0:
            return observation, belief
        period = self.control_period
        rest = self.latency - (self.num_pending - 1) * period
        durations = jnp.full((self.num_pending,), period).at[0].set(rest)
        # One model step per period, like the closed loop that the model belongs to.
        ahead = predict_state(self.robot, observation, state.commands, durations, period)
        return ahead, belief
