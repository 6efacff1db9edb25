"""Rollouts: what many control sequences lead to and cost."""

import contextlib
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Scalar, StateVector
from jaxplore._xla import cut
from jaxplore.belief.belief import MissingPartError
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.risk import Risk
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State


class Outcomes(NamedTuple):
    """M uncertain outcomes of each rollout instead of one: `risk` makes one cost of them."""

    disturbance: Disturbance
    risk: Risk
    drawn: Any
    """As drawn from the disturbance: leaves begin with (T, M)."""

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
        """Return outcomes with fresh draws."""
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
) -> Float[Array, " K"]:
    """Return the cost of each control sequence.

    The samples are on the last axis and costs are added up inside the scan over time: no states of
    size T x K are stored. The states travel as one vector of K per component, the layout in which
    XLA makes vector loops of a step.

    Args:
        dynamics: the model.
        cost: what is paid.
        initial: (nx,) state from which all start, or (nx, K) one for each.
        controls: (T, nu, K).
        dt: model step [s].
        belief: what the robot knows.
        applied: (nu,) control before the first one; the default control when absent.
        outcomes: M of them for each sequence, if the outcome is uncertain.

    Raises:
        ValueError: a model or a cost that returns another shape than it should.
    """
    (total,) = _totals(
        dynamics, (cost,), initial, controls, dt, belief, applied=applied, outcomes=outcomes
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
    """Return what each of several costs comes to, from one rollout of each control sequence.

    What costs have in common, such as a look-up in the same map, is computed once.

    Args:
        dynamics: the model.
        objectives: O costs.
        initial: as of `rollout_costs`.
        controls: (T, nu, K).
        dt: model step [s].
        belief: what the robot knows.
        applied: (nu,) control before the first one; the default control when absent.

    Raises:
        ValueError: a model or a cost that returns another shape than it should.
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
) -> tuple[Float[Array, " K"], ...]:
    """Return the total (K,) of each cost."""
    horizon, _, num_samples = controls.shape
    lanes = _lanes(num_samples)
    drawn: Any = ()
    shape: tuple[int, ...] = (lanes,)
    state_shape = shape
    axis = None
    if outcomes is not None:
        drawn = outcomes.drawn
        shape = (jax.tree.leaves(drawn)[0].shape[1], lanes)
        # Where only what is believed differs between outcomes, the states are the same in all.
        if outcomes.disturbance.moves_robot:
            axis, state_shape = 0, shape

    def known(draw: Any) -> Any:
        return belief if outcomes is None else outcomes.disturbance.belief(belief, draw)

    def number(cost: Cost, method: Callable[..., Array], *arguments: Any) -> Array:
        # To look for the culprit traces everything once more, so only when there is one.
        try:
            paid = method(*arguments)
        except (TypeError, ValueError):
            check_costs(dynamics, cost, horizon, belief)
            raise
        if jnp.shape(paid) != ():
            check_costs(dynamics, cost, horizon, belief)
        return paid

    def sample_step(
        components: tuple[Array, ...], control: Array, t: Array, draw: Any
    ) -> tuple[Array, tuple[Array, ...]]:
        state = jnp.stack(components)
        if outcomes is None:
            reached = dynamics.step_at(state, control, t - dt, dt)
        else:
            reached = outcomes.disturbance.step_at(dynamics, state, control, t - dt, dt, draw)
        check_state(dynamics, jnp.shape(reached))
        # The costs read what the model has computed; fused, they would compute the step again.
        reached = jnp.stack(cut(tuple(reached)))
        here, truth = State(reached, dynamics), known(draw)
        return reached, tuple(number(cost, cost.stage, here, control, t, truth) for cost in costs)

    step_all = jax.vmap(sample_step, in_axes=(0, -1, None, None), out_axes=(-1, 0))
    if outcomes is not None:
        out = None if axis is None else 1
        step_all = jax.vmap(step_all, in_axes=(axis, None, None, 0), out_axes=(out, 0))

    Values = tuple[Array, ...]

    def advance(
        carry: tuple[Values, Values, Values], inputs: tuple[Array, Array, Any]
    ) -> tuple[tuple[Values, Values, Values], None]:
        components, totals, variations = carry
        control, t, draw = inputs
        control = cut(jnp.pad(control, ((0, 0), (0, lanes - num_samples))))
        reached, paid = step_all(components, control, t, draw)
        if outcomes is not None:
            variations = tuple(
                variation + outcomes.risk.step_variation(each, t, dt)
                for variation, each in zip(variations, paid, strict=True)
            )
        totals = tuple(total + each for total, each in zip(totals, paid, strict=True))
        return (tuple(reached), totals, variations), None

    if initial.ndim == 2:
        initial = jnp.pad(initial, ((0, 0), (0, lanes - num_samples)), mode="edge")
    start = tuple(jnp.broadcast_to(value, state_shape) for value in initial)
    times = dt * jnp.arange(1, horizon + 1, dtype=dt.dtype)
    nothing = tuple(jnp.zeros(shape) for _ in costs), tuple(jnp.zeros(lanes) for _ in costs)
    (last, totals, variations), _ = jax.lax.scan(
        advance, (start, *nothing), (controls, times, drawn)
    )

    before = dynamics.default_control if applied is None else applied

    def final(cost: Cost, components: tuple[Array, ...], draw: Any) -> Array:
        state = State(jnp.stack(components), dynamics)
        return number(cost, cost.terminal, state, known(draw))

    def changes(cost: Cost, sequence: Array) -> Array:
        return number(cost, cost.sequence, sequence, before, dt, dynamics)

    def finish(cost: Cost, total: Array, variation: Array) -> Array:
        ending = jax.vmap(functools.partial(final, cost), in_axes=(0, None))
        if outcomes is not None:
            ending = jax.vmap(ending, in_axes=(axis, 0))
        total = total + ending(last, jax.tree.map(lambda rows: rows[-1], drawn))
        if outcomes is not None:
            contained = jnp.all(jnp.isfinite(total), axis=0)
            total = jnp.where(contained, outcomes.risk.costs(total, variation), jnp.inf)
        over_all = jax.vmap(functools.partial(changes, cost), in_axes=-1)
        return total[:num_samples] + over_all(controls)

    return tuple(
        finish(cost, total, variation)
        for cost, total, variation in zip(costs, totals, variations, strict=True)
    )


def _lanes(num_samples: int) -> int:
    """Return on how many samples to compute: `num_samples`, or a cache line more.

    The vectors of all components lie side by side in memory. If their length is a multiple of 1 KiB
    they compete for the same few sets of the first-level cache: three times slower, measured.
    """
    line = 16
    return num_samples + line if -(-num_samples // line) % line == 0 else num_samples


def check_parts(dynamics: Dynamics, cost: Cost, horizon: int) -> None:
    """Raise a `ValueError` if a model's bounds, its step or a cost are not of the right shape."""
    size = dynamics.control_size
    for name in ("control_min", "control_max"):
        bound = getattr(dynamics, name)
        if jnp.shape(bound) != (size,):
            raise ValueError(
                f"{name} of {type(dynamics).__name__} has shape {jnp.shape(bound)}; "
                f"accepted: ({size},), one per name in control_names"
            )
    if not _checks.is_traced(dynamics.control_min, dynamics.control_max):
        low, high = np.asarray(dynamics.control_min), np.asarray(dynamics.control_max)
        if not (low <= high).all():
            raise ValueError(
                f"control_min of {type(dynamics).__name__} is {low.tolist()}; accepted: at most "
                f"control_max, {high.tolist()}"
            )
    state, control = jnp.zeros(dynamics.state_size), jnp.zeros(size)
    number = jnp.zeros(())
    reached = jax.eval_shape(
        lambda x, u, t, dt: dynamics.step_at(x, u, t, dt), state, control, number, number
    )
    check_state(dynamics, reached.shape)
    for _, term in cost.terms():
        # A cost that reads the belief fails here, whatever the error: it is checked in `step`.
        with contextlib.suppress(AttributeError, TypeError, MissingPartError):
            check_costs(dynamics, term, horizon, None)


def check_state(dynamics: Dynamics, shape: tuple[int, ...]) -> None:
    """Raise a `ValueError` if a model returns something else than a state."""
    expected = (dynamics.state_size,)
    if shape != expected:
        raise ValueError(
            f"step of {type(dynamics).__name__} returns shape {shape}; accepted: "
            f"{expected}, one number per name in state_names"
        )


def check_costs(dynamics: Dynamics, cost: Cost, horizon: int, belief: Any) -> None:
    """Raise a `ValueError` that names a term of a cost which returns something else than numbers.

    Nothing is computed.
    """
    number, control = jnp.zeros(()), jnp.zeros(dynamics.control_size)
    values, controls = jnp.zeros(dynamics.state_size), jnp.zeros((horizon, dynamics.control_size))
    for name, term in cost.terms():
        calls: dict[str, Callable[..., Array]] = {
            "stage": lambda x, u, us, t, b, term=term: term.stage(State(x, dynamics), u, t, b),
            "terminal": lambda x, u, us, t, b, term=term: term.terminal(State(x, dynamics), b),
            "sequence": lambda x, u, us, t, b, term=term: term.sequence(us, u, t, dynamics),
        }
        for method, call in calls.items():
            paid = jax.eval_shape(call, values, control, controls, number, belief)
            if paid.shape != ():
                raise ValueError(
                    f"{method} of {name} returns shape {paid.shape}; accepted: (), one number"
                )


class Trajectory(NamedTuple):
    """One rollout.

    Args:
        states: (T + 1, nx) with the initial one.
        controls: (T, nu).
        terms: the cost of each named term, added up over time.
    """

    states: Float[Array, "T+1 nx"]
    controls: Float[Array, "T nu"]
    terms: dict[str, Scalar]


def rollout(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector,
    controls: Float[Array, "T nu"],
    dt: Scalar,
    belief: Any = None,
    *,
    applied: ControlVector | None = None,
) -> Trajectory:
    """Return the states that one control sequence leads to, and what each term of a cost takes.

    Args:
        dynamics: the model.
        cost: what is paid; terms of the same name are added.
        initial: (nx,).
        controls: (T, nu).
        dt: model step [s].
        belief: what the robot knows.
        applied: (nu,) control before the first one; the default control when absent.
    """
    before = dynamics.default_control if applied is None else applied
    reached = follow(dynamics, initial, controls, dt)
    terms: dict[str, Scalar] = {}
    for name, term in cost.terms():
        paid = step_costs(dynamics, term, reached, controls, dt, belief, applied=before)
        terms[name] = terms.get(name, jnp.zeros(())) + jnp.sum(paid)
    return Trajectory(jnp.concatenate([initial[None], reached]), controls, terms)


def follow(
    dynamics: Dynamics, initial: StateVector, controls: Float[Array, "T nu"], dt: Scalar
) -> Float[Array, "T nx"]:
    """Return the states (T, nx) that controls lead to, without the initial one."""

    def advance(state: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        control, t = inputs
        reached = dynamics.step_at(state, control, t - dt, dt)
        return reached, reached

    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=dt.dtype)
    return jax.lax.scan(advance, initial, (controls, times))[1]


def step_costs(
    dynamics: Dynamics,
    cost: Cost,
    states: Float[Array, "T nx"],
    controls: Float[Array, "T nu"],
    dt: Scalar,
    belief: Any,
    *,
    applied: ControlVector,
) -> Float[Array, " T"]:
    """Return what each step of a rollout pays (T,), the last one also for the end and the sequence.

    Args:
        dynamics: the model.
        cost: what is paid.
        states: (T, nx) reached by the controls.
        controls: (T, nu).
        dt: model step [s].
        belief: what the robot knows.
        applied: (nu,) control before the first one.
    """
    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=dt.dtype)

    def paid(state: Array, control: Array, t: Array) -> Array:
        return cost.stage(State(state, dynamics), control, t, belief)

    ending = cost.terminal(State(states[-1], dynamics), belief)
    ending = ending + cost.sequence(controls, applied, dt, dynamics)
    return jax.vmap(paid)(states, controls, times).at[-1].add(ending)
