"""Rates of sensing and of fields: whole numbers of control periods."""

from collections.abc import Callable

import jax
import numpy as np
from jax import Array

from jaxplore import _checks
from jaxplore._types import Flag
from jaxplore._xla import on_device


def when_due[*T](
    is_due: Flag, is_possible: Flag, update: Callable[[*T], tuple[*T]], values: tuple[*T]
) -> tuple[*T]:
    """Return `update(*values)` if the update is due and possible, else the values unchanged.

    `is_due` must depend on the clock alone. The clock is the same for all runs of a batch, so under
    `jax.vmap` this stays a branch, and a batch updates only as often as one run.
    """

    def try_it(*old: *T) -> tuple[*T]:
        # The branches are nested, because `is_possible` differs between the runs of a batch and
        # becomes a select under vmap.
        new: tuple[*T] = jax.lax.cond(is_possible, update, _same, *old)
        return new

    found: tuple[*T] = jax.lax.cond(is_due, try_it, _same, *values)
    return found


def whole_steps(name: str, rate: float, control_rate: float) -> Array:
    """Return the number of control periods in a period of a slower rate; both rates are in Hz."""
    checked = _checks.number(name, rate, above=0.0, at_most=control_rate)
    ratio = control_rate / checked
    most = np.iinfo(np.int32).max
    if ratio > most:
        raise ValueError(f"{name} is {rate!r}; accepted: once in {most} control periods or oftener")
    # The tolerance accepts a rounded rate, such as 16.67 Hz of 50 Hz.
    if abs(ratio - round(ratio)) > 1e-3 * ratio:
        raise ValueError(
            f"{name} is {rate!r}; accepted: a whole fraction of the control rate of "
            f"{control_rate:g} Hz, such as {control_rate / max(1, round(ratio)):g}"
        )
    return on_device(np.asarray(round(ratio), np.int32))


def _same[*T](*unchanged: *T) -> tuple[*T]:
    return unchanged
