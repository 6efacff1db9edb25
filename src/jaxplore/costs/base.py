"""Costs, and how they add up."""

import abc
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.dynamics.base import Dynamics, State


class Cost(eqx.Module):
    """What a rollout pays:

        sum over t of stage(x_{t+1}, u_t, t + dt) + terminal(x_T) + sequence(u_0 ... u_{T-1})

    Written for one rollout; the engine maps it. The stage cost is taken at the state that a control
    leads to. Weights are outside: `2.0 * A() + B()`.
    """

    @abc.abstractmethod
    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the cost of one step.

        Args:
            state: the state reached.
            control: (nu,) the control that led to it.
            t: time from now at which it is reached [s].
            belief: what the robot knows, as given to the controller: a `Belief`, or whatever
                pytree the cost expects.
        """

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Return the cost of the last state; none unless a cost says otherwise."""
        return jnp.zeros(())

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Return the cost of the controls as a sequence; none unless a cost says otherwise.

        Args:
            controls: (T, nu) those of the rollout.
            applied: (nu,) the control before them, the last one that was given out.
            dt: model step [s].
            dynamics: the model.
        """
        return jnp.zeros(())

    def terms(self) -> Iterator[tuple[str, "Cost"]]:
        """Yield the terms that add up to this cost, each with its name."""
        yield type(self).__name__, self

    def __add__(self, other: "Cost") -> "SumCost":
        return SumCost((self, other))

    def __mul__(self, weight: ArrayLike) -> "WeightedCost":
        return WeightedCost(_checks.scalar("weight", weight), self)

    def __rmul__(self, weight: ArrayLike) -> "WeightedCost":
        return self * weight

    def named(self, name: str) -> "NamedCost":
        """Return this cost as one term of that name, to tell it from others of its class."""
        return NamedCost(name, self)


class WeightedCost(Cost):
    """A cost times a weight; changing the weight never recompiles."""

    weight: Scalar
    cost: Cost

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the weighted stage cost."""
        return self.weight * self.cost.stage(state, control, t, belief)

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Return the weighted terminal cost."""
        return self.weight * self.cost.terminal(state, belief)

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Return the weighted cost of the sequence."""
        return self.weight * self.cost.sequence(controls, applied, dt, dynamics)

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the weighted terms."""
        for name, term in self.cost.terms():
            yield name, WeightedCost(self.weight, term)


class SumCost(Cost):
    """The sum of costs."""

    costs: tuple[Cost, ...]

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the sum of the stage costs."""
        total = jnp.zeros(())
        for cost in self.costs:
            total = total + cost.stage(state, control, t, belief)
        return total

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Return the sum of the terminal costs."""
        total = jnp.zeros(())
        for cost in self.costs:
            total = total + cost.terminal(state, belief)
        return total

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Return the sum of the costs of the sequence."""
        total = jnp.zeros(())
        for cost in self.costs:
            total = total + cost.sequence(controls, applied, dt, dynamics)
        return total

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the terms of every summand."""
        for cost in self.costs:
            yield from cost.terms()


class NamedCost(Cost):
    """A cost under a name of its own: `ObstacleCost().named("left wall")`.

    A sum that is named is one term. Weights may be inside or outside the name.

    Args:
        name: of the term; static.
        cost: what is paid.

    Raises:
        ValueError: a name that is empty or no text.
    """

    cost: Cost
    name: str = eqx.field(static=True)

    def __init__(self, name: str, cost: Cost) -> None:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"name is {name!r}; accepted: a text that is not empty")
        self.name = name
        self.cost = cost

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the stage cost."""
        return self.cost.stage(state, control, t, belief)

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Return the terminal cost."""
        return self.cost.terminal(state, belief)

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Return the cost of the sequence."""
        return self.cost.sequence(controls, applied, dt, dynamics)

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the cost as one term."""
        yield self.name, self.cost
