"""Objectives of a search: weighted sums of metrics."""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxplore.parameters import nearest
from jaxplore.report.compute import Compute
from jaxplore.report.metrics import Metrics
from jaxplore.report.statistics import tail_mean

type Numbers = Mapping[str, float | None]
"""Metrics of one episode by name; None for an event that never happened."""

_TERM = re.compile(
    r"\s*(?P<sign>[+-])?\s*(?:(?P<weight>\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+)\s*\*\s*)?"
    r"(?P<name>[A-Za-z_]\w*(?:[.-]\w+)*)\s*"
)

_TAIL = re.compile(r"\s*cvar\s*\(\s*(?P<level>[^,()]*?)\s*,(?P<sum>[^()]*)\)\s*")


@dataclasses.dataclass(frozen=True)
class Objective:
    """A weighted sum of metrics to minimize. A metric to maximize has a negative weight.

    Over the episodes its mean counts, or the mean of its worst share `1 - level`, the conditional
    value at risk: see `jaxplore.report.statistics.tail_mean`.

    Args:
        terms: weights and metrics, at least one.
        level: share of the best episodes that is left out, in [0, 1).

    Raises:
        ValueError: no terms, a weight that is not finite, a level outside [0, 1).
    """

    terms: tuple[tuple[float, str], ...]
    level: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.level < 1.0:
            raise ValueError(
                f"level of an objective is {self.level!r}; accepted: a number in [0, 1)"
            )
        if not self.terms or not all(math.isfinite(weight) for weight, _ in self.terms):
            raise ValueError(
                f"terms of an objective are {self.terms}; accepted: metrics with finite weights"
            )

    @classmethod
    def parse(cls, text: str) -> "Objective":
        """Parse an objective such as `time_to.90 + 100*collisions - coverage`.

        `cvar(LEVEL, SUM)` is the mean of a sum over its worst episodes: `cvar(0.8, finished_at)` is
        that over the slowest fifth.

        Args:
            text: a sum of metrics with weights, or the tail of one.

        Raises:
            ValueError: a text that is not a sum of metrics with weights, a level outside [0, 1).
        """
        tail = _TAIL.fullmatch(text)
        if tail is not None:
            try:
                level = float(tail["level"])
            except ValueError:
                level = -1.0
            if not 0.0 <= level < 1.0:
                raise ValueError(
                    f"level of objective {text!r} is {tail['level']!r}; accepted: a number in "
                    "[0, 1)"
                )
            return dataclasses.replace(cls.parse(tail["sum"]), level=level)
        terms: list[tuple[float, str]] = []
        position = 0
        while position < len(text):
            found = _TERM.match(text, position)
            if found is None or (terms and not found["sign"]):
                raise ValueError(
                    f"objective is {text!r}; accepted: a sum of metrics with weights, such as "
                    "time_to.90 + 100*collisions, or its tail, cvar(0.8, finished_at)"
                )
            sign = -1.0 if found["sign"] == "-" else 1.0
            terms.append((sign * float(found["weight"] or 1.0), found["name"]))
            position = found.end()
        return cls(tuple(terms))

    def __str__(self) -> str:
        text = ""
        for weight, name in self.terms:
            size = "" if abs(weight) == 1.0 else f"{abs(weight):g}*"
            sign = (" - " if weight < 0 else " + ") if text else ("-" if weight < 0 else "")
            text += f"{sign}{size}{name}"
        return f"cvar({self.level:g}, {text})" if self.level else text

    @property
    def is_about_time(self) -> bool:
        """Whether it contains a time with a positive weight."""
        times = ("finished_at", LAST_TARGET, "duration")
        return any(
            weight > 0.0 and (name in times or name.startswith("time_to."))
            for weight, name in self.terms
        )

    def check(self, known: Sequence[str]) -> None:
        """Check that all metrics are known.

        Args:
            known: names of metrics; one that ends with a dot stands for all that begin with it.

        Raises:
            ValueError: an unknown metric; the message names similar ones.
        """
        groups = tuple(each for each in known if each.endswith("."))
        for _, name in self.terms:
            if name not in known and not name.startswith(groups):
                raise ValueError(
                    f"metric {name} is not known; accepted: such as {nearest(name, tuple(known))}"
                )

    def value(self, metrics: Numbers) -> float:
        """Compute the objective of an episode; NaN if a metric has no value.

        Raises:
            ValueError: an unknown metric; the message names similar ones.
        """
        total = 0.0
        for weight, name in self.terms:
            if name not in metrics:
                raise ValueError(
                    f"metric {name} is not known; accepted: such as {nearest(name, dict(metrics))}"
                )
            value = metrics[name]
            total += math.nan if value is None else weight * value
        return total

    def mean(self, episodes: Sequence[Numbers]) -> float:
        """Compute the mean over episodes, or that of the worst ones; NaN without any."""
        return self.mean_of([self.value(each) for each in episodes])

    def mean_of(self, values: Sequence[float]) -> float:
        """Compute the mean of the values of episodes, or of the greatest ones; NaN without any."""
        if not values:
            return math.nan
        if self.level:
            return float(tail_mean(np.asarray(values, np.float64), self.level))
        return math.fsum(values) / len(values)


