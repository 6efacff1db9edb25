"""Metrics and drawing of objects and their classes."""

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from PIL import ImageDraw

from jaxplore.maps.datum import move_points
from jaxplore.parts.recognition.robot import Recognition
from jaxplore.parts.targets.report import TargetReport
from jaxplore.report.drawing.colours import ALARM, FREE, TARGET, blend, shade
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import INK, PALE, PAPER, Colour
from jaxplore.report.drawing.shapes import Surface
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column
from jaxplore.report.part import PartMetrics, PartReport

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


@dataclasses.dataclass(frozen=True, kw_only=True)
class ObjectMetrics(PartMetrics):
    """Metrics of the recognition of objects.

    Args:
        num_objects: number of objects, targets included.
        objects_detected: number of them that were detected.
        false_reports: number of objects that were reported as a target and are none.
        mislabelled: number of other reports of a class that the object does not have.
        class_entropy: sum of the entropies of the objects' classes at the end [nat].
        labels: the reports by time: `label`, `place` [m], `reported_at` [s], `probability`,
            `true_label` and `is_true`. An object is reported once for each class that was ever
            certain.
    """

    num_objects: int
    objects_detected: int
    false_reports: int
    mislabelled: int
    class_entropy: float
    labels: list[dict[str, Any]]

    columns = (Column.total("false_reports", "false reports", applies=lambda total: total > 0),)

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers and the reports."""
        total, detected = self.num_objects, self.objects_detected
        false, other = self.false_reports, self.mislabelled
        mistakes = f"{false} false reports of a target, {other} other mistakes"
        number = len(self.labels)
        rows = [("objects", f"{detected} of {total} detected, {number} reports; {mistakes}")]
        for each in self.labels:
            x, y = each["place"]
            where = f"({x:.1f}, {y:.1f}) m after {each['reported_at']:.1f} s"
            known = "" if each["is_true"] else f", but it is: {each['true_label']}"
            rows.append(
                (f"  {each['label']}", f"{where}, {100 * each['probability']:.0f} %{known}")
            )
        return rows


@dataclasses.dataclass(frozen=True)
class ObjectReport(PartReport):
    """Objects of N slots and C classes, and what the robot knew of them at the end.

    Args:
        classes: names of the classes.
        target: number of the class of the targets.
        place: (N, 2) true positions, the targets first [m].
        label: (N,) numbers of the true classes.
        probability: (N, C) probability of each class in the belief.
        detected_at: (N,) times of the first detection [s]; infinite if there was none.
        looks: (N,) number of looks that counted.
        reported_at: (N, C) time at which each class was first certain [s]; infinite if it never
            was.
        reported_probability: (N, C) its probability then.
    """

    name: ClassVar[str] = Recognition.name

    classes: tuple[str, ...]
    target: int
    place: np.ndarray
    label: np.ndarray
    probability: np.ndarray
    detected_at: np.ndarray
    looks: np.ndarray
    reported_at: np.ndarray
    reported_probability: np.ndarray

    def move(self, offset: np.ndarray) -> "ObjectReport":
        """Return the report with an offset (2,) [m] added to all positions."""
        return dataclasses.replace(self, place=move_points(self.place, offset))

    @property
    def class_colours(self) -> list[tuple[int, int, int]]:
        """Colour of each class; that of the targets is the colour of targets."""
        others = [number for number in range(len(self.classes)) if number != self.target]
        ranks = {number: rank for rank, number in enumerate(others)}
        return [
            OTHERS[ranks[number] % len(OTHERS)] if number in ranks else TARGET
            for number in range(len(self.classes))
        ]

    @property
    def is_false(self) -> np.ndarray:
        """Whether each object (N,) is no target and was reported as one."""
        is_reported = np.isfinite(self.reported_at[:, self.target])
        return np.asarray(is_reported & (self.label != self.target))

    def metrics(self, run: MissionData) -> ObjectMetrics:
        """Compute the metrics."""
        found = np.argwhere(np.isfinite(self.reported_at))
        times = self.reported_at[tuple(found.T)]
        rows = [
            {
                "label": self.classes[label],
                "place": [round(float(each), 2) for each in self.place[row]],
                "reported_at": round(float(self.reported_at[row, label]), 2),
                "probability": round(float(self.reported_probability[row, label]), 4),
                "true_label": self.classes[int(self.label[row])],
                "is_true": bool(self.label[row] == label),
            }
            for row, label in found[np.argsort(times, kind="stable")]
        ]
        false = int(self.is_false.sum())
        some = np.maximum(self.probability.astype(np.float64), 1e-300)
        return ObjectMetrics(
            num_objects=len(self.label),
            objects_detected=int(np.isfinite(self.detected_at).sum()),
            false_reports=false,
            mislabelled=sum(not each["is_true"] for each in rows) - false,
            class_entropy=float(-(some * np.log(some)).sum()),
            labels=rows,
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the objects with their true labels, and the probability of each class."""
        return {
            "objects": self.place,
            "object_labels": self.label,
            "object_classes": self.probability,
            "class_names": np.asarray(self.classes, np.str_),
        }

    def marks(self, frame: Any) -> list[tuple[np.ndarray, Colour]]:
        """Return the place and a colour of each object that was detected by the time of a frame.

        The colour is that of the most probable class, the paler the less certain it is. Targets
        that were found are left out: they are drawn as such.
        """
        colours, is_found = self.class_colours, self.is_found(frame)
        shares = ((row, known, float(np.max(known)) ** 2) for row, known in self._rows(frame))
        return [
            (self.place[row], blend(colours[int(np.argmax(known))], FREE, share))
            for row, known, share in shares
            if np.isfinite(known).all() and not is_found[row]
        ]

    def is_found(self, frame: MissionFrame) -> np.ndarray:
        """Return which objects (N,) are targets that were found by the time of a frame."""
        found = frame.parts.get(TargetReport.name, {"is_found": np.zeros(0, bool)})["is_found"]
        return np.append(np.asarray(found, bool), np.zeros(len(self.label) - len(found), bool))

    def _rows(self, frame: MissionFrame) -> list[tuple[int, np.ndarray]]:
        return list(enumerate(frame.parts[self.name]["classes"]))

    def legend(self) -> list[Entry]:
        """Return the entries of objects and of the classes that they may be taken for."""
        entries = [
            Entry(name, colour, "disc", INK)
            for name, colour in zip(self.classes, self.class_colours, strict=True)
        ]
        if (self.label != self.target).any():
            entries.insert(0, Entry("other object", PALE))
        if self.is_false.any():
            entries.append(Entry("false report", ALARM, "cross"))
        return entries

    def colours(self) -> list[Colour]:
        """Return the colours of the classes, and of a false report."""
        return [ALARM, *(each for each in self.class_colours if each != TARGET)]

    def draw(
        self, surface: Surface, draw: ImageDraw.ImageDraw, run: MissionData, frame: Any
    ) -> None:
        """Draw what the robot knows of each object in a frame.

        An object other than a target is a square. Beside an object that was detected is a badge: a
        disc that is filled as far as the class is certain, in the colour of the most probable
        class. A target that was found has no badge. What was reported as a target and is none is
        crossed out.
        """
        colours, unit = self.class_colours, surface.unit
        is_found = self.is_found(frame)
        reported = self.is_false & (self.reported_at[:, self.target] <= frame.time)
        for (row, known), middle in zip(self._rows(frame), surface.pixels(self.place), strict=True):
            if self.label[row] != self.target:
                _draw_square(draw, middle, unit)
            if np.isfinite(known).all() and not is_found[row]:
                best = int(np.argmax(known))
                _draw_badge(draw, middle, unit, float(known[best]), colours[best])
            if reported[row]:
                for arm in (np.array([7.0, 7.0]), np.array([7.0, -7.0])):
                    ends = [tuple(middle - arm * unit), tuple(middle + arm * unit)]
                    draw.line(ends, ALARM, round(2.5 * unit))

    def add_to_map(self, axes: "Axes", run: MissionData, window: Window) -> None:
        """Draw the objects that are no targets, and how certain their class is.

        Each has the marker and the colour of its most probable class. What was reported as a target
        is labelled as false.
        """
        places = window.place(self.place) + window.corner
        colours, best = self.class_colours, np.argmax(self.probability, axis=1)
        is_found = np.isfinite(self.reported_at[:, self.target])
        is_target = self.label == self.target
        is_shown = ~(is_target & is_found) & np.isfinite(self.detected_at)
        others = [number for number in range(len(self.classes)) if number != self.target]
        for number, name in enumerate(self.classes):
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
            words = f"{self.classes[best[row]]} {100 * self.probability[row, best[row]]:.0f} %"
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
        unseen = ~is_target & ~np.isfinite(self.detected_at)
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
