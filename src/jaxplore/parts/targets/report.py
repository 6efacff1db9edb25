"""Metrics and pictures of targets that are to be found."""

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from PIL import ImageDraw

from jaxplore._types import Count
from jaxplore.maps.datum import move_points
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.drawing.colours import FREE, TARGET, blend, shade
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import Colour
from jaxplore.report.drawing.shapes import Surface, draw_targets
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column, Curve
from jaxplore.report.of_parts import PartsData
from jaxplore.report.part import Headline, PartMetrics, PartReport, Tally

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOUND = blend(TARGET, FREE, 0.3)
"""Colour of the disc of a target that was found."""


class TargetRecord(NamedTuple):
    """The targets at a step.

    Args:
        targets_seen: number of those that were found so far: seen, or with a detector reported.
    """

    targets_seen: Count


@dataclasses.dataclass(frozen=True, kw_only=True)
class TargetMetrics(PartMetrics):
    """Metrics of targets.

    Args:
        number: number of targets.
        seen: number of targets that were found: seen, or with a detector reported.
        last_at: time at which the last target was found [s]; None if some were not.
        how: what finding means, `seen` or `recognised`.
    """

    number: int
    seen: int
    last_at: float | None
    how: str

    is_end: ClassVar[bool] = True
    columns = (
        Column.quartiles("seen", "targets seen", applies=lambda spread: spread[2] > 0.0),
        Column("number", "of targets", lambda runs: max(each.number for each in runs), str),
    )
    plotted = (Curve("targets", "targets found", is_count=True),)

    def rows(self) -> list[tuple[str, str]]:
        """Return how many were found, and when the last one was."""
        if not self.number:
            return []
        found = f"{self.seen} of {self.number} {self.how}"
        last = "" if self.last_at is None else f", the last at {self.last_at:.2f} s"
        return [("targets", found + last)]


@dataclasses.dataclass(frozen=True)
class TargetReport(PartReport):
    """Targets, and how they are found.

    Args:
        places: (M, 2) positions, in a volume (M, 3) [m].
        how: what finding means, `seen` or `recognised`.
    """

    name: ClassVar[str] = "targets"
    record_type: ClassVar[type | None] = TargetRecord
    mark_size: ClassVar[float] = 0.8

    places: np.ndarray
    how: str = "seen"

    def move(self, offset: np.ndarray) -> "TargetReport":
        """Return the report with an offset (2,) [m] added to the targets."""
        return dataclasses.replace(self, places=move_points(self.places, offset))

    def metrics(self, run: PartsData) -> TargetMetrics:
        """Compute the metrics."""
        seen, number = np.asarray(run.records.parts[self.name].targets_seen), len(self.places)
        return TargetMetrics(
            number=number,
            seen=int(seen[-1]) if len(seen) else 0,
            last_at=_last_target_at(seen, number, run.control_period),
            how=self.how,
        )

    def series(self, run: PartsData) -> dict[str, np.ndarray]:
        """Return the number of targets that were found at each instant."""
        return {"targets": at_instants(run.records.parts[self.name].targets_seen, 0.0)}

    def tally(self, run: PartsData) -> Tally:
        """Return how many targets were found at each instant."""
        return Tally("targets", self.series(run)["targets"], len(self.places), TARGET)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the targets."""
        return {"targets": self.places}

    def headline(self, run: PartsData, step: int) -> Headline:
        """Return how many targets were found."""
        values = self.series(run)["targets"]
        return Headline(f"{values[step]:.0f}", "targets found", values, float(len(self.places)))

    def footer(self, run: PartsData, frame: Any) -> str:
        """Return how many targets were found by the time of a frame."""
        return f"targets {int(np.sum(self.is_found(frame)))} of {len(self.places)}"

    def is_found(self, frame: Any) -> np.ndarray:
        """Return which targets (M,) were found by the time of a frame."""
        return np.asarray(frame.parts[self.name]["is_found"], bool)

    def draw(self, surface: Surface, draw: ImageDraw.ImageDraw, run: Any, frame: Any) -> None:
        """Draw the targets: a star until it is found, then a ring with a check mark."""
        draw_targets(surface, draw, self.places, self.is_found(frame), TARGET)

    def add_to_map(self, axes: "Axes", run: PartsData, window: Window) -> None:
        """Draw the targets: found ones as rings, those that are still to be found as stars."""
        places = window.place(self.places) + window.corner
        colour, is_found = shade(TARGET), self.is_found(run.frames[-1])
        for some, marker, size, fill, edge, label in (
            (~is_found, "*", 12.0, colour, "white", "target"),
            (is_found, "o", 8.0, "white", colour, "target found"),
        ):
            # A kind that is not there has no entry in the legend.
            if not some.any():
                continue
            axes.plot(
                *places[some].T,
                marker=marker,
                color=fill,
                markersize=size,
                markeredgecolor=edge,
                markeredgewidth=1.0 if marker == "*" else 2.4,
                linestyle="none",
                label=label,
                zorder=4.0,
            )

    def add_to_space(self, axes: "Axes", frame: Any) -> None:
        """Draw the targets: found ones as discs, those that are still to be found as stars."""
        is_found = self.is_found(frame)
        for some, marker, label in ((~is_found, "*", "target"), (is_found, "o", "target found")):
            if some.any():
                look: dict[str, Any] = {"color": shade(TARGET), "marker": marker, "s": 60}
                axes.scatter(*self.places[some].T, label=label, **look)

    def marks(self, frame: Any) -> list[tuple[np.ndarray, Colour]]:
        """Return the targets, pale where they were found."""
        pairs = zip(self.places, self.is_found(frame), strict=True)
        return [(place, FOUND if is_found else TARGET) for place, is_found in pairs]

    def legend(self) -> list[Entry]:
        """Return the entries of targets."""
        return [Entry("target", TARGET, "star"), Entry("target found", TARGET, "found")]

    def colours(self) -> list[Colour]:
        """Return the colour of targets."""
        return [TARGET]


def _last_target_at(seen: np.ndarray, number: int, period: float) -> float | None:
    """Return the time at which the last target was seen [s]; None if some were not, or without any.

    The record of step k holds how many of the `number` targets were `seen` (N,) at its beginning,
    so the time is k control periods [s].
    """
    is_all = seen >= number if number else np.zeros(0, bool)
    return int(is_all.argmax()) * period if is_all.any() else None
