"""Checks of a model and of costs: shapes that only a trace shows."""

import contextlib
from collections.abc import Callable, Hashable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _checks, _kinds
from jaxplore._types import StateVector
from jaxplore.belief.belief import MissingPartError
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State

MOST_ACCEPTED = 1000
"""Number of structures above which the set of accepted ones begins anew."""
_accepted: set[Hashable] = set()
"""Structures of models and costs whose shapes have been accepted."""


def check_parts(dynamics: Dynamics, cost: Cost, horizon: int) -> None:
    """Raise a `ValueError` if the bounds or the step of a model, or a cost, have a wrong shape."""
    size = dynamics.control_size
    for name in ("control_min", "control_max"):
        bound = getattr(dynamics, name)
        if not isinstance(bound, (Array, np.ndarray)):
            raise ValueError(
                f"{name} of {type(dynamics).__name__} is {_kinds.describe(bound)}; accepted: an "
                f"array of shape ({size},), such as jax.numpy.array([...])"
            )
        if jnp.shape(bound) != (size,):
            raise ValueError(
                f"{name} of {type(dynamics).__name__} has shape {jnp.shape(bound)}; "
                f"accepted: ({size},), one per name in control_names"
            )
    if not _kinds.is_traced(dynamics.control_min, dynamics.control_max):
        low, high = np.asarray(dynamics.control_min), np.asarray(dynamics.control_max)
        if not (low <= high).all():
            raise ValueError(
                f"control_min of {type(dynamics).__name__} is {low.tolist()}; accepted: at most "
                f"control_max, {high.tolist()}"
            )
    # Shapes do not follow from values, so controllers that differ in values only are traced once: a
    # search builds one for each candidate.
    structure = _structure(dynamics, cost, horizon)
    if structure in _accepted:
        return
    number, state, control = _floats(), _floats(dynamics.state_size), _floats(size)
    reached = jax.eval_shape(
        lambda x, u, t, dt: dynamics.step_at(x, u, t, dt), state, control, number, number
    )
    if not hasattr(reached, "shape"):
        raise ValueError(
            f"step of {type(dynamics).__name__} returns {_kinds.describe(reached)}; accepted: "
            f"an array of shape ({dynamics.state_size},), such as jax.numpy.stack([...])"
        )
    check_state(dynamics, reached.shape)
    for _, term in cost.terms():
        # There is no belief yet, so a cost that reads one fails here. `step` checks it.
        with contextlib.suppress(AttributeError, TypeError, MissingPartError):
            check_costs(dynamics, term, horizon, None)
    if structure is not None:
        if len(_accepted) >= MOST_ACCEPTED:
            _accepted.clear()
        _accepted.add(structure)


def _structure(*parts: Any) -> Hashable | None:
    """Return everything about parts but the values of arrays; None if some of it has no hash."""
    leaves, tree = jax.tree.flatten(parts)
    kinds = (
        jax.typeof(each) if isinstance(each, (Array, np.ndarray)) else (type(each), each)
        for each in leaves
    )
    found = tree, *kinds, _floats().dtype
    try:
        hash(found)
    except TypeError:
        return None
    return found


def check_call(
    dynamics: Dynamics, state: Any, kind: type, observation: Any, key: Any
) -> StateVector:
    """Check the arguments of a controller's `step`, and return the observed state as an array.

    `kind` is the class of the controller's state. The observation is an array or a list of the size
    of the state. Its numbers are not checked, nor anything of one that is traced.
    """
    _kinds.instance("state", state, kind, hint="from init() or the last step")
    _kinds.key("key", key)
    if _kinds.is_traced(observation):
        traced: StateVector = observation
        return traced
    names = dynamics.state_names
    accepted = f"{len(names)} numbers: {', '.join(names)}"
    if isinstance(observation, (list, tuple)) and _kinds.is_traced(*observation):
        observation = jnp.asarray(observation)
    if not isinstance(observation, Array):
        observation = jnp.asarray(_checks.floats("observation", observation, accepted))
    known: StateVector = observation
    if known.shape != (len(names),):
        raise ValueError(f"observation has shape {known.shape}; accepted: {accepted}")
    return known


def check_state(dynamics: Dynamics, shape: tuple[int, ...]) -> None:
    """Raise a `ValueError` if a model returns something other than a state."""
    expected = (dynamics.state_size,)
    if shape != expected:
        raise ValueError(
            f"step of {type(dynamics).__name__} returns shape {shape}; accepted: "
            f"{expected}, one number per name in state_names"
        )


def check_costs(dynamics: Dynamics, cost: Cost, horizon: int, belief: Any) -> None:
    """Raise a `ValueError` that names the first term of a cost which does not return one number.

    Only shapes are evaluated.
    """
    size = dynamics.control_size
    number, control, controls = _floats(), _floats(size), _floats(horizon, size)
    values = _floats(dynamics.state_size)
    # What is no array cannot be traced: the cost itself refuses a text in place of a belief.
    arrays, others = eqx.partition(belief, eqx.is_array_like)
    for name, term in cost.terms():
        calls: dict[str, Callable[..., Array]] = {
            "stage": lambda x, u, us, t, b, term=term: term.stage(State(x, dynamics, u), u, t, b),
            "terminal": lambda x, u, us, t, b, term=term: term.terminal(State(x, dynamics, u), b),
            "sequence": lambda x, u, us, t, b, term=term: term.sequence(us, u, t, dynamics),
        }
        for method, call in calls.items():

            def evaluate_with(x: Any, u: Any, us: Any, t: Any, known: Any, call: Any = call) -> Any:
                return call(x, u, us, t, eqx.combine(known, others))

            paid = jax.eval_shape(evaluate_with, values, control, controls, number, arrays)
            if not hasattr(paid, "shape"):
                given = _kinds.describe(paid)
                raise ValueError(f"{method} of {name} returns {given}; accepted: one number")
            if paid.shape != ():
                raise ValueError(
                    f"{method} of {name} returns shape {paid.shape}; accepted: (), one number"
                )


def without_belief(dynamics: Dynamics, cost: Cost, horizon: int) -> str | None:
    """Return the name of the first term of a cost that cannot be computed without a belief."""
    for name, term in cost.terms():
        try:
            check_costs(dynamics, term, horizon, None)
        except (AttributeError, TypeError, MissingPartError):
            return name
    return None


def _floats(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.result_type(float))  # type: ignore[no-untyped-call]
