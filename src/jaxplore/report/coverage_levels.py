"""When an exploration reached levels of coverage; the same in the plane, in volumes and fleets."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jax.typing import ArrayLike

LEVELS = (50, 90, 95, 99)
"""Coverages [%] at which time and path are compared. A run that begins at the last one has a map
that was known in advance."""


def at_instants(values: ArrayLike, initial: ArrayLike) -> np.ndarray:
    """Return the values (N + 1, ...) at the instants of a run from those of its N steps.

    Instant k is the beginning of step k, the last one the end of the run. Nothing is sensed after
    the last step, so the last value is repeated; without a step it is `initial`.
    """
    rows = np.asarray(values)
    last = rows[-1:] if len(rows) else np.asarray(initial, rows.dtype)[None]
    return np.concatenate([rows, last])


def find_first(coverage: np.ndarray, share: float) -> int | None:
    """Return the first instant at which a share is covered, of N + 1; None if there is none.

    The coverage is float32, so the share is rounded in the same way before the comparison.
    """
    is_there = np.asarray(coverage, np.float32) >= np.float32(share)
    return int(is_there.argmax()) if is_there.any() else None


def describe_levels(time_to: Mapping[str, float | None]) -> str:
    """Return when the levels of coverage were reached, in words; `time_to` is the metric [s]."""
    times = [f"{name} % after {each:.1f} s" for name, each in time_to.items() if each is not None]
    return ", ".join(times) or f"less than {LEVELS[0]} %"


def reach_levels(coverage: np.ndarray, path: np.ndarray, period: float) -> dict[str, Any]:
    """Return the metrics `time_to` [s] and `path_to` [m]: when each of `LEVELS` was first reached.

    `coverage` (N + 1,) and `path` (N + 1,) [m] are those at each instant, a control period [s]
    apart. The entries are by level, "50" and so on; None for a level that was not reached.
    """
    first = {str(level): find_first(coverage, level / 100) for level in LEVELS}
    return {
        "time_to": {name: None if k is None else k * period for name, k in first.items()},
        "path_to": {name: None if k is None else float(path[k]) for name, k in first.items()},
    }
