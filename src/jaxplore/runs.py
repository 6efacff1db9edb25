"""Simulate, judge and save in three lines."""

import abc
import contextlib
import dataclasses
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, TextColumn

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.report.comparison import Comparison, check_names
from jaxplore.report.exploration.metrics import Metrics, compute_metrics
from jaxplore.report.exploration.save import save_recording
from jaxplore.report.following.metrics import PathMetrics, compute_path_metrics
from jaxplore.report.following.save import save_path_recording
from jaxplore.simulation import simulate as simulation
from jaxplore.simulation.exploration.scenario import Scenario
from jaxplore.simulation.following.follow import PathProgress, PathRecording, record_path_run
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.recording import Recording


class Saved(abc.ABC):
    """What is written into a run folder."""

    @abc.abstractmethod
    def _write(self, path: str | os.PathLike[str], **options: Any) -> None:
        """Write it, with the options of `save_recording`."""

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        animation: bool = True,
        settings: Mapping[str, object] | None = None,
        progress: bool = False,
    ) -> None:
        """Write a run folder: metrics.json, arrays.npz, pictures and an animation.

        The folder appears complete or not at all.

        Args:
            path: the folder.
            overwrite: replace a run folder that is there.
            animation: draw one.
            settings: written to settings.yaml, from which the command line repeats the run.
            progress: show how far the drawing is.

        Raises:
            ValueError: the folder exists, or cannot be written.
        """
        with progress_bar("drawing", enabled=progress and animation) as advance:
            self._write(
                path,
                settings=settings,
                animation=animation,
                overwrite=overwrite,
                on_progress=lambda share: advance(share, ""),
            )


@dataclasses.dataclass(frozen=True)
class Run(Saved):
    """A finished run; its folder has map.png, coverage.png and exploration.gif.

    Args:
        recording: every step, and looks at the run.
        metrics: what came of it.
    """

    recording: Recording
    metrics: Metrics

    def _write(self, path: str | os.PathLike[str], **options: Any) -> None:
        save_recording(self.recording, self.metrics, path, **options)


def simulate(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    key: Key,
    progress: bool = False,
    num_trajectories: int = simulation.NUM_TRAJECTORIES,
) -> Run:
    """Simulate until the target coverage is reached or the steps are done.

    The closed loop is one compiled program, run in chunks of half a simulated second. Ctrl-C ends
    the run after the current chunk and returns what was done.

    Args:
        controller: decides; it is told the scenario's control rate.
        scenario: where and how.
        num_steps: at most, in control periods of the scenario.
        key: the same key gives the same run.
        progress: show coverage, speed and time left.
        num_trajectories: rollouts in each look at the run, for the animation. 0 for no plans in it,
            which saves compiling the controller a second time, to look into it.

    Raises:
        ValueError: a number of steps < 1, or of rollouts < 0.
    """
    with progress_bar("exploring", enabled=progress) as advance:

        def show(now: simulation.Progress) -> None:
            speed = now.time / max(now.seconds, 1e-9)
            left = (now.time_limit - now.time) / speed
            advance(
                now.time / now.time_limit,
                f"{now.time:4.0f} of {now.time_limit:.0f} s  coverage {now.coverage:6.1%}  "
                f"{speed:4.1f} x real time  at most {left:3.0f} s left",
            )

        recording = simulation.record_run(
            controller,
            scenario,
            num_steps,
            key=key,
            on_progress=show,
            num_trajectories=num_trajectories,
        )
    return Run(recording, compute_metrics(recording, seed=_seed(key)))


@dataclasses.dataclass(frozen=True)
class PathRun(Saved):
    """A finished run along a path; its folder has path.png, errors.png and following.gif.

    Args:
        recording: every step, and looks at the run.
        metrics: what came of it.
    """

    recording: PathRecording
    metrics: PathMetrics

    def _write(self, path: str | os.PathLike[str], **options: Any) -> None:
        save_path_recording(self.recording, self.metrics, path, **options)


