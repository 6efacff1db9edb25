"""Contouring control along an S-curve, ours and Faran's: times of a step, and how well it follows.

The problem is that of Faran's README: its waypoints and spline, car, Euler's rule, noise,
temperature and weights. Its path parameter runs to 35 units, of which each is worth 1000; ours is
the arc length, and gains the same over the whole path. The rest is what each library has by
default: Faran draws new noise at each step of the horizon, ours draws the knots of splines. Beside
that, ours with the integrator that our car has by default, Runge and Kutta's.

A time is that of one whole `planner.step` in its closed loop, from Python until the optimal
controls are there; of ours with the making of its key, which Faran's planners do within the step.
Ours is timed before and after each peer.

The car stands at first. A run is over when the path parameter is `NEAR_END` before the path's end,
or after `steps`. Contouring and lag errors are what each library's own objects say, from its own
reference point; `distance` is that from the car to the nearest point of the path, for all alike.
"""

import functools
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxplore as jx
from benchmarks.control_peers import PYTHONS, run_peer
from benchmarks.tables import Rows
from benchmarks.timing import percentiles
from jaxplore.planning.presets.path_following import PathFollowing

BACKENDS = {"numpy": "Faran, NumPy", "jax": "Faran, JAX"}
PRECISE = "jaxplore, Runge-Kutta"
NEAR_END = 0.8
PROBLEM: dict[str, Any] = {
    "waypoints": [(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)],
    "path_length": 35.0,
    "wheelbase": 2.5,
    "dt": 0.1,
    "max_speed": 15.0,
    "max_steering": 0.5,
    "max_acceleration": 3.0,
    "noise_std": [0.5, 0.05],
    "temperature": 50.0,
    "contouring_weight": 100.0,
    "lag_weight": 100.0,
    "progress_weight": 1000.0,
}
Run = dict[str, Any]


class Sizes(NamedTuple):
    """Samples and horizons, steps of a run, its seeds, and timed steps after those that warm up."""

    controllers: tuple[tuple[int, int], ...] = ((256, 30), (1000, 40))
    run_steps: int = 100
    runs: int = 20
    timed_steps: int = 400
    warm_up: int = 20


class _Driver(NamedTuple):
    """Controller of a car on a path, and its compiled step: memory, state and key in, control and
    memory out."""

    following: PathFollowing
    step: Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, Any]]


