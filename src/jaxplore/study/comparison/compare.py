"""Comparison of variants in one scenario: every variant runs with the same seeds."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import jax
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS
from jaxplore.control.base import Controller
from jaxplore.report.console import progress_bar
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Recording
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.run import NUM_TRAJECTORIES
from jaxplore.simulation.scenario import Scenario
from jaxplore.study.comparison.comparison import Comparison, check_names
from jaxplore.study.experiments import record_alone
from jaxplore.study.runner import Runner
from jaxplore.study.seeds import check_number_of_runs, check_number_of_seeds
from jaxplore.study.workers.task import Task


@dataclasses.dataclass(frozen=True)
class RecordingTask(Task):
    """One run of a variant, whose result is the metrics and the recording."""

    variant: str
    seed: int
    controller: Controller
    scenario: Scenario
    num_steps: int

    @property
    def id(self) -> str:
        """Variant and seed."""
        return f"{self.variant}, seed {self.seed}"

    @property
    def group(self) -> str:
        """The variant: its closed loop is one compiled program."""
        return self.variant

    def run(self) -> tuple[Metrics, Recording]:
        """Run it."""
        # The key is made in the worker: a JAX key cannot be pickled.
        key = jax.random.key(self.seed)
        experiment = Experiment(self.controller, self.scenario, self.num_steps, key)
        recording = record_alone(experiment, num_trajectories=NUM_TRAJECTORIES)
        return recording.metrics(seed=self.seed), recording

    def make_failure(self, reason: str) -> tuple[Metrics, Recording]:
        """Raise a `ChildProcessError`: the run ended its workers."""
        raise ChildProcessError(f"run of {self.variant} with seed {self.seed} failed: {reason}")


@_kinds.check_arguments
def compare(
    experiments: Mapping[str, tuple[Controller, Scenario, int]],
    seeds: Sequence[int],
    *,
    runner: Runner | None = None,
    progress: bool = False,
) -> Comparison:
    """Compare variants over the same seeds.

    Runs go seed by seed. Ctrl-C ends the call and returns the finished runs.

    Args:
        experiments: controller, scenario and number of steps by the name of the variant; the
            arguments of `simulate`.
        seeds: seeds of the runs.
        runner: runner for other processes or a cluster; this process when absent. It is closed at
            the end.
        progress: whether to show a progress bar.

    Raises:
        ValueError: no experiments, no seeds, a repeated seed, a name that is not a file name.
    """
    _check_arguments(experiments, seeds)
    check_number_of_seeds("seeds", seeds)
    check_number_of_runs(len(experiments) * len(seeds))
    _kinds.flag("progress", progress)
    if not experiments:
        raise ValueError("experiments is empty; accepted: at least one controller")
    check_names(experiments)
    if not seeds or len(set(seeds)) != len(seeds):
        raise ValueError(f"seeds is {list(seeds)}; accepted: different whole numbers, at least one")
    tasks = [
        RecordingTask(name, seed, *experiment[:3])
        for seed in seeds
        for name, experiment in experiments.items()
    ]
    found: dict[tuple[str, int], Metrics] = {}
    recordings: dict[str, Recording] = {}
    is_interrupted = False
    with progress_bar("comparing", enabled=progress) as advance:
        show = _show(advance, len(tasks))

        def keep(task: RecordingTask, result: tuple[Metrics, Recording]) -> None:
            metrics, recording = result
            found[task.variant, task.seed] = metrics
            # A recording takes much more memory than metrics, so one per variant is kept.
            if task.seed == seeds[0]:
                recordings[task.variant] = recording
            show(len(found), task)

        try:
            with Runner() if runner is None else runner as active:
                active.run(tasks, keep)
        except KeyboardInterrupt:
            is_interrupted = True
    runs = {
        name: tuple(found[name, seed] for seed in seeds if (name, seed) in found)
        for name in experiments
    }
    ordered = {name: recordings[name] for name in experiments if name in recordings}
    return Comparison(runs, ordered, is_interrupted)


def _check_arguments(experiments: object, seeds: object) -> None:
    """Raise a `ValueError` for another type; `compare` checks the values."""
    if not isinstance(experiments, Mapping):
        given = _kinds.describe(experiments)
        raise ValueError(f"experiments is {given}; accepted: the arguments of simulate by name")
    for name, experiment in experiments.items():
        label = f"experiments[{name!r}]"
        if not isinstance(experiment, (list, tuple)) or len(experiment) < 3:
            given = _kinds.describe(experiment)
            raise ValueError(f"{label} is {given}; accepted: (controller, scenario, num_steps)")
        _kinds.instance(f"controller of {label}", experiment[0], Controller)
        _kinds.instance(f"scenario of {label}", experiment[1], Scenario)
        _checks.positive_int(f"num_steps of {label}", experiment[2], at_most=MOST_STEPS)
    if not isinstance(seeds, Sequence) or isinstance(seeds, str):
        given = _kinds.describe(seeds)
        raise ValueError(f"seeds is {given}; accepted: different whole numbers, at least one")
    for index, seed in enumerate(seeds):
        _kinds.instance(f"seeds[{index}]", seed, int, np.integer)


def _show(
    advance: Callable[[float, str], None], total: int
) -> Callable[[int, RecordingTask], None]:
    """Return a function that shows how many runs are done, and the time left."""
    began = time.perf_counter()
    advance(0.0, f"{total} runs")

    def show(done: int, task: RecordingTask) -> None:
        left = (time.perf_counter() - began) / done * (total - done)
        rest = f", about {left:.0f} s left" if left > 0.0 else ""
        advance(done / total, f"{done} of {total} runs{rest}, done: {task.id}")

    return show
