"""The recording of an exploration by a fleet."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from jaxplore.maps.files.ros import write_map
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.fleet.animation import compute_palette, frame_image, painter
from jaxplore.report.fleet.data import FleetData, FleetFrame
from jaxplore.report.fleet.metrics import FleetMetrics, compute_metrics
from jaxplore.report.fleet.plots import coverage_figure, map_figure
from jaxplore.report.recording import Course, Recording, find_known

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXPLORED = "explored.yaml"
"""File of the explored map in a run folder."""


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class FleetRecording(FleetData, Recording):
    """A finished exploration by a fleet.

    Its folder has `map.png`, `fleet.gif`, and what the robots know together for ROS's `map_server`
    (`explored.yaml` and `explored.pgm`); `coverage.png` unless the map was known in advance; and
    the figures of parts.
    """

    animation = "fleet.gif"

    def metrics(self, *, seed: int | None = None) -> FleetMetrics:
        """Compute the metrics of the run."""
        return compute_metrics(self, seed=seed)

    def course(self) -> Course:
        """Return what a comparison on several maps shows of the run."""
        return Course(self.coverage, self.lengths.sum(axis=0), self.trails, known=find_known)

    def frame_image(self, frame: FleetFrame, *, scale: float = 1.0) -> Image.Image:
        """Draw a frame as in the animation."""
        return frame_image(self, frame, scale)

    def painter(self, scale: float = 1.0) -> Callable[[FleetFrame], Image.Image]:
        """Return a function that draws frames."""
        return painter(self, scale)

    def palette(self, pictures: Sequence[Image.Image]) -> Image.Image:
        """Compute the palette that all frames share."""
        return compute_palette(self, pictures)

    def figures(self) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures, by file name without suffix."""
        draw: dict[str, Callable[[Any], Figure]] = {"map": map_figure}
        # As of one robot: each figure shows what the task is judged by.
        if not is_known_map(self):
            draw["coverage"] = coverage_figure
        return {**{name: partial(each, self) for name, each in draw.items()}, **self.part_figures()}

    def files(self) -> dict[str, Callable[[Path], None]]:
        """Return a function that writes the explored map as a ROS map of three values."""
        return {EXPLORED: self._write_explored}

    def _write_explored(self, path: Path) -> None:
        origin = np.asarray(self.origin, np.float64).tolist()
        write_map(path, self.belief, self.resolution, origin)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of `arrays.npz`: plain arrays, no pickles.

        Each field of `FleetRecord` under its name, one row per step; `time` (steps + 1,) [s],
        `positions` (N, steps + 1, 2) [m] of each robot, `world` and `belief` (H, W) probabilities,
        `beliefs` (N, H, W) in 256 levels, `reachable` (H, W), `origin`, `resolution`,
        `control_period`, `start`, `state_names`, `radii` (N,) [m] and `targets` (M, 2) [m]; each
        field of the record of a part, and `PartReport.arrays`.
        Where the robots found their poses also `true_poses_1` and `estimated_poses_1` (K, 3) of the
        first robot at its stored scans, and so on.
        """
        steps = super().arrays()
        del steps["parts"]
        return {
            **steps,
            **self.part_arrays(self.records.parts),
            "positions": self.trails,
            "world": self.world,
            "belief": self.belief,
            "beliefs": self.beliefs,
            "reachable": self.reachable,
            "origin": self.origin,
            "resolution": np.asarray(self.resolution),
            "start": self.start,
            "state_names": np.asarray(self.state_names, np.str_),
            "radii": self.radii,
            "targets": self.targets,
            **self._place_arrays(),
        }

    def _place_arrays(self) -> dict[str, np.ndarray]:
        """Return the poses at the stored scans of each robot i, if they found them."""
        found = {}
        for number, each in enumerate(self.localisation or (), start=1):
            found[f"true_poses_{number}"] = each.true_poses
            found[f"estimated_poses_{number}"] = each.poses
        return found