def list_metrics(metrics_type: type[Metrics], groups: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names of the metrics of a class; a name that ends with a dot is a prefix.

    `groups` are names of groups beside them, see `Scenario.metric_groups`.
    """
    names = [f"{each}." for each in groups]
    for field in dataclasses.fields(metrics_type):
        if field.name in ("time_to", "path_to"):
            names += [f"{field.name}.{level}" for level in metrics_type.levels]
        elif field.name == "compute":
            names += [f"compute.{each.name}" for each in dataclasses.fields(Compute)]
        elif field.name == "members":
            names.append("members.")
        elif field.name not in _NO_NUMBERS:
            names.append(field.name)
    return tuple(names)


_NO_NUMBERS = ("coverage_curve", "curves", "lap_times", "versions", "seed", "parts")
"""Fields of metrics that are no objective: curves, lists, texts and the seed."""


def flat(metrics: Mapping[str, Any], prefix: str = "") -> dict[str, float | None]:
    """Flatten metrics to numbers by dotted names, such as `time_to.90`.

    Lists and texts are left out, booleans become 1 and 0, infinite values and NaN become None.
    """
    numbers: dict[str, float | None] = {}
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            numbers |= flat(value, f"{prefix}{name}.")
        elif value is None:
            numbers[f"{prefix}{name}"] = None
        elif isinstance(value, bool | int | float):
            numbers[f"{prefix}{name}"] = float(value) if math.isfinite(value) else None
    return numbers


LAST_TARGET, TARGETS_SEEN, NUM_TARGETS = "targets.last_at", "targets.seen", "targets.number"
"""Metrics of targets."""
LATE = "late."
"""Prefix of the metrics that mark times of events that did not happen."""


def is_late(names: Iterable[str], metrics: Numbers) -> bool:
    """Check whether one of some metrics is the time of an event that did not happen."""
    return any(f"{LATE}{name}" in metrics for name in names)


def with_late_times(metrics: Numbers, limit: float) -> dict[str, float | None]:
    """Replace missing times of events that did not happen within the time limit [s].

    Such a time is `limit (1 + missing)`, where `missing` is the share of the task that was left: of
    the coverage, the path, the targets, or the distance to the goal. So the objective still
    improves gradually in a search that starts with settings that never finish. Each such time adds
    the metric `late.NAME`, 1.
    """
    filled = dict(metrics)
    coverage = metrics.get("coverage")
    for name, value in metrics.items():
        if value is None and name.startswith("time_to.") and coverage is not None:
            level = float(name.removeprefix("time_to.")) / 100.0
            filled[name] = limit * (1.0 + max(level - coverage, 0.0))
            filled[f"{LATE}{name}"] = 1.0
    for name in ("finished_at", LAST_TARGET):
        # Without targets there is no last one, so nothing is late.
        is_asked = name != LAST_TARGET or bool(metrics.get(NUM_TARGETS))
        if name in metrics and metrics[name] is None and is_asked:
            filled[name] = limit * (1.0 + _share_left(metrics))
            filled[f"{LATE}{name}"] = 1.0
    return filled


def _share_left(metrics: Numbers) -> float:
    """Return the share of a task that was left, from 0 to 1."""

    def number(name: str) -> float:
        value = metrics.get(name)
        return 0.0 if value is None else value

    if "to_go" in metrics:
        left = max(number("to_go"), 0.0)
        return left / max(left + max(number("progress"), 0.0), 1e-9)
    if number(NUM_TARGETS):
        return 1.0 - number(TARGETS_SEEN) / number(NUM_TARGETS)
    if metrics.get("goal_distance") is not None:
        # A goal needs a known map and the way there, and each counts half.
        away = number("goal_distance")
        return min(
            1.0, 0.5 * number("final_unknown") + 0.5 * away / (away + number("path_length") + 1e-9)
        )
    # Who ends by what he can learn has as much left as he has not seen.
    target = metrics.get("target_coverage")
    return max(0.0, (1.0 if target is None else target) - number("coverage"))
