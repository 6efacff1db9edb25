"""How a plan's first control changes with the state it is made for."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Key, StateVector
from jaxplore.control.base import Info
from jaxplore.control.draft import MPPIState
from jaxplore.control.mppi import MPPI
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
    """Plan once with MPPI, and say how the control would change with the observed state.

        K = du_0 / dx_0 = sum_k (du_0 / dJ_k) (dJ_k / dx_0)^T

    is the derivative of the whole step for the noise that was drawn: through the weighting, the
    parameterisation and the smoothing, exactly. For the softmax and controls sampled directly it is
    `-(1 / lambda) sum_k w_k eps_k (dJ_k/dx_0 - sum_j w_j dJ_j/dx_0)^T`. With it a controller
    follows its plan between plans, `u = u_0 + K (x - x_0)`: see `FeedbackMPPI`.

    Model and cost must be differentiable; rollouts whose derivative is not finite are left out.

    Source: Belvedere, Ziegltrum, Turrisi, Modugno, "Feedback-MPPI: Fast Sampling-Based MPC via
    Rollout Differentiation", 2025, eq. 17.

    Args:
        mppi: the controller.
        state: as of `MPPI.step`, and so are the others.
        observation: (nx,).
        belief: what the robot knows.
        key: randomness.
        perturbations: (P, nu, K) instead of the proposal's noise.

    Returns:
        What `MPPI.step` returns, and the gains (nu, nx).
    """
    plan = mppi.draft(state, key=key, perturbations=perturbations)
    samples = plan.samples.shape[-1]
    each = jnp.broadcast_to(observation[:, None], (observation.shape[0], samples))
    costs, pull_back = jax.vjp(lambda initial: mppi.price(plan, initial, belief), each)
    (slopes,) = pull_back(jnp.ones_like(costs))
    usable = jnp.isfinite(costs) & jnp.all(jnp.isfinite(slopes), axis=0)
    slopes = jnp.where(usable, slopes, 0.0)
    sensitivity = jax.jacrev(lambda values: mppi.conclude(plan, values)[0])(costs)
    sensitivity = jnp.where(jnp.isfinite(sensitivity), sensitivity, 0.0)
    return *mppi.conclude(plan, costs), sensitivity @ slopes.T
