"""Checks of a model and of costs: shapes that only a trace shows."""

import contextlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _checks
from jaxplore.belief.belief import MissingPartError
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State


def check_parts(dynamics: Dynamics, cost: Cost, horizon: int) -> None:
    """Raise a `ValueError` if the bounds or the step of a model, or a cost, have a wrong shape."""
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
    number, state, control = _floats(), _floats(dynamics.state_size), _floats(size)
    reached = jax.eval_shape(
        lambda x, u, t, dt: dynamics.step_at(x, u, t, dt), state, control, number, number
    )
    check_state(dynamics, reached.shape)
    for _, term in cost.terms():
        # There is no belief yet, so a cost that reads one fails here. `step` checks it.
        with contextlib.suppress(AttributeError, TypeError, MissingPartError):
            check_costs(dynamics, term, horizon, None)


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


def _floats(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.result_type(float))  # type: ignore[no-untyped-call]
