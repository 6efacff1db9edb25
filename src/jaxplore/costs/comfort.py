"""The cost of accelerations, which passengers and loads feel and tyres have to transmit."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore.costs.base import Cost
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics, State
from jaxplore.geometry.angles import sin_cos


class ComfortCost(Cost):
    """Acceleration of the robot's position, along its heading and across it:

        ((|a_lat| - free_lateral)_+ / lateral)^2
            + ((|a_lon| - free_longitudinal)_+ / longitudinal)^2

    with (a_lon, a_lat) the second time derivative of the position (x, y) under a constant control,
    rotated to the frame of the robot. In a bend of curvature k at speed v, a_lat = v^2 k. Changes
    of the controls are penalised by `ControlRateCost` and `ControlJerkCost`.

    Args:
        lateral: lateral acceleration beyond the free one that costs 1 [m/s^2].
        longitudinal: longitudinal acceleration beyond the free one that costs 1 [m/s^2].
        free_lateral: lateral acceleration that costs nothing, such as the grip of the tyres
            [m/s^2].
        free_longitudinal: longitudinal acceleration that costs nothing [m/s^2].

    Raises:
        ValueError: a scale that is not positive, a negative free acceleration. When traced, a model
            that is not given by its time derivative.
    """

    lateral: Scalar
    longitudinal: Scalar
    free_lateral: Scalar
    free_longitudinal: Scalar

    def __init__(
        self,
        lateral: ArrayLike = 2.0,
        longitudinal: ArrayLike = 2.0,
        free_lateral: ArrayLike = 0.0,
        free_longitudinal: ArrayLike = 0.0,
    ) -> None:
        self.lateral = _checks.scalar("lateral", lateral, above=0.0)
        self.longitudinal = _checks.scalar("longitudinal", longitudinal, above=0.0)
        self.free_lateral = _checks.scalar("free_lateral", free_lateral, at_least=0.0)
        self.free_longitudinal = _checks.scalar(
            "free_longitudinal", free_longitudinal, at_least=0.0
        )

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of the accelerations."""
        along, across = acceleration(state.values, control, state.dynamics)
        hard = jnp.maximum(jnp.abs(along) - self.free_longitudinal, 0.0) / self.longitudinal
        sideways = jnp.maximum(jnp.abs(across) - self.free_lateral, 0.0) / self.lateral
        return hard * hard + sideways * sideways

    def accelerations(
        self,
        states: Float[Array, "T nx"],
        controls: Float[Array, "T nu"],
        dynamics: Dynamics,
    ) -> Float[Array, "T 2"]:
        """Compute (a_lon, a_lat) of each of T states under its control (T, 2) [m/s^2]."""

        def one(values: Array, control: Array) -> Array:
            return jnp.stack(acceleration(values, control, dynamics))

        return jax.vmap(one)(states, controls)


def acceleration(
    state: StateVector, control: ControlVector, dynamics: Dynamics
) -> tuple[Scalar, Scalar]:
    """Compute the acceleration of a robot's position along its heading and to its left [m/s^2].

    The control is taken as constant. Of an `Augmented` model the physical part is used.
    """
    if isinstance(dynamics, Augmented):
        state, control = dynamics.split_state(state)[0], dynamics.split_control(control)[0]
        return acceleration(state, control, dynamics.physical)
    if not isinstance(dynamics, ContinuousDynamics):
        raise ValueError(
            f"dynamics is {type(dynamics).__name__}, whose accelerations are not known; accepted: "
            "a ContinuousDynamics"
        )
    # The position may be any function of the state. Its second time derivative is a derivative
    # along the flow taken twice: no model has to provide accelerations.
    model = dynamics

    def velocity(values: Array) -> Array:
        rate = model.derivative(values, control)
        moved: Array = jax.jvp(model.position, (values,), (rate,))[1]
        return moved

    x, y = jax.jvp(velocity, (state,), (model.derivative(state, control),))[1]
    heading = model.heading(state)
    sin, cos = sin_cos(heading)
    return cos * x + sin * y, cos * y - sin * x
