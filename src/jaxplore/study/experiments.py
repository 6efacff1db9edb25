"""Running of single experiments and of batches."""

from collections.abc import Callable, Sequence

from jaxplore.report.recording import Recording
from jaxplore.simulation.batch import record_experiments
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.run import record_run
from jaxplore.simulation.stacking import LeafMask


def record_alone(
    experiment: Experiment, time_limit: float | None = None, *, num_trajectories: int = 0
) -> Recording:
    """Run one experiment until a limit of the simulated time [s], at most its own number of steps.

    Each frame holds `num_trajectories` rollouts, for animations.
    """
    steps = _num_steps(experiment, time_limit)
    recording = record_run(
        experiment.controller,
        experiment.scenario,
        steps,
        key=experiment.key,
        num_trajectories=num_trajectories,
    )
    return _complete(recording)


class SideBySide:
    """Runner of batches of experiments by `jax.vmap`, with a fixed batch size.

    It remembers which arrays have differed between the experiments of a kind and stacks them in all
    later batches, so that these run the same program. A smaller batch is filled up with copies of
    its last experiment: another size would need another program, with other rounding.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._differs: dict[str, LeafMask] = {}

    def record(
        self,
        kind: str,
        experiments: Sequence[Experiment],
        time_limit: float | None = None,
        *,
        with_frames: bool = False,
    ) -> list[Recording]:
        """Run experiments, at most a batch, that differ in keys and in the values of arrays only.

        `kind` names those that share a compiled program, such as the scenario. `time_limit` is
        simulated time [s].
        """
        padded = [*experiments, *[experiments[-1]] * (self._size - len(experiments))]
        steps = max(_num_steps(each, time_limit) for each in padded)
        recordings, self._differs[kind] = record_experiments(
            padded, steps, with_frames=with_frames, differs=self._differs.get(kind)
        )
        return [_complete(each) for each in recordings[: len(experiments)]]


def in_batches[T](items: Sequence[T], alike: Callable[[T], object], size: int) -> list[list[T]]:
    """Group similar items into batches of at most `size`, in their order."""
    groups: dict[object, list[T]] = {}
    for item in items:
        groups.setdefault(alike(item), []).append(item)
    return [
        some[first : first + size]
        for some in groups.values()
        for first in range(0, len(some), size)
    ]


def _num_steps(experiment: Experiment, time_limit: float | None) -> int:
    if time_limit is None:
        return experiment.num_steps
    steps = round(time_limit / experiment.scenario.period)
    return max(1, min(experiment.num_steps, steps))


def _complete(recording: Recording) -> Recording:
    if recording.is_interrupted:
        raise KeyboardInterrupt
    return recording
