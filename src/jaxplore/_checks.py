"""Check numbers and arrays where objects are built.

Each function returns the checked value, or raises a `ValueError` that names the argument, its value
and what is accepted. Traced values pass unchecked: their numbers are unknown during tracing.
"""

import math
import operator
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore._kinds import describe, is_traced
from jaxplore._types import ArrayLike, Scalar
from jaxplore._xla import on_device

LARGEST = float(np.finfo(np.float32).max)
"""Greatest finite number in float32, the type of all arrays."""
PATH_STEP = 0.002
"""Greatest distance between neighbouring coordinates in float32 along a path [m]."""


def warn_above(name: str, value: ArrayLike, most: float, meaning: str) -> None:
    """Warn if a number is so large that its unit is likely to be another one; a traced one passes.

    `most` is the greatest usual number, of either sign. `meaning` is the unit of the number, and
    what else may have been meant.
    """
    if is_traced(value) or not abs(float(np.asarray(value))) > most:
        return
    warn_user(f"{name} is {float(np.asarray(value)):g}; {meaning}")


def warn_user(text: str) -> None:
    """Warn at the line that a user wrote."""
    # Not at ours, nor at that of Equinox, which calls constructors.
    ours = (str(Path(__file__).parent), str(Path(sys.modules["equinox"].__file__ or "").parent))
    warnings.warn(text, UserWarning, skip_file_prefixes=ours)


def positive_int(name: str, value: object, *, at_most: int | None = None) -> int:
    """Return `value` as an int >= 1, and <= `at_most` if it is given."""
    return whole_number(name, value, at_least=1, at_most=at_most)


def whole_number(name: str, value: object, *, at_least: int, at_most: int | None = None) -> int:
    """Return `value` as an int >= `at_least`, and <= `at_most` if it is given.

    Sizes of arrays have an `at_most`, one of `jaxplore._limits`.
    """
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = at_least - 1  # refused below, with the same message as a number that is too small
    if isinstance(value, bool) or number < at_least:
        raise ValueError(f"{name} is {value!r}; accepted: a whole number >= {at_least}")
    if at_most is not None and number > at_most:
        # Python refuses to print whole numbers of many digits.
        shown = number if number < LARGEST else f"{number.bit_length()} bits long"
        raise ValueError(f"{name} is {shown}; accepted: a whole number <= {at_most}")
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
    """Return `value` as a finite Python float within the given bounds."""
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
        raise ValueError(f"{name} is {describe(value)}; accepted: {accepted}") from None
    # The negated comparison also refuses NaN. `float` would accept a bool as 0 or 1, and a text.
    if (
        isinstance(value, (bool, str, bytes))
        or not abs(result) <= LARGEST
        or (above is not None and result <= above)
        or (below is not None and result >= below)
        or (at_least is not None and result < at_least)
        or (at_most is not None and result > at_most)
    ):
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}")
    return result


def _strong(value: Any) -> Array:
    """Return a traced value as a strongly typed array: float64 unchanged, all else as float32.

    A weakly typed leaf would compile a second program beside the one for objects built outside of
    the trace.
    """
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
    """Return `value` as a float32 scalar array.

    It becomes a leaf of the pytree, so changing it does not recompile.
    """
    if isinstance(value, jax.core.Tracer):
        return _strong(value)
    if not isinstance(value, (bool, int, float)):
        try:
            flat = np.asarray(value)
        except ValueError:
            raise ValueError(f"{name} is {describe(value)}; accepted: one number") from None
        if flat.shape != ():
            raise ValueError(f"{name} has shape {flat.shape}; accepted: one number")
        value = flat.item()
    checked = number(name, value, above=above, below=below, at_least=at_least, at_most=at_most)
    with np.errstate(over="ignore"):  # too large becomes infinite
        return on_device(np.asarray(checked, np.float32))


def floats(name: str, value: object, accepted: str) -> np.ndarray:
    """Return a number, a list or an array as a float32 array, infinite where a number is too large.

    `value` is not traced, and the array may share its memory. `accepted` is for the message.
    """
    try:
        given = np.asarray(value)
        # NumPy reads numbers from texts and dates, and leaves out the imaginary part.
        if given.dtype.kind in "USMmc":
            raise TypeError
        with np.errstate(over="ignore"):
            return given.astype(np.float32, copy=False)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {_short(value)}; accepted: {accepted}") from None


