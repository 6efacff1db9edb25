"""The protocol of a task's metrics, and the metrics that all tasks share."""

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from jaxplore.report._numbers import finite, text
from jaxplore.report.compute import Compute
from jaxplore.report.statistics import Quartiles, quartiles

CURVE_PERIOD = 0.5
"""Time between the points of a curve [s]."""


class Column(NamedTuple):
    """A column of a comparison: one statistic over the runs of a variant.

    Args:
        name: key of the statistic in `metrics.json`.
        header: heading of the column, with the unit.
        value: function that computes the statistic from the metrics of the runs.
        text: function that formats the statistic.
        applies: function that says whether a statistic is meaningful; a column without a meaningful
            value is left out.
    """

    name: str
    header: str
    value: Callable[[Sequence[Any]], Any]
    text: Callable[[Any], str]
    applies: Callable[[Any], bool] = lambda _: True

    @classmethod
    def quartiles(
        cls,
        name: str,
        header: str,
        *,
        digits: int = 1,
        scale: float = 1.0,
        missing: float = math.inf,
        applies: Callable[[Any], bool] = lambda _: True,
        number: Callable[[Any], float | None] | None = None,
        separator: str = " ",
    ) -> "Column":
        """Make a column with the median and the quartiles of a number.

        Args:
            name: name of the attribute of the metrics, unless `number` is given.
            header: heading, with the unit.
            digits: decimals.
            scale: factor of the displayed values.
            missing: value for a run without the number. By default a run that never finished is
                infinitely late, so that a variant does not gain by failing in its slow runs.
            applies: see `Column`.
            number: function that reads the number from the metrics of a run.
            separator: text between the median and the quartiles.
        """
        read = number or (lambda each: getattr(each, name))

        def value(runs: Sequence[Any]) -> Quartiles:
            found = [read(each) for each in runs]
            return quartiles([missing if each is None else float(each) for each in found])

        def format_spread(spread: Quartiles) -> str:
            low, median, high = (
                f"{scale * each:.{digits}f}" if math.isfinite(each) else "-" for each in spread
            )
            # Equal quartiles, as of a single run, would only repeat the median.
            return median if low == high else f"{median}{separator}[{low}, {high}]"

        return cls(name, header, value, format_spread, applies)

    @classmethod
    def num_finished(cls) -> "Column":
        """Make a column with the number of finished runs, of all."""
        return cls(
            "num_finished",
            "finished",
            lambda runs: (sum(each.is_finished for each in runs), len(runs)),
            lambda counts: f"{counts[0]} of {counts[1]}",
        )

    @classmethod
    def total(
        cls, name: str, header: str, *, applies: Callable[[Any], bool] = lambda _: True
    ) -> "Column":
        """Make a column with the sum of a count over the runs."""
        return cls(
            name, header, lambda runs: sum(getattr(each, name) for each in runs), str, applies
        )

    @classmethod
    def least(
        cls,
        name: str,
        header: str,
        *,
        digits: int = 2,
        applies: Callable[[Any], bool] = lambda _: True,
    ) -> "Column":
        """Make a column with the least value of all runs, infinite without any."""

        def value(runs: Sequence[Any]) -> float:
            numbers = [getattr(each, name) for each in runs]
            return min(math.inf if each is None else each for each in numbers)

        return cls(
            name,
            header,
            value,
            lambda least: f"{least:.{digits}f}" if math.isfinite(least) else "-",
            applies,
        )


