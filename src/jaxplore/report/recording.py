"""The protocol of a recording: the data of a run in NumPy, its metrics, figures and animation.

A scenario (`jaxplore.simulation`) makes the recording. Saving, comparison, tuning and drawing use
this protocol only and do not depend on the kind of task.
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from PIL import Image

from jaxplore import _kinds
from jaxplore.maps.datum import move_points
from jaxplore.report.compute import Timing as Timing
from jaxplore.report.compute import compute_cost, software
from jaxplore.report.drawing.film import (
    FilmOptions,
    add_caption,
    check_film,
    describe_speed,
    evenly_chosen,
    write_film,
)
from jaxplore.report.drawing.palette import fit_palette
from jaxplore.report.metrics import Metrics

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True)
class Frame:
    """A snapshot of a run, for drawing.

    Args:
        step: number of steps before it.
        time: time since the start [s].
    """

    step: int
    time: float

    places: ClassVar[tuple[str, ...]] = ()
    """Fields that are positions (..., 2) [m]."""

    def move[F: "Frame"](self: F, offset: np.ndarray, state_names: Sequence[str]) -> F:
        """Return the frame with an offset (2,) [m] added to all positions, and to a `state`.

        Args:
            offset: the offset; with one of zero nothing changes.
            state_names: names of the components of the robot's state.
        """
        if not offset.any():
            return self
        changed: dict[str, Any] = {
            name: move_points(getattr(self, name), offset) for name in self.places
        }
        if hasattr(self, "state"):
            changed["state"] = move_states(self.state, offset, state_names)
        return dataclasses.replace(self, **changed)


def move_states(states: np.ndarray, offset: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return states (..., nx) with an offset (2,) [m] added to x and y of each robot, if any."""
    for own in robot_columns(names).values():
        if "x" in own and "y" in own:
            states = move_points(states, offset, (own["x"], own["y"]))
    return states


