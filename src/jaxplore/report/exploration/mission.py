"""Data of a run on a map, by a robot or a fleet, and of what it looks for beside the map."""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxplore.maps.datum import move_points
from jaxplore.report.of_parts import PartsData
from jaxplore.report.recording import Frame


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissionFrame(Frame):
    """A snapshot of what was found so far: arrays of each part that has any, by its name."""

    parts: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class MissionData(PartsData):
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

    @property
    @abc.abstractmethod
    def last_positions(self) -> np.ndarray:
        """Positions (N, 2) of all robots at the end [m]."""

    def move_mission(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that have positions, with an offset (2,) [m] added."""
        return {"origin": move_points(self.origin, offset), "parts": self.move_parts(offset)}
