"""Simulation of a scenario with a controller, for every kind of task."""

import base64
import dataclasses
import html
import io
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS
from jaxplore._types import Count, Key
from jaxplore.control.base import Controller
from jaxplore.maps.lattice_figure import show_in_notebooks
from jaxplore.report.console import progress_bar
from jaxplore.report.drawing.figure import PNG
from jaxplore.report.drawing.film import FPS, SCALE, Film, FilmOptions
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Frame, Recording
from jaxplore.report.recording_arrays import load_run
from jaxplore.report.save import save_run
from jaxplore.simulation.checkpoint import Checkpoint
from jaxplore.simulation.chunks import (
    CHUNK_SECONDS,
    FRAME_SECONDS,
    Chunk,
    ChunkedRun,
    run_in_chunks,
)
from jaxplore.simulation.loop import copy_tree, frame_arrays, initial_loop_state, run_chunk
from jaxplore.simulation.monitor import Monitor, Watch
from jaxplore.simulation.scenario import Scenario, blank_recording
from jaxplore.simulation.state import LoopState

NUM_TRAJECTORIES = 60
"""Number of rollouts in each frame."""

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class RunProgress(NamedTuple):
    """Progress of a run.

    `time` is simulated, and the run ends at `time_limit` at the latest [s]. `share` of the task is
    done, from 0 to 1; `text` says it in words. `seconds` is the wall-clock time since the loop was
    compiled [s].
    """

    time: float
    time_limit: float
    share: float
    text: str
    seconds: float


@dataclasses.dataclass(frozen=True)
class Run:
    """A finished run.

    Args:
        recording: every step, and frames of the run.
        metrics: metrics of the run.
        checkpoint: what `simulate(resume=...)` continues from.
        parameters: parameters of the controller that monitors set during the run, by path, with
            their last values; empty for a run that was loaded. `set_parameters(controller,
            run.parameters)` is the controller at the end.
    """

    recording: Recording
    metrics: Metrics
    checkpoint: Checkpoint | None = None
    parameters: Mapping[str, float | list[float]] = dataclasses.field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Run({self.recording!r})"

    def plot(self, name: str | None = None) -> "Figure":
        """Draw one of the figures of the run folder.

        Args:
            name: name of the figure, such as "map" or "coverage"; the first one when absent.

        Raises:
            ValueError: the run has no figure of that name.
        """
        _kinds.instance("name", name, str, may_be_none=True)
        figures = self.recording.figures()
        chosen = next(iter(figures), "") if name is None else name
        if chosen not in figures:
            raise ValueError(f"name is {name!r}; accepted: {', '.join(figures) or 'none'}")
        return show_in_notebooks(figures[chosen]())

    def _repr_html_(self) -> str:
        """Return the first figure and the metrics, for notebooks."""
        rows = "".join(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>"
            for name, value in self.metrics.rows()
        )
        picture = ""
        if self.recording.figures():
            buffer = io.BytesIO()
            self.plot().savefig(buffer, format="png")
            code = base64.b64encode(buffer.getvalue()).decode()
            picture = f'<img src="data:image/png;base64,{code}">'
        return f"{picture}<table>{rows}</table>"

    @_kinds.check_arguments
    def animate(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        fps: int | float = FPS,
        scale: int | float = SCALE,
        progress: bool = False,
    ) -> Film:
        """Draw the run as a film, which a notebook shows.

        The film plays `T * fps` times as fast as the run, where T is the simulated time between two
        frames [s]; its caption says so.

        Args:
            path: file to write, which ends in .gif or .mp4; one that exists is replaced. When
                absent the film is a GIF and no file is written.
            fps: frames per second of playback, up to 120, in a GIF up to 50.
            scale: factor on the size of the picture, from 0.5 to 4; lines and texts stay sharp.
            progress: whether to show a progress bar.

        Raises:
            ValueError: another kind of file, one that cannot be written, numbers that are not
                accepted, or a missing `imageio-ffmpeg` for an MP4.
        """
        options = FilmOptions(fps=fps, scale=scale)
        with (
            tempfile.TemporaryDirectory() as folder,
            progress_bar("drawing", enabled=_kinds.flag("progress", progress)) as advance,
        ):
            file = Path(folder) / "film.gif" if path is None else Path(path)
            self.recording.write_animation(
                file, options, on_progress=lambda share: advance(share, "")
            )
            return Film(file.read_bytes(), file.suffix.lower())

    @_kinds.check_arguments
    def save(
        self,
        path: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        animation: bool = True,
        film: FilmOptions | None = None,
        figures: str | Sequence[str] = PNG,
        settings: Mapping[str, object] | None = None,
        progress: bool = False,
    ) -> None:
        """Write a run folder: metrics.json, arrays.npz, state.npz, figures and an animation.

        The folder is written completely or not at all. `Run.load` reads it.

        Args:
            path: the folder.
            overwrite: whether to replace a former run folder.
            animation: whether to draw the animation.
            film: frames per second and size of the animation; the defaults when absent.
            figures: formats of the figures: png, pdf or svg, or several, "pdf,svg".
            settings: settings of the run, written to settings.yaml; the command line repeats the
                run from them.
            progress: whether to show a progress bar of the drawing.

        Raises:
            ValueError: the folder exists, or cannot be written; another format of figures.
        """
        for name, value in {
            "overwrite": overwrite,
            "animation": animation,
            "progress": progress,
        }.items():
            _kinds.flag(name, value)
        with progress_bar("drawing", enabled=progress and animation) as advance:
            save_run(
                self.recording,
                self.metrics,
                path,
                settings=settings,
                animation=animation,
                film=film,
                figures=figures,
                overwrite=overwrite,
                on_progress=lambda share: advance(share, ""),
                further=None if self.checkpoint is None else self.checkpoint.arrays(),
            )

    @classmethod
    @_kinds.check_arguments
    def load(cls, path: str | os.PathLike[str]) -> "Run":
        """Read a run folder.

        The run has the metrics, arrays, figures and frames of the one that was saved, and
        `simulate` can resume it. Nothing in the folder is executed.

        Args:
            path: the folder.

        Raises:
            ValueError: a folder that holds no run, is malformed or too large, or holds a run of a
                kind of task whose module was not imported.
        """

        def build(
            recording: Recording, metrics: Metrics, arrays: Mapping[str, np.ndarray]
        ) -> "Run":
            return cls(recording, metrics, Checkpoint.from_arrays(recording, arrays))

        return load_run(path, build)


