"""Metrics of parts, of a robot and of a fleet."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.metrics import Column, Curve, Metrics
from jaxplore.report.part import PartMetrics


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionMetrics(Metrics):
    """Metrics of the parts of the robots.

    Args:
        parts: metrics of each part, by its name; in `metrics.json` each is an entry of its own.
    """

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
        """Return the metrics of parts as (name, text), for tables."""
        return [row for each in self.parts.values() for row in each.rows()]

    @property
    def ends_by_parts(self) -> bool:
        """Whether a part says when the task is finished."""
        return any(each.is_end for each in self.parts.values())


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


def mission_metrics(data: MissionData) -> dict[str, PartMetrics]:
    """Compute the metrics of each part."""
    return {name: each.metrics(data) for name, each in data.parts.items()}


def mission_curves(data: MissionData) -> dict[str, np.ndarray]:
    """Return the curves of parts at the N + 1 instants, if any."""
    curves: dict[str, np.ndarray] = {}
    for each in data.parts.values():
        curves |= each.series(data)
    return curves
