"""The closed loop in volumes, by resolution and range: time of a step and of its parts, and memory.

Each volume is measured in a process of its own, so that its memory is that of the process.
"""

import json
import resource
import sys
from typing import Any

import jax
import numpy as np

from benchmarks.timing import TimedLoop, in_own_processes
from jaxplore import DepthCamera, Quadrotor, VolumeScenario, generate_volume, volume_explorer
from jaxplore.maps.generators.volumes import START

VOLUMES = (
    (20.0, 15.0, 0.2, 5.0),
    (20.0, 15.0, 0.1, 5.0),
    (20.0, 15.0, 0.1, 8.0),
    (35.0, 35.0, 0.1, 5.0),
)
"""Extents along x and y, side of a voxel and range of the camera [m]. All are 3 m high."""
CHUNK, STEPS = 40, 400


def measure() -> list[dict[str, Any]]:
    """Return a row for each volume."""
    return in_own_processes(__spec__.name, VOLUMES)


def measure_volume(
    width: float, height: float, resolution: float, max_range: float
) -> dict[str, Any]:
    """Return the row of a volume: a forest, in flight after the first two seconds."""
    world = generate_volume("forest", 0, size=(width, height, 3.0), resolution=resolution)
    robot = Quadrotor()
    camera = DepthCamera(max_range=max_range)
    scenario = VolumeScenario(world, robot, camera, (*START, 0.6), target_coverage=1.0)
    loop = TimedLoop(volume_explorer(robot), scenario, jax.random.key(0), CHUNK)
    compile_seconds = loop.run(0)
    loop.run(CHUNK)
    chunks, single = loop.turns(STEPS)
    times = 1e3 * np.asarray(single).reshape(-1, int(scenario.steps_per_field))
    phases = np.median(times, axis=0)
    # Scans are due in every second step, and fields in every second of these.
    nothing_due, scan = float(phases[1::2].mean()), float(phases[2])
    p50, p99 = np.percentile(times, [50, 99])
    return {
        "million voxels": world.log_odds.size / 1e6,
        "voxel m": resolution,
        "range m": max_range,
        "p50 ms": float(p50),
        "p99 ms": float(p99),
        "loop ms": 1e3 * float(np.median(chunks)),
        "command ms": nothing_due,
        "scan and map ms": scan - nothing_due,
        "fields ms": float(phases[0]) - scan,
        "compiled in s": compile_seconds,
        "GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


if __name__ == "__main__":
    print(json.dumps(measure_volume(*map(float, sys.argv[1:]))))
