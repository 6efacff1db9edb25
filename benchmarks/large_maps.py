"""The closed loop on maps of up to ten million cells: time of a step, of the fields, and memory.

Each map is measured in a process of its own, so that its memory is that of the process. Half of the
map is known beforehand: the guidance of a robot that has explored for long covers much of it.
"""

import resource
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, measure_cases, percentiles
from jaxplore import DifferentialDrive, ExplorationScenario, Lidar, OccupancyGrid, explorer
from jaxplore.maps.generators.office import office, start_pose


class Sizes(NamedTuple):
    """Width, height and side of a cell of the offices [m], beams and range of the lidar, sizes of
    the controller, steps of a chunk and in all, and whether each map has a process."""

    maps: tuple[tuple[float, float, float], ...] = (
        (20.0, 14.0, 0.1),
        (45.0, 30.0, 0.05),
        (90.0, 60.0, 0.05),
        (250.0, 100.0, 0.05),
    )
    beams: int = 360
    max_range: float = 5.0
    samples: int = 1000
    horizon: int = 40
    chunk: int = 50
    steps: int = 500
    are_apart: bool = True


FULL = Sizes()
# The loop of `benchmarks.setting.SMALL`.
SMOKE = Sizes(((8.0, 7.0, 0.1),), 90, 4.0, 64, 40, 10, 10, are_apart=False)
TITLES = {"maps": "Large maps: half known, 360 beams of 5 m, K = 1000, T = 40"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return a row for each map."""
    shared = sizes.beams, sizes.max_range, sizes.samples, sizes.horizon, sizes.chunk, sizes.steps
    cases = [(*each, *shared) for each in sizes.maps]
    return {"maps": measure_cases(measure_map, cases, are_apart=sizes.are_apart)}


def measure_map(
    width: float,
    height: float,
    resolution: float,
    beams: int,
    max_range: float,
    samples: int,
    horizon: int,
    chunk: int,
    steps: int,
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
        Lidar(num_beams=beams, max_range=max_range, range_noise=0.02),
        start=start_pose(world),
        prior=OccupancyGrid(known, resolution),
    )
    controller = explorer(robot, num_samples=samples, horizon=horizon)
    loop = TimedLoop(controller, scenario, jax.random.key(0), chunk)
    compile_seconds = loop.run(0)
    loop.run(chunk)
    chunks, single = loop.turns(steps)
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
