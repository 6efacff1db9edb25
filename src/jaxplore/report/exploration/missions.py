"""Metrics of targets, of idleness and of a controller's members."""

import numpy as np

from jaxplore.report._numbers import finite, finite_mean
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.fleet.data import FleetData


def last_target_at(recording: ExplorationData | FleetData) -> float | None:
    """Return the time at which the last target was seen [s]; None if some were not, or without any.

    The record of step k holds what was seen at its beginning, so the time is k control periods.
    """
    if len(recording.targets) == 0:
        return None
    is_all = np.asarray(recording.records.targets_seen) >= len(recording.targets)
    if not is_all.any():
        return None
    return int(is_all.argmax()) * recording.control_period


def find_judged_start(recording: ExplorationData) -> int:
    """Return the first step of the second half of a run, N // 2."""
    return recording.num_steps // 2


def idleness(recording: ExplorationData) -> tuple[float | None, float | None]:
    """Compute the mean over time of the mean idleness, and the worst idleness [s].

    Both are over the second half of the run: the first is needed to see everything once. None
    without an idleness map or without a step.
    """
    if recording.idleness is None or recording.num_steps == 0:
        return None, None
    records, begin = recording.records, find_judged_start(recording)
    worst = np.asarray(records.worst_idleness[begin:], np.float64)
    return finite_mean(records.mean_idleness[begin:]), finite(np.max(worst))


def member_means(recording: ExplorationData) -> dict[str, dict[str, float | None]] | None:
    """Compute the mean share of each member in the control, and means over its own plans.

    `share`, `uncertainty` [half ranges], `effective_sample_size` and `cost`: means over the steps
    in which they were finite; None if they never were. None without members or without a step.
    """
    members = recording.records.members
    if members is None or recording.num_steps == 0:
        return None
    columns = {
        "share": members.shares,
        "uncertainty": members.uncertainties,
        "effective_sample_size": members.effective_sample_sizes,
        "cost": members.costs,
    }
    return {
        name: {key: finite_mean(rows[:, number]) for key, rows in columns.items()}
        for number, name in enumerate(recording.member_names)
    }


def fusion_means(recording: ExplorationData) -> tuple[float | None, float | None]:
    """Compute the mean diversity of the members' controls [half ranges], and the share of steps in
    which one member's plan replaced the mixture; None without members or a step."""
    members = recording.records.members
    if members is None or recording.num_steps == 0:
        return None, None
    return finite_mean(members.diversity), finite_mean(members.is_replaced)
