"""Contacts with faults of the pose and with delayed commands, with and without the guard.

`python -m benchmarks.faults zones 0 20` runs every fault with seeds 0 to 19. A further argument is
`guarded`, the default, `unguarded`, or `paired`: both without a fault, to compare their times. It
is no part of `make bench`.
"""

import json
import statistics
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore.control.guard import MotionGuard
from jaxplore.parts import Faults
from jaxplore.report.motion import episodes
from jaxplore.report.statistics import paired_difference
from jaxplore.simulation.experiment import Experiment
from jaxplore.study.experiments import record_alone
from jaxplore.tasks.registry import build, make_settings

TASKS: dict[str, dict[str, Any]] = {
    "zones": {"map": "zones"},
    "office": {
        "map": "office",
        "robot": {"model": "differential_drive"},
        "time_limit": 250.0,
        "target_coverage": 0.99,
    },
}
"""Entries of settings by name."""
BEGINS = {"zones": (1.0, 2.0), "office": (5.0, 12.0)}
"""Times at which the faults begin [s]. A flight through the zones takes four to five seconds."""
AFTERWARDS = 5.0
"""Time that is simulated after a fault [s]."""
DELAY, DELAYED = 0.2, 30.0
"""Delay of the commands, and time that is simulated with it [s]."""


class Case(NamedTuple):
    """A fault: its name, the faults, and the time that is simulated [s]."""

    name: str
    faults: Faults
    seconds: float


def cases(task: str, period: float) -> Iterator[Case]:
    """Yield the faults of a task."""
    for kind in ("frozen", "lost"):
        for lasts in (2.0, 5.0):
            for begin in BEGINS[task]:
                end = begin + lasts
                during: dict[str, Any] = {f"{kind}_odometry": (begin, end)}
                faults = Faults(**during)
                yield Case(f"{kind} {lasts:g} s", faults, end + AFTERWARDS)
    # The delay is a size of the program, so that these runs come last.
    yield Case(f"delay {DELAY:g} s", Faults(control_delay=round(DELAY / period)), DELAYED)


def guarded(experiment: Experiment, *, is_guarded: bool) -> Experiment:
    """Return an experiment with or without the guard."""
    guard = MotionGuard() if is_guarded else None
    return experiment._replace(scenario=experiment.scenario.with_guard(guard))


def measure(task: str, seeds: range, *, is_guarded: bool) -> list[dict[str, Any]]:
    """Return the contacts with each fault: runs, runs with contacts, contacts."""
    experiment = guarded(build(make_settings(TASKS[task])), is_guarded=is_guarded)
    period = experiment.scenario.period
    found: dict[str, list[int]] = {}
    for case in cases(task, period):
        scenario = experiment.scenario.with_disturbances([case.faults])
        for seed in seeds:
            run = experiment._replace(
                scenario=scenario, num_steps=round(case.seconds / period), key=jax.random.key(seed)
            )
            records = record_alone(run).records
            contacts = episodes(np.asarray(records.is_collision, bool))
            stops: Any = [] if records.stop is None else np.flatnonzero(records.stop)
            found.setdefault(case.name, []).append(contacts)
            row = {
                "case": case.name,
                "seed": seed,
                "seconds": case.seconds,
                "contacts": contacts,
                "steps": len(records.is_collision),
                "coverage": round(float(records.coverage[-1]), 3),
                "first contact": _first(np.flatnonzero(records.is_collision), period),
                "first stop": _first(stops, period),
                "stops": [] if records.stop is None else np.bincount(records.stop).tolist(),
            }
            print(json.dumps(row), flush=True)
    return [
        {
            "task": task,
            "fault": name,
            "runs": len(each),
            "with contacts": sum(number > 0 for number in each),
            "contacts": sum(each),
        }
        for name, each in found.items()
    ]


def compare(task: str, seeds: range) -> dict[str, Any]:
    """Return the change of the time to the end by the guard without a fault, paired by seed."""
    experiment = build(make_settings(TASKS[task]))
    times: dict[bool, list[float]] = {False: [], True: []}
    stopped = 0
    for is_guarded, durations in times.items():
        explorer = guarded(experiment, is_guarded=is_guarded)
        for seed in seeds:
            recording: Any = record_alone(explorer._replace(key=jax.random.key(seed)))
            metrics = recording.metrics()
            if is_guarded:
                stopped += int(np.count_nonzero(recording.records.stop))
            limit = experiment.num_steps * experiment.scenario.period
            ended = limit if metrics.finished_at is None else metrics.finished_at
            durations.append(ended)
            contacts = metrics.collisions
            print(
                json.dumps(
                    {"guard": is_guarded, "seed": seed, "finished": ended, "contacts": contacts}
                ),
                flush=True,
            )
    before, after = times.values()
    ratios = [100.0 * new / old for old, new in zip(before, after, strict=True)]
    change = paired_difference([100.0] * len(ratios), ratios)
    return {
        "task": task,
        "seeds": len(seeds),
        "finished [s]": [round(statistics.fmean(each), 2) for each in (before, after)],
        "change [%]": [round(float(each), 2) for each in change],
        "stopped steps": stopped,
    }


def _first(steps: Any, period: float) -> float | None:
    return round(float(steps[0]) * period, 2) if len(steps) else None


if __name__ == "__main__":
    which, first, last, *mode = sys.argv[1:]
    chosen = range(int(first), int(last))
    if mode == ["paired"]:
        print(json.dumps(compare(which, chosen)))
    else:
        for each in measure(which, chosen, is_guarded=mode != ["unguarded"]):
            print(json.dumps(each))
