"""Metrics of vehicles on their wheels, of one and of a fleet."""

import dataclasses
import math
from typing import Any

import numpy as np

from jaxplore.report._numbers import finite, percent
from jaxplore.report.metrics import Column, Metrics

WHEEL_COLUMNS = (
    Column.quartiles(
        "load_transfer",
        "load transfer",
        digits=2,
        missing=math.nan,
        applies=lambda spread: math.isfinite(spread[1]),
    ),
    Column.total("num_tipped", "tipped over", applies=lambda total: total > 0),
    Column.total("hanging_steps", "wheel in air [steps]", applies=lambda total: total > 0),
)
"""Columns of vehicles on their wheels."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class WheelMetrics(Metrics):
    """Metrics of vehicles on their wheels; those of a fleet are of all its vehicles.

    Args:
        tipped_at: time at which the vehicle tipped over [s]; None if it did not.
        load_transfer: greatest load transfer between two pairs of wheels, as a share of the load;
            None for a robot without a chassis.
        hanging_steps: number of steps that ended with a wheel in the air.
        num_tipped: number of vehicles that tipped over.
    """

    tipped_at: float | None
    load_transfer: float | None
    hanging_steps: int
    num_tipped: int

    def wheel_rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables."""
        rows = []
        if self.load_transfer is not None:
            rows.append(("load transfer", f"{percent(self.load_transfer)} at most"))
        if self.hanging_steps:
            rows.append(("wheel in the air", f"{self.hanging_steps} steps"))
        if self.tipped_at is not None:
            rows.append(("tipped over", f"after {self.tipped_at:.2f} s"))
        return rows


def wheel_metrics(records: Any, period: float) -> dict[str, Any]:
    """Compute the fields of `WheelMetrics` from records of one vehicle, or of N along a last axis.

    Without a chassis nothing has tipped over.
    """
    if records.is_tipped is None or records.load_transfer is None or records.wheel_travel is None:
        return {"tipped_at": None, "load_transfer": None, "hanging_steps": 0, "num_tipped": 0}
    is_tipped = np.asarray(records.is_tipped, bool)
    is_tipped = is_tipped[:, None] if is_tipped.ndim == 1 else is_tipped
    first = is_tipped.any(axis=1)
    return {
        # The record of step k holds what is true at its end.
        "tipped_at": (int(first.argmax()) + 1) * period if first.any() else None,
        "load_transfer": finite(np.max(np.asarray(records.load_transfer), initial=0.0)),
        "hanging_steps": int((np.asarray(records.wheel_travel) > 1.0).sum()),
        "num_tipped": int(is_tipped.any(axis=0).sum()),
    }
