"""Parts of MPPI against each other in closed loop, on paired seeds.

`python -m benchmarks.sampling "diff nav2_depot" 0 20` runs the default explorer against the former
one with seeds 0 to 19. Two more arguments are settings of the controller's section before and
after, as JSON: `python -m benchmarks.sampling zones 0 20 '{}' '{"noise": "bank"}'`. It is no part
of `make bench`.
"""

import json
import statistics
import sys
from typing import Any

import jax

from benchmarks.setting import MAPS
from jaxplore.report.statistics import paired_difference
from jaxplore.study.experiments import record_alone
from jaxplore.tasks.registry import build, make_settings

FORMER: dict[str, Any] = {"parameterisation": "direct", "weighting": "softmax"}
"""The default explorer until 2026-11-24: independent controls, and a fixed temperature."""
PLACES: dict[str, dict[str, Any]] = {
    "office": {"map": "office", "time_limit": 250.0, "target_coverage": 0.99},
    "nav2_depot": {
        "map": str(MAPS / "nav2_depot/depot.yaml"),
        "start": (4.62, 7.73, 0.0),
        "time_limit": 150.0,
        "target_coverage": 0.99,
    },
    "aws_small_house": {
        "map": str(MAPS / "aws_small_house/map.yaml"),
        "start": (4.68, -1.97, 0.0),
        "time_limit": 90.0,
        "target_coverage": 0.99,
    },
}
ROBOTS: dict[str, dict[str, Any]] = {
    "diff": {"model": "differential_drive"},
    "unicycle": {"model": "unicycle"},
    # In the house a car of the default size would not pass the doors.
    "car": {"model": "ackermann", "length": 0.6, "width": 0.35},
}
TASKS: dict[str, dict[str, Any]] = {
    **{
        f"{robot} {place}": {**entries, "robot": model}
        for robot, model in ROBOTS.items()
        for place, entries in PLACES.items()
    },
    "zones": {"map": "zones"},
    **{
        f"zones {each}": {"map": "zones", "architecture": each}
        for each in ("parallel", "sequential")
    },
    "warehouse": {"map": "warehouse", "time_limit": 250.0},
}
"""Entries of settings by name."""
SECTIONS = {
    **dict.fromkeys(("zones", "zones parallel", "zones sequential"), "informative"),
    "warehouse": "portfolio",
}
"""Sections of settings with the parts of MPPI; `controller` of all other tasks."""
TIMES = ("finished", "90", "99")


def measure(
    task: str,
    seeds: range,
    before: dict[str, Any] | None = None,
    after: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the means of each number before and after, and their mean paired difference.

    The differences of times are in per cent. Times that were not reached count as the limit.

    Args:
        task: name of one of `TASKS`.
        seeds: seeds of the runs.
        before: settings of the controller that differ from the defaults; `FORMER` when absent.
        after: those to compare with it; none when absent.
    """
    entries = TASKS[task]
    explorers = {
        name: build(make_settings({**entries, SECTIONS.get(task, "controller"): changes}))
        for name, changes in (
            ("before", FORMER if before is None else before),
            ("after", after or {}),
        )
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in explorers}
    for seed in seeds:
        for name, experiment in explorers.items():
            run = _numbers(experiment._replace(key=jax.random.key(seed)), seed)
            found[name].append(run)
            print(json.dumps({"task": task, "seed": seed, "explorer": name, **run}), flush=True)
    row: dict[str, Any] = {"task": task, "seeds": len(seeds)}
    for number in found["before"][0]:
        old, new = ([run[number] for run in found[name]] for name in explorers)
        row[number] = [round(statistics.fmean(each), 3) for each in (old, new)]
        if number in TIMES:
            old, new = [100.0] * len(old), [100.0 * b / a for a, b in zip(old, new, strict=True)]
        change = paired_difference(old, new)
        row[f"{number} change"] = [round(float(each), 3) for each in change]
    return row


def _numbers(experiment: Any, seed: int) -> dict[str, float]:
    """Return the numbers of a run by which explorers are compared."""
    metrics: Any = record_alone(experiment).metrics(seed=seed)
    limit = experiment.num_steps * float(experiment.scenario.period)
    times = dict(
        zip(TIMES, (metrics.finished_at, *map(metrics.time_to.get, TIMES[1:])), strict=True)
    )
    return {
        **{name: limit if time is None else time for name, time in times.items()},
        "entropy": metrics.final_entropy,
        "jerk": metrics.command_jerk,
        "effective": metrics.mean_effective_sample_size,
        "contacts": metrics.collisions,
    }


if __name__ == "__main__":
    which, first, last, *changes = sys.argv[1:]
    print(json.dumps(measure(which, range(int(first), int(last)), *map(json.loads, changes))))
