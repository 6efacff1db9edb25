"""The information engine: fields, windows, updates, growth, trajectories; and a peer."""

import math
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.control_peers import PEERS, PYTHONS, run_peer
from benchmarks.setting import OFFICE, SMALL, experiment
from benchmarks.tables import Rows
from benchmarks.timing import timed
from jaxplore import (
    FieldSensor,
    InverseSensorModel,
    Lidar,
    OccupancyGrid,
    PoseInformation,
    TrajectoryInformation,
)
from jaxplore.information import GaussianNoise, LocalFieldSensor
from jaxplore.information.trajectory import METHODS
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

RESOLUTION, RANGE = 0.1, 5.0
NOISES = {
    "noise-free": None,
    "Gaussian 0.15 m, to 3 sigma": GaussianNoise(0.15, 3.0),
    "Gaussian 0.15 m, exact": GaussianNoise(0.15),
}


class Sizes(NamedTuple):
    """The office, its window [cells], the exploration with its scans and its lidar, and what is
    computed on it."""

    width: float = 20.0
    height: float = 20.0
    position: tuple[float, float] = (9.33, 7.81)
    window: int = 100
    scans: int = 300
    changes: dict[str, Any] = {"lidar": {"max_range": RANGE}, "guard": False}  # noqa: RUF012
    capacity: int = 50
    """Steps for which a call of the exploration's loop has room."""
    noises: tuple[str, ...] = tuple(NOISES)
    beams: int = 12
    reach: float = 10.0
    directions: int = 64
    ranges: tuple[int, ...] = (100, 200, 400, 800)
    """Ranges on a map of `ranged` cells a side."""
    ranged: int = 400
    maps: tuple[int, ...] = (250, 500, 1000, 2000)
    """Maps whose range is half a side."""
    poses: int = 50
    methods: tuple[str, ...] = METHODS
    runs: int = 50


