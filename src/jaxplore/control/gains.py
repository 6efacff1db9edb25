"""Feedback gains of an MPPI plan: the derivative of its first control by the initial state."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Key, StateVector
from jaxplore.control.base import Info
from jaxplore.control.mppi import MPPI
from jaxplore.control.mppi_state import MPPIState
from jaxplore.control.parameterisations import Samples


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