def simulate(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    key: Key,
    progress: bool = False,
    num_trajectories: int = NUM_TRAJECTORIES,
    resume: Run | None = None,
    monitors: Sequence[Monitor] = (),
) -> Run:
    """Simulate a task until it is finished or the steps are done.

    The closed loop is one compiled program that runs in chunks of half a simulated second. Ctrl-C
    ends the run after the current chunk and returns what was done.

    A run that ended early, by Ctrl-C or at its greatest number of steps, can be continued: give it
    as `resume`, with the same controller, scenario and key. The result is the whole run, equal to
    one that never stopped.

    Args:
        controller: controller; it is adapted to the scenario's control period.
        scenario: the task.
        num_steps: greatest number of control periods, those of `resume` included.
        key: random key; the same key gives the same run.
        progress: whether to show a progress bar with the speed and the time left.
        num_trajectories: rollouts in each frame, for the animation; with 0 the frames show no plan,
            and the controller is not compiled a second time for inspection.
        resume: run to continue; None to start one.
        monitors: live views and recorders that watch the run, and may pause, stop or change it.

    Raises:
        ValueError: fewer than one step, or fewer than 0 rollouts; something else than a controller,
            a scenario, a key or monitors; a run to resume that is finished, has as many steps
            already, or was made with another controller, scenario or key.
    """
    _kinds.flag("progress", progress)
    _kinds.instance("resume", resume, Run, may_be_none=True)
    _kinds.instances("monitors", monitors, Monitor)
    former = None if resume is None else _checkpoint_of(resume)
    with progress_bar("simulating", enabled=progress) as advance:

        def show(now: RunProgress) -> None:
            speed = now.time / max(now.seconds, 1e-9)
            left = (now.time_limit - now.time) / speed
            # A run ends when its task is finished or at the time limit, whichever is nearer.
            share = max(now.share, now.time / now.time_limit)
            advance(
                min(max(share, 0.0), 1.0),
                f"{now.time:4.0f} of {now.time_limit:.0f} s  {now.text}  "
                f"{speed:4.1f} x real time  at most {left:3.0f} s left",
            )

        # With a warm compilation cache the text stands for a second only.
        advance(0.0, "compiling the loop, about 10 s the first time")
        recording, loop, watch = _closed_loop(
            controller, scenario, num_steps, key, show, num_trajectories, former, monitors
        )
    # The last word of a key's data is the seed that `jax.random.key` was given.
    seed = int(np.asarray(jax.random.key_data(key)).reshape(-1)[-1])
    checkpoint = Checkpoint.at_end_of(loop, watch.controller, scenario, key)
    return Run(recording, recording.metrics(seed=seed), checkpoint, watch.parameters)