FULL = Sizes()
SMOKE = Sizes(
    width=8.0,
    height=7.0,
    position=(4.0, 3.5),
    window=40,
    scans=6,
    changes=SMALL,
    capacity=25,
    noises=("noise-free",),
    beams=4,
    reach=2.0,
    directions=4,
    ranges=(10,),
    ranged=20,
    maps=(20,),
    poses=4,
    methods=METHODS[:1],
    runs=3,
)
TITLES = {
    "local_field": "Local field: 20 x 20 nodes, 8 yaws, 12 beams, 10 m",
    "fields": "Fields of all headings, 5 m; an update after each scan of an exploration",
    "growth": "Growth: 16 directions, 64 beams",
    "trajectories": "Information of a trajectory: 50 poses, 16 beams, 5 m",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of the information engine on an office that a robot explores."""
    beliefs = _exploration(sizes)
    grid = beliefs[len(beliefs) // 3]
    position = jnp.asarray(sizes.position)
    along, width, height = np.linspace(0.0, 1.0, sizes.poses), sizes.width, sizes.height
    x, y = width * (0.1 + 0.7 * along), height * (0.25 + 0.3 * along) + np.sin(6 * along)
    path = jnp.asarray(np.stack([x, y, 0 * along], axis=1), jnp.float32)
    peer = _peer(grid, position, path)
    return {
        "local_field": _local_field(grid, position, peer, sizes),
        "fields": _fields(beliefs, position, sizes),
        "growth": _growth(sizes),
        "trajectories": _trajectories(grid, path, peer, sizes),
    }


def _exploration(sizes: Sizes) -> list[OccupancyGrid]:
    """Return what a robot knows after each of its first scans in an office."""
    size = {"width": sizes.width, "height": sizes.height, "seed": 5}
    changes = {**sizes.changes, "office": size, "resolution": RESOLUTION}
    controller, scenario, _, key = experiment(OFFICE, **changes)
    state = initial_loop_state(controller, scenario, key)
    beliefs = []
    for _ in range(sizes.scans):
        # Scans come at 10 Hz, controls at 50 Hz.
        given = controller, scenario, key, jnp.asarray(5, jnp.int32)
        state, _, _ = run_chunk(given, copy_tree(state), sizes.capacity)
        beliefs.append(state.task.belief.grid)
    return beliefs


def _local_field(
    grid: OccupancyGrid, position: jax.Array, peer: dict[str, Any] | None, sizes: Sizes
) -> Rows:
    """3200 poses of beams over 90 degrees."""
    lidar, sensor = Lidar(sizes.beams, sizes.reach, math.pi / 2.0), InverseSensorModel.from_odds()
    rows = []
    for name in sizes.noises:
        pose = PoseInformation(lidar, sensor, noise=NOISES[name])
        fast = LocalFieldSensor(pose, grid.resolution)
        found = eqx.filter_jit(fast.field)(grid, position)
        nodes = jnp.stack(jnp.meshgrid(jnp.arange(20), jnp.arange(20), indexing="ij"), axis=-1)
        at = jnp.repeat(found.frame.cell_centre(nodes.reshape(-1, 2)), 8, axis=0)
        yaw = jnp.tile(found.headings, 400)
        by_ray = eqx.filter_jit(pose)(grid, at, yaw)
        shifted = timed(fast.field, grid, position, runs=sizes.runs)
        rays = timed(pose, grid, at, yaw, runs=max(1, sizes.runs // 10))
        row = {
            "": name,
            **shifted.row(),
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


def _fields(beliefs: list[OccupancyGrid], position: jax.Array, sizes: Sizes) -> Rows:
    """Whole fields, windows and updates after each scan, at 5 m."""
    model, lidar = InverseSensorModel(), Lidar(**sizes.changes["lidar"], range_noise=0.02)
    grid = beliefs[len(beliefs) // 3]
    window = [_cut(belief, sizes.window) for belief in beliefs]
    rows = []
    for grids, directions, stride in (
        (beliefs, sizes.directions, 1),
        (beliefs, sizes.directions // 2, 2),
        (window, sizes.directions // 2, 1),
    ):
        sensor = FieldSensor(lidar, RESOLUTION, directions, stride)
        field = timed(sensor.field, grids[len(grids) // 3], model, runs=sizes.runs)
        cells = " x ".join(map(str, grids[0].shape))
        name = f"{cells}, {directions} directions" + (", every 2nd cell" if stride == 2 else "")
        beams = directions * math.prod(-(-size // stride) for size in grids[0].shape)
        rows.append(
            {
                "": name,
                **field.row(),
                "million_beams_per_s": beams / field.p50_ms / 1e3,
                "memory_mb": _memory(sensor, grids[0], model),
                **_updates(sensor, grids, model),
            }
        )
    sensor = FieldSensor(lidar, RESOLUTION, sizes.directions // 2)
    shape = (sizes.window, sizes.window)
    taken = timed(lambda g, p: sensor.window(g, model, p, shape), grid, position, runs=sizes.runs)
    beams = math.prod(shape) * sizes.directions // 2
    rows.append(
        {
            "": f"window of {sizes.window} x {sizes.window} of it",
            **taken.row(),
            "million_beams_per_s": beams / taken.p50_ms / 1e3,
        }
    )
    return rows


def _updates(
    sensor: FieldSensor, grids: list[OccupancyGrid], model: InverseSensorModel
) -> dict[str, float]:
    update = eqx.filter_jit(sensor.update)
    field = eqx.filter_jit(sensor.field)(grids[0], model)
    seconds = []
    for grid in grids[1:]:
        began = time.perf_counter()
        field = update(field, grid, model)
        field.cumulative.block_until_ready()
        seconds.append(time.perf_counter() - began)
    again = eqx.filter_jit(sensor.field)(grids[-1], model)
    p50, p90 = 1e3 * np.percentile(seconds[3:], [50, 90])
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


def _growth(sizes: Sizes) -> Rows:
    """Time per cell and direction as maps and ranges grow together, by either method."""
    model, directions = InverseSensorModel(), 16
    rows: Rows = []
    rng = np.random.default_rng(0)

    def half_known(size: int) -> OccupancyGrid:
        levels = rng.choice([0.001, 0.5, 0.99], (size, size), p=[0.9, 0.099, 0.001])
        return OccupancyGrid(levels.astype(np.float32), RESOLUTION)

    ranges = [(sizes.ranged, reach) for reach in sizes.ranges]
    for size, reach in [*ranges, *((size, size // 2) for size in sizes.maps)]:
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
    sensor = FieldSensor(Lidar(max_range=RANGE, range_noise=0.02), RESOLUTION, directions, 2)
    size = max(sizes.maps)
    took = timed(sensor.field, half_known(size), model, runs=3, warm_up=1)
    rows.append(
        {
            "": f"{size} x {size} cells, range 50 cells, every 2nd cell",
            "scan_ms": took.p50_ms,
            "scan_ns_per_beam": 1e6 * took.p50_ms / (size * size / 4 * directions),
        }
    )
    return rows


def _trajectories(
    grid: OccupancyGrid, path: jax.Array, peer: dict[str, Any] | None, sizes: Sizes
) -> Rows:
    """Poses of 16 beams over 90 degrees and 5 m."""
    pose, rows = PoseInformation(Lidar(16, 5.0, math.pi / 2.0)), []
    for method in sizes.methods:
        took = timed(TrajectoryInformation(pose, method), grid, path[:, :2], runs=2 * sizes.runs)
        theirs = None if peer is None else peer["trajectory_ms"].get(method)
        rows.append({"": method, **took.row(), "jax_mppi_ms": theirs})
    return rows


def _peer(grid: OccupancyGrid, position: jax.Array, path: jax.Array) -> dict[str, Any] | None:
    """Run jax_mppi's own code on the same problem, where `make bench` has set it up."""
    with tempfile.TemporaryDirectory() as folder:
        problem = Path(folder) / "problem.npz"
        np.savez(
            problem,
            grid=np.asarray(grid.probability),
            position=np.asarray(position),
            path=np.asarray(path),
            resolution=grid.resolution,
        )
        script = Path(__file__).parent / "peers" / "jax_mppi_information.py"
        command = [PYTHONS["jax_mppi"], script, PEERS / "jax_mppi", problem]
        return run_peer([str(each) for each in command], folder)
