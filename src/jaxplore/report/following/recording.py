"""The recording of a path-following run."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from jaxplore.report.following.animation import (
    path_frame_image,
    path_painter,
    path_palette,
)
from jaxplore.report.following.data import PathData, PathFrame, speeds
from jaxplore.report.following.metrics import PathMetrics, compute_path_metrics
from jaxplore.report.following.plots import errors_figure, path_figure
from jaxplore.report.recording import Course, LiveCurves, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PathRecording(PathData, Recording):
    """A finished path-following run. Its folder has `path.png`, `errors.png` and
    `following.gif`."""

    animation = "following.gif"

    @property
    def live_curves(self) -> LiveCurves:
        """The speed after each step."""
        return LiveCurves("speed [m/s]", ("speed",), speeds(self)[None, 1:])

    def metrics(self, *, seed: int | None = None) -> PathMetrics:
        """Compute the metrics of the run."""
        return compute_path_metrics(self, seed=seed)

    def course(self) -> Course:
        """Return what a comparison on several paths shows of the run: the share that is driven."""
        driven = (self.progress - self.start_progress) / max(self.end - self.start_progress, 1e-6)
        steps = np.linalg.norm(np.diff(self.positions.astype(np.float64), axis=0), axis=1)
        path = np.concatenate([[0.0], np.cumsum(steps)])
        return Course(np.clip(driven, 0.0, 1.0), path, self.positions[None])

    def frame_image(self, frame: PathFrame, *, scale: float = 1.0) -> Image.Image:
        """Draw a frame as in the animation."""
        return path_frame_image(self, frame, scale=scale)

    def painter(self, scale: float = 1.0) -> Callable[[PathFrame], Image.Image]:
        """Return a function that draws frames."""
        return path_painter(self, scale)

    def palette(self, pictures: Sequence[Image.Image]) -> Image.Image:
        """Compute the palette that all frames share."""
        return path_palette(pictures)

    def figures(self) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures, by file name without suffix."""
        return {"path": partial(path_figure, self), "errors": partial(errors_figure, self)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of `arrays.npz`: plain arrays, no pickles.

        Each field of `PathRecord` under its name, one row per step, but `progress` (N + 1,) [m]
        with the start, like `time` (N + 1,) [s] and `positions` (N + 1, 2) [m]; `centre` (P, 2) of
        the path and `edges` (2, P, 2) of its corridor [m], if it has one; `length` [m], `end` [m],
        `control_period` [s], `start` and `state_names`.
        """
        steps = {name: np.asarray(rows) for name, rows in self.records._asdict().items()}
        edges = {"edges": self.edges} if len(self.edges) else {}
        return {
            **steps,
            "progress": self.progress,
            "time": self.time,
            "positions": self.positions,
            "centre": self.centre,
            **edges,
            "length": np.asarray(self.length),
            "end": np.asarray(self.end),
            "control_period": np.asarray(self.control_period),
            "start": self.start,
            "state_names": np.asarray(self.state_names, np.str_),
        }
