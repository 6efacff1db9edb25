"""Costs of leaving the bounds of a state or the speed limit."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._checks import by_name, names_within
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State


class StateBoundsCost(Cost):
    """Squared distance of named state components outside their bounds,

        sum_i ((lower_i - x_i)_+^2 + (x_i - upper_i)_+^2) / scale_i^2

    The cost is 0 inside the bounds and continuous at them. A box for the position is given by
    bounds of `x`, `y` and `z`. Angles are compared without wrapping.

    Args:
        lower: lower bounds by name of the component [unit of the component]; the names are static.
        upper: upper bounds by name. A component may have one bound or both.
        scale: distance outside that costs 1, by name [unit of the component]; 1 where absent.

    Raises:
        ValueError: no bound at all, a lower bound above the upper one, a scale that is not positive
            or of a component without bounds. When traced, a name that the model does not have.
    """

    lower: dict[str, Scalar]
    upper: dict[str, Scalar]
    scale: dict[str, Scalar]

    def __init__(
        self,
        lower: Mapping[str, ArrayLike] | None = None,
        upper: Mapping[str, ArrayLike] | None = None,
        scale: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        self.lower = by_name("lower", lower)
        self.upper = by_name("upper", upper)
        bounded = {**self.lower, **self.upper}
        if not bounded:
            raise ValueError(
                f"lower is {lower!r} and upper is {upper!r}; accepted: one bound or more"
            )
        for name in sorted(self.lower.keys() & self.upper.keys()):
            low, high = self.lower[name], self.upper[name]
            if not _kinds.is_traced(low, high) and low > high:
                raise ValueError(
                    f"lower[{name!r}] is {low}; accepted: at most the upper one, {high}"
                )
        given = by_name("scale", scale, above=0.0)
        names_within("scale", list(given), bounded)
        self.scale = {name: given.get(name, jnp.ones(())) for name in sorted(bounded)}

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the sum of the squared distances outside the bounds."""
        total = jnp.zeros(())
        for name, scale in self.scale.items():
            value, inverse = state[name], 1.0 / scale
            depth = jnp.zeros(())
            if name in self.lower:
                depth = depth + jnp.maximum(self.lower[name] - value, 0.0)
            if name in self.upper:
                depth = depth + jnp.maximum(value - self.upper[name], 0.0)
            # At most one of the two terms is positive, so their sum is squared.
            depth = inverse * depth
            total = total + depth * depth
        return total


class SpeedLimitCost(Cost):
    """Squared speed above a limit, `((|v| - limit)_+ / scale)^2`.

    Args:
        limit: speed up to which the cost is 0 [m/s].
        scale: excess speed that costs 1 [m/s].

    Raises:
        ValueError: a value that is not positive.
    """

    limit: Scalar
    scale: Scalar

    def __init__(self, limit: ArrayLike, scale: ArrayLike = 0.1) -> None:
        self.limit = _checks.scalar("limit", limit, above=0.0)
        self.scale = _checks.scalar("scale", scale, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the squared excess speed."""
        excess = jnp.maximum(jnp.abs(state.speed) - self.limit, 0.0) / self.scale
        return excess * excess


class BackwardsCost(Cost):
    """Speed backwards, `(-v)_+ / scale`, for a robot that prefers to drive forwards.

    v is the forward component of the velocity: `vx` of an `Omnidirectional`, the speed of any other
    robot.

    Args:
        scale: speed backwards that costs 1 [m/s].

    Raises:
        ValueError: a scale that is not positive. When traced, a model without a speed.
    """

    scale: Scalar

    def __init__(self, scale: ArrayLike = 1.0) -> None:
        self.scale = _checks.scalar("scale", scale, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the speed backwards, in units of the scale."""
        forward = state["vx"] if "vx" in state.dynamics.state_names else state.speed
        return jnp.maximum(-forward, 0.0) / self.scale
