"""The closed loop on maps of up to ten million cells: time of a step, of the fields, and memory.

Each map is measured in a process of its own, so that its memory is that of the process. Half of the
map is known beforehand: the guidance of a robot that has explored for long covers much of it.
"""

import json
import resource
import sys
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, in_own_processes, percentiles
from jaxplore import DifferentialDrive, ExplorationScenario, Lidar, OccupancyGrid, explorer
from jaxplore.maps.generators.office import office, start_pose

CHUNK = 50


class Sizes(NamedTuple):
    """Width, height and side of a cell of the offices [m], sizes of the controller, and steps."""

    maps: tuple[tuple[float, float, float], ...] = (
        (20.0, 14.0, 0.1),
        (45.0, 30.0, 0.05),
        (90.0, 60.0, 0.05),
        (250.0, 100.0, 0.05),
    )
    samples: int = 1000
    horizon: int = 40
    steps: int = 500


FULL = Sizes()
SMOKE = Sizes(((8.0, 7.0, 0.1),), 8, 4, CHUNK)
TITLES = {"maps": "Large maps: half known, 360 beams of 5 m, K = 1000, T = 40"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return a row for each map."""
    cases = [(*each, sizes.samples, sizes.horizon, sizes.steps) for each in sizes.maps]
    return {"maps": in_own_processes(__spec__.name, cases)}


def measure_map(
    width: float, height: float, resolution: float, samples: float, horizon: float, steps: float
) -> dict[str, Any]:
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
    controller = explorer(robot, num_samples=int(samples), horizon=int(horizon))
    loop = TimedLoop(controller, scenario, jax.random.key(0), CHUNK)
    compile_seconds = loop.run(0)
    loop.run(CHUNK)
    chunks, single = loop.turns(int(steps))
    times = 1e3 * np.asarray(single).reshape(-1, int(scenario.steps_per_field))
    phases = np.median(times, axis=0)
    # The fields are derived in the last step of a period, a scan is taken in the first.
    nothing_due = float(np.median(phases))
    return {
        "million cells": world.probability.size / 1e6,
        "cell m": resolution,
        "thousand nodes": loop.state.task.belief.dwell.size / 1e3,
        **percentiles(single),
        "loop ms": 1e3 * float(np.median(chunks)),
        "scan and map ms": float(phases[0]) - nothing_due,
        "fields and guidance ms": float(phases[-1]) - nothing_due,
        "compiled in s": compile_seconds,
        "GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


if __name__ == "__main__":
    print(json.dumps(measure_map(*map(float, sys.argv[1:]))))