def _short(value: object) -> str:
    # Lists are shown whole: one of their entries is wrong.
    return repr(value) if isinstance(value, (list, tuple)) else describe(value)


def vector(name: str, value: object, size: int, *, at_least: float | None = None) -> Array:
    """Return `value` as a finite float32 array of shape (size,)."""
    if isinstance(value, jax.core.Tracer):
        return _strong(value)
    accepted = f"{size} finite numbers"
    array = floats(name, value, accepted)
    if array.shape != (size,) or not np.isfinite(array).all():
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}")
    if at_least is not None and (array < at_least).any():
        raise ValueError(f"{name} is {array.tolist()}; accepted: {size} numbers >= {at_least:g}")
    # A copy: `asarray` may share memory with the caller's array, who may write to it later.
    return on_device(array.copy())


def near(name: str, value: Any, step: float) -> None:
    """Check that single precision tells coordinates `step` [m] apart; traced ones pass."""
    if isinstance(value, jax.core.Tracer):
        return
    given = np.asarray(value, np.float64)
    far = np.where(np.isfinite(given), given, 0.0).ravel()
    signed = float(far[np.argmax(np.abs(far))]) if far.size else 0.0
    worst = abs(signed)
    # From 2^e to 2^(e + 1) numbers in single precision are 2^(e - 23) apart.
    limit = 2.0 ** (math.floor(math.log2(step)) + 24)
    if worst >= limit:
        raise ValueError(
            f"{name} has a coordinate of {signed:.10g} m, where single precision resolves "
            f"{2.0 ** (math.floor(math.log2(worst)) - 23):.2g} m; accepted: less than {limit:g} m, "
            "or relative to a datum, see jaxplore.maps.Datum"
        )


def probabilities(name: str, value: ArrayLike, ndim: int) -> Array:
    """Return `value` as a float32 array of probabilities with `ndim` axes, none empty."""
    if not isinstance(value, jax.core.Tracer):
        shape = "(n,) with n" if ndim == 1 else "(H, W) with H, W"
        array = floats(name, value, f"{shape} >= 1")
        if array.ndim != ndim or array.size == 0:
            raise ValueError(f"{name} has shape {array.shape}; accepted: {shape} >= 1")
        # The negated comparison also refuses NaN.
        if not ((array >= 0) & (array <= 1)).all():
            raise ValueError(
                f"{name} spans {array.min()} to {array.max()}; accepted: values in [0, 1]"
            )
        # A copy: `asarray` may share memory with the caller's array, who may write to it later.
        return on_device(array.copy())
    return jnp.asarray(value, jnp.float32)


def array(
    name: str,
    value: object,
    *shapes: tuple[int | str, ...],
    above: float | None = None,
    at_least: float | None = None,
    may_be_empty: bool = False,
) -> Array:
    """Return `value` as a finite float32 array of one of the accepted shapes.

    A letter in a shape stands for any size >= 1, and equal letters for equal sizes. For a traced
    value only the shape is checked. With `may_be_empty`, an array without rows is accepted and
    takes its columns from the first shape, because an empty list has none.
    """
    if not is_traced(value):
        value = floats(name, value, _describe(shapes))
        is_bad = ~np.isfinite(value)
        numbers = "finite numbers"
        if above is not None:
            is_bad |= value <= above
            numbers += f" > {above}"
        if at_least is not None:
            is_bad |= value < at_least
            numbers += f" >= {at_least}"
        if is_bad.any():
            raise ValueError(f"{name} has a value {value[is_bad][0]}; accepted: {numbers}")
        # A copy: the caller may write to the original later.
        result = on_device(value.copy())
    else:
        result = jnp.asarray(value, jnp.float32)
    if may_be_empty and result.shape[:1] == (0,):
        columns = [size for size in shapes[0][1:] if isinstance(size, int)]
        return jnp.zeros((0, *columns))
    if not any(_fits(result.shape, shape) for shape in shapes):
        raise ValueError(f"{name} has shape {result.shape}; accepted: {_describe(shapes)}")
    return result


