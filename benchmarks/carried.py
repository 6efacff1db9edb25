"""A robot that is carried away on a map that it knows: how often and how soon it is found again.

`python -m benchmarks.carried MAP.yaml 0 20` patrols with seeds 0 to 19 and each number of
particles. After 5 s the robot is carried to a random place. A further argument is a number of
particles, for that number alone. The last rows compare the time of a step with that of scan
matching. It is no part of `make bench`.
"""

import json
import statistics
import sys
from typing import Any

import jax

from jaxplore.simulation.experiment import Experiment
from jaxplore.study.experiments import record_alone
from jaxplore.tasks.registry import build, make_settings

NUMBERS = (500, 2000, 5000)
CARRIED_AT, AFTERWARDS = 5.0, 30.0
"""Time at which the robot is carried away, and time that is simulated after it [s]."""


def patrol(path: str, localisation: dict[str, Any], faults: dict[str, Any]) -> Experiment:
    """Return a patrol of a known map."""
    entries = {
        "map": path,
        "is_map_known": True,
        "watch": {},
        "target_coverage": None,
        "time_limit": CARRIED_AT + AFTERWARDS,
        "localisation": localisation,
        "faults": faults,
    }
    return build(make_settings(entries))


def measure(path: str, number: int, seeds: range) -> dict[str, Any]:
    """Return what a number of particles did, over seeds."""
    carried = {"carried_at": CARRIED_AT}
    experiment = patrol(path, {"method": "particles", "num_particles": number}, carried)
    rows = []
    for seed in seeds:
        metrics: Any = record_alone(experiment._replace(key=jax.random.key(seed))).metrics()
        row = {
            "particles": number,
            "seed": seed,
            "recovered_after": metrics.recovered_after,
            "ate": round(metrics.ate, 3),
            "contacts": metrics.collisions,
            "stopped_steps": metrics.stopped_steps,
            "double_walls": round(metrics.double_walls, 4),
        }
        print(json.dumps(row), flush=True)
        rows.append(row)
    times = [each["recovered_after"] for each in rows if each["recovered_after"] is not None]
    return {
        "particles": number,
        "runs": len(rows),
        "recovered": len(times),
        "median [s]": round(statistics.median(times), 2) if times else None,
        "greatest [s]": round(max(times), 2) if times else None,
        "contacts": sum(each["contacts"] for each in rows),
    }


def step_times(path: str) -> list[dict[str, Any]]:
    """Return the median time of a step of each method, without a fault."""
    methods = {"matching": {"loops": False}} | {
        f"particles {number}": {"method": "particles", "num_particles": number}
        for number in NUMBERS
    }
    rows = []
    for name, localisation in methods.items():
        recording: Any = record_alone(patrol(path, localisation, {}))
        compute = recording.metrics().compute
        rows.append({"method": name, "loop [ms]": round(compute.loop_step_ms, 3)})
    return rows


def main() -> None:
    path, first, end, *others = sys.argv[1:]
    seeds = range(int(first), int(end))
    numbers = tuple(map(int, others)) or NUMBERS
    table = [measure(path, number, seeds) for number in numbers]
    if not others:
        table += step_times(path)
    for row in table:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