def _checkpoint_of(run: Run) -> Checkpoint:
    if run.checkpoint is None:
        raise ValueError(
            "resume is a run without the state of its loop; accepted: a run of simulate or Run.load"
        )
    return run.checkpoint


def record_run(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    key: Key,
    on_progress: Callable[[RunProgress], None] = lambda _: None,
    num_trajectories: int = NUM_TRAJECTORIES,
) -> Recording:
    """Simulate like `simulate`, call `on_progress` after each chunk, and return the recording."""
    return _closed_loop(controller, scenario, num_steps, key, on_progress, num_trajectories)[0]


def _closed_loop(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    key: Key,
    on_progress: Callable[[RunProgress], None],
    num_trajectories: int,
    former: Checkpoint | None = None,
    monitors: Sequence[Monitor] = (),
) -> tuple[Recording, ChunkedRun[LoopState, Any, Frame], Watch[LoopState]]:
    """Simulate; return the recording, the loop's result, and the watch with the last controller."""
    order = "in the order simulate(controller, scenario, num_steps)"
    _kinds.instance("controller", controller, Controller, hint=order)
    _kinds.instance("scenario", scenario, Scenario, hint=order)
    _kinds.key("key", key)
    limit = _checks.positive_int("num_steps", num_steps, at_most=MOST_STEPS)
    rollouts = _checks.whole_number("num_trajectories", num_trajectories, at_least=0)
    if former is not None:
        former.check(controller, scenario, key, limit)
    period = scenario.period
    # The preparations compile programs as well, so their time counts as compilation.
    began = time.perf_counter()
    initial = initial_loop_state(controller.at_period(scenario.control_period), scenario, key)
    first = initial if former is None else former.state(scenario, initial)
    capacity = max(1, round(CHUNK_SECONDS / period))
    total = 0 if former is None else former.loop.num_steps

    def adapt(given: Controller) -> Controller:
        return given.at_period(scenario.control_period)

    def make_frame(planner: Controller, current: LoopState, step: int) -> Frame:
        return scenario.make_frame(step, frame_arrays(planner, scenario, current, key, rollouts))

    watch = Watch(monitors, controller, adapt, make_frame, period, total)

    def run(current: LoopState, steps: Count) -> tuple[LoopState, Any, Count]:
        return run_chunk((watch.planner, scenario, key, steps), current, capacity)

    def report(chunk: Chunk[LoopState, Any]) -> int:
        share, text = scenario.progress(chunk.state.task)
        on_progress(RunProgress(chunk.total * period, limit * period, share, text, chunk.seconds))
        if not monitors:
            return capacity
        records = scenario.records_on_map(chunk.records)
        return watch.show_chunk(dataclasses.replace(chunk, records=records), text)

    if monitors:
        frame = make_frame(watch.planner, first, total)
        watch.begin(blank_recording(scenario, controller, first, frame))
    recording = None
    try:
        done = run_in_chunks(
            run,
            lambda current: scenario.is_unfinished(current.task),
            lambda current, step: make_frame(watch.planner, current, step),
            # The first state is read again after the run, or belongs to the user.
            copy_tree(first),
            began=began,
            limit=limit,
            chunk=capacity,
            interval=max(1, round(FRAME_SECONDS / period)),
            on_chunk=report,
            former=None if former is None else former.loop,
            revise=scenario.update_on_host if scenario.steps_per_revision else None,
            revise_every=scenario.steps_per_revision or 0,
        )
        recording = scenario.recording(watch.controller, initial.task, done)
    finally:
        # A recorder closes its file, however the run ended.
        watch.end(recording)
    return recording, done, watch
