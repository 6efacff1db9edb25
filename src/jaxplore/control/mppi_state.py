"""The state of MPPI between two steps, its shift in time, and the samples within a step."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Scalar
from jaxplore.control.parameterisations import (
    ControlSpace,
    Parameterisation,
    Samples,
    shift_sequence,
)
from jaxplore.control.proposals import Proposal, SamplingContext
from jaxplore.control.rollout import Outcomes


class MPPIState(NamedTuple):
    """State of MPPI between steps.

    Args:
        nominal: last solution, as the parameterisation stores it; with `Direct` it is the control
            sequence (T, nu) itself.
        proposal: memory of the proposal; empty unless the proposal adapts.
        applied: (nu,) control of the last step.
        past: (H, nu) controls applied before that one, one per model step, newest last. H is the
            number of past controls that the smoothing filter reads.
        phase: fraction of a model step by which the nominal lags behind, if shifts are not
            interpolated.
    """

    nominal: Any
    proposal: Any
    applied: ControlVector
    past: Float[Array, "H nu"]
    phase: Scalar


class SampledControls(NamedTuple):
    """Control sequences that were sampled and have not been evaluated yet.

    Args:
        state: state of the controller after the shift.
        context: nominal and parameterisation that the proposal sampled around.
        samples: (P, nu, K) parameters as they took effect, that is after clipping.
        controls: (T, nu, K) control sequences of these parameters.
        outcomes: draws of the disturbance; None without one.
    """

    state: MPPIState
    context: SamplingContext
    samples: Samples
    controls: Float[Array, "T nu K"]
    outcomes: Outcomes | None


def shift_state(
    state: MPPIState,
    steps: Scalar,
    space: ControlSpace,
    parameterisation: Parameterisation,
    proposal: Proposal,
    *,
    is_interpolated: bool,
) -> MPPIState:
    """Move the nominal and the memories on by a number of model steps, not necessarily whole.

    With `is_interpolated` a part of a model step interpolates the nominal. Without it, the nominal
    is shifted by whole model steps when they are due.
    """
    phase = state.phase
    if not is_interpolated:
        # In float32, 20 periods of 0.05 s add up to slightly less than a step of 1 s.
        due = phase + steps
        steps = jnp.floor(due + 1e-3)
        phase = due - steps
    # Proposals adapt per row of parameters, of which there may be fewer than model steps.
    rows = steps * (parameterisation.num_parameters(space.horizon) / space.horizon)
    planned = parameterisation.controls(state.nominal, space)
    # The first planned control has been applied; where it differs (a portfolio applies the fused
    # control), the smoothing filter must see what was applied.
    timeline = jnp.concatenate([state.past, state.applied[None], planned[1:]])
    return MPPIState(
        nominal=parameterisation.shift(state.nominal, steps, space),
        proposal=proposal.shift(state.proposal, rows),
        applied=state.applied,
        past=shift_sequence(timeline, steps, space.default)[: state.past.shape[0]],
        phase=phase,
    )