FULL = Sizes()
SMOKE = Sizes(((8, 4),), 6, 1, 3, 2)
TITLES = {
    "step": "Contouring control along an S-curve, a step, and Faran's",
    "tracking": "How well it follows: K = 256, T = 30, at most 10 s",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of all sizes, and how well the first of them follows."""
    # Natural, as Faran's spline: with another one the curve is another, by up to a metre.
    path = jx.path_through(PROBLEM["waypoints"], boundary="natural")
    times: Rows = []
    tracking: Rows = []
    with tempfile.TemporaryDirectory() as folder:
        for samples, horizon in sizes.controllers:
            seeds = 0 if tracking else sizes.runs
            problem = {
                **PROBLEM,
                "rollouts": samples,
                "horizon": horizon,
                "seeds": seeds,
                "steps": sizes.run_steps,
                "timed_steps": sizes.timed_steps,
                "warm_up": sizes.warm_up,
            }
            file = Path(folder) / "problem.json"
            file.write_text(json.dumps(problem), encoding="utf-8")
            ordinary = _driver(problem, path, jx.Euler())
            precise = _driver(problem, path, jx.RK4())
            ours = [_seconds(ordinary, problem)]
            theirs = [_times_row(PRECISE, _times([_seconds(precise, problem)], sizes.warm_up))]
            runs = {
                library: [_follow(each, problem, path, seed) for seed in range(seeds)]
                for library, each in (("jaxplore", ordinary), (PRECISE, precise))
            }
            for backend, library in BACKENDS.items():
                result = run_peer(_command(backend, file), folder)
                ours.append(_seconds(ordinary, problem))
                # Those of our runs before and after it.
                beside = _times(ours[-2:], sizes.warm_up)["p50_ms"]
                row = _times_row(library, result)
                if result is not None:
                    row["times_as_long_as_jaxplore"] = result["p50_ms"] / beside
                    runs[library] = result["runs"]
                theirs.append(row)
            mine = _times(ours, sizes.warm_up)
            title = f"K = {samples}, T = {horizon}"
            times += [{"": title, **row} for row in (_times_row("jaxplore", mine), *theirs)]
            if seeds:
                tracking = [_tracking_row(library, kept, path) for library, kept in runs.items()]
    return {"step": times, "tracking": tracking}


def _command(backend: str, problem: Path) -> list[str]:
    script = Path(__file__).parent / "peers" / "faran_mpcc.py"
    return [str(PYTHONS["Faran"]), str(script), backend, str(problem)]


def _driver(problem: dict[str, Any], path: jx.Path, integrator: jx.Integrator) -> _Driver:
    limits = {name: problem[name] for name in ("max_speed", "max_acceleration", "max_steering")}
    # Faran's car is known by its rear axle; ours may not stand right on it.
    car = jx.KinematicBicycle(problem["wheelbase"], 1e-3, **limits, integrator=integrator)
    shared = ("noise_std", "max_speed", "contouring_weight", "lag_weight", "horizon", "dt")
    following = jx.mpcc(
        car,
        path,
        num_samples=problem["rollouts"],
        temperature=problem["temperature"],
        comfort_weight=None,
        progress_weight=problem["progress_weight"] * problem["path_length"] / float(path.length),
        **{name: problem[name] for name in shared},
    )
    # What is no array is split off once: to do it in each call takes a tenth of a millisecond.
    arrays, fixed = eqx.partition(following.controller, eqx.is_array)

    @jax.jit
    def step(arrays: Any, memory: Any, state: jax.Array, key: jax.Array) -> tuple[jax.Array, Any]:
        controller: jx.MPPI = eqx.combine(arrays, fixed)
        control, memory, _ = controller.step(memory, state, key=key)
        return control, memory

    return _Driver(following, functools.partial(step, arrays))


def _drive(
    driver: _Driver, problem: dict[str, Any], seed: int
) -> Iterator[tuple[jax.Array, float]]:
    """Yield the state after each step, and the time it took."""
    controller, model = driver.following.controller, driver.following.model
    move = jax.jit(lambda state, control: model.step(state, control, jnp.asarray(problem["dt"])))
    state, memory = model.at_pose(0.0, 0.0, 0.0), controller.init()
    for number in range(problem["steps"]):
        jax.block_until_ready((state, memory))  # type: ignore[no-untyped-call]
        began = time.perf_counter()
        key = jax.random.key(problem["steps"] * seed + number)
        control, memory = driver.step(memory, state, key)
        control.block_until_ready()
        spent = time.perf_counter() - began
        state = move(state, control)
        yield state, spent


def _seconds(driver: _Driver, problem: dict[str, Any]) -> list[float]:
    """Time steps along the path, which begins anew when a run is over [s]."""
    seconds: list[float] = []
    seed = 0
    while len(seconds) < problem["warm_up"] + problem["timed_steps"]:
        seconds += [spent for _, spent in _drive(driver, problem, seed)]
        seed += 1
    return seconds


def _times(turns: list[list[float]], warm_up: int) -> dict[str, Any]:
    """Return the times of all turns together, the first call apart."""
    together = percentiles([spent for each in turns for spent in each[warm_up:]])
    return {**together, "compile_seconds": turns[0][0]}


def _follow(driver: _Driver, problem: dict[str, Any], path: jx.Path, seed: int) -> Run:
    following = driver.following
    states = jnp.stack([state for state, _ in _drive(driver, problem, seed)])
    return {
        "positions": states[:, :2],
        "share": states[:, -1] / path.length,
        "contouring": eqx.filter_jit(following.contouring.errors)(states, following.model),
        "lag": eqx.filter_jit(following.lag.errors)(states, following.model),
    }


def _times_row(library: str, times: dict[str, Any] | None) -> dict[str, Any]:
    names = {"p50_ms": "p50_ms", "p99_ms": "p99_ms", "first_call_s": "compile_seconds"}
    row = {short: None if times is None else times[name] for short, name in names.items()}
    repeats = {"repeats": times["repeats"]} if times and "repeats" in times else {}
    return {"library": library, **row, "times_as_long_as_jaxplore": None, **repeats}


def _tracking_row(library: str, runs: list[Run], path: jx.Path) -> dict[str, Any]:
    """Return how well the runs followed the path, over all their steps until they were over."""
    errors: dict[str, list[np.ndarray]] = {"contouring": [], "lag": [], "distance": []}
    seconds, finished = [], 0
    for run in runs:
        share = np.asarray(run["share"])
        there = np.flatnonzero(share >= 1.0 - NEAR_END / float(path.length))
        steps = int(there[0]) + 1 if there.size else share.size
        finished += bool(there.size)
        seconds.append(steps * PROBLEM["dt"])
        for name in ("contouring", "lag"):
            errors[name].append(np.abs(run[name])[:steps])
        errors["distance"].append(_distances(run["positions"], path)[:steps])
    row: dict[str, Any] = {"library": library}
    for name in errors:
        together = np.concatenate(errors[name])
        row[f"{name}_mean_m"] = float(together.mean())
        if name != "distance":
            row[f"{name}_max_m"] = float(together.max())
    return {**row, "finished": f"{finished} of {len(runs)}", "median_s": float(np.median(seconds))}


def _distances(positions: Any, path: jx.Path) -> np.ndarray:
    points = np.asarray(positions, np.float32)
    each = jax.vmap(lambda path, point: path.at(path.nearest(point)).position, (None, 0))
    nearest = np.asarray(eqx.filter_jit(each)(path, points))
    return np.asarray(np.linalg.norm(points - nearest, axis=1))
