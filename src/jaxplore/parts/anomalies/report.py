"""Metrics and drawing of what differed from the known map."""

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from PIL import ImageDraw

from jaxplore.maps.datum import move_points
from jaxplore.parts.anomalies.reports import KIND_NAMES
from jaxplore.parts.anomalies.robot import AnomalyTest
from jaxplore.report._numbers import finite
from jaxplore.report.drawing.colours import ALARM, shade
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import Colour
from jaxplore.report.drawing.shapes import Surface, draw_targets
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column
from jaxplore.report.part import PartMetrics, PartReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MATCH = 0.75
"""A report is of an anomaly if it is at most this far from its box [m]."""

APART = 2.5
"""Least distance between two labels of one kind [m]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnomalyMetrics(PartMetrics):
    """Metrics of a search for anomalies.

    Args:
        num_anomalies: number of places where the world differs from the known map.
        anomalies_found: number of them that were reported after a second look, with their kind.
        false_alarms: number of reports of places where nothing differs.
        cleared: number of suspicions that the second look did not confirm.
        last_anomaly_at: time at which the last anomaly was reported [s]; None if some were not.
        reports: the reports by time: `kind`, `place` [m], `suspected_at` and `reported_at` [s], and
            whether something `is_planted` there.
    """

    num_anomalies: int
    anomalies_found: int
    false_alarms: int
    cleared: int
    last_anomaly_at: float | None
    reports: list[dict[str, Any]]

    columns = (
        Column.quartiles(
            "anomalies_found", "anomalies found", applies=lambda spread: spread[2] > 0.0
        ),
        Column.total("false_alarms", "false alarms", applies=lambda total: total > 0),
    )

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers and the reports."""
        alarms = f"{self.false_alarms} false alarms, {self.cleared} suspicions dropped"
        rows = [("anomalies", f"{self.anomalies_found} of {self.num_anomalies} found; {alarms}")]
        for each in self.reports:
            x, y = each["place"]
            where = f"({x:.1f}, {y:.1f}) m after {each['reported_at']:.1f} s"
            known = "" if each["is_planted"] else ", a false alarm"
            rows.append((f"  {each['kind']}", where + known))
        return rows


@dataclasses.dataclass(frozen=True)
class AnomalyReport(PartReport):
    """What differs from the known map, and what the robot found of it.

    Args:
        boxes: (P, 4) rectangles (x_min, y_min, x_max, y_max) of what differs [m].
        kinds: (P,) kinds, the keys of `KIND_NAMES`.
        place: (R, 2) places that the robot suspected [m].
        kind: (R,) their kinds.
        suspected: (R,) times of the suspicions [s].
        reported: (R,) times of the reports [s]; infinite without a second look.
        num_cleared: number of suspicions that the second look did not confirm.
    """

    name: ClassVar[str] = AnomalyTest.name

    boxes: np.ndarray
    kinds: np.ndarray
    place: np.ndarray
    kind: np.ndarray
    suspected: np.ndarray
    reported: np.ndarray
    num_cleared: int

    def move(self, offset: np.ndarray) -> "AnomalyReport":
        """Return the report with an offset (2,) [m] added to all positions."""
        boxes = move_points(move_points(self.boxes, offset), offset, (2, 3))
        return dataclasses.replace(self, boxes=boxes, place=move_points(self.place, offset))

    @property
    def middles(self) -> np.ndarray:
        """Middles (P, 2) of what differs [m]."""
        return np.asarray(0.5 * (self.boxes[:, :2] + self.boxes[:, 2:]))

    @property
    def matches(self) -> np.ndarray:
        """Whether each place of the robot (R) is at each box (P): a mask (R, P)."""
        place = self.place[:, None]
        beside = np.maximum(self.boxes[:, :2] - place, place - self.boxes[:, 2:])
        return np.asarray(np.hypot(*np.moveaxis(np.maximum(beside, 0.0), -1, 0)) <= MATCH)

    @property
    def report_times(self) -> np.ndarray:
        """Time (P,) of the first report of each anomaly by its kind and place [s]."""
        is_of = self.matches & (self.kind[:, None] == self.kinds)
        times = np.where(is_of, self.reported[:, None], np.inf)
        return np.asarray(times.min(axis=0, initial=np.inf))

    def metrics(self, run: MissionData) -> AnomalyMetrics:
        """Compute the metrics."""
        times, is_true = self.report_times, self.matches.any(axis=1)
        is_reported = np.isfinite(self.reported)
        return AnomalyMetrics(
            num_anomalies=len(times),
            anomalies_found=int(np.isfinite(times).sum()),
            false_alarms=int((is_reported & ~is_true).sum()),
            cleared=self.num_cleared,
            last_anomaly_at=finite(times.max()) if len(times) else None,
            reports=[
                {
                    "kind": KIND_NAMES[int(self.kind[row])],
                    "place": [round(float(each), 2) for each in self.place[row]],
                    "suspected_at": round(float(self.suspected[row]), 2),
                    "reported_at": round(float(self.reported[row]), 2),
                    "is_planted": bool(is_true[row]),
                }
                for row in np.argsort(self.suspected)
                if is_reported[row]
            ],
        )

    def draw(
        self, surface: Surface, draw: ImageDraw.ImageDraw, run: MissionData, frame: Any
    ) -> None:
        """Draw a star at each anomaly, and a ring at those that were found by then."""
        is_found = self.report_times <= frame.time
        draw_targets(surface, draw, self.middles, is_found, ALARM)

    def legend(self) -> list[Entry]:
        """Return the entries of anomalies."""
        if not len(self.boxes):
            return []
        return [Entry("anomaly", ALARM, "star"), Entry("reported", ALARM, "found")]

    def colours(self) -> list[Colour]:
        """Return the colour of anomalies."""
        return [ALARM]

    def add_to_map(self, axes: "Axes", run: MissionData, window: Window) -> None:
        """Draw what differs from the known map, and the reports with their times.

        What was found is a ring, what was not is a star.
        """
        colour = shade(ALARM)
        is_found = np.isfinite(self.report_times)
        places = window.place(self.middles) + window.corner
        for some, marker, size, fill, edge, label in (
            (~is_found, "*", 14.0, colour, "white", "anomaly, not found"),
            (is_found, "o", 11.0, "none", colour, "anomaly found"),
        ):
            if some.any():
                axes.plot(
                    *places[some].T,
                    marker=marker,
                    markerfacecolor=fill,
                    markersize=size,
                    markeredgecolor=edge,
                    markeredgewidth=1.0 if marker == "*" else 2.2,
                    linestyle="none",
                    label=label,
                    zorder=4.2,
                )
        reported = np.isfinite(self.reported)
        if not reported.any():
            return
        spots = window.place(self.place[reported]) + window.corner
        axes.plot(*spots.T, marker="x", color=colour, linestyle="none", label="report", zorder=4.4)
        labelled: list[tuple[int, np.ndarray]] = []
        for row in np.argsort(self.reported[reported]):
            spot, kind = spots[row], int(self.kind[reported][row])
            # Several faces of one thing have reports of their own, whose labels would overlap.
            if any(each == kind and np.hypot(*(spot - at)) < APART for each, at in labelled):
                continue
            labelled.append((kind, spot))
            axes.annotate(
                f"{KIND_NAMES[kind]}, {self.reported[reported][row]:.0f} s",
                spot,
                xytext=(9.0, -14.0),
                textcoords="offset points",
                color=colour,
                fontsize=8,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
                zorder=4.6,
            )
