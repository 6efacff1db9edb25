"""What the runs of one controller come to."""

import dataclasses
import math

import numpy as np

from jaxplore.report.exploration.metrics import Metrics

Spread = tuple[float, float, float]
"""Lower quartile, median and upper quartile; infinite where too few runs have a value."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """What the runs of one controller come to.

    Quartiles are over runs; one that did not finish counts as infinitely late, so no controller
    gains by failing where it is slow.

    Args:
        num_runs: how many there are.
        num_finished: that reached the end.
        finished_at: time of the end [s].
        time_to_90: until 90 % coverage [s].
        path_length: [m].
        information_per_metre: [nat/m]; 0 of a robot that did not move.
        final_unknown: share of the map's cells.
        coverage: at the end.
        collisions: in all runs together.
        minimum_clearance: the least of all runs [m]; infinite if nothing was near.
        command_jerk: [ranges/s^2].
        fault_steps: in all runs together.
        num_targets: how many places there were to see, in the run with the most.
        targets_seen: how many of them were.
        mean_idleness: time since a cell was seen, mean over the second half [s].
        worst_idleness: the longest in the second half [s].
        untraversable_steps: in all runs together.
        step_ms: median wall-clock time of a step [ms].
    """

    num_runs: int
    num_finished: int
    finished_at: Spread
    time_to_90: Spread
    path_length: Spread
    information_per_metre: Spread
    final_unknown: Spread
    coverage: Spread
    collisions: int
    minimum_clearance: float
    command_jerk: Spread
    fault_steps: int
    num_targets: int
    targets_seen: Spread
    mean_idleness: Spread
    worst_idleness: Spread
    untraversable_steps: int
    step_ms: Spread


def summarise(metrics: tuple[Metrics, ...]) -> Summary:
    """Return what the runs of one controller come to.

    Args:
        metrics: of the runs; at least one.

    Raises:
        ValueError: no runs.
    """
    if not metrics:
        raise ValueError("metrics is empty; accepted: at least one run")
    information = [each.information_per_metre for each in metrics]
    clearances = [each.minimum_clearance for each in metrics]
    return Summary(
        num_runs=len(metrics),
        num_finished=sum(each.is_finished for each in metrics),
        finished_at=_quartiles([each.finished_at for each in metrics]),
        time_to_90=_quartiles([each.time_to["90"] for each in metrics]),
        path_length=_quartiles([each.path_length for each in metrics]),
        information_per_metre=_quartiles([0.0 if each is None else each for each in information]),
        final_unknown=_quartiles([each.final_unknown for each in metrics]),
        coverage=_quartiles([each.coverage for each in metrics]),
        collisions=sum(each.collisions for each in metrics),
        minimum_clearance=min(math.inf if each is None else each for each in clearances),
        command_jerk=_quartiles([each.command_jerk for each in metrics]),
        fault_steps=sum(each.fault_steps for each in metrics),
        num_targets=max(each.num_targets for each in metrics),
        targets_seen=_quartiles([float(each.targets_seen) for each in metrics]),
        mean_idleness=_quartiles([each.mean_idleness for each in metrics]),
        worst_idleness=_quartiles([each.worst_idleness for each in metrics]),
        untraversable_steps=sum(each.untraversable_steps for each in metrics),
        step_ms=_quartiles([each.compute.step_ms_p50 for each in metrics]),
    )


def _quartiles(values: list[float | None]) -> Spread:
    """Return the quartiles, nothing interpolated between a value and infinity."""
    numbers = np.sort([math.inf if value is None else value for value in values])
    low, median, high = np.percentile(numbers, [25, 50, 75], method="higher")
    if np.isfinite(numbers).all():
        low, median, high = np.percentile(numbers, [25, 50, 75])
    return float(low), float(median), float(high)
