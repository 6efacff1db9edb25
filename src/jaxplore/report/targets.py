"""Metrics of targets that are to be found, of all tasks."""

from typing import Any

import numpy as np


def last_target_at(data: Any) -> float | None:
    """Return the time at which the last target was seen [s]; None if some were not, or without any.

    The record of step k holds what was seen at its beginning, so the time is k control periods.
    """
    if len(data.targets) == 0:
        return None
    is_all = np.asarray(data.records.targets_seen) >= len(data.targets)
    return int(is_all.argmax()) * data.control_period if is_all.any() else None


def target_rows(
    number: int, seen: int, last: float | None, done: str = "seen"
) -> list[tuple[str, str]]:
    """Return the row of the targets for a table, as (name, text); none without targets."""
    if not number:
        return []
    found = f"{seen} of {number} {done}"
    return [("targets", found if last is None else f"{found}, the last at {last:.2f} s")]
