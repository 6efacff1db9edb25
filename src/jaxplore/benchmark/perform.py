"""One run of a benchmark, from its task to its row."""

from collections.abc import Callable
from pathlib import Path

import jax

from jaxplore.benchmark.maps import read_grid
from jaxplore.benchmark.rows import Result, Row, failed_row, result_of, row_of
from jaxplore.benchmark.tasks import Task
from jaxplore.experiment.assembly import build
from jaxplore.experiment.parts import robot_of
from jaxplore.report.metrics import compute_metrics
from jaxplore.settings import Settings, make_settings
from jaxplore.simulation.reachability import open_spot
from jaxplore.simulation.simulate import record_run

Perform = Callable[[Task], Row]
"""Makes a run and returns its row. Another process finds it by its module and name."""

MOST_MAPPINGS = 20_000
"""Pieces of memory that a process may map before compiled loops are forgotten: Linux gives it
65530, each loop takes hundreds, and without any left the next compilation crashes."""


def perform(task: Task) -> Row:
    """Make a run and return its row.

    Raises:
        ValueError: settings, a map or a start that are not accepted.
        KeyboardInterrupt: the user stopped the run.
    """
    settings = make_settings(task.entries)
    if settings.start is None:
        settings = make_settings({**task.entries, "start": _open_start(settings)})
    experiment = build(settings)
    recording = record_run(
        experiment.controller,
        experiment.scenario,
        experiment.num_steps,
        key=experiment.key,
        num_trajectories=0,
    )
    if recording.is_interrupted:
        raise KeyboardInterrupt
    metrics = compute_metrics(recording, seed=task.seed)
    where = settings.model_copy(update={"map": task.path})
    return row_of(task, recording, metrics, settings=where)


def result_for(task: Task, make: Perform = perform) -> Result:
    """Return what a task comes to; a row with the error where it comes to nothing.

    Raises:
        KeyboardInterrupt: the user stopped the run.
    """
    _forget_loops()
    try:
        row = make(task)
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        reason = str(error)
        if task.copy is not None:
            # A copy of the map is nothing that anybody could look at afterwards.
            reason = reason.replace(task.copy, task.path)
        row = failed_row(task, kind + reason)
    return result_of(row)


def _open_start(settings: Settings) -> tuple[float, float, float]:
    """Return the most open spot of the map as the run will have it, heading along x."""
    grid = read_grid(settings.map, settings.resolution)
    x, y = open_spot(grid, float(robot_of(settings.robot).radius))
    return x, y, 0.0


def _forget_loops() -> None:
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()  # type: ignore[no-untyped-call]
