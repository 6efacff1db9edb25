"""Metrics and drawing of objects and their classes."""

from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import ImageDraw

from jaxplore.report.drawing.colours import ALARM, FREE, TARGET, blend, shade
from jaxplore.report.drawing.palette import INK, PALE, PAPER, Colour
from jaxplore.report.drawing.shapes import Surface
from jaxplore.report.exploration.mission import MissionData, MissionFrame, ObjectData
from jaxplore.report.exploration.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OTHERS: tuple[tuple[int, int, int], ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (213, 94, 0),
)
"""Colours of the classes other than the targets', in turn: those of Okabe and Ito, which
colour-blind readers tell apart."""
MARKERS = "^DvPXs"
"""Markers of these classes in the map, in turn."""
BADGE, SHIFT = 6.5, 9.0
"""Radius of a badge, and its distance from its object in x and y [pixels of scale 1]."""


def class_colours(objects: ObjectData) -> list[tuple[int, int, int]]:
    """Return the colour of each class; that of the targets is the colour of targets."""
    others = [number for number in range(len(objects.classes)) if number != objects.target]
    ranks = {number: rank for rank, number in enumerate(others)}
    return [
        OTHERS[ranks[number] % len(OTHERS)] if number in ranks else TARGET
        for number in range(len(objects.classes))
    ]


def mission_colours(recording: MissionData) -> list[Colour]:
    """Return the colours of targets, objects and anomalies, as far as a run has them."""
    colours: list[Colour] = [TARGET] if len(recording.targets) else []
    if recording.anomalies is not None or recording.objects is not None:
        colours.append(ALARM)
    if recording.objects is not None:
        colours += [each for each in class_colours(recording.objects) if each != TARGET]
    return colours


def find_known_objects(
    objects: ObjectData | None, frame: MissionFrame
) -> list[tuple[np.ndarray, tuple[int, int, int]]]:
    """Return the place and a colour of each object that was detected by the time of a frame.

    The colour is that of the most probable class, the paler the less certain it is. Targets that
    were found are left out: they are drawn as such.
    """
    if objects is None:
        return []
    colours, found = class_colours(objects), np.flatnonzero(frame.is_found)
    return [
        (objects.place[row], blend(colours[int(np.argmax(known))], FREE, float(np.max(known)) ** 2))
        for row, known in enumerate(frame.classes)
        if np.isfinite(known).all() and row not in found
    ]


def is_false(objects: ObjectData) -> np.ndarray:
    """Return whether each object (N,) is no target and was reported as one."""
    is_reported = np.isfinite(objects.reported_at[:, objects.target])
    return np.asarray(is_reported & (objects.label != objects.target))


def report_rows(objects: ObjectData | None) -> list[dict[str, Any]] | None:
    """Return the reports by time; None without a detector.

    An object is reported once for each class that was ever certain. `is_true` says whether it is of
    that class.
    """
    if objects is None:
        return None
    found = np.argwhere(np.isfinite(objects.reported_at))
    times = objects.reported_at[tuple(found.T)]
    return [
        {
            "label": objects.classes[label],
            "place": [round(float(each), 2) for each in objects.place[row]],
            "reported_at": round(float(objects.reported_at[row, label]), 2),
            "probability": round(float(objects.reported_probability[row, label]), 4),
            "true_label": objects.classes[int(objects.label[row])],
            "is_true": bool(objects.label[row] == label),
        }
        for row, label in found[np.argsort(times, kind="stable")]
    ]


def object_metrics(objects: ObjectData | None) -> dict[str, Any]:
    """Return the metrics of the objects, as in `ExplorationMetrics`."""
    rows = report_rows(objects)
    if objects is None or rows is None:
        return {
            "num_objects": 0,
            "objects_detected": 0,
            "false_reports": 0,
            "mislabelled": 0,
            "class_entropy": None,
            "labels": None,
        }
    false = int(is_false(objects).sum())
    some = np.maximum(objects.probability.astype(np.float64), 1e-300)
    return {
        "num_objects": len(objects.label),
        "objects_detected": int(np.isfinite(objects.detected_at).sum()),
        "false_reports": false,
        "mislabelled": sum(not each["is_true"] for each in rows) - false,
        "class_entropy": float(-(some * np.log(some)).sum()),
        "labels": rows,
    }


