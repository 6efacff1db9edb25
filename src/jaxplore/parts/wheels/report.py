"""Metrics of vehicles on their wheels, of one and of a fleet."""

import dataclasses
import math
from typing import ClassVar, NamedTuple

import numpy as np

from jaxplore._types import Flag, Scalar
from jaxplore.report._numbers import finite, percent
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.metrics import Column
from jaxplore.report.part import PartMetrics, PartReport


class WheelRecord(NamedTuple):
    """The vehicle on its wheels after a step.

    Args:
        load_transfer: load transfer between two pairs of wheels, as a share of the whole load;
            above 1 one of them is without load.
        wheel_travel: how far the ground moves each wheel from the plane of the four, as a share of
            the travel of the suspension; above 1 a wheel hangs in the air.
        is_tipped: whether the vehicle has tipped over.
    """

    load_transfer: Scalar
    wheel_travel: Scalar
    is_tipped: Flag


@dataclasses.dataclass(frozen=True, kw_only=True)
class WheelMetrics(PartMetrics):
    """Metrics of vehicles on their wheels; those of a fleet are of all its vehicles.

    Args:
        tipped_at: time at which the vehicle tipped over [s]; None if it did not.
        load_transfer: greatest load transfer between two pairs of wheels, as a share of the load.
        hanging_steps: number of steps that ended with a wheel in the air.
        num_tipped: number of vehicles that tipped over.
    """

    tipped_at: float | None
    load_transfer: float | None
    hanging_steps: int
    num_tipped: int

    columns = (
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

    def rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text)."""
        rows = []
        if self.load_transfer is not None:
            rows.append(("load transfer", f"{percent(self.load_transfer)} at most"))
        if self.hanging_steps:
            rows.append(("wheel in the air", f"{self.hanging_steps} steps"))
        if self.tipped_at is not None:
            rows.append(("tipped over", f"after {self.tipped_at:.2f} s"))
        return rows


@dataclasses.dataclass(frozen=True)
class WheelReport(PartReport):
    """What a run shows of wheels: numbers alone."""

    name: ClassVar[str] = "wheels"
    record_type: ClassVar[type | None] = WheelRecord

    def metrics(self, run: MissionData) -> WheelMetrics:
        """Compute the metrics from records of one vehicle, or of N along a last axis."""
        record = run.records.parts[self.name]
        is_tipped = np.asarray(record.is_tipped, bool)
        is_tipped = is_tipped[:, None] if is_tipped.ndim == 1 else is_tipped
        first = is_tipped.any(axis=1)
        return WheelMetrics(
            # The record of step k holds what is true at its end.
            tipped_at=(int(first.argmax()) + 1) * run.control_period if first.any() else None,
            load_transfer=finite(np.max(np.asarray(record.load_transfer), initial=0.0)),
            hanging_steps=int((np.asarray(record.wheel_travel) > 1.0).sum()),
            num_tipped=int(is_tipped.any(axis=0).sum()),
        )
