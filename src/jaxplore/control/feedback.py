"""Feedback-MPPI: linear feedback between two plans."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Scalar, StateVector
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.control.mppi import MPPI, MPPIState
from jaxplore.control.parameterisations import Samples
from jaxplore.control.trajectory import rollout


def step_with_gains(
    mppi: MPPI,
    state: MPPIState,
    observation: StateVector,
    belief: Any = None,
    *,
    key: Key,
    perturbations: Samples | None = None,
) -> tuple[ControlVector, MPPIState, Info, Float[Array, "nu nx"]]:
    """Plan once with MPPI and compute the gains of the control with respect to the state.

        K = du_0 / dx_0 = sum_k (du_0 / dJ_k) (dJ_k / dx_0)^T

    This is the exact derivative of the step for the noise that was drawn, through weighting,
    parameterisation and smoothing. For the softmax and the `Direct` parameterisation it is
    `-(1 / lambda) sum_k w_k eps_k (dJ_k/dx_0 - sum_j w_j dJ_j/dx_0)^T`. `FeedbackMPPI` uses the
    gains between plans, `u = u_0 + K (x - x_0)`.

    Model and cost must be differentiable. Rollouts whose derivative is not finite are left out.

    Source: Belvedere, Ziegltrum, Turrisi, Modugno, "Feedback-MPPI: Fast Sampling-Based MPC via
    Rollout Differentiation", 2025, eq. 17.

    Args:
        mppi: controller that plans.
        state: state of the controller.
        observation: (nx,) observed state of the robot.
        belief: what the robot knows of the world.
        key: random key of this step.
        perturbations: (P, nu, K) perturbations to use instead of the proposal's noise.

    Returns:
        The control (nu,), the new state and `Info`, as `MPPI.step`, and the gains (nu, nx).
    """
    sampled = mppi.sample(state, key=key, perturbations=perturbations)
    num_samples = sampled.samples.shape[-1]
    # With one copy of the state for each rollout, a single reverse pass gives the slopes of all K
    # costs.
    each = jnp.broadcast_to(observation[:, None], (observation.shape[0], num_samples))
    costs, pull_back = jax.vjp(lambda initial: mppi.evaluate(sampled, initial, belief), each)
    (slopes,) = pull_back(jnp.ones_like(costs))
    usable = jnp.isfinite(costs) & jnp.all(jnp.isfinite(slopes), axis=0)
    slopes = jnp.where(usable, slopes, 0.0)
    # The control has few components, so reverse mode needs one pass for each of them, not for
    # each of the K costs.
    sensitivity = jax.jacrev(lambda values: mppi.update(sampled, values)[0])(costs)
    sensitivity = jnp.where(jnp.isfinite(sensitivity), sensitivity, 0.0)
    return *mppi.update(sampled, costs), sensitivity @ slopes.T


class FeedbackState(NamedTuple):
    """State of `FeedbackMPPI`.

    Args:
        planner: state of the MPPI that plans.
        states: (T + 1, nx) planned states.
        gains: (nu, nx) feedback gains of the plan's first control.
        info: diagnostics of the last plan.
        commands: number of commands since the last plan.
    """

    planner: MPPIState
    states: Float[Array, "T+1 nx"]
    gains: Float[Array, "nu nx"]
    info: Info
    commands: Count


class FeedbackMPPI(Controller):
    """MPPI at every n-th command, with linear feedback around the plan in between.

        u(t) = clip(u_plan(t) + K (x(t) - x_plan(t)))

    with t the time since the plan and K the gains of the plan, see `step_with_gains`. Planned
    controls are constant over each model step, planned states are linear between steps. A command
    between plans costs one matrix product, so the robot is controlled at 200 Hz and more while
    plans are made at 50 Hz. States are subtracted component by component, so angles must not wrap.

    Source: Belvedere, Ziegltrum, Turrisi, Modugno, "Feedback-MPPI: Fast Sampling-Based MPC via
    Rollout Differentiation", 2025.

    Args:
        planner: MPPI controller; its control period is the time between plans.
        commands_per_plan: number of commands per plan, n. The time between commands is the control
            period divided by n.

    Raises:
        ValueError: `commands_per_plan` < 1.
    """

    planner: MPPI
    commands_per_plan: Count

    @_kinds.check_arguments
    def __init__(self, planner: MPPI, commands_per_plan: int = 4) -> None:
        self.planner = planner
        self.commands_per_plan = jnp.asarray(
            _checks.positive_int("commands_per_plan", commands_per_plan), jnp.int32
        )

    @property
    def command_period(self) -> Scalar:
        """Time between commands [s]."""
        return self.planner.control_period / self.commands_per_plan.astype(jnp.float32)

    def init(self) -> FeedbackState:
        """Return the initial state. The first command plans."""
        planner, model = self.planner, self.planner.dynamics
        samples = jnp.zeros(planner.num_samples)
        controls = jnp.zeros((planner.horizon, model.control_size))
        return FeedbackState(
            planner=planner.init(),
            states=jnp.zeros((planner.horizon + 1, model.state_size)),
            gains=jnp.zeros((model.control_size, model.state_size)),
            info=Info(
                controls, samples, samples, jnp.zeros(()), jnp.zeros((), bool), log_ratio=samples
            ),
            commands=jnp.zeros((), jnp.int32),
        )

    def at_period(self, control_period: ArrayLike) -> "FeedbackMPPI":
        """Return a copy of this controller that is called every `control_period` seconds."""
        period = _checks.scalar("control_period", control_period, above=0.0)
        planner = self.planner.at_period(period * self.commands_per_plan.astype(jnp.float32))
        same: FeedbackMPPI = eqx.tree_at(lambda controller: controller.planner, self, planner)
        return same

    def step(
        self, state: FeedbackState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, FeedbackState, Info]:
        """Compute one control; plan first if a plan is due.

        Returns:
            The control (nu,), the new state, and the `Info` of the last plan.
        """
        model = self.planner.dynamics
        observation = check_call(model, state, FeedbackState, observation, key)
        state = jax.lax.cond(
            state.commands % self.commands_per_plan == 0,
            lambda: self._plan(state, observation, belief, key),
            lambda: state,
        )
        control = self._feedback_control(state, observation)
        # The next plan must count changes and smooth from the control that the robot applied.
        after = state._replace(
            planner=state.planner._replace(applied=control), commands=state.commands + 1
        )
        return control, after, state.info

    def inspect(
        self,
        state: FeedbackState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of the planner as if it planned now."""
        model = self.planner.dynamics
        observation = check_call(model, state, FeedbackState, observation, key)
        return self.planner.inspect(
            state.planner, observation, belief, key=key, num_trajectories=num_trajectories
        )

    def _plan(
        self, state: FeedbackState, observation: StateVector, belief: Any, key: Key
    ) -> FeedbackState:
        """Plan with MPPI, and compute the planned states and the gains."""
        planner = self.planner
        _, after, info, gains = step_with_gains(
            planner, state.planner, observation, belief, key=key
        )
        # MPPI itself returns no states of its plan: the mean of rollouts is no rollout.
        planned = rollout(
            planner.dynamics, planner.cost, observation, info.controls, planner.dt, belief
        )
        return FeedbackState(after, planned.states, gains, info, jnp.zeros((), jnp.int32))

    def _feedback_control(self, state: FeedbackState, observation: StateVector) -> ControlVector:
        """Evaluate the feedback law at the time since the last plan."""
        planner = self.planner
        steps = state.commands.astype(jnp.float32) * self.command_period / planner.dt
        # In float32 a multiple of the command period may fall just short of a model step.
        steps = jnp.clip(steps + 1e-4, 0.0, planner.horizon - 1.0)
        index = jnp.floor(steps).astype(jnp.int32)
        share = steps - jnp.floor(steps)
        planned = (1.0 - share) * state.states[index] + share * state.states[index + 1]
        away = observation - planned
        # A lost robot has no finite state: it then follows the plan without feedback.
        correction = state.gains @ jnp.where(jnp.isfinite(away), away, 0.0)
        control = state.info.controls[index] + correction
        return jnp.clip(control, planner.dynamics.control_min, planner.dynamics.control_max)
