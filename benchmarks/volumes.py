"""The closed loop in volumes, by resolution and range: time of a step and of its parts, and memory.

Each volume is measured in a process of its own, so that its memory is that of the process.
"""

import resource
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, measure_cases, percentiles
from jaxplore import DepthCamera, Quadrotor, VolumeScenario, generate_volume, volume_explorer
from jaxplore.maps.generators.volumes import START


class Sizes(NamedTuple):
    """Extents along x, y and z, side of a voxel and range of the camera [m], the camera's rays,
    sizes of the controller, steps of a chunk and in all, and whether each volume has a process."""

    volumes: tuple[tuple[float, float, float, float, float], ...] = (
        (20.0, 15.0, 3.0, 0.2, 5.0),
        (20.0, 15.0, 3.0, 0.1, 5.0),
        (20.0, 15.0, 3.0, 0.1, 8.0),
        (35.0, 35.0, 3.0, 0.1, 5.0),
    )
    width: int = 64
    height: int = 48
    samples: int = 512
    horizon: int = 30
    chunk: int = 40
    steps: int = 400
    are_apart: bool = True


FULL = Sizes()
# The loop of the document on three dimensions, which the suite compiles anyway.
SMOKE = Sizes(((8.0, 6.0, 2.4, 0.2, 5.0),), 32, 24, 256, 20, 4, 4, are_apart=False)
TITLES = {"volumes": "Volumes: camera of 64 x 48 rays, K = 512, T = 30"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return a row for each volume."""
    camera, controller = (sizes.width, sizes.height), (sizes.samples, sizes.horizon)
    shared = *camera, *controller, sizes.chunk, sizes.steps
    cases = [(*each, *shared) for each in sizes.volumes]
    return {"volumes": measure_cases(measure_volume, cases, are_apart=sizes.are_apart)}


def measure_volume(
    width: float, depth: float, height: float, resolution: float, max_range: float, *sizes: int
) -> dict[str, Any]:
    """Return the row of a volume: a forest, in flight after the first two seconds."""
    columns, lines, samples, horizon, chunk, steps = sizes
    world = generate_volume("forest", 0, size=(width, depth, height), resolution=resolution)
    robot = Quadrotor()
    camera = DepthCamera(columns, lines, max_range=max_range)
    scenario = VolumeScenario(world, robot, camera, (*START, 0.6), target_coverage=1.0)
    controller = volume_explorer(robot, num_samples=samples, horizon=horizon)
    loop = TimedLoop(controller, scenario, jax.random.key(0), chunk)
    compile_seconds = loop.run(0)
    loop.run(chunk)
    chunks, single = loop.turns(steps)
    times = 1e3 * np.asarray(single).reshape(-1, int(scenario.steps_per_field))
    phases = np.median(times, axis=0)
    # Scans are due in every second step, and fields in every second of these.
    nothing_due, scan = float(phases[1::2].mean()), float(phases[2])
    return {
        "": f"{width:g} x {depth:g} x {height:g} m, voxels of {resolution:g} m, {max_range:g} m",
        "million voxels": world.log_odds.size / 1e6,
        **percentiles(single),
        "loop ms": 1e3 * float(np.median(chunks)),
        "command ms": nothing_due,
        "scan and map ms": scan - nothing_due,
        "fields ms": float(phases[0]) - scan,
        "compiled in s": compile_seconds,
        "GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }
