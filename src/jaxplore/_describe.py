"""Short descriptions of objects for `repr`, with their values."""

import dataclasses
import textwrap
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

WIDTH = 88
"""Longest line of a description that is not broken [characters]."""
SHOWN = 6
"""Largest number of elements of an array that are shown; of others there is the shape."""


def describe(value: Any) -> str:
    """Return a short text for a value: an object with its fields, and arrays with their values.

    Fields that are None are left out. An array with many elements is its type and its shape.
    Anything else is its `repr`.
    """
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        return _array(value)
    # A named tuple has names that its own repr shows.
    if type(value) in (list, tuple):
        return _in_lines("[", [describe(each) for each in value], "]")
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, eqx.Module) and type(value).__repr__ is eqx.Module.__repr__:
        return describe_fields(value)
    return repr(value)


def describe_fields(owner: Any, *names: str) -> str:
    """Return the name of an object's class with these fields or properties, or with all fields."""
    shown = names or [field.name for field in dataclasses.fields(owner)]
    values = [(name, getattr(owner, name, None)) for name in shown]
    texts = [f"{name}={describe(value)}" for name, value in values if value is not None]
    return _in_lines(f"{type(owner).__name__}(", texts, ")")


def _array(value: Any) -> str:
    shape = "" if value.shape == () else str(list(value.shape))
    # The values of a traced array are not known yet, and those of a random key mean nothing.
    is_key = jnp.issubdtype(value.dtype, jax.dtypes.extended)
    if isinstance(value, jax.core.Tracer) or is_key or value.size > SHOWN:
        return f"{value.dtype}{shape}"
    return _numbers(np.asarray(value).tolist())


def _numbers(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_numbers, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _in_lines(begin: str, texts: list[str], end: str) -> str:
    line = f"{begin}{', '.join(texts)}{end}"
    if len(line) <= WIDTH and "\n" not in line:
        return line
    inner = textwrap.indent(",\n".join(texts), "  ")
    return f"{begin}\n{inner},\n{end}"
