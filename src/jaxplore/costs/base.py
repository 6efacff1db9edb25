"""The interface of costs, and their sums, weights and names."""

import abc
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._describe import WIDTH, describe, describe_fields
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.dynamics.base import Dynamics, State


class Cost(eqx.Module):
    """Cost of a rollout:

        sum over t of stage(x_{t+1}, u_t, t + dt) + terminal(x_T) + sequence(u_0 ... u_{T-1})

    A cost is written for one rollout; the rollout engine maps it over samples. The stage cost is
    evaluated at the state that a control leads to. Weights are applied outside: `2.0 * A() + B()`.
    """

    accepted_hint: ClassVar = (
        "such as A() + 2.0 * B(), or an instance of your own subclass of jaxplore.Cost"
    )
    """What an error says of accepted values."""

    @abc.abstractmethod
    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of one step.

        Args:
            state: state after the step.
            control: (nu,) control that led to it.
            t: time from now at which the state is reached [s].
            belief: what the robot knows of the world, as given to the controller: a `Belief`, or
                whatever pytree the cost expects.
        """

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Compute the cost of the last state; 0 by default."""
        return jnp.zeros(())

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Compute the cost of the control sequence as a whole; 0 by default.

        Args:
            controls: (T, nu) controls of the rollout.
            applied: (nu,) control of the last step, before the first of these.
            dt: model step [s].
            dynamics: model of the robot.
        """
        return jnp.zeros(())

    def terms(self) -> Iterator[tuple[str, "Cost"]]:
        """Yield the name and the cost of each term that adds up to this cost."""
        # A cost without parts is one term; sums override this.
        yield type(self).__name__, self

    def __repr__(self) -> str:
        return describe_fields(self)

    def __add__(self, other: "Cost") -> "SumCost":
        _check_summand(other)
        return SumCost((self, other))

    def __radd__(self, other: Any) -> "Cost":
        # `sum` begins with 0. Nothing else gets here but what `+` refuses.
        return self if isinstance(other, int) and other == 0 else self + other

    def __mul__(self, weight: ArrayLike) -> "WeightedCost":
        return WeightedCost(_checks.scalar("weight", weight), self)

    def __rmul__(self, weight: ArrayLike) -> "WeightedCost":
        return self * weight

    def with_name(self, name: str) -> "NamedCost":
        """Return this cost as one term with a name, to distinguish it from others of its class."""
        return NamedCost(name, self)

    if not TYPE_CHECKING:  # for type checkers any attribute could be set

        def __setattr__(self, name: str, value: Any) -> None:
            _kinds.check_annotation(self, name)
            super().__setattr__(name, value)


def _check_summand(value: object) -> None:
    # Python's operators raise a `TypeError`.
    try:
        _kinds.instance("summand", value, Cost)
    except ValueError as error:
        raise TypeError(str(error)) from None


class WeightedCost(Cost):
    """A cost times a weight. The weight is a leaf: changing it does not recompile."""

    weight: Scalar
    cost: Cost

    def __repr__(self) -> str:
        return f"{describe(self.weight)} * {_in_brackets(self.cost)}"

    def __check_init__(self) -> None:
        _kinds.instance("cost", self.cost, Cost)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the weighted stage cost."""
        return self.weight * self.cost.stage(state, control, t, belief)

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Compute the weighted terminal cost."""
        return self.weight * self.cost.terminal(state, belief)

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Compute the weighted cost of the sequence."""
        return self.weight * self.cost.sequence(controls, applied, dt, dynamics)

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the weighted terms."""
        for name, term in self.cost.terms():
            yield name, WeightedCost(self.weight, term)


class SumCost(Cost):
    """The sum of costs."""

    costs: tuple[Cost, ...]

    def __repr__(self) -> str:
        terms = [repr(cost) for cost in self.costs]
        line = " + ".join(terms)
        return line if len(line) <= WIDTH else "\n+ ".join(terms)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the sum of the stage costs."""
        total = jnp.zeros(())
        for cost in self.costs:
            total = total + cost.stage(state, control, t, belief)
        return total

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Compute the sum of the terminal costs."""
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
        """Compute the sum of the costs of the sequence."""
        total = jnp.zeros(())
        for cost in self.costs:
            total = total + cost.sequence(controls, applied, dt, dynamics)
        return total

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the terms of every summand."""
        for cost in self.costs:
            yield from cost.terms()


class NamedCost(Cost):
    """A cost with a name: `ObstacleCost().with_name("left wall")`.

    A named sum is one term. Weights may be applied inside or outside the name.

    Args:
        name: name of the term; static.
        cost: cost of the term.

    Raises:
        ValueError: a name that is empty or not a string.
    """

    cost: Cost
    name: str = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(self, name: str, cost: Cost) -> None:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"name is {name!r}; accepted: a text that is not empty")
        self.name = name
        self.cost = cost

    def __repr__(self) -> str:
        return f"{_in_brackets(self.cost)}.with_name({self.name!r})"

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the stage cost."""
        return self.cost.stage(state, control, t, belief)

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Compute the terminal cost."""
        return self.cost.terminal(state, belief)

    def sequence(
        self,
        controls: Float[Array, "T nu"],
        applied: ControlVector,
        dt: Scalar,
        dynamics: Dynamics,
    ) -> Scalar:
        """Compute the cost of the sequence."""
        return self.cost.sequence(controls, applied, dt, dynamics)

    def terms(self) -> Iterator[tuple[str, Cost]]:
        """Yield the cost as one term."""
        yield self.name, self.cost


def _in_brackets(cost: Cost) -> str:
    return f"({cost!r})" if isinstance(cost, (SumCost, WeightedCost)) else repr(cost)