class Curve(NamedTuple):
    """A quantity over time that a comparison plots.

    Args:
        name: key of the curve in `Metrics.series`.
        label: label of the axis, with the unit.
        scale: factor of the displayed values.
        limit: upper end of the axis; by the data when absent.
        applies: function that says whether the curve is meaningful for the metrics of a run; a
            curve that is not for any run is left out.
        is_count: whether the values are counts: the axis then has ticks at whole numbers.
    """

    name: str
    label: str
    scale: float = 1.0
    limit: float | None = None
    applies: Callable[[Any], bool] = lambda _: True
    is_count: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Metrics(abc.ABC):
    """Metrics of a run. `print` shows them as a table.

    Args:
        duration: simulated time [s].
        num_steps: number of control periods.
        is_finished: whether the task was finished.
        finished_at: time at which the task was finished [s]; None if it was not.
        given_up_at: time at which it was given up, because nothing new was seen [s]; None if it was
            not.
        is_interrupted: whether the user stopped the run.
        compute: wall-clock cost.
        seed: seed of the run, if known.
        versions: versions of the software, and the machine.
    """

    duration: float
    num_steps: int
    is_finished: bool
    finished_at: float | None
    is_interrupted: bool
    compute: Compute
    seed: int | None
    versions: dict[str, str | int | None]
    given_up_at: float | None = None

    columns: ClassVar[tuple[Column, ...]] = ()
    """Columns of a comparison's table, after the name of the variant."""
    plotted: ClassVar[tuple[Curve, ...]] = ()
    """Curves of a comparison, each a key of `series`."""
    levels: ClassVar[tuple[int, ...]] = ()
    """Levels [%] of the entries of fields that are mappings by level, such as `time_to`."""

    def list_columns(self) -> tuple[Column, ...]:
        """Return the columns of a comparison's table; by default `columns`."""
        return self.columns

    def list_curves(self) -> tuple[Curve, ...]:
        """Return the curves of a comparison; by default `plotted`."""
        return self.plotted

    def series(self) -> Mapping[str, Sequence[float | None]]:
        """Return quantities over time: "time" [s], and one entry for each of `plotted`."""
        return {}

    def as_dict(self) -> dict[str, Any]:
        """Return all metrics as plain Python values for JSON."""
        return dataclasses.asdict(self)

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text), for tables: by default every number."""
        common = {field.name for field in dataclasses.fields(Metrics)}
        own = [field.name for field in dataclasses.fields(self) if field.name not in common]
        rows = [self.duration_row()]
        for name in own:
            value = getattr(self, name)
            # Mappings and curves do not fit into a line of a table.
            if value is None or isinstance(value, bool | int | float | str):
                shown = text(value, 3) if value is None or isinstance(value, float) else str(value)
                rows.append((name.replace("_", " "), shown))
        return rows + self.last_rows()

    def duration_row(self, *, has_end: bool = True) -> tuple[str, str]:
        """Return the row of the duration and of how the run ended.

        Args:
            has_end: whether the task has an end; a patrol can be neither finished nor unfinished.
        """
        end = "not finished"
        if self.finished_at is not None:
            end = f"finished after {self.finished_at:.2f} s"
        elif self.given_up_at is not None:
            end = f"given up after {self.given_up_at:.2f} s"
        words = f"{self.duration:.2f} s, {self.num_steps} steps"
        return "duration", f"{words}, {end}" if has_end else words

    def last_rows(self) -> list[tuple[str, str]]:
        """Return the last rows of every table: time, seed and software."""
        versions = self.versions
        return [
            *self.compute.rows(),
            *([] if self.seed is None else [("seed", str(self.seed))]),
            ("software", f"jaxplore {versions['jaxplore']}, jax {versions['jax']}"),
            ("device", str(versions["device"])),
        ]

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def thin_series(series: Mapping[str, np.ndarray], period: float) -> dict[str, list[float | None]]:
    """Thin series (N + 1,) to one point per `CURVE_PERIOD`, the end included.

    Args:
        series: series by name.
        period: control period [s].
    """
    steps = len(next(iter(series.values()))) - 1
    stride = max(1, round(CURVE_PERIOD / period))
    kept = np.unique(np.append(np.arange(0, steps + 1, stride), steps))
    return {
        name: [finite(value, digits=5) for value in values[kept]] for name, values in series.items()
    }
