"""Check what kind of object an argument is.

Each check raises a `ValueError` that names the argument, what it is and what is accepted.
`jaxplore._checks` checks numbers and arrays.
"""

import functools
import inspect
import types
from collections.abc import Callable, Sequence
from typing import Any, Union, get_args, get_origin

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import AbstractArray

MOST_LETTERS = 60
"""Longest text of a value in a message."""
_NUMBERS = (AbstractArray, Array, np.ndarray, bool, int, float)
_ANYTHING = (object, type, list, tuple, Sequence, Callable)


def is_traced(*values: object) -> bool:
    """Return whether any value is a JAX tracer: its numbers are unknown until the program runs."""
    return any(isinstance(value, jax.core.Tracer) for value in values)


def describe(value: object) -> str:
    """Return in a few words what a value is."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if value is None or isinstance(value, (bool, int, float, str)):
        text = repr(value)
        return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."
    if isinstance(value, (np.ndarray, Array)):
        return f"an array of shape {value.shape}"
    if inspect.isroutine(value):
        return f"the function {value.__name__}"
    return _with_article(type(value).__name__)


def instance(
    name: str, value: object, *kinds: type, hint: str = "", may_be_none: bool = False
) -> None:
    """Raise a `ValueError` unless `value` is an instance of one of `kinds`.

    None passes if `may_be_none`. `hint` is what else the message says of an accepted value; a class
    may have its own, `accepted_hint`.
    """
    if isinstance(value, kinds) or (may_be_none and value is None):
        return
    if isinstance(value, type) and issubclass(value, kinds) and not inspect.isabstract(value):
        accepted = f"an instance, such as {value.__name__}()"
    else:
        names = [_with_article(kind.__name__) for kind in kinds] + ["None"] * may_be_none
        hint = hint or getattr(kinds[0], "accepted_hint", "")
        accepted = " or ".join(names) + (f", {hint}" if hint else "")
    raise ValueError(f"{name} is {describe(value)}; accepted: {accepted}")


def instances(name: str, value: object, *kinds: type) -> None:
    """Raise a `ValueError` unless `value` is a list or tuple of instances of one of `kinds`."""
    if not isinstance(value, (list, tuple)):
        each = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{name} is {describe(value)}; accepted: a list or tuple of {each}")
    for index, item in enumerate(value):
        instance(f"{name}[{index}]", item, *kinds)


def check_arguments[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a function, or of a constructor, by its annotations.

    A class, a union of classes and None, and a `Sequence` of a class are checked as by `instance`
    and `instances`. Numbers, texts, arrays and functions are left to `jaxplore._checks`.
    """
    names = list(inspect.signature(function).parameters)

    @functools.cache
    def find_checks() -> list[tuple[int, str, Callable[[str, object], None]]]:
        # At the first call: an annotation may be a name that its module defines further below.
        annotations = inspect.get_annotations(function, eval_str=True)
        checks = ((at, name, _check_of(annotations.get(name))) for at, name in enumerate(names))
        return [(at, name, check) for at, name, check in checks if check is not None]

    @functools.wraps(function)
    def check_and_call(*args: P.args, **kwargs: P.kwargs) -> R:
        for at, name, check in find_checks():
            if at < len(args):
                check(name, args[at])
            elif name in kwargs:
                check(name, kwargs[name])
        return function(*args, **kwargs)

    return check_and_call


def _check_of(annotation: Any) -> Callable[[str, object], None] | None:
    is_many = get_origin(annotation) is Sequence
    kinds, may_be_none = _kinds_of(get_args(annotation)[0] if is_many else annotation)
    if not kinds or kinds == [str]:
        return None
    if is_many:
        return lambda name, value: instances(name, value, *kinds)
    return lambda name, value: instance(name, value, *kinds, may_be_none=may_be_none)


def _kinds_of(annotation: Any) -> tuple[list[type], bool]:
    """Return the classes of an annotation, none if it has others too, and whether it has None."""
    if get_origin(annotation) in (types.UnionType, Union):
        members = [each for each in get_args(annotation) if each is not types.NoneType]
        found = [_kinds_of(each)[0] for each in members]
        kinds = [kind for each in found for kind in each] if all(found) else []
        return kinds, len(members) < len(get_args(annotation))
    kind = get_origin(annotation) or annotation
    if not isinstance(kind, type) or kind in _ANYTHING or issubclass(kind, _NUMBERS):
        return [], False
    return [] if getattr(kind, "_is_protocol", False) else [kind], False


def function(name: str, value: object, accepted: str) -> None:
    """Raise a `ValueError` unless `value` can be called, and is no class."""
    if isinstance(value, type) or not callable(value):
        raise ValueError(f"{name} is {describe(value)}; accepted: {accepted}")


def flag(name: str, value: object) -> bool:
    """Return `value` as a bool."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} is {describe(value)}; accepted: True or False")
    return bool(value)


def key(name: str, value: Any, ndim: int = 0) -> None:
    """Raise a `ValueError` unless `value` is a random key, or an array of them with `ndim` axes.

    Raw keys, arrays of uint32, are accepted as well. Traced values pass.
    """
    if is_traced(value):
        return
    if isinstance(value, Array):
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        if value.ndim == (ndim if is_key else ndim + 1) and (is_key or value.dtype == jnp.uint32):
            return
    accepted = "jax.random.key(0)"
    if ndim:
        accepted = f"several keys, such as jax.random.split({accepted}, 4)"
    raise ValueError(f"{name} is {describe(value)}; accepted: {accepted}")


def check_annotation(owner: Any, name: str) -> None:
    """Raise a `ValueError` unless the class of `owner`, a module, has an annotation of a field.

    Equinox refuses to set other attributes, with a message that does not say why.
    """
    known = getattr(type(owner), "__dataclass_fields__", {})
    if name not in known and not name.startswith("__"):
        raise ValueError(
            f"{name} is no field of {type(owner).__name__}; accepted: names that the class "
            f"annotates, such as {name}: jax.Array"
        )


def _with_article(name: str) -> str:
    # "an MPPI" and "an RK4", but "a Mission": capitals are read letter by letter.
    vowels = "AEFHILMNORSX" if name[:2].isupper() or name[1:2].isdigit() else "AEIOUaeiou"
    return f"an {name}" if name[0] in vowels else f"a {name}"
