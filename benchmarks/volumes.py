"""The closed loop in volumes, by resolution and range: time of a step and of its parts, and memory.

Each volume is measured in a process of its own, so that its memory is that of the process.
"""

import json
import resource
import sys
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, in_own_processes, percentiles
from jaxplore import DepthCamera, Quadrotor, VolumeScenario, generate_volume, volume_explorer
from jaxplore.maps.generators.volumes import START

CHUNK = 40


class Sizes(NamedTuple):
    """Extents along x and y, side of a voxel and range of the camera [m], the camera's rays, sizes
    of the controller, and steps. All are 3 m high."""

    volumes: tuple[tuple[float, float, float, float], ...] = (
        (20.0, 15.0, 0.2, 5.0),
        (20.0, 15.0, 0.1, 5.0),
        (20.0, 15.0, 0.1, 8.0),
        (35.0, 35.0, 0.1, 5.0),
    )
    width: int = 64
    height: int = 48
    samples: int = 512
    horizon: int = 30
    steps: int = 400


FULL = Sizes()
SMOKE = Sizes(((12.0, 12.0, 0.4, 3.0),), 8, 6, 8, 4, CHUNK)
TITLES = {"volumes": "Volumes: camera of 64 x 48 rays, K = 512, T = 30"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return a row for each volume."""
    shared = sizes.width, sizes.height, sizes.samples, sizes.horizon, sizes.steps
    cases = [(*each, *shared) for each in sizes.volumes]
    return {"volumes": in_own_processes(__spec__.name, cases)}


def measure_volume(
    width: float, height: float, resolution: float, max_range: float, *sizes: float
) -> dict[str, Any]:
    """Return the row of a volume: a forest, in flight after the first two seconds."""
    columns, lines, samples, horizon, steps = map(int, sizes)
    world = generate_volume("forest", 0, size=(width, height, 3.0), resolution=resolution)
    robot = Quadrotor()
    camera = DepthCamera(columns, lines, max_range=max_range)
    scenario = VolumeScenario(world, robot, camera, (*START, 0.6), target_coverage=1.0)
    controller = volume_explorer(robot, num_samples=samples, horizon=horizon)
    loop = TimedLoop(controller, scenario, jax.random.key(0), CHUNK)
    compile_seconds = loop.run(0)
    loop.run(CHUNK)
    chunks, single = loop.turns(steps)
    times = 1e3 * np.asarray(single).reshape(-1, int(scenario.steps_per_field))
    phases = np.median(times, axis=0)
    # Scans are due in every second step, and fields in every second of these.
    nothing_due, scan = float(phases[1::2].mean()), float(phases[2])
    return {
        "": f"{width:g} x {height:g} x 3 m, voxels of {resolution:g} m, {max_range:g} m",
        "million voxels": world.log_odds.size / 1e6,
        **percentiles(single),
        "loop ms": 1e3 * float(np.median(chunks)),
        "command ms": nothing_due,
        "scan and map ms": scan - nothing_due,
        "fields ms": float(phases[0]) - scan,
        "compiled in s": compile_seconds,
        "GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


if __name__ == "__main__":
    print(json.dumps(measure_volume(*map(float, sys.argv[1:]))))
