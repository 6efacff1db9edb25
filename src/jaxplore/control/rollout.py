"""Rollouts: simulate control sequences with the model and add up their costs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Count, Key, Scalar, StateVector
from jaxplore._xla import cut
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.model_checks import check_costs, check_state
from jaxplore.control.risk import Risk
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State


class Outcomes(NamedTuple):
    """Draws of a disturbance: M outcomes of each rollout, reduced to one cost by a risk measure.

    Args:
        disturbance: distribution of what is uncertain.
        risk: risk measure over the M costs of a control sequence.
        drawn: draws of the disturbance, a pytree whose leaves begin with (T, M).
    """

    disturbance: Disturbance
    risk: Risk
    drawn: Any

    @classmethod
    def draw(
        cls,
        disturbance: Disturbance,
        risk: Risk,
        dynamics: Dynamics,
        horizon: int,
        num_outcomes: int,
        *,
        key: Key,
    ) -> "Outcomes":
        """Draw M outcomes of T steps; all control sequences share them."""
        drawn = disturbance.draw(dynamics, horizon, num_outcomes, key=key)
        return cls(disturbance, risk, drawn)


def rollout_costs(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector | Float[Array, "nx K"],
    controls: Float[Array, "T nu K"],
    dt: Scalar,
    belief: Any = None,
    *,
    applied: ControlVector | None = None,
    outcomes: Outcomes | None = None,
    steps: Count | None = None,
) -> Float[Array, " K"]:
    """Simulate K control sequences and return their costs (K,).

        J = sum_t stage(x_{t+1}, u_t) + terminal(x_T) + sequence(U)

    Costs are summed inside the scan over time, so the T x K states are never stored. Each state
    component is one vector of K samples: the layout from which XLA makes vector loops.

    Args:
        dynamics: model of the robot.
        cost: cost to sum up.
        initial: (nx,) initial state of all rollouts, or (nx, K) one for each.
        controls: (T, nu, K) control sequences.
        dt: model step [s].
        belief: what the robot knows of the world.
        applied: (nu,) control before the first one; the default control when absent.
        outcomes: M draws of a disturbance; None if the model is taken as exact.
        steps: number H of steps to simulate, from 1 to T; all T when absent. The sum of the stage
            costs is then times T / H, so that a temperature means the same for every H. Such a
            rollout has no derivative in reverse mode.

    Raises:
        ValueError: a model or a cost that returns the wrong shape.
    """
    (total,) = _totals(
        dynamics,
        (cost,),
        initial,
        controls,
        dt,
        belief,
        applied=applied,
        outcomes=outcomes,
        steps=steps,
    )
    return total


def rollout_objectives(
    dynamics: Dynamics,
    objectives: Sequence[Cost],
    initial: StateVector | Float[Array, "nx K"],
    controls: Float[Array, "T nu K"],
    dt: Scalar,
    belief: Any = None,
    *,
    applied: ControlVector | None = None,
) -> Float[Array, "O K"]:
    """Simulate K control sequences once and return each of O costs separately (O, K).

    What the costs have in common, such as a look-up in the same map, is computed once.

    Args:
        dynamics: model of the robot.
        objectives: the O costs.
        initial: (nx,) initial state of all rollouts, or (nx, K) one for each.
        controls: (T, nu, K) control sequences.
        dt: model step [s].
        belief: what the robot knows of the world.
        applied: (nu,) control before the first one; the default control when absent.

    Raises:
        ValueError: a model or a cost that returns the wrong shape.
    """
    return jnp.stack(
        _totals(dynamics, tuple(objectives), initial, controls, dt, belief, applied=applied)
    )


def _totals(
    dynamics: Dynamics,
    costs: tuple[Cost, ...],
    initial: StateVector | Float[Array, "nx K"],
    controls: Float[Array, "T nu K"],
    dt: Scalar,
    belief: Any,
    *,
    applied: ControlVector | None = None,
    outcomes: Outcomes | None = None,
    steps: Count | None = None,
) -> tuple[Float[Array, " K"], ...]:
    """Roll out K control sequences and return the total (K,) of each cost."""
    horizon, _, num_samples = controls.shape
    task = _RolloutTask(dynamics, costs, horizon, dt, belief, outcomes)
    lanes = _lanes(num_samples)
    shape = (lanes,) if outcomes is None else (task.num_outcomes, lanes)
    # Where outcomes differ in the belief only, all of them have the same states.
    state_shape = shape if task.outcome_axis is not None else (lanes,)

    # The padded lanes copy the last sample: states of zeros might not be valid for a model.
    if initial.ndim == 2:
        initial = jnp.pad(initial, ((0, 0), (0, lanes - num_samples)), mode="edge")
    start = tuple(jnp.broadcast_to(value, state_shape) for value in initial)
    times = dt * jnp.arange(1, horizon + 1, dtype=dt.dtype)
    zeros = tuple(jnp.zeros(shape) for _ in costs), tuple(jnp.zeros(lanes) for _ in costs)
    step_all = task.batch_step()

    def advance(carry: _Carry, inputs: tuple[Array, Array, Any]) -> tuple[_Carry, None]:
        components, totals, variations = carry
        control, t, draw = inputs
        # Without the cut, each output of the step would pad the controls again.
        control = cut(jnp.pad(control, ((0, 0), (0, lanes - num_samples))))
        reached, paid = step_all(components, control, t, draw)
        if outcomes is not None:
            variations = tuple(
                variation + outcomes.risk.step_variation(each, t, dt)
                for variation, each in zip(variations, paid, strict=True)
            )
        totals = tuple(total + each for total, each in zip(totals, paid, strict=True))
        return (tuple(reached), totals, variations), None

    rows = (controls, times, task.drawn)
    if steps is None:
        (last, totals, variations), _ = jax.lax.scan(advance, (start, *zeros), rows)
    else:

        def nth(step: Count, carry: _Carry) -> _Carry:
            return advance(carry, jax.tree.map(lambda each: each[step], rows))[0]

        last, totals, variations = jax.lax.fori_loop(0, steps, nth, (start, *zeros))
        whole = horizon / steps.astype(dt.dtype)
        totals, variations = jax.tree.map(lambda each: whole * each, (totals, variations))
    before = dynamics.default_control if applied is None else applied
    return tuple(
        task.total(cost, last, total, variation, controls, before, steps)
        for cost, total, variation in zip(costs, totals, variations, strict=True)
    )


_Values = tuple[Array, ...]
_Carry = tuple[_Values, _Values, _Values]
"""State components, totals and variations of the costs, in the scan over time."""


class _RolloutTask(NamedTuple):
    """What all rollouts of one batch share, and the functions of one rollout."""

    dynamics: Dynamics
    costs: tuple[Cost, ...]
    horizon: int
    dt: Scalar
    belief: Any
    outcomes: Outcomes | None

    @property
    def drawn(self) -> Any:
        """Draws of the disturbance; leaves begin with (T, M)."""
        return () if self.outcomes is None else self.outcomes.drawn

    @property
    def num_outcomes(self) -> int:
        return int(jax.tree.leaves(self.drawn)[0].shape[1])

    @property
    def outcome_axis(self) -> int | None:
        """Axis of the states that counts outcomes; None where all outcomes share the states."""
        return 0 if self.outcomes is not None and self.outcomes.disturbance.moves_robot else None

    def belief_in(self, draw: Any) -> Any:
        outcomes = self.outcomes
        return self.belief if outcomes is None else outcomes.disturbance.belief(self.belief, draw)

    def number(self, cost: Cost, method: Callable[..., Array], *arguments: Any) -> Array:
        """Call a method of a cost; if its result is not one number, raise the error of the term."""
        # Finding the term that fails traces all of them again, so it is done only after a failure.
        try:
            paid = method(*arguments)
        except (TypeError, ValueError):
            check_costs(self.dynamics, cost, self.horizon, self.belief)
            raise
        if jnp.shape(paid) != ():
            check_costs(self.dynamics, cost, self.horizon, self.belief)
        return paid

    def step(
        self, components: _Values, control: Array, t: Array, draw: Any
    ) -> tuple[Array, tuple[Array, ...]]:
        """Advance one rollout by one step; return the state reached and each stage cost there."""
        # `t` is the end of the step, which costs read. A model takes its beginning, t - dt.
        dynamics, dt, state = self.dynamics, self.dt, jnp.stack(components)
        if self.outcomes is None:
            reached = dynamics.step_at(state, control, t - dt, dt)
        else:
            disturbance = self.outcomes.disturbance
            reached = disturbance.step_at(dynamics, state, control, t - dt, dt, draw)
        check_state(dynamics, jnp.shape(reached))
        # Costs read the new state. If XLA fused them with the model, each would compute the model's
        # step again.
        reached = jnp.stack(cut(tuple(reached)))
        here, known = State(reached, dynamics, control), self.belief_in(draw)
        paid = tuple(self.number(cost, cost.stage, here, control, t, known) for cost in self.costs)
        return reached, paid

    def batch_step(self) -> Callable[..., Any]:
        """Map `step` over samples (last axis) and, if there are any, outcomes (first axis)."""
        step = jax.vmap(self.step, in_axes=(0, -1, None, None), out_axes=(-1, 0))
        if self.outcomes is None:
            return step
        # States are (nx, M, K) after a step: outcomes come after the components.
        out = None if self.outcome_axis is None else 1
        in_axes = (self.outcome_axis, None, None, 0)
        return jax.vmap(step, in_axes=in_axes, out_axes=(out, 0))

    def total(
        self,
        cost: Cost,
        last: _Values,
        total: Array,
        variation: Array,
        controls: Float[Array, "T nu K"],
        before: ControlVector,
        steps: Count | None,
    ) -> Float[Array, " K"]:
        """Add the terminal and the sequence cost to a sum of stage costs."""

        def terminal(components: _Values, control: Array, draw: Any) -> Array:
            state = State(jnp.stack(components), self.dynamics, control)
            return self.number(cost, cost.terminal, state, self.belief_in(draw))

        def sequence(planned: Array) -> Array:
            return self.number(cost, cost.sequence, planned, before, self.dt, self.dynamics)

        num_samples, lanes = controls.shape[-1], last[0].shape[-1]
        ending = jax.vmap(terminal, in_axes=(0, -1, None))
        if self.outcomes is not None:
            ending = jax.vmap(ending, in_axes=(self.outcome_axis, None, 0))
        end = -1 if steps is None else steps - 1
        # Only a model whose speed is a control reads it; for the others XLA removes it.
        final = jnp.pad(controls[end], ((0, 0), (0, lanes - num_samples)))
        # The terminal cost reads the belief of the last step.
        total = total + ending(last, final, jax.tree.map(lambda rows: rows[end], self.drawn))
        if self.outcomes is not None:
            # One outcome that diverges makes the sequence infinitely expensive under any risk.
            is_finite = jnp.all(jnp.isfinite(total), axis=0)
            total = jnp.where(is_finite, self.outcomes.risk.costs(total, variation), jnp.inf)
        # The sequence cost depends on the controls alone, which no outcome changes.
        return total[:num_samples] + jax.vmap(sequence, in_axes=-1)(controls)


def _lanes(num_samples: int) -> int:
    """Return the length of the sample vectors: `num_samples`, or one cache line more. The vectors
    of all state components lie side by side. Those of a multiple of 1 KiB compete for the same few
    sets of the first-level cache, which was measured to be three times slower."""
    line = 16
    return num_samples + line if -(-num_samples // line) % line == 0 else num_samples