def object_rows(
    labels: list[dict[str, Any]] | None, counts: tuple[int, int, int, int]
) -> list[tuple[str, str]]:
    """Return the metrics of the objects as (name, text), for tables; none without a detector.

    The counts are those of all objects, of the detected ones, of false reports of a target, and of
    other mistakes.
    """
    if labels is None:
        return []
    total, detected, false, other = counts
    mistakes = f"{false} false reports of a target, {other} other mistakes"
    rows = [("objects", f"{detected} of {total} detected, {len(labels)} reports; {mistakes}")]
    for each in labels:
        x, y = each["place"]
        where = f"({x:.1f}, {y:.1f}) m after {each['reported_at']:.1f} s"
        known = "" if each["is_true"] else f", but it is: {each['true_label']}"
        rows.append((f"  {each['label']}", f"{where}, {100 * each['probability']:.0f} %{known}"))
    return rows


def draw_objects(
    surface: Surface, draw: ImageDraw.ImageDraw, objects: ObjectData, frame: MissionFrame
) -> None:
    """Draw what the robot knows of each object in a frame.

    An object other than a target is a square. Beside an object that was detected is a badge: a disc
    that is filled as far as the class is certain, in the colour of the most probable class. A
    target that was found has no badge. What was reported as a target and is none is crossed out.
    """
    colours, unit = class_colours(objects), surface.unit
    is_found = np.zeros(len(objects.label), bool)
    is_found[: len(frame.is_found)] = frame.is_found
    reported = is_false(objects) & (objects.reported_at[:, objects.target] <= frame.time)
    for row, middle in enumerate(surface.pixels(objects.place)):
        if objects.label[row] != objects.target:
            _draw_square(draw, middle, unit)
        known = frame.classes[row]
        if np.isfinite(known).all() and not is_found[row]:
            best = int(np.argmax(known))
            _draw_badge(draw, middle, unit, float(known[best]), colours[best])
        if reported[row]:
            for arm in (np.array([7.0, 7.0]), np.array([7.0, -7.0])):
                ends = [tuple(middle - arm * unit), tuple(middle + arm * unit)]
                draw.line(ends, ALARM, round(2.5 * unit))


def _draw_square(draw: ImageDraw.ImageDraw, middle: np.ndarray, unit: float) -> None:
    (x, y), reach = middle.tolist(), 3.5 * unit
    draw.rectangle((x - reach, y - reach, x + reach, y + reach), PALE, PAPER, round(unit))


def _draw_badge(
    draw: ImageDraw.ImageDraw, middle: np.ndarray, unit: float, share: float, colour: Colour
) -> None:
    x, y = (middle + np.array([SHIFT, -SHIFT]) * unit).tolist()
    reach = BADGE * unit
    box = (x - reach, y - reach, x + reach, y + reach)
    draw.ellipse(box, PAPER)
    draw.pieslice(box, -90.0, -90.0 + 360.0 * share, colour)
    draw.ellipse(box, None, INK, round(1.2 * unit))


def add_objects(axes: "Axes", objects: ObjectData | None, window: Window) -> None:
    """Draw the objects that are no targets, and how certain their class is.

    Each has the marker and the colour of its most probable class. What was reported as a target is
    labelled as false.
    """
    if objects is None:
        return
    places = window.place(objects.place) + window.corner
    colours, best = class_colours(objects), np.argmax(objects.probability, axis=1)
    is_found = np.isfinite(objects.reported_at[:, objects.target])
    is_target = objects.label == objects.target
    is_shown = ~(is_target & is_found) & np.isfinite(objects.detected_at)
    others = [number for number in range(len(objects.classes)) if number != objects.target]
    for number, name in enumerate(objects.classes):
        some = is_shown & (best == number)
        if not some.any():
            continue
        marker = MARKERS[others.index(number) % len(MARKERS)] if number in others else "h"
        axes.plot(
            *places[some].T,
            marker=marker,
            color=shade(colours[number]),
            markersize=7.5,
            markeredgecolor="white",
            markeredgewidth=0.8,
            linestyle="none",
            label=f"taken for: {name}",
            zorder=4.1,
        )
    for row in np.flatnonzero(is_shown):
        is_wrong = is_found[row] and not is_target[row]
        words = f"{objects.classes[best[row]]} {100 * objects.probability[row, best[row]]:.0f} %"
        if is_wrong:
            words += ", false report"
        axes.annotate(
            words,
            places[row],
            xytext=(7.0, 5.0),
            textcoords="offset points",
            color=shade(ALARM) if is_wrong else "0.15",
            fontsize=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6},
            zorder=4.3,
        )
    unseen = ~is_target & ~np.isfinite(objects.detected_at)
    if unseen.any():
        axes.plot(
            *places[unseen].T,
            marker="x",
            color="0.45",
            markersize=6.0,
            linestyle="none",
            label="object, not detected",
            zorder=4.0,
        )
