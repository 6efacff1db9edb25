"""The state of MPPI between two steps, and its intermediate result within a step."""

from typing import Any, NamedTuple

from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Scalar
from jaxplore.control.parameterisations import Samples
from jaxplore.control.proposals import SamplingContext
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
