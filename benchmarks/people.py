"""Contacts with people who walk and look out for nobody, by their speed.

`python -m benchmarks.people --map office --seeds 10`

A contact counts against the robot if the robot moved in the control period in which it began, or in
that before. Those with walls are among them, and are counted apart in `with_walls`. One compiled
program serves all seeds and speeds of an architecture on a map.
"""

import argparse
import json
import time
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.setting import available_maps
from jaxplore.settings.architectures import ARCHITECTURES
from jaxplore.simulation.exploration.part_truth import init_truths, what_moves
from jaxplore.simulation.loop import run_chunk
from jaxplore.simulation.run import record_run
from jaxplore.tasks.registry import build, make_settings

SITES = {
    "office": "office",
    "aws_small_house": "aws_small_house/map.yaml",
    "nav2_depot": "nav2_depot/depot.yaml",
}
SPEEDS = (0.5, 1.0, 1.5, 2.0)
LIDAR_ERRORS: dict[str, Any] = {
    "least_range": 0.2,
    "missing": 0.05,
    "false_returns": 0.01,
    "pitch_degrees": 4.0,
    "roll_degrees": 2.0,
    "height": 0.2,
}
"""Errors of a lidar near the floor, which it sees 2.9 m ahead."""
ALL_AROUND: dict[str, Any] = {"num_beams": 96, "field_of_view_degrees": 360.0}
"""A lidar that sees to all sides, for a robot that has a camera of 90 degrees."""
STILL = 0.02
"""Speed below which the robot stands [m/s]."""
TOUCHES = 0.1
"""Distance from a person above which the robot touches something else [m]."""


def measure_contacts(
    place: str,
    architecture: str,
    number: int,
    speed: float,
    seed: int,
    seconds: float,
    changes: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return a row of one run.

    Args:
        place: name of a generated map, or file of a map.
        architecture: architecture of the robot.
        number: number of people.
        speed: their speed [m/s].
        seed: seed of the run and of the people's ways.
        seconds: simulated time [s].
        changes: further settings, such as errors of the lidar.
    """
    began = time.process_time()
    people = {"number": number, "speed": speed}
    entries = {"map": place, "architecture": architecture, "people": people, "seed": seed}
    limits = {"time_limit": seconds, "target_coverage": None}
    experiment = build(make_settings({**entries, **limits, **(changes or {})}))
    # Frames without plans: the controller is not compiled a second time.
    run = record_run(*experiment[:3], key=experiment.key, num_trajectories=0)
    records: Any = run.records
    period = experiment.scenario.period
    states = np.asarray(records.state)
    moved = np.hypot(*np.diff(states[:, :2], axis=0, prepend=states[:1, :2]).T) / period
    is_contact = np.asarray(records.is_collision)
    begins = np.flatnonzero(is_contact & ~np.append(False, is_contact[:-1]))
    is_moving = [bool(moved[max(0, at - 1) : at + 1].max() > STILL) for at in begins]
    gaps = [distance_from_people(experiment, states[at], (at + 1) * period) for at in begins]
    is_wall = np.array(is_moving, bool) & (np.array(gaps) > TOUCHES)
    return {
        "architecture": architecture,
        "speed": speed,
        "seed": seed,
        "seconds": len(states) * period,
        "metres": float(moved.sum() * period),
        "contacts": len(begins),
        "contacts_moving": sum(is_moving),
        "with_walls": int(is_wall.sum()),
        "moving_at": [round(float(at * period), 2) for at in begins[np.array(is_moving, bool)]],
        "standing": float((moved < STILL).mean()),
        "coverage": float(np.asarray(records.coverage)[-1]),
        "cpu": round(time.process_time() - began, 1),
        "programs": getattr(run_chunk, "_cached")._cache_size(),  # noqa: B009
    }


def distance_from_people(experiment: Any, state: np.ndarray, at: float) -> float:
    """Return the distance of the robot's edge from the nearest person at a time [m].

    Args:
        experiment: the experiment.
        state: (nx,) state of the robot.
        at: the time [s].
    """
    scenario = experiment.scenario
    drawn = init_truths(scenario.truths, scenario.robot.pose(scenario.start), experiment.key)
    people = what_moves(scenario.truths, drawn, jnp.float32(at))
    assert people is not None
    x, y, radius = np.asarray(people.discs).T
    away = np.hypot(x - state[0], y - state[1]) - radius
    return float(away.min()) - float(scenario.robot.footprint.radius)


def main() -> None:
    """Measure, and print a line for each run and for each speed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", default="office", choices=sorted(SITES))
    parser.add_argument("--architectures", nargs="+", choices=ARCHITECTURES, default=["explorer"])
    parser.add_argument("--speeds", nargs="+", type=float, default=SPEEDS)
    parser.add_argument("--people", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=80.0)
    parser.add_argument("--lidar-errors", action="store_true", help="with `LIDAR_ERRORS`")
    parser.add_argument("--all-around", action="store_true", help="with `ALL_AROUND`")
    given = parser.parse_args()
    lidar = (LIDAR_ERRORS if given.lidar_errors else {}) | (ALL_AROUND if given.all_around else {})
    changes = {"lidar": lidar} if lidar else {}
    place = given.map if given.map == "office" else available_maps(SITES)[given.map]
    for architecture in given.architectures:
        for speed in given.speeds:
            rows = []
            for seed in range(given.first_seed, given.first_seed + given.seeds):
                args = (architecture, given.people, speed, seed, given.seconds, changes)
                rows.append(measure_contacts(place, *args))
                print(json.dumps(rows[-1]), flush=True)
            metres = sum(row["metres"] for row in rows)
            sums = {
                name: sum(row[name] for row in rows)
                for name in ("contacts", "contacts_moving", "with_walls")
            }
            per = {f"{name}_per_100_m": 100.0 * sums[name] / metres for name in sums}
            found = {"map": given.map, "architecture": architecture, "speed": speed}
            print(json.dumps({**found, "metres": metres, **sums, **per}), flush=True)


if __name__ == "__main__":
    main()
