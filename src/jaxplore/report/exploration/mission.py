"""Data of a run on a map, by a robot or a fleet, and of what it looks for beside the map."""

import abc
import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxplore.maps.datum import move_points
from jaxplore.report.recording import Frame, RunData


class AnomalyData(NamedTuple):
    """What differs from the known map, and what the robot found of it.

    Args:
        boxes: (P, 4) rectangles (x_min, y_min, x_max, y_max) of what differs [m].
        kinds: (P,) kinds, the keys of `parts.anomaly_reports.KIND_NAMES`.
        place: (R, 2) places that the robot suspected [m].
        kind: (R,) their kinds.
        suspected: (R,) times of the suspicions [s].
        reported: (R,) times of the reports [s]; infinite without a second look.
        num_cleared: number of suspicions that the second look did not confirm.
    """

    boxes: np.ndarray
    kinds: np.ndarray
    place: np.ndarray
    kind: np.ndarray
    suspected: np.ndarray
    reported: np.ndarray
    num_cleared: int


class ObjectData(NamedTuple):
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

    classes: tuple[str, ...]
    target: int
    place: np.ndarray
    label: np.ndarray
    probability: np.ndarray
    detected_at: np.ndarray
    looks: np.ndarray
    reported_at: np.ndarray
    reported_probability: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionFrame(Frame):
    """A snapshot of what was found so far.

    Args:
        is_found: (M,) whether each target was found.
        classes: (N, C) probability of each class of each object; NaN for objects that were not
            detected, (0, 0) without a detector.
    """

    is_found: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, bool))
    classes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class MissionData(RunData):
    """A run on a map, what was looked for beside the map, and what was found of it.

    Args:
        world: (H, W) probability of the true map.
        belief: (H, W) probability of the map at the end; of a fleet what the robots know together.
        reachable: (H, W) cells that count for coverage.
        origin: pose of the grid [m, m, rad].
        resolution: side of a cell [m].
        initial_coverage: coverage before the first step.
        initial_unknown: share of unknown cells among the reachable ones before the first step.
        target_coverage: coverage at which exploration is finished; None if it never is.
        finished_step: number of steps until the scenario was finished; None if it was not, or was
            finished before the first step.
        given_up_step: number of steps until it was given up; None if it was not.
        elevation: (H, W) elevation of the ground [m]; None if it is level.
        traversable: (H, W) cells that may be entered; None if all that are free may.
        targets: (M, 2) positions of the targets [m].
        idleness: (H, W) time since each cell was last seen, at the end [s]; None without an
            idleness map.
        anomalies: what differs from the known map, and what was found of it; None without a test.
        objects: objects and their classes; None without a detector.
    """

    world: np.ndarray
    belief: np.ndarray
    reachable: np.ndarray
    origin: np.ndarray
    resolution: float
    initial_coverage: float
    initial_unknown: float
    target_coverage: float | None
    finished_step: int | None
    given_up_step: int | None = None
    elevation: np.ndarray | None = None
    traversable: np.ndarray | None = None
    targets: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    idleness: np.ndarray | None = None
    anomalies: AnomalyData | None = None
    objects: ObjectData | None = None

    @property
    @abc.abstractmethod
    def last_positions(self) -> np.ndarray:
        """Positions (N, 2) of all robots at the end [m]."""

    def move_mission(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that have positions, with an offset (2,) [m] added."""
        found, objects = self.anomalies, self.objects
        if found is not None:
            boxes = move_points(move_points(found.boxes, offset), offset, (2, 3))
            found = found._replace(boxes=boxes, place=move_points(found.place, offset))
        if objects is not None:
            objects = objects._replace(place=move_points(objects.place, offset))
        moved = {name: move_points(getattr(self, name), offset) for name in ("origin", "targets")}
        return {"anomalies": found, "objects": objects, **moved}