def robot_columns(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return for each robot the columns of a state (nx,) by the names of its components.

    Of several robots the names end with their numbers, as `Formation` gives them: `x_1`, `y_2`.
    """
    if "x" in names or "x_1" not in names:
        return {"": {name: column for column, name in enumerate(names)}}
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        own, _, number = name.rpartition("_")
        found.setdefault(number, {})[own] = column
    return found


def move_records(records: Any, offset: np.ndarray, names: Sequence[str]) -> Any:
    """Return records of steps with an offset (2,) [m] added to their states, if they have any."""
    if not (offset.any() and hasattr(records, "state")):
        return records
    return records._replace(state=move_states(records.state, offset, names))


class LiveCurves(NamedTuple):
    """Curves over time that a live view plots beside the picture of a run.

    Args:
        title: title of the plot; it tells the unit.
        names: name of each of the C curves.
        values: (C, N) value of each at the N steps that the data have.
    """

    title: str
    names: tuple[str, ...]
    values: np.ndarray


class Course(NamedTuple):
    """What a comparison on several maps shows of a run, at the beginning of each step and its end.

    Args:
        done: (N + 1,) share of the task that is done: what is known of a map, or driven of a path.
        path: (N + 1,) distance that all robots have travelled [m].
        positions: (R, N + 1, 2) positions of the robots [m].
        entropy: (N + 1,) entropy of the belief [nat]; None without one.
        known: function of a frame that returns the cells (H, W) that were known then; None if all
            were from the beginning.
    """

    done: np.ndarray
    path: np.ndarray
    positions: np.ndarray
    entropy: np.ndarray | None = None
    known: Callable[[Any], np.ndarray] | None = None


def find_known_cells(frame: Any) -> np.ndarray:
    """Return the cells (H, W) that the `probability` of a frame knows: `4 p (1 - p) <= 1/2`."""
    p = frame.probability / 255.0
    return np.asarray(4.0 * p * (1.0 - p) <= 0.5)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunData:
    """Data that the recordings of all tasks share: the records of N steps, a NamedTuple of the
    scenario with a leading axis; evenly spaced snapshots, the last one at the end; the period of
    controls [s]. The data of a run that the user stopped end there."""

    records: Any
    frames: tuple[Any, ...]
    timing: Timing
    control_period: float
    is_interrupted: bool

    @property
    def num_steps(self) -> int:
        """Number of steps, N."""
        return len(self.records[0])

    @property
    def time(self) -> np.ndarray:
        """Times (N + 1,) of the start and of the end of each step [s]."""
        return np.arange(self.num_steps + 1) * self.control_period

    @property
    def live_curves(self) -> "LiveCurves | None":
        """What a live view plots over time; None by default."""
        return None

    def move[R: "RunData"](self: R, offset: np.ndarray) -> R:
        """Return the data with an offset (2,) [m] added to all positions but those of the frames.

        These have `Frame.move`.
        """
        if not offset.any():
            return self
        return dataclasses.replace(self, **self.move_fields(offset))

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that are or have positions, with an offset added; none by default."""
        return {}

    def common_metrics(self, *, finished_at: float | None, seed: int | None) -> dict[str, Any]:
        """Compute the fields of all `Metrics`; `finished_at` [s] is None for an unfinished task."""
        return {
            "duration": self.num_steps * self.control_period,
            "num_steps": self.num_steps,
            "is_finished": finished_at is not None,
            "finished_at": finished_at,
            "is_interrupted": self.is_interrupted,
            "compute": compute_cost(self.timing, self.control_period),
            "seed": seed,
            "versions": software(),
        }


class Recording(RunData, abc.ABC):
    """The recording of a run.

    A new kind of task implements `metrics` and `frame_image`; the other methods have defaults.
    """

    animation: ClassVar[str] = "animation.gif"
    """File name of the animation in a run folder."""

    def __repr__(self) -> str:
        ended = ", interrupted" if self.is_interrupted else ""
        return (
            f"{type(self).__name__}({self.num_steps} steps of {self.control_period:g} s, "
            f"{len(self.frames)} frames{ended})"
        )

    @abc.abstractmethod
    def metrics(self, *, seed: int | None = None) -> Metrics:
        """Compute the metrics of the run.

        Args:
            seed: seed of the run, to be noted.
        """

    def course(self) -> Course | None:
        """Return what a comparison on several maps shows of the run; None by default."""
        return None

    @abc.abstractmethod
    def frame_image(self, frame: Any, *, scale: float = 1.0) -> Image.Image:
        """Draw one of the frames.

        Args:
            frame: the frame.
            scale: factor on the size of the picture.
        """

    def painter(self, scale: float = 1.0) -> Callable[[Any], Image.Image]:
        """Return a function that draws frames: `frame_image`, unless frames share computations.

        Args:
            scale: factor on the size of the pictures.
        """
        return partial(self.frame_image, scale=scale)

    def palette(self, pictures: Sequence[Image.Image]) -> Image.Image:
        """Compute the palette of a GIF from some of its pictures."""
        return fit_palette((), pictures)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of `arrays.npz`: plain arrays, no pickles.

        By default each field of the records under its name, one row per step, `time` (N + 1,) [s]
        and `control_period` [s].
        """
        given = self.records._asdict()
        rows = {name: np.asarray(values) for name, values in given.items() if values is not None}
        return {**rows, "time": self.time, "control_period": np.asarray(self.control_period)}

    def figures(self) -> Mapping[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures of the run folder, by file name without suffix."""
        return {}

    def files(self) -> Mapping[str, Callable[[Path], None]]:
        """Return functions that write more files of the run folder, by file name.

        A function gets the path of its file, and may write others beside it.
        """
        return {}

    def write_animation(
        self,
        path: str | PathLike[str],
        options: FilmOptions | None = None,
        *,
        title: str = "",
        on_progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        """Write the run as a film: a GIF that plays in browsers and in a README, or an MP4 video.

        Its caption says how many times as fast as the run it plays.

        Args:
            path: file to write, which ends in .gif or .mp4; one that exists is replaced.
            options: frames per second, size and number of frames; the defaults when absent.
            title: text in the caption, such as the name of a variant.
            on_progress: called with the share that is done, from 0 to 1.

        Raises:
            ValueError: another kind of file, one that cannot be written, or a missing
                `imageio-ffmpeg` for an MP4.
        """
        options = FilmOptions() if options is None else options
        _kinds.instance("film", options, FilmOptions)
        suffix = check_film(path, options).suffix.lower()
        frames = evenly_chosen(self.frames, options.max_frames)
        speed = describe_speed(options.speed([frame.time for frame in frames], suffix))
        draw, scale = self.painter(options.scale), options.scale
        write_film(
            path,
            frames,
            lambda frame: add_caption(draw(frame), scale, title, speed),
            self.palette,
            options,
            on_progress,
        )