def follow_path(
    controller: Controller,
    scenario: PathScenario,
    num_steps: int,
    *,
    key: Key,
    progress: bool = False,
    num_trajectories: int = simulation.NUM_TRAJECTORIES,
) -> PathRun:
    """Simulate a robot along a path until its end is reached or the steps are done.

    The closed loop is one compiled program, run in chunks of half a simulated second. Ctrl-C ends
    the run after the current chunk and returns what was done.

    Args:
        controller: decides, such as the `planner.mppi` of `mpcc`; it is told the scenario's control
            rate. Its belief are the `Obstacles` that the robot knows of; None without any.
        scenario: where and how.
        num_steps: at most, in control periods of the scenario.
        key: the same key gives the same run.
        progress: show the way passed, speed and time left.
        num_trajectories: rollouts in each look at the run, for the animation; with 0 there are no
            plans in it.

    Raises:
        ValueError: a number of steps < 1, or of rollouts < 0.
    """
    with progress_bar("following", enabled=progress) as advance:

        def show(now: PathProgress) -> None:
            speed = now.time / max(now.seconds, 1e-9)
            left = (now.time_limit - now.time) / speed
            share = max(now.progress / now.end, now.time / now.time_limit)
            advance(
                min(max(share, 0.0), 1.0),
                f"{now.time:4.0f} of {now.time_limit:.0f} s  {now.progress:6.1f} of {now.end:.1f} m"
                f"  {speed:4.1f} x real time  at most {left:3.0f} s left",
            )

        recording = record_path_run(
            controller,
            scenario,
            num_steps,
            key=key,
            on_progress=show,
            num_trajectories=num_trajectories,
        )
    return PathRun(recording, compute_path_metrics(recording, seed=_seed(key)))


def _seed(key: Key) -> int:
    return int(np.asarray(jax.random.key_data(key)).reshape(-1)[-1])


def compare(
    experiments: Mapping[str, tuple[Controller, Scenario, int]],
    seeds: Sequence[int],
    *,
    progress: bool = False,
) -> Comparison:
    """Run several controllers with the same seeds.

    Seed by seed, so that Ctrl-C leaves as many runs of each controller, and what was done is kept.

    Args:
        experiments: by name, what `simulate` takes: controller, scenario, number of steps.
        seeds: of the runs.
        progress: show how far it is.

    Raises:
        ValueError: nothing to compare, no seeds, a seed twice, a name that is no file's.
    """
    if not experiments:
        raise ValueError("experiments is empty; accepted: at least one controller")
    check_names(experiments)
    if not seeds or len(set(seeds)) != len(seeds):
        raise ValueError(f"seeds is {list(seeds)}; accepted: different whole numbers, at least one")
    runs: dict[str, list[Metrics]] = {name: [] for name in experiments}
    recordings: dict[str, Recording] = {}
    total, done, is_interrupted = len(seeds) * len(experiments), 0, False
    with progress_bar("comparing", enabled=progress) as advance:
        began = time.perf_counter()
        for seed in seeds:
            for name, (controller, scenario, num_steps) in experiments.items():
                left = (time.perf_counter() - began) / done * (total - done) if done else math.nan
                advance(
                    done / total,
                    f"{name}, seed {seed}, run {done + 1} of {total}"
                    + (f", about {left:.0f} s left" if done else ""),
                )
                # Also where Ctrl-C is not waited for, while something compiles.
                with contextlib.suppress(KeyboardInterrupt):
                    recording = simulation.record_run(
                        controller, scenario, num_steps, key=jax.random.key(seed)
                    )
                    if not recording.is_interrupted:
                        runs[name].append(compute_metrics(recording, seed=seed))
                        recordings.setdefault(name, recording)
                        done += 1
                        continue
                is_interrupted = True
                break
            if is_interrupted:
                break
        if not is_interrupted:
            advance(1.0, f"{total} runs")
    return Comparison(
        {name: tuple(metrics) for name, metrics in runs.items()}, recordings, is_interrupted
    )


@contextmanager
def progress_bar(label: str, *, enabled: bool) -> Iterator[Callable[[float, str], None]]:
    """Yield a function that shows a share done and a text; on a terminal as a bar."""
    if not enabled:
        yield lambda share, text: None
        return
    console = Console(stderr=True)
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[text]}"),
    ]
    with Progress(*columns, console=console) as bars:
        task = bars.add_task(label, total=1.0, text="")
        yield lambda share, text: bars.update(task, completed=share, text=text)
