"""Significance of a search: current and chosen settings on unseen seeds."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxplore.report.statistics import paired_difference, tail_mean
from jaxplore.study.tuning.objective import Numbers, Objective, is_late

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
    "targets.seen",
    "targets.last_at",
    "watch.mean_idleness",
    "watch.worst_idleness",
    "goal_distance",
    "collisions",
    "collision_steps",
    "minimum_clearance",
    "minimum_gap",
    "command_jerk",
    "mean_effective_sample_size",
    "compute.step_ms_p50",
)
"""Metrics to show, if the runs have them."""


@dataclasses.dataclass(frozen=True)
class Change:
    """Change of a quantity by a search, over the same episodes.

    Args:
        name: name of the metric or the objective.
        before: mean before the search.
        after: mean after the search.
        difference: mean over the episodes of after minus before.
        low: lower end of its 95 % interval.
        high: upper end.
        episodes: number of episodes.
        late_before: number of episodes before the search in which the event of a time did not
            happen within the time limit. Their times are those of `with_late_times`.
        late_after: the same number after the search.
    """

    name: str
    before: float
    after: float
    difference: float
    low: float
    high: float
    episodes: int = 0
    late_before: int = 0
    late_after: int = 0

    @property
    def is_significant(self) -> bool:
        """Whether the interval of the difference excludes zero."""
        return self.low > 0.0 or self.high < 0.0


def change(
    name: str, before: Sequence[float], after: Sequence[float], level: float = 0.0
) -> Change:
    """Compute the change of a quantity, episode by episode; see `paired_difference`.

    The share `level` of the best episodes is left out of the means, see `tail_mean`.
    """
    difference = paired_difference(before, after, level=level)
    first, second = (
        float(tail_mean(np.asarray(some, np.float64), level)) for some in (before, after)
    )
    return Change(name, first, second, *difference, episodes=len(before))


def changes(
    objectives: Sequence[Objective],
    before: Mapping[tuple[str, int], Numbers],
    after: Mapping[tuple[str, int], Numbers],
) -> list[Change]:
    """Compute the changes of the objectives, then of the metrics to show.

    Metrics are by scenario and seed. An episode that failed before or after is left out.
    """
    where = [each for each in before if before[each] and after.get(each)]
    found = []
    for objective in objectives:
        pairs = [(objective.value(before[each]), objective.value(after[each])) for each in where]
        names = [metric for _, metric in objective.terms]
        found += _count_late(
            _change(str(objective), pairs, objective.level), names, where, before, after
        )
    for name in SHOWN:
        pairs = [(_number(before[each], name), _number(after[each], name)) for each in where]
        if name not in map(str, objectives):
            found += _count_late(_change(name, pairs), [name], where, before, after)
    return found


def _count_late(
    found: Sequence[Change],
    names: Sequence[str],
    where: Sequence[tuple[str, int]],
    before: Mapping[tuple[str, int], Numbers],
    after: Mapping[tuple[str, int], Numbers],
) -> list[Change]:
    """Count the episodes in which one of the metrics of a change is late."""
    late_before, late_after = (
        sum(is_late(names, some[each]) for each in where) for some in (before, after)
    )
    return [
        dataclasses.replace(each, late_before=late_before, late_after=late_after) for each in found
    ]


def verdict(chosen: int, objectives: Sequence[Objective], found: Sequence[Change]) -> str:
    """Summarise in a sentence whether the search has improved the settings.

    `chosen` is 0 for the current settings, and `found` are the changes on unseen seeds.
    """
    names = set(map(str, objectives))
    if chosen == 0:
        return "No candidate beat the current settings."
    better = [each.name for each in found if each.name in names and each.high < 0.0]
    worse = [each.name for each in found if each.name in names and each.low > 0.0]
    if better and worse:
        return (
            f"On unseen seeds the chosen settings are better in {', '.join(better)} and worse in "
            f"{', '.join(worse)}."
        )
    if better:
        return "The chosen settings are better than the current ones, also on unseen seeds."
    return (
        "The chosen settings are not significantly better than the current ones on unseen seeds. "
        "More seeds or a larger budget may find better ones."
    )


def _number(metrics: Numbers, name: str) -> float:
    value = metrics.get(name)
    return math.nan if value is None else value


def _change(name: str, pairs: Sequence[tuple[float, float]], level: float = 0.0) -> list[Change]:
    # A mean over only some of the episodes is not comparable, so the metric is left out.
    complete = [pair for pair in pairs if all(map(math.isfinite, pair))]
    if not complete or len(complete) < len(pairs):
        return []
    before, after = zip(*complete, strict=True)
    return [change(name, before, after, level)]


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
                # The time of an event that did not happen is left empty.
                for label, some in (("before", metrics), ("after", other)):
                    row[f"{name} {label}"] = None if is_late([name], some) else some.get(name)
        rows.append(row)
    return rows
