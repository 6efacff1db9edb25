"""The default explorer against explorers with other parts of MPPI, on paired seeds.

`python -m benchmarks.smoothness diff nav2_depot 0 20` runs seeds 0 to 19; it is not part of
`make bench`.
"""

import json
import statistics
import sys
from typing import Any

import jax
import numpy as np

from benchmarks.setting import MAPS
from jaxplore.build.tasks import build, make_settings
from jaxplore.report.statistics import paired_difference
from jaxplore.study.experiments import record_alone

FORMER: dict[str, Any] = {"parameterisation": "direct", "weighting": "softmax"}
"""The default until 2026-11-24: independent controls at each step, and a fixed temperature."""
PLACES: dict[str, dict[str, Any]] = {
    "office": {"map": "office", "time_limit": 250.0},
    "nav2_depot": {
        "map": str(MAPS / "nav2_depot/depot.yaml"),
        "start": (4.62, 7.73, 0.0),
        "time_limit": 150.0,
    },
    "aws_small_house": {
        "map": str(MAPS / "aws_small_house/map.yaml"),
        "start": (4.68, -1.97, 0.0),
        "time_limit": 90.0,
    },
}
ROBOTS: dict[str, dict[str, Any]] = {
    "diff": {"model": "differential_drive"},
    "unicycle": {"model": "unicycle"},
    # In the house a car of the default size would not pass the doors.
    "car": {"model": "ackermann", "length": 0.6, "width": 0.35},
}
NUMBERS = ("90", "99", "jerk", "effective")


def measure(
    robot: str, place: str, seeds: range, variant: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return the mean of each number with both explorers, and the paired difference in per cent.

    Times that were not reached count as the limit.

    Args:
        robot: name of one of `ROBOTS`.
        place: name of one of `PLACES`.
        seeds: seeds of the runs.
        variant: settings of `controller` that differ; the default explorer when absent.
    """
    entries = {**PLACES[place], "robot": ROBOTS[robot]}
    explorers = {
        "before": build(make_settings({**entries, "controller": FORMER})),
        "after": build(make_settings({**entries, "controller": variant or {}})),
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in explorers}
    for seed in seeds:
        for name, experiment in explorers.items():
            recording = record_alone(experiment._replace(key=jax.random.key(seed)))
            metrics: Any = recording.metrics(seed=seed)
            times = {level: metrics.time_to[level] for level in ("90", "99")}
            found[name].append(
                {
                    **{k: entries["time_limit"] if t is None else t for k, t in times.items()},
                    "jerk": metrics.command_jerk,
                    "effective": metrics.mean_effective_sample_size,
                    "contacts": metrics.collisions,
                }
            )
            print(robot, place, seed, name, found[name][-1], flush=True)
    row: dict[str, Any] = {"robot": robot, "map": place, "seeds": len(seeds)}
    for number in NUMBERS:
        before, after = ([run[number] for run in found[name]] for name in explorers)
        row[number] = [round(statistics.fmean(each), 1) for each in (before, after)]
        if number in ("90", "99"):
            ratio = [100.0 * (b / a - 1.0) for a, b in zip(before, after, strict=True)]
            change = paired_difference(np.zeros(len(ratio)).tolist(), ratio)
            row[f"{number} change [%]"] = [round(float(each), 1) for each in change]
    row["contacts"] = sum(run["contacts"] for runs in found.values() for run in runs)
    return row


if __name__ == "__main__":
    vehicle, where, first, last, *changes = sys.argv[1:]
    given = json.loads(changes[0]) if changes else None
    print(measure(vehicle, where, range(int(first), int(last)), given))
