"""Metrics of targets, idleness, anomalies and objects, of a robot and of a fleet."""

import dataclasses
import math
from typing import Any

import numpy as np

from jaxplore.report._numbers import finite, finite_mean, text
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.exploration.anomalies import anomaly_metrics, report_texts
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.objects import object_metrics, object_rows
from jaxplore.report.metrics import Column, Curve, Metrics
from jaxplore.report.targets import last_target_at, target_rows

MISSION_CURVES = (
    Curve(
        "targets",
        "targets found",
        applies=lambda each: each.num_targets > 0,
        is_count=True,
    ),
    # A search is judged by its targets; the idleness only leads it to places not seen lately.
    Curve(
        "idleness",
        "mean idleness [s]",
        applies=lambda each: each.mean_idleness is not None and not each.num_targets,
    ),
)
"""Curves of what is looked for beside the map."""
MISSION_COLUMNS = (
    Column.quartiles("targets_seen", "targets seen", applies=lambda spread: spread[2] > 0.0),
    Column(
        "num_targets",
        "of targets",
        lambda runs: max(each.num_targets for each in runs),
        str,
        lambda most: most > 0,
    ),
    Column.quartiles(
        "mean_idleness", "idle mean [s]", applies=lambda spread: math.isfinite(spread[0])
    ),
    Column.quartiles(
        "worst_idleness", "idle worst [s]", applies=lambda spread: math.isfinite(spread[0])
    ),
    Column.quartiles("anomalies_found", "anomalies found", applies=lambda spread: spread[2] > 0.0),
    Column.total("false_alarms", "false alarms", applies=lambda total: total > 0),
    Column.total("false_reports", "false reports", applies=lambda total: total > 0),
)
"""Columns of what is looked for beside the map."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionMetrics(Metrics):
    """Metrics of what is looked for beside the map.

    Args:
        num_targets: number of targets.
        targets_seen: number of targets that were found: seen, or with a detector reported.
        last_target_at: time at which the last target was found [s]; None if some were not.
        mean_idleness: time since each reachable cell was last seen, mean over the cells and the
            second half of the run [s]: the first half is needed to see everything once. None
            without an idleness map.
        worst_idleness: the greatest of these times in the second half [s].
        num_anomalies: number of places where the world differs from the known map; 0 without a test
            for anomalies.
        anomalies_found: number of them that were reported after a second look, with their kind.
        false_alarms: number of reports of places where nothing differs.
        cleared: number of suspicions that the second look did not confirm.
        last_anomaly_at: time at which the last anomaly was reported [s]; None if some were not.
        reports: the reports by time: `kind`, `place` [m], `suspected_at` and `reported_at` [s], and
            whether something `is_planted` there; None without a test for anomalies.
        num_objects: number of objects, targets included; 0 without a detector.
        objects_detected: number of them that were detected.
        false_reports: number of objects that were reported as a target and are none.
        mislabelled: number of other reports of a class that the object does not have.
        class_entropy: sum of the entropies of the objects' classes at the end [nat]; None without a
            detector.
        labels: the reports by time: `label`, `place` [m], `reported_at` [s], `probability`,
            `true_label` and `is_true`; None without a detector.
    """

    num_targets: int
    targets_seen: int
    last_target_at: float | None
    mean_idleness: float | None
    worst_idleness: float | None
    num_anomalies: int
    anomalies_found: int
    false_alarms: int
    cleared: int
    last_anomaly_at: float | None
    reports: list[dict[str, Any]] | None
    num_objects: int
    objects_detected: int
    false_reports: int
    mislabelled: int
    class_entropy: float | None
    labels: list[dict[str, Any]] | None

    def mission_rows(self) -> list[tuple[str, str]]:
        """Return the metrics as (name, text), for tables; none without something to look for."""
        done = "seen" if self.labels is None else "recognised"
        rows = target_rows(self.num_targets, self.targets_seen, self.last_target_at, done)
        # A search is judged by its targets; the idleness only leads it to places not seen lately.
        if not self.num_targets and self.mean_idleness is not None:
            both = f"{self.mean_idleness:.1f} s, {text(self.worst_idleness, 1)} s at worst"
            rows.append(("idleness", f"{both}, in the second half"))
        counts = (self.num_objects, self.objects_detected, self.false_reports, self.mislabelled)
        return [*rows, *object_rows(self.labels, counts), *self._anomaly_rows()]

    def _anomaly_rows(self) -> list[tuple[str, str]]:
        if self.reports is None:
            return []
        alarms = f"{self.false_alarms} false alarms, {self.cleared} suspicions dropped"
        rows = [("anomalies", f"{self.anomalies_found} of {self.num_anomalies} found; {alarms}")]
        return rows + report_texts(self.reports)


def mission_metrics(data: MissionData) -> dict[str, Any]:
    """Compute the fields of `MissionMetrics`."""
    mean, worst = idleness(data)
    seen = data.records.targets_seen
    return {
        "num_targets": len(data.targets),
        "targets_seen": int(seen[-1]) if seen is not None and len(seen) else 0,
        "last_target_at": last_target_at(data),
        "mean_idleness": mean,
        "worst_idleness": worst,
        **anomaly_metrics(data.anomalies),
        **object_metrics(data.objects),
    }


def mission_curves(data: MissionData) -> dict[str, np.ndarray]:
    """Return the targets found and the mean idleness [s] at the N + 1 instants, if any."""
    curves = {}
    if len(data.targets):
        curves["targets"] = at_instants(data.records.targets_seen, 0.0)
    if data.idleness is not None:
        curves["idleness"] = at_instants(data.records.mean_idleness, 0.0)
    return curves


def find_judged_start(recording: MissionData) -> int:
    """Return the first step of the second half of a run, N // 2."""
    return recording.num_steps // 2


def idleness(recording: MissionData) -> tuple[float | None, float | None]:
    """Compute the mean over time of the mean idleness, and the worst idleness [s].

    Both are over the second half of the run: the first is needed to see everything once. None
    without an idleness map or without a step.
    """
    if recording.idleness is None or recording.num_steps == 0:
        return None, None
    records, begin = recording.records, find_judged_start(recording)
    worst = np.asarray(records.worst_idleness[begin:], np.float64)
    return finite_mean(records.mean_idleness[begin:]), finite(np.max(worst))