def of_shape(
    name: str,
    value: Any,
    *shapes: tuple[int | str, ...],
    accepted: str = "",
    dtype: Any = jnp.float32,
) -> Any:
    """Return `value`, an array, a number or lists of numbers, if its shape is accepted.

    Only the shape is checked, also of a traced value, so that this costs nothing in a compiled
    program. A letter in a shape stands for any size. An array and a number are returned as they
    are, lists as an array of type `dtype`. The message names `accepted`, or the shapes without it.
    """
    found = _static_shape(value)
    for shape in shapes:
        if found is not None and len(found) == len(shape):
            pairs = zip(found, shape, strict=True)
            if all(isinstance(wanted, str) or size == wanted for size, wanted in pairs):
                is_list = isinstance(value, (list, tuple))
                return jnp.asarray(value, dtype) if is_list else value
    raise ValueError(f"{name} is {describe(value)}; accepted: {accepted or _describe(shapes)}")


def position(name: str, value: Any) -> Any:
    """Return `value` if it is the position (x, y) of one point; see `of_shape`."""
    return of_shape(name, value, (2,), accepted="2 numbers: x, y")


def pose(name: str, value: Any) -> Any:
    """Return `value` if it is one pose (x, y, yaw); see `of_shape`."""
    return of_shape(name, value, (3,), accepted="3 numbers: x, y, yaw")


def pairs(name: str, value: Any, dtype: Any) -> Any:
    """Return `value` if it is an array (..., 2) of any number of axes; see `of_shape`."""
    axes = len(_static_shape(value) or (0,))
    wanted: tuple[int | str, ...] = (*("N" for _ in range(axes - 1)), 2)
    return of_shape(
        name, value, wanted, accepted="pairs of numbers, an array (..., 2)", dtype=dtype
    )


def rows_and_columns(name: str, value: object) -> tuple[int, int]:
    """Return `value` as two whole numbers >= 1."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"{name} is {describe(value)}; accepted: (rows, columns)")
    return positive_int(name, value[0]), positive_int(name, value[1])


def _static_shape(value: Any) -> tuple[int, ...] | None:
    """Return the shape of an array, a number or lists of numbers; None of anything else."""
    if isinstance(value, (Array, np.ndarray, np.generic)):
        is_number = value.dtype.kind in "biuf" or jnp.issubdtype(value.dtype, np.number)
        return value.shape if is_number else None
    if isinstance(value, (int, float)):
        return ()
    if not isinstance(value, (list, tuple)):
        return None
    inner = {_static_shape(each) for each in value}
    if len(inner) > 1:
        return None
    within = inner.pop() if inner else ()
    return None if within is None else (len(value), *within)


def one_each(
    name: str,
    value: object,
    number: int,
    *,
    above: float | None = None,
    at_least: float | None = None,
) -> Float[Array, " N"]:
    """Return one number for each of N items, (N,); a single number is repeated."""
    bounds = {"above": above, "at_least": at_least}
    given = array(name, value, (), (number,), **bounds, may_be_empty=number == 0)
    return jnp.broadcast_to(given, (number,))


def by_name(
    name: str,
    value: Mapping[str, ArrayLike] | None,
    *,
    above: float | None = None,
    at_least: float | None = None,
) -> dict[str, Scalar]:
    """Return a mapping of names to float32 scalars, sorted by name; None gives an empty mapping.

    The numbers are leaves of the pytree, the names are static.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        given = describe(value)
        raise ValueError(f"{name} is {given}; accepted: numbers by the name of a component")
    return {
        key: scalar(f"{name}[{key!r}]", number, above=above, at_least=at_least)
        for key, number in sorted(value.items())
    }


def names_within(name: str, names: Sequence[str], known: Mapping[str, object]) -> None:
    """Raise a `ValueError` if one of `names` is not a key of `known`."""
    for key in names:
        if key not in known:
            raise ValueError(f"{name} has {key!r}; accepted: {', '.join(known)}")


def _fits(shape: tuple[int, ...], accepted: tuple[int | str, ...]) -> bool:
    # Remembers which size each letter stands for, so that a repeated letter must agree.
    sizes: dict[str, int] = {}
    return len(shape) == len(accepted) and all(
        size >= 1 and sizes.setdefault(wanted, size) == size
        if isinstance(wanted, str)
        else size == wanted
        for size, wanted in zip(shape, accepted, strict=True)
    )


def _describe(shapes: tuple[tuple[int | str, ...], ...]) -> str:
    texts = [str(shape).replace("'", "") if shape else "one number" for shape in shapes]
    return " or ".join(texts)
