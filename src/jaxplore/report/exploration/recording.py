"""The recording of an exploration run."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from jaxplore.maps.files.ros import write_map
from jaxplore.report.exploration.animation import compute_palette, frame_image, painter
from jaxplore.report.exploration.data import TEAM, ExplorationData, ExplorationFrame
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.members import members_figure
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.plots import coverage_figure, map_figure
from jaxplore.report.exploration.progress import is_known_map, progress
from jaxplore.report.recording import Course, Recording, find_known_cells

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EXPLORED = "explored.yaml"
"""File of the explored map in a run folder."""


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class ExplorationRecording(ExplorationData, Recording):
    """A finished exploration run, by one robot or several.

    Its folder has `map.png`, the explored map for ROS's `map_server` (`explored.yaml` and
    `explored.pgm`) and `exploration.gif`; `coverage.png` unless the map was known in
    advance; `members.png` if the controller has several members; and the figures of parts.
    """

    animation = "exploration.gif"

    def metrics(self, *, seed: int | None = None) -> ExplorationMetrics:
        """Compute the metrics of the run."""
        return compute_metrics(self, seed=seed)

    def course(self) -> Course:
        """Return what a comparison on several maps shows of the run."""
        _, coverage, entropy, path = progress(self)
        places = np.stack([each.positions for each in self.robots])
        return Course(coverage, path, places, entropy, find_known_cells)

    def frame_image(self, frame: ExplorationFrame, *, scale: float = 1.0) -> Image.Image:
        """Draw a frame as in the animation."""
        return frame_image(self, frame, scale=scale)

    def painter(self, scale: float = 1.0) -> Callable[[ExplorationFrame], Image.Image]:
        """Return a function that draws frames."""
        return painter(self, scale)

    def palette(self, pictures: Sequence[Image.Image]) -> Image.Image:
        """Compute the palette that all frames share."""
        return compute_palette(self, pictures)

    def figures(self) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures, by file name without suffix."""
        draw = {"map": map_figure}
        # Each figure shows what the task is judged by: the coverage of a map that is known in
        # advance says nothing.
        if not is_known_map(self):
            draw["coverage"] = coverage_figure
        if self.records.members is not None:
            draw["members"] = members_figure
        return {**{name: partial(each, self) for name, each in draw.items()}, **self.part_figures()}

    def files(self) -> dict[str, Callable[[Path], None]]:
        """Return a function that writes the explored map as a ROS map of three values: occupied,
        free, unknown."""
        return {EXPLORED: self._write_explored}

    def _write_explored(self, path: Path) -> None:
        origin = np.asarray(self.origin, np.float64).tolist()
        write_map(path, self.belief, self.resolution, origin)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of `arrays.npz`: plain arrays, no pickles.

        Each field of `ExplorationRecord` under its name, one row per step; `time` (N + 1,) [s] and
        `positions` (N + 1, 2) [m] with the start: step k leads from row k to row k + 1, and its
        coverage and entropy were measured at `time[k]`; `world` and `belief` (H, W) probabilities
        and `reachable` (H, W); `origin` [m, m, rad], `resolution` [m], `control_period` [s],
        `start` and `state_names`. Of N robots `positions` are (N, steps + 1, 2).

        Where they exist: `stop` of a robot with a guard; each field of `Members` as
        `members_NAME`, one row per step, with `member_names`; each field of the record of a part
        under its name, and `PartReport.arrays`; `elevation` (H, W) [m] and
        `traversable` (H, W) of the ground; `mover_radii` (M,) [m]; `footprint` (4, 2) corners of a
        rectangular robot [m]; of a robot that localised itself, `true_poses` and `estimated_poses`
        (N, 3) of its stored scans and the map `reference` (H, W) of the same scans at the true
        poses. Of N robots these names end with the number of the robot, as `true_poses_1`, and
        `radii` (N,) [m] takes the place of `footprint`.
        """
        time, *_ = progress(self)
        steps = {name: rows for name, rows in self.records._asdict().items() if rows is not None}
        members = steps.pop("members", None)
        steps |= self.part_arrays(steps.pop("parts"))
        if members is not None:
            steps |= {f"members_{name}": rows for name, rows in members._asdict().items()}
            steps["member_names"] = np.asarray(self.member_names, np.str_)
        optional: dict[str, Any] = {
            "elevation": self.elevation,
            "traversable": self.traversable,
            "mover_radii": self.mover_radii,
        }
        is_one = TEAM not in self.parts
        optional |= {"footprint": self.footprint} if is_one else {"radii": self.radii}
        for each in self.robots:
            end, found = "" if is_one else f"_{each.number + 1}", each.localisation
            if found is not None:
                optional |= {
                    f"true_poses{end}": found.true_poses,
                    f"estimated_poses{end}": found.poses,
                    f"reference{end}": found.reference,
                }
        return {
            **{name: np.asarray(rows) for name, rows in steps.items()},
            "time": time,
            "positions": self.positions if is_one else self.trails,
            "world": self.world,
            "belief": self.belief,
            "reachable": self.reachable,
            "origin": self.origin,
            "resolution": np.asarray(self.resolution),
            "control_period": np.asarray(self.control_period),
            "start": self.start,
            "state_names": np.asarray(self.state_names, np.str_),
            **{name: each for name, each in optional.items() if each is not None and len(each)},
        }
