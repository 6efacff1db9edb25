"""Metrics of targets and of parts, of a robot and of a fleet."""

import dataclasses
from typing import Any

import numpy as np

from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.metrics import Column, Curve
from jaxplore.report.of_parts import PartsMetrics
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
class MissionMetrics(PartsMetrics):
    """Metrics of what is looked for beside the map, and of the parts of the robots.

    Args:
        num_targets: number of targets.
        targets_seen: number of targets that were found: seen, or with a detector reported.
        last_target_at: time at which the last target was found [s]; None if some were not.
    """

    num_targets: int
    targets_seen: int
    last_target_at: float | None

    def mission_rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables; none without something to look for."""
        words = [each.found for each in self.parts.values() if each.found]
        done = words[0] if words else "seen"
        rows = target_rows(self.num_targets, self.targets_seen, self.last_target_at, done)
        return rows + self.part_rows()


def mission_metrics(data: MissionData) -> dict[str, Any]:
    """Compute the fields of `MissionMetrics`."""
    seen = data.records.targets_seen
    return {
        "num_targets": len(data.targets),
        "targets_seen": int(seen[-1]) if seen is not None and len(seen) else 0,
        "last_target_at": last_target_at(data),
        "parts": data.part_metrics(),
    }


def mission_curves(data: MissionData) -> dict[str, np.ndarray]:
    """Return the targets found, and the curves of parts, at the N + 1 instants, if any."""
    curves = {}
    if len(data.targets):
        curves["targets"] = at_instants(data.records.targets_seen, 0.0)
    return curves | data.part_curves()
