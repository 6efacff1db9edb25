"""Metrics and drawing of what differed from the known map."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.parts.anomaly_reports import KIND_NAMES
from jaxplore.report._numbers import finite
from jaxplore.report.drawing.colours import ALARM, shade
from jaxplore.report.exploration.mission import AnomalyData
from jaxplore.report.exploration.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MATCH = 0.75
"""A report is of an anomaly if it is at most this far from its box [m]."""

APART = 2.5
"""Least distance between two labels of one kind [m]."""


def middles(found: AnomalyData) -> np.ndarray:
    """Return the middles (P, 2) of what differs [m]."""
    return np.asarray(0.5 * (found.boxes[:, :2] + found.boxes[:, 2:]))


def matches(found: AnomalyData) -> np.ndarray:
    """Return whether each place of the robot (R) is at each box (P): a mask (R, P)."""
    place = found.place[:, None]
    beside = np.maximum(found.boxes[:, :2] - place, place - found.boxes[:, 2:])
    return np.asarray(np.hypot(*np.moveaxis(np.maximum(beside, 0.0), -1, 0)) <= MATCH)


def find_report_times(found: AnomalyData) -> np.ndarray:
    """Return the time (P,) of the first report of each anomaly by its kind and place [s]."""
    is_of = matches(found) & (found.kind[:, None] == found.kinds)
    times = np.where(is_of, found.reported[:, None], np.inf)
    return np.asarray(times.min(axis=0, initial=np.inf))


def false_alarms(found: AnomalyData) -> int:
    """Return the number of reports of places where nothing differs."""
    is_reported = np.isfinite(found.reported)
    return int((is_reported & ~matches(found).any(axis=1)).sum())


def anomaly_rows(found: AnomalyData | None) -> list[dict[str, Any]] | None:
    """Return the reports in the order of their suspicions; None without a test.

    `is_planted` says whether something differs there.
    """
    if found is None:
        return None
    is_true = matches(found).any(axis=1)
    return [
        {
            "kind": KIND_NAMES[int(found.kind[row])],
            "place": [round(float(each), 2) for each in found.place[row]],
            "suspected_at": round(float(found.suspected[row]), 2),
            "reported_at": round(float(found.reported[row]), 2),
            "is_planted": bool(is_true[row]),
        }
        for row in np.argsort(found.suspected)
        if np.isfinite(found.reported[row])
    ]


def anomaly_metrics(found: AnomalyData | None) -> dict[str, Any]:
    """Return the metrics of the anomalies, as in `ExplorationMetrics`."""
    times = np.zeros(0) if found is None else find_report_times(found)
    return {
        "num_anomalies": len(times),
        "anomalies_found": int(np.isfinite(times).sum()),
        "false_alarms": 0 if found is None else false_alarms(found),
        "cleared": 0 if found is None else found.num_cleared,
        "last_anomaly_at": finite(times.max()) if len(times) else None,
        "reports": anomaly_rows(found),
    }


def report_texts(reports: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Return the reports as (name, text), for tables."""
    rows = []
    for each in reports:
        x, y = each["place"]
        where = f"({x:.1f}, {y:.1f}) m after {each['reported_at']:.1f} s"
        known = "" if each["is_planted"] else ", a false alarm"
        rows.append((f"  {each['kind']}", where + known))
    return rows


def add_anomalies(axes: "Axes", found: AnomalyData | None, window: Window) -> None:
    """Draw what differs from the known map, and the reports with their times.

    What was found is a ring, what was not is a star.
    """
    if found is None:
        return
    colour = shade(ALARM)
    is_found = np.isfinite(find_report_times(found))
    places = window.place(middles(found)) + window.corner
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
    reported = np.isfinite(found.reported)
    if not reported.any():
        return
    spots = window.place(found.place[reported]) + window.corner
    axes.plot(*spots.T, marker="x", color=colour, linestyle="none", label="report", zorder=4.4)
    labelled: list[tuple[int, np.ndarray]] = []
    for row in np.argsort(found.reported[reported]):
        spot, kind = spots[row], int(found.kind[reported][row])
        # Several faces of one thing have reports of their own, and labels would cover each other.
        if any(each == kind and np.hypot(*(spot - at)) < APART for each, at in labelled):
            continue
        labelled.append((kind, spot))
        axes.annotate(
            f"{KIND_NAMES[kind]}, {found.reported[reported][row]:.0f} s",
            spot,
            xytext=(9.0, -14.0),
            textcoords="offset points",
            color=colour,
            fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
            zorder=4.6,
        )
