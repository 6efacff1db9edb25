"""What MPPI remembers between steps, and what it holds in the middle of one."""

from typing import Any, NamedTuple

from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Scalar
from jaxplore.control.parameterisations import Samples
from jaxplore.control.proposals import SamplingContext
from jaxplore.control.rollout import Outcomes


class MPPIState(NamedTuple):
    """What MPPI remembers between steps.

    Args:
        nominal: of the parameterisation; the control sequence (T, nu) itself with `Direct`.
        proposal: memory of the proposal; nothing unless it adapts.
        applied: (nu,) the control given out last.
        past: (H, nu) what was applied before, one per model step, newest last; as many as the
            smoothing looks back on.
        phase: part of a model step by which the nominal lags behind, if shifts do not interpolate.
    """

    nominal: Any
    proposal: Any
    applied: ControlVector
    past: Float[Array, "H nu"]
    phase: Scalar


class Draft(NamedTuple):
    """A step half done: what was sampled, before it is priced.

    Args:
        state: of the controller, moved on.
        around: what was sampled around.
        samples: (P, nu, K) parameters as they take effect.
        controls: (T, nu, K) the sequences that they are.
        outcomes: uncertain ones, if there is a disturbance.
    """

    state: MPPIState
    around: SamplingContext
    samples: Samples
    controls: Float[Array, "T nu K"]
    outcomes: Outcomes | None
