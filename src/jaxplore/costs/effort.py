"""Costs of the controls: effort, and changes from step to step."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._checks import array
from jaxplore._types import ControlVector, Rows, Scalar, Vector
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.geometry.vectors import squared_length


class ControlCost(Cost):
    """Control effort, `sum_i (u_i / max(|u_min,i|, |u_max,i|))^2`: 1 per control at its bound.

    A control whose bounds are both 0 costs nothing.
    """

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the control effort."""
        low, high = state.dynamics.control_min, state.dynamics.control_max
        largest = jnp.maximum(jnp.abs(low), jnp.abs(high))
        share = control / jnp.where(largest > 0.0, largest, 1.0)
        return squared_length(*share)


class QuadraticControlCost(Cost):
    """Quadratic control effort, `(u - u*)^T R (u - u*)`.

    Args:
        weights: matrix R (nu, nu), or its diagonal (nu,) [1 / unit of the control squared].
        target: (nu,) control that costs nothing, u*; the `default_control` of the model when
            absent.

    Raises:
        ValueError: negative weights, a matrix with a negative eigenvalue, sizes that differ. When
            traced, sizes that do not fit the model.
    """

    weights: Float[Array, " nu"] | Float[Array, "nu nu"]
    target: ControlVector | None

    def __init__(self, weights: Rows, target: Vector | None = None) -> None:
        self.weights = array("weights", weights, ("nu",), ("nu", "nu"))
        _check_no_reward(self.weights)
        size = self.weights.shape[0]
        self.target = None if target is None else array("target", target, (size,))

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the control effort."""
        _check_size("weights", self.weights, state.dynamics)
        target = state.dynamics.default_control if self.target is None else self.target
        error = [value - wanted for value, wanted in zip(control, target, strict=True)]
        # Component by component: mapped over samples, each is one vector, as in `costs._distance`.
        total = jnp.zeros(())
        for i, row in enumerate(error):
            if self.weights.ndim == 1:
                total = total + self.weights[i] * row * row
            else:
                for j, column in enumerate(error):
                    total = total + self.weights[i, j] * row * column
        return total


class ControlDifferenceCost(Cost):
    """Squared differences of some order of the controls, each divided by a scale; abstract."""

    scale: eqx.AbstractVar[Scalar | ControlVector | None]

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return 0: changes are a property of the sequence."""
        return jnp.zeros(())

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Compute the sum over steps and controls."""
        paid = self._squares(controls, applied)
        return jnp.sum(paid * _inverse_squares(self.scale, dynamics))

    @abc.abstractmethod
    def _squares(self, controls: Float[Array, "T nu"], applied: ControlVector) -> ControlVector:
        """Compute the sum of the squared differences of each control (nu,)."""


class ControlRateCost(ControlDifferenceCost):
    """Squared changes of the controls from step to step:

        sum_t sum_i ((u_t,i - u_{t-1,i}) / s_i)^2

    with `u_{-1}` the control applied last. The sum is over steps and does not depend on `dt`.

    Args:
        scale: change that costs 1, s, (nu,) or one number [unit of the control]; the range between
            the bounds when absent. A control whose range is 0 or infinite then costs nothing.
        include_applied: whether the first control is compared with the control applied last;
            static.

    Raises:
        ValueError: a scale that is not positive. When traced, one that does not fit the model.
    """

    scale: Scalar | ControlVector | None
    include_applied: bool = eqx.field(static=True)

    def __init__(self, scale: Vector | None = None, include_applied: bool = True) -> None:
        self.scale = None if scale is None else array("scale", scale, (), ("nu",), above=0.0)
        self.include_applied = _kinds.flag("include_applied", include_applied)

    def _squares(self, controls: Float[Array, "T nu"], applied: ControlVector) -> ControlVector:
        changes = controls[1:] - controls[:-1]
        paid = jnp.sum(changes * changes, axis=0)
        if self.include_applied:
            first = controls[0] - applied
            paid = paid + first * first
        return paid


class ControlJerkCost(ControlDifferenceCost):
    """Squared second differences of the controls:

        sum_t sum_i ((u_t,i - 2 u_{t-1,i} + u_{t-2,i}) / s_i)^2

    with `u_{-1}` the control applied last, where the sum begins. A control that changes at a
    constant rate costs nothing. The sum does not depend on `dt`.

    Args:
        scale: second difference that costs 1, s, (nu,) or one number [unit of the control]; the
            range between the bounds when absent. A control whose range is 0 or infinite then costs
            nothing.
        include_applied: whether the sum includes the control applied last, or begins one step
            later; static.

    Raises:
        ValueError: a scale that is not positive. When traced, one that does not fit the model.
    """

    scale: Scalar | ControlVector | None
    include_applied: bool = eqx.field(static=True)

    def __init__(self, scale: Vector | None = None, include_applied: bool = True) -> None:
        self.scale = None if scale is None else array("scale", scale, (), ("nu",), above=0.0)
        self.include_applied = _kinds.flag("include_applied", include_applied)

    def _squares(self, controls: Float[Array, "T nu"], applied: ControlVector) -> ControlVector:
        changes = controls[1:] - controls[:-1]
        bends = changes[1:] - changes[:-1]
        paid = jnp.sum(bends * bends, axis=0)
        # A horizon of one step has no second difference.
        if self.include_applied and controls.shape[0] > 1:
            first = changes[0] - (controls[0] - applied)
            paid = paid + first * first
        return paid


def _inverse_squares(scale: Array | None, dynamics: Dynamics) -> ControlVector:
    if scale is None:
        # A fixed control has no range. An infinite range gives an inverse of 0.
        span = dynamics.control_max - dynamics.control_min
        inverse = jnp.where(span > 0.0, 1.0 / jnp.where(span > 0.0, span, 1.0), 0.0)
    else:
        if scale.ndim == 1:
            _check_size("scale", scale, dynamics)
        inverse = jnp.broadcast_to(1.0 / scale, (dynamics.control_size,))
    return inverse * inverse


def _check_size(name: str, value: Array, dynamics: Dynamics) -> None:
    size = dynamics.control_size
    if value.shape[0] != size:
        raise ValueError(
            f"{name} is for {value.shape[0]} controls; "
            f"accepted: {size}, the controls of {type(dynamics).__name__}"
        )


def _check_no_reward(weights: Array) -> None:
    """Raise a `ValueError` if the quadratic form of the weights is not bounded below."""
    if _kinds.is_traced(weights):
        return
    given = np.asarray(weights, np.float64)
    # A quadratic form depends on the symmetric part of its matrix alone.
    matrix = np.diag(given) if given.ndim == 1 else 0.5 * (given + given.T)
    lowest = np.linalg.eigvalsh(matrix).min()
    # Rounding to float32 can make a zero eigenvalue slightly negative.
    if lowest < -1e-6 * np.abs(matrix).max():
        raise ValueError(
            f"weights is {given.tolist()}, which rewards some controls (eigenvalue {lowest:.3g}); "
            "accepted: no eigenvalue below 0"
        )
