"""The closed loop on maps of up to ten million cells: time of a step, of the fields, and memory.

Each map is measured in a process of its own, so that its memory is that of the process. Half of the
map is known beforehand: the guidance of a robot that has explored for long covers much of it.
"""

import json
import resource
import sys
from typing import Any

import jax
import numpy as np

from benchmarks.timing import TimedLoop, in_own_processes
from jaxplore import DifferentialDrive, ExplorationScenario, Lidar, OccupancyGrid, explorer
from jaxplore.maps.generators.office import office, start_pose

MAPS = ((20.0, 14.0, 0.1), (45.0, 30.0, 0.05), (90.0, 60.0, 0.05), (250.0, 100.0, 0.05))
"""Width, height and side of a cell of the offices [m]."""
CHUNK, STEPS = 50, 500


def measure() -> list[dict[str, Any]]:
    """Return a row for each map."""
    return in_own_processes(__spec__.name, MAPS)


def measure_map(width: float, height: float, resolution: float) -> dict[str, Any]:
    """Return the row of a map."""
    world = office(seed=1, width=width, height=height, resolution=resolution)
    known = np.full(world.shape, 0.5, np.float32)
    half = world.shape[1] // 2
    known[:, :half] = np.where(np.asarray(world.probability)[:, :half] > 0.5, 0.99, 0.001)
    robot = DifferentialDrive()
    scenario = ExplorationScenario(
        world,
        robot,
        Lidar(num_beams=360, max_range=5.0, range_noise=0.02),
        start=start_pose(world),
        prior=OccupancyGrid(known, resolution),
    )
    loop = TimedLoop(explorer(robot), scenario, jax.random.key(0), CHUNK)
    compile_seconds = loop.run(0)
    loop.run(CHUNK)
    chunks, single = loop.turns(STEPS)
    times = 1e3 * np.asarray(single).reshape(-1, int(scenario.steps_per_field))
    phases = np.median(times, axis=0)
    # The fields are derived in the last step of a period, a scan is taken in the first.
    nothing_due = float(np.median(phases))
    p50, p99 = np.percentile(times, [50, 99])
    return {
        "million cells": world.probability.size / 1e6,
        "cell m": resolution,
        "thousand nodes": loop.state.task.belief.dwell.size / 1e3,
        "p50 ms": float(p50),
        "p99 ms": float(p99),
        "loop ms": 1e3 * float(np.median(chunks)),
        "scan and map ms": float(phases[0]) - nothing_due,
        "fields and guidance ms": float(phases[-1]) - nothing_due,
        "compiled in s": compile_seconds,
        "GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


if __name__ == "__main__":
    print(json.dumps(measure_map(*map(float, sys.argv[1:]))))
