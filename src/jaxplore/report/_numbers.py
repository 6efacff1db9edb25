"""Formatting of optional numbers."""

import math
from typing import SupportsFloat

import numpy as np
from jax.typing import ArrayLike


def finite(value: SupportsFloat, *, digits: int | None = None) -> float | None:
    """Return a number, optionally rounded; None if it is not finite."""
    number = float(value)
    if not math.isfinite(number):
        return None
    return number if digits is None else round(number, digits)


def finite_mean(values: ArrayLike) -> float | None:
    """Return the mean of the finite values; None without any."""
    numbers = np.asarray(values, np.float64)
    numbers = numbers[np.isfinite(numbers)]
    return float(numbers.mean()) if numbers.size else None


def text(value: float | None, digits: int) -> str:
    """Format a number with a number of decimals; None becomes a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def numbers(name: str, pattern: str, *values: float | None) -> list[tuple[str, str]]:
    """Return a row of a table with a name and formatted numbers; no row if one of them is None."""
    present = [value for value in values if value is not None]
    return [(name, pattern.format(*present))] if len(present) == len(values) else []


def percent(share: float | None) -> str:
    """Format a share in percent; None becomes a dash."""
    return "-" if share is None else f"{100.0 * share:.1f} %"
