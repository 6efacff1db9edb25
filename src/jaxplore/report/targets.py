"""Metrics of targets that are to be found, of all tasks."""

import numpy as np


def last_target_at(seen: np.ndarray, number: int, period: float) -> float | None:
    """Return the time at which the last target was seen [s]; None if some were not, or without any.
    The record of step k holds how many of the `number` targets were `seen` (N,) at its beginning,
    so the time is k control periods [s]."""
    is_all = seen >= number if number else np.zeros(0, bool)
    return int(is_all.argmax()) * period if is_all.any() else None


def target_rows(
    number: int, seen: int, last: float | None, done: str = "seen"
) -> list[tuple[str, str]]:
    """Return the row of the targets for a table, as (name, text); none without targets."""
    if not number:
        return []
    found = f"{seen} of {number} {done}"
    return [("targets", found if last is None else f"{found}, the last at {last:.2f} s")]
