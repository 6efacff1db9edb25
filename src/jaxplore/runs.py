"""Compares controllers with the same seeds."""

import contextlib
import math
import time
from collections.abc import Mapping, Sequence

import jax

from jaxplore.control.base import Controller
from jaxplore.report.comparison import Comparison, check_names
from jaxplore.report.console import progress_bar
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Recording
from jaxplore.simulation.run import record_run
from jaxplore.simulation.scenario import Scenario


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
                    recording = record_run(
                        controller, scenario, num_steps, key=jax.random.key(seed)
                    )
                    if not recording.is_interrupted:
                        runs[name].append(recording.metrics(seed=seed))
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
