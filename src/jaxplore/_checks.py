"""Checks of arguments: each raises a `ValueError` that names the argument, its value and what is
accepted. They run where objects are built; traced values pass, since nothing raises in a trace."""

import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

LARGEST = float(np.finfo(np.float32).max)
"""The greatest finite number: arrays are float32."""


def is_traced(*values: object) -> bool:
    """Return whether any value is known only when the program runs."""
    return any(isinstance(value, jax.core.Tracer) for value in values)


def positive_int(name: str, value: object) -> int:
    """Return `value` as an int >= 1."""
    return whole_number(name, value, at_least=1)


def whole_number(name: str, value: object, *, at_least: int) -> int:
    """Return `value` as an int within the bound."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = at_least - 1
    if isinstance(value, bool) or number < at_least:
        raise ValueError(f"{name} is {value!r}; accepted: a whole number >= {at_least}")
    return number


def number(
    name: str,
    value: object,
    *,
    above: float | None = None,
    below: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> float:
    """Return `value` as a finite Python float within the bounds given."""
    bounds = [
        text
        for text, bound in (
            (f"> {above}", above),
            (f"< {below}", below),
            (f">= {at_least}", at_least),
            (f"<= {at_most}", at_most),
        )
        if bound is not None
    ]
    accepted = "a finite number" + (" " + " and ".join(bounds) if bounds else "")
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}") from None
    if (
        isinstance(value, bool)
        or not abs(result) <= LARGEST
        or (above is not None and result <= above)
        or (below is not None and result >= below)
        or (at_least is not None and result < at_least)
        or (at_most is not None and result > at_most)
    ):
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}")
    return result


def _strong(value: Any) -> Array:
    """Return a traced value that is not weakly typed, so that what is built from it is used by the
    same program as what is built outside: as float32, but for float64, which stays exact."""
    is_strong = value.dtype in (jnp.float32, jnp.float64) and not value.aval.weak_type
    strong: Array = value if is_strong else jnp.asarray(value, jnp.float32)
    return strong


def scalar(
    name: str,
    value: ArrayLike,
    *,
    above: float | None = None,
    below: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> Array:
    """Return `value` as a float32 scalar array (a leaf: changing it never recompiles)."""
    if isinstance(value, jax.core.Tracer):
        return _strong(value)
    if not isinstance(value, (bool, int, float)):
        flat = np.asarray(value)
        if flat.shape != ():
            raise ValueError(f"{name} has shape {flat.shape}; accepted: one number")
        value = flat.item()
    checked = number(name, value, above=above, below=below, at_least=at_least, at_most=at_most)
    return jnp.asarray(checked, jnp.float32)


def vector(name: str, value: object, size: int) -> Array:
    """Return `value` as a finite float32 array of shape (size,)."""
    if isinstance(value, jax.core.Tracer):
        return _strong(value)
    accepted = f"{size} finite numbers"
    try:
        with np.errstate(over="ignore"):  # too large becomes infinite, which is refused below
            array = np.asarray(value, np.float32)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}") from None
    if array.shape != (size,) or not np.isfinite(array).all():
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}")
    # A copy: `asarray` may share memory with the caller's array, who may write to it later.
    return jnp.array(array)


def probabilities(name: str, value: ArrayLike, ndim: int) -> Array:
    """Return `value` as a float32 array of probabilities with `ndim` axes, none empty."""
    if not isinstance(value, jax.core.Tracer):
        array = np.asarray(value, np.float32)
        if array.ndim != ndim or array.size == 0:
            shape = "(n,) with n" if ndim == 1 else "(H, W) with H, W"
            raise ValueError(f"{name} has shape {array.shape}; accepted: {shape} >= 1")
        if not ((array >= 0) & (array <= 1)).all():
            raise ValueError(
                f"{name} spans {array.min()} to {array.max()}; accepted: values in [0, 1]"
            )
        # A copy: `asarray` may share memory with the caller's array, who may write to it later.
        return jnp.array(array)
    return jnp.asarray(value, jnp.float32)
