"""Metrics of what the guard did, of one robot and of a fleet."""

import dataclasses
from typing import Any

import numpy as np

from jaxplore.control.stops import REASONS
from jaxplore.report.metrics import Column, Metrics
from jaxplore.report.motion import episodes

GUARD_COLUMN = Column.total("stopped_steps", "stopped [steps]", applies=lambda total: total > 0)
"""Column of the steps in which a guard stopped its robot."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class GuardMetrics(Metrics):
    """Metrics of the guard, of all robots together: how often it stopped one, by reason, and the
    number of steps in which one was stopped."""

    stops: dict[str, int] = dataclasses.field(default_factory=dict)
    stopped_steps: int = 0

    def guard_rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables; nothing if the guard did nothing."""
        rows = [("stopped", f"{self.stopped_steps} steps")] if self.stops else []
        return [
            *rows,
            *((f"  {reason}", f"{number} times") for reason, number in self.stops.items()),
        ]


def guard_metrics(stop: Any) -> dict[str, Any]:
    """Compute the metrics of the guard from its records (steps,), or (steps, N) of a fleet; None
    without a guard."""
    if stop is None:
        return {"stops": {}, "stopped_steps": 0}
    codes = np.asarray(stop)
    robots = codes.T if codes.ndim > 1 else codes[None]
    numbers = {
        reason: sum(episodes(own == code) for own in robots)
        for code, reason in enumerate(REASONS)
        if code > 0
    }
    stops = {reason: number for reason, number in numbers.items() if number}
    return {"stops": stops, "stopped_steps": int((codes > 0).sum())}
