"""Data and metrics of runs whose robots have parts."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.metrics import Column, Curve, Metrics
from jaxplore.report.part import PartMetrics, PartReport, Tally
from jaxplore.report.recording import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PartsData(RunData):
    """A run, and what it shows of each part of the robots, by the name of the part."""

    parts: Mapping[str, PartReport] = dataclasses.field(default_factory=dict)

    def part_figures(self) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures of parts, by file name without suffix."""
        return {
            name: draw for each in self.parts.values() for name, draw in each.figures(self).items()
        }

    def part_arrays(self, records: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Return what `arrays.npz` has of parts: the fields of their records, and `arrays`."""
        fields = [each._asdict() for each in records.values()]
        fields += [each.arrays() for each in self.parts.values()]
        return {name: np.asarray(rows) for each in fields for name, rows in each.items()}

    def tallies(self) -> list[Tally]:
        """Return how many were found of what the task is about."""
        found = (each.tally(self) for each in self.parts.values())
        return [each for each in found if each is not None]

    def part_metrics(self) -> dict[str, PartMetrics]:
        """Compute the metrics of each part, by its name."""
        return {name: each.metrics(self) for name, each in self.parts.items()}

    def part_curves(self) -> dict[str, np.ndarray]:
        """Return the curves of parts at the N + 1 instants, by name."""
        return {
            name: rows for each in self.parts.values() for name, rows in each.series(self).items()
        }

    def move_parts(self, offset: np.ndarray) -> dict[str, PartReport]:
        """Return `parts` with an offset (2,) [m] added to their positions."""
        return {name: each.move(offset) for name, each in self.parts.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class PartsMetrics(Metrics):
    """Metrics of a run, those of the parts of its robots among them by their names; in
    `metrics.json` each is an entry of its own."""

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

    def part_rows(self) -> list[tuple[str, str]]:
        """Return the main metrics of parts as (name, text), for tables."""
        return [row for each in self.parts.values() for row in each.rows()]


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
