"""The information engine: fields, windows, updates, growth, trajectories; and a peer."""

import json
import math
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.timing import timed
from jaxplore import (
    FieldSensor,
    InverseSensorModel,
    Lidar,
    OccupancyGrid,
    PoseInformation,
    TrajectoryInformation,
    explorer,
    office,
    start_pose,
)
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.information import GaussianNoise, LocalFieldSensor
from jaxplore.information.trajectory import METHODS
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import copied, initial_loop_state, run_chunk

PEERS = Path(__file__).parent / ".peers"
SIDE, RESOLUTION = 20.0, 0.1
NUM_SCANS = 300


def measure() -> dict[str, Any]:
    """Return the times of the information engine on an office that a robot explores."""
    beliefs = _exploration()
    grid = beliefs[len(beliefs) // 3]
    position = jnp.asarray([9.33, 7.81])
    along = np.linspace(0.0, 1.0, 50)
    curve = np.stack([2 + 14 * along, 5 + 6 * along + np.sin(6 * along), 0 * along], axis=1)
    path = jnp.asarray(curve, jnp.float32)
    with tempfile.TemporaryDirectory() as folder:
        peer = _peer(Path(folder), grid, position, path)
    return {
        "local_field": _local_field(grid, position, peer),
        "fields": _fields(beliefs),
        "growth": _growth(),
        "trajectories": _trajectories(grid, path, peer),
    }


def _exploration() -> list[OccupancyGrid]:
    """Return what a robot knows after each scan of its first half minute in a 20 m office."""
    world = office(seed=5, width=SIDE, height=SIDE, resolution=RESOLUTION)
    robot = DifferentialDrive()
    scenario = ExplorationScenario(
        world, robot, Lidar(max_range=5.0, range_noise=0.02), start=start_pose(world)
    )
    controller = explorer(robot).at_period(scenario.control_period)
    key = jax.random.key(0)
    state = initial_loop_state(controller, scenario, key)
    beliefs = []
    for _ in range(NUM_SCANS):
        # Scans come at 10 Hz, controls at 50 Hz.
        state, _, _ = run_chunk((controller, scenario, key, jnp.asarray(5)), copied(state), 50)
        beliefs.append(state.task.belief.grid)
    return beliefs


def _local_field(
    grid: OccupancyGrid, position: jax.Array, peer: dict[str, Any] | None
) -> list[dict[str, Any]]:
    """3200 poses of 12 beams over 90 degrees and 10 m."""
    lidar, sensor = Lidar(12, 10.0, math.pi / 2.0), InverseSensorModel.from_odds()
    variants = {
        "noise-free": None,
        "Gaussian 0.15 m, to 3 sigma": GaussianNoise(0.15, 3.0),
        "Gaussian 0.15 m, exact": GaussianNoise(0.15),
    }
    rows = []
    for name, noise in variants.items():
        pose = PoseInformation(lidar, sensor, noise=noise)
        fast = LocalFieldSensor(pose, grid.resolution)
        found = eqx.filter_jit(fast.field)(grid, position)
        nodes = jnp.stack(jnp.meshgrid(jnp.arange(20), jnp.arange(20), indexing="ij"), axis=-1)
        at = jnp.repeat(found.frame.cell_centre(nodes.reshape(-1, 2)), 8, axis=0)
        yaw = jnp.tile(found.headings, 400)
        by_ray = eqx.filter_jit(pose)(grid, at, yaw)
        shifted = timed(fast.field, grid, position, runs=50)
        rays = timed(pose, grid, at, yaw, runs=5)
        row = {
            "": name,
            "ms": shifted.p50_ms,
            "p99_ms": shifted.p99_ms,
            "ray_by_ray_ms": rays.p50_ms,
            "times_faster": rays.p50_ms / shifted.p50_ms,
            "largest_difference": float(jnp.abs(found.values.reshape(-1) - by_ray).max()),
        }
        if peer is not None:
            row["jax_mppi_ms"] = peer["field_ms"]
            row["times_faster_than_jax_mppi"] = peer["field_ms"] / shifted.p50_ms
            row["correlation"] = _correlation(pose, grid, position, peer)
        rows.append(row)
    return rows


def _correlation(
    pose: PoseInformation, grid: OccupancyGrid, position: jax.Array, peer: dict[str, Any]
) -> float:
    """Compare with jax_mppi's field, which counts every cell of every beam in full."""
    full = PoseInformation(pose.lidar, pose.sensor, noise=pose.noise, near_weight=False)
    sensor = LocalFieldSensor(full, grid.resolution)
    ours = np.asarray(eqx.filter_jit(sensor.field)(grid, position).best.values)
    theirs = np.asarray(peer["field"]).T  # [x, y]
    return float(np.corrcoef(ours.reshape(-1), theirs.reshape(-1))[0, 1])


def _fields(beliefs: list[OccupancyGrid]) -> list[dict[str, Any]]:
    """Whole fields, windows and updates after each scan, at 5 m."""
    model = InverseSensorModel()
    window = [_cut(belief, 100) for belief in beliefs]
    rows = []
    for name, grids, directions, stride in (
        ("200 x 200, 64 directions", beliefs, 64, 1),
        ("200 x 200, 32 directions, every 2nd cell", beliefs, 32, 2),
        ("100 x 100, 32 directions", window, 32, 1),
    ):
        sensor = FieldSensor(Lidar(max_range=5.0, range_noise=0.02), RESOLUTION, directions, stride)
        field = timed(sensor.field, grids[len(grids) // 3], model, runs=50)
        beams = directions * math.prod(-(-size // stride) for size in grids[0].shape)
        rows.append(
            {
                "": name,
                "ms": field.p50_ms,
                "p99_ms": field.p99_ms,
                "million_beams_per_s": beams / field.p50_ms / 1e3,
                "memory_mb": _memory(sensor, grids[0], model),
                **_updates(sensor, grids, model),
            }
        )
    sensor = FieldSensor(Lidar(max_range=5.0, range_noise=0.02), RESOLUTION, 32)
    position, shape = jnp.asarray([9.33, 7.81]), (100, 100)
    taken = timed(lambda g, p: sensor.window(g, model, p, shape), beliefs[100], position, runs=50)
    rows.append(
        {
            "": "window 10 m x 10 m of it, 32 directions",
            "ms": taken.p50_ms,
            "p99_ms": taken.p99_ms,
            "million_beams_per_s": 320_000 / taken.p50_ms / 1e3,
        }
    )
    return rows


def _updates(
    sensor: FieldSensor, grids: list[OccupancyGrid], model: InverseSensorModel
) -> dict[str, float]:
    update = eqx.filter_jit(sensor.update)
    field = eqx.filter_jit(sensor.field)(grids[0], model)
    milliseconds = []
    for grid in grids[1:]:
        began = time.perf_counter()
        field = update(field, grid, model)
        field.cumulative.block_until_ready()
        milliseconds.append(1e3 * (time.perf_counter() - began))
    again = eqx.filter_jit(sensor.field)(grids[-1], model)
    p50, p90 = np.percentile(milliseconds[3:], [50, 90])
    return {
        "update_ms": float(p50),
        "update_p90_ms": float(p90),
        "update_differs_by": float(jnp.abs(field.cumulative - again.cumulative).max()),
    }


def _memory(sensor: FieldSensor, grid: OccupancyGrid, model: InverseSensorModel) -> float:
    """Return what one evaluation allocates, result included [MB]."""
    arrays, static = eqx.partition((sensor, grid, model), eqx.is_array)

    def run(arrays: Any) -> Any:
        sensor, grid, model = eqx.combine(arrays, static)
        return eqx.filter(sensor.field(grid, model), eqx.is_array)

    analysis: Any = jax.jit(run).lower(arrays).compile().memory_analysis()
    return float(analysis.temp_size_in_bytes + analysis.output_size_in_bytes) / 1e6


def _cut(grid: OccupancyGrid, size: int) -> OccupancyGrid:
    first = (np.asarray(grid.shape) - size) // 2
    part = np.asarray(grid.probability)[first[0] : first[0] + size, first[1] : first[1] + size]
    return OccupancyGrid(part, grid.resolution)


def _growth() -> list[dict[str, Any]]:
    """Time per cell and direction as maps and ranges grow together, by either method."""
    model, directions = InverseSensorModel(), 16
    rows: list[dict[str, Any]] = []
    rng = np.random.default_rng(0)

    def half_known(size: int) -> OccupancyGrid:
        levels = rng.choice([0.001, 0.5, 0.99], (size, size), p=[0.9, 0.099, 0.001])
        return OccupancyGrid(levels.astype(np.float32), RESOLUTION)

    ranges = [(400, reach) for reach in (100, 200, 400, 800)]
    for size, reach in [*ranges, (250, 125), (500, 250), (1000, 500), (2000, 1000)]:
        grid = half_known(size)
        row: dict[str, Any] = {"": f"{size} x {size} cells, range {reach} cells"}
        for method in ("scan", "doubling"):
            lidar = Lidar(64, reach * RESOLUTION)
            sensor = FieldSensor(lidar, RESOLUTION, directions, method=method)
            took = timed(sensor.field, grid, model, runs=3, warm_up=1)
            each = 1e6 * took.p50_ms / (size * size * directions)
            row[f"{method}_ms"] = took.p50_ms
            row[f"{method}_ns_per_beam"] = each
            row[f"{method}_ns_per_log2_range"] = each / math.log2(reach)
        rows.append(row)
    sensor = FieldSensor(Lidar(max_range=5.0, range_noise=0.02), RESOLUTION, directions, 2)
    took = timed(sensor.field, half_known(2000), model, runs=3, warm_up=1)
    rows.append(
        {
            "": "2000 x 2000 cells, range 50 cells, every 2nd cell",
            "scan_ms": took.p50_ms,
            "scan_ns_per_beam": 1e6 * took.p50_ms / (1000 * 1000 * directions),
        }
    )
    return rows


def _trajectories(
    grid: OccupancyGrid, path: jax.Array, peer: dict[str, Any] | None
) -> list[dict[str, Any]]:
    """50 poses of 16 beams over 90 degrees and 5 m."""
    pose, rows = PoseInformation(Lidar(16, 5.0, math.pi / 2.0)), []
    for method in METHODS:
        took = timed(TrajectoryInformation(pose, method), grid, path[:, :2], runs=100)
        theirs = None if peer is None else peer["trajectory_ms"].get(method)
        rows.append({"": method, "ms": took.p50_ms, "p99_ms": took.p99_ms, "jax_mppi_ms": theirs})
    return rows


def _peer(
    folder: Path, grid: OccupancyGrid, position: jax.Array, path: jax.Array
) -> dict[str, Any] | None:
    """Run jax_mppi's own code on the same problem, where `make bench` has set it up."""
    python = PEERS / "bin" / "python"
    if not python.exists():
        return None
    problem = folder / "problem.npz"
    np.savez(
        problem,
        grid=np.asarray(grid.probability),
        position=np.asarray(position),
        path=np.asarray(path),
        resolution=grid.resolution,
    )
    script = Path(__file__).parent / "peers" / "jax_mppi_information.py"
    command = [str(python), str(script), str(PEERS / "jax_mppi"), str(problem)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result
