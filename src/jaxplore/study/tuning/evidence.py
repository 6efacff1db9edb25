"""What was won: settings before and after with seeds that they were not tuned on."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from jaxplore.study.tuning.objective import Numbers, Objective

CONFIDENCE = 0.95
"""Share of the bootstrap's draws that lie in its interval."""
SHOWN = (
    "finished_at",
    "time_to.50",
    "time_to.90",
    "time_to.95",
    "time_to.99",
    "coverage",
    "path_length",
    "progress",
    "mean_deviation",
    "max_deviation",
    "corridor_violations",
    "targets_seen",
    "last_target_at",
    "mean_idleness",
    "worst_idleness",
    "goal_distance",
    "collisions",
    "collision_steps",
    "minimum_clearance",
    "minimum_gap",
    "command_jerk",
    "mean_effective_sample_size",
    "compute.step_ms_p50",
)
"""Numbers of the table, where runs have them."""


@dataclasses.dataclass(frozen=True)
class Change:
    """One quantity before and after, over the same episodes.

    Args:
        name: of the metric or the objective.
        before: mean.
        after: mean.
        difference: after less before, mean over the episodes.
        low: lower end of its 95 % interval.
        high: upper end.
    """

    name: str
    before: float
    after: float
    difference: float
    low: float
    high: float

    @property
    def is_certain(self) -> bool:
        """Whether the interval of the difference leaves out zero."""
        return self.low > 0.0 or self.high < 0.0


def change(name: str, before: Sequence[float], after: Sequence[float]) -> Change:
    """Return how much a quantity has changed, episode by episode.

    The interval is the percentile bootstrap's of the mean difference; of a single episode, or of
    differences that are all the same, it is that number.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.

    Args:
        name: of the quantity.
        before: of each episode.
        after: of the same episodes.
    """
    differences = np.asarray(after, np.float64) - np.asarray(before, np.float64)
    mean = float(differences.mean())
    low = high = mean
    if len(differences) > 1 and np.ptp(differences) > 0.0:
        found = stats.bootstrap(
            (differences,),
            np.mean,
            confidence_level=CONFIDENCE,
            method="percentile",
            rng=np.random.default_rng(0),
        )
        low, high = map(float, found.confidence_interval)
    return Change(name, float(np.mean(before)), float(np.mean(after)), mean, low, high)


def changes(
    objectives: Sequence[Objective],
    before: Mapping[tuple[str, int], Numbers],
    after: Mapping[tuple[str, int], Numbers],
) -> list[Change]:
    """Return what has changed: the objectives first, then what reports show.

    An episode that failed with either settings is left out.

    Args:
        objectives: what was tuned for.
        before: metrics by scenario and seed.
        after: of the same.
    """
    where = [each for each in before if before[each] and after.get(each)]
    found = []
    for objective in objectives:
        pairs = [(objective.value(before[each]), objective.value(after[each])) for each in where]
        found += _change(str(objective), pairs)
    for name in SHOWN:
        pairs = [(_number(before[each], name), _number(after[each], name)) for each in where]
        if name not in map(str, objectives):
            found += _change(name, pairs)
    return found


def verdict(chosen: int, objectives: Sequence[Objective], found: Sequence[Change]) -> str:
    """Return in a sentence what was won.

    Args:
        chosen: number of the candidate; 0 are the settings that there were.
        objectives: what was tuned for.
        found: what has changed with seeds that were not tuned on.
    """
    names = set(map(str, objectives))
    if chosen == 0:
        return "The settings that there were are the best that were found."
    if any(each.high < 0.0 for each in found if each.name in names):
        return "They are better than those that there were, on seeds that were not tuned on."
    return (
        "It may be luck: on seeds that were not tuned on they are not certainly better than those "
        "that there were. More --seeds and a larger --budget tell more."
    )


def _number(metrics: Numbers, name: str) -> float:
    value = metrics.get(name)
    return math.nan if value is None else value


def _change(name: str, pairs: Sequence[tuple[float, float]]) -> list[Change]:
    complete = [pair for pair in pairs if all(map(math.isfinite, pair))]
    if not complete or len(complete) < len(pairs):
        return []
    before, after = zip(*complete, strict=True)
    return [change(name, before, after)]


def table(
    objectives: Sequence[Objective],
    before: Mapping[tuple[str, int], Numbers],
    after: Mapping[tuple[str, int], Numbers],
) -> list[dict[str, Any]]:
    """Return a row for each episode: scenario, seed, and every metric before and after."""
    rows = []
    for (scenario, seed), metrics in before.items():
        other = after.get((scenario, seed), {})
        row: dict[str, Any] = {"scenario": scenario, "seed": seed}
        for objective in objectives:
            for label, some in (("before", metrics), ("after", other)):
                row[f"{objective} {label}"] = objective.value(some) if some else math.nan
        for name in SHOWN:
            if name in metrics or name in other:
                row[f"{name} before"] = metrics.get(name)
                row[f"{name} after"] = other.get(name)
        rows.append(row)
    return rows
