"""Metrics of targets and of parts, of a robot and of a fleet."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.metrics import Column, Curve, Metrics
from jaxplore.report.part import PartMetrics
from jaxplore.report.targets import last_target_at, target_rows

TARGET_CURVE = Curve(
    "targets",
    "targets found",
    applies=lambda each: each.num_targets > 0,
    is_count=True,
)
"""Curve of the targets that were found."""
TARGET_COLUMNS = (
    Column.quartiles("targets_seen", "targets seen", applies=lambda spread: spread[2] > 0.0),
    Column(
        "num_targets",
        "of targets",
        lambda runs: max(each.num_targets for each in runs),
        str,
        lambda most: most > 0,
    ),
)
"""Columns of targets."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionMetrics(Metrics):
    """Metrics of what is looked for beside the map, and of the parts of the robots.

    Args:
        num_targets: number of targets.
        targets_seen: number of targets that were found: seen, or with a detector reported.
        last_target_at: time at which the last target was found [s]; None if some were not.
        parts: metrics of each part, by its name; in `metrics.json` each is an entry of its own.
    """

    num_targets: int
    targets_seen: int
    last_target_at: float | None
    parts: Mapping[str, PartMetrics]

    def as_dict(self) -> dict[str, Any]:
        """Return all metrics as plain Python values for JSON."""
        found = super().as_dict()
        return {**found, **found.pop("parts")}

    def list_columns(self) -> tuple[Column, ...]:
        """Return the columns of a comparison's table, those of parts at the end."""
        own = [_column_of(name, each) for name, part in self.parts.items() for each in part.columns]
        return (*super().list_columns(), *own)

    def list_curves(self) -> tuple[Curve, ...]:
        """Return the curves of a comparison, those of parts at the end."""
        own = [_curve_of(name, each) for name, part in self.parts.items() for each in part.plotted]
        return (*super().list_curves(), *own)

    def mission_rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables; none without something to look for."""
        words = [each.found for each in self.parts.values() if each.found]
        done = words[0] if words else "seen"
        rows = target_rows(self.num_targets, self.targets_seen, self.last_target_at, done)
        return rows + [row for each in self.parts.values() for row in each.rows()]


def _column_of(name: str, column: Column) -> Column:
    """Return a column of a part's metrics as one of all metrics."""
    return column._replace(
        name=f"{name}.{column.name}",
        value=lambda runs: column.value([each.parts[name] for each in runs]),
    )


def _curve_of(name: str, curve: Curve) -> Curve:
    """Return a curve of a part's metrics as one of all metrics."""
    return curve._replace(
        applies=lambda each: name in each.parts and curve.applies(each.parts[name])
    )


def mission_metrics(data: MissionData) -> dict[str, Any]:
    """Compute the fields of `MissionMetrics`."""
    seen = data.records.targets_seen
    return {
        "num_targets": len(data.targets),
        "targets_seen": int(seen[-1]) if seen is not None and len(seen) else 0,
        "last_target_at": last_target_at(data),
        "parts": {name: each.metrics(data) for name, each in data.parts.items()},
    }


def mission_curves(data: MissionData) -> dict[str, np.ndarray]:
    """Return the targets found, and the curves of parts, at the N + 1 instants, if any."""
    curves = {}
    if len(data.targets):
        curves["targets"] = at_instants(data.records.targets_seen, 0.0)
    for each in data.parts.values():
        curves |= each.series(data)
    return curves
