"""Runs of a benchmark, from their tasks to their rows."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from jaxplore.build.parts import build_robot
from jaxplore.build.tasks import build
from jaxplore.settings.exploration import Settings, make_exploration_settings
from jaxplore.simulation.batch import record_runs
from jaxplore.simulation.exploration.reachability import open_spot
from jaxplore.simulation.run import record_run
from jaxplore.study.comparison.maps import read_grid
from jaxplore.study.comparison.rows import Result, Row, failed_row, result_of, row_of
from jaxplore.study.comparison.tasks import Batch, Task

Perform = Callable[[Batch], Sequence[Row]]
"""Makes the runs of a batch and returns their rows. Another process finds it by its module and
name."""


def perform(batch: Batch) -> tuple[Row, ...]:
    """Make the runs of a batch, side by side if there are several, and return their rows.

    Raises:
        ValueError: settings, a map or a start that are not accepted.
        KeyboardInterrupt: the user stopped the runs.
    """
    first = batch[0]
    settings = make_exploration_settings(first.entries)
    if settings.start is None:
        settings = make_exploration_settings({**first.entries, "start": _open_start(settings)})
    controller, scenario, num_steps, key = build(settings)
    if first.batch == 1:
        recordings = {
            first.seed: record_run(controller, scenario, num_steps, key=key, num_trajectories=0)
        }
    else:
        # A map is what it is: of an experiment only the key depends on the seed.
        keys = jnp.stack([jax.random.key(seed) for seed in first.seeds])
        together = record_runs(controller, scenario, num_steps, keys=keys)
        recordings = dict(zip(first.seeds, together, strict=True))
    if any(recording.is_interrupted for recording in recordings.values()):
        raise KeyboardInterrupt
    return tuple(
        row_of(
            task,
            recordings[task.seed],
            recordings[task.seed].metrics(seed=task.seed),
            settings=settings.model_copy(update={"map": task.path, "seed": task.seed}),
        )
        for task in batch
    )


def results_for(batch: Batch, make: Perform = perform) -> tuple[Result, ...]:
    """Return what tasks come to; rows with the error where they come to nothing.

    Raises:
        KeyboardInterrupt: the user stopped the runs.
    """
    try:
        rows = make(batch)
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        rows = [failed_row(task, _reason(task, kind + str(error))) for task in batch]
    return tuple(map(result_of, rows))


def _reason(task: Task, error: str) -> str:
    """Return an error as the user is told it: a copy of the map is nothing to look at later."""
    return error if task.copy is None else error.replace(task.copy, task.path)


def _open_start(settings: Settings) -> tuple[float, float, float]:
    """Return the most open spot of the map as the run will have it, heading along x."""
    grid = read_grid(settings.map, settings.resolution)
    x, y = open_spot(grid, float(build_robot(settings.robot).radius))
    return x, y, 0.0
