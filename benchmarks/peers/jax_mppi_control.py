"""Times of a command of jax_mppi, in the environment that `make bench` sets up.

    python jax_mppi_control.py SOURCE PROBLEM.npz VARIANT

SOURCE is the unpacked package: its build needs a CUDA tool chain, its JAX part does not, so only
that part is imported. PROBLEM holds sizes, states and arrays: a quadrotor, or with a cost map a
differential drive; both models are jax_mppi's own. VARIANT is plain, smooth or kernel. The result
is JSON on stdout: times of a compiled command, and what the given controls cost, to check that
everybody solves the same problem.
"""

import importlib
import json
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Problem = dict[str, jax.Array]
Model = Callable[[Any, Any], Any]


def main() -> None:
    """Time the variant on the problem given."""
    source, variant = Path(sys.argv[1]), sys.argv[3]
    with np.load(sys.argv[2], allow_pickle=False) as file:
        problem = {name: jnp.asarray(file[name]) for name in file.files}
    _prepare_imports(source)
    model, cost = _drive(problem) if "cost_map" in problem else _quadrotor(problem)
    command, state = _controller(variant, problem, model, cost)
    result = _timed(command, state, problem["start"], int(problem["runs"]))
    print(json.dumps({**result, "probe_cost": _probe(problem, model, cost)}))


class _Shaped:
    """Stands for jaxtyping's `Float`, which jax_mppi uses in annotations only."""

    def __class_getitem__(cls, _: Any) -> type:
        return jax.Array


def _prepare_imports(source: Path) -> None:
    """Import modules without their packages' __init__, which load what is not installed."""
    for name in ("jax_mppi", "jax_mppi.dynamics"):
        package = types.ModuleType(name)
        package.__path__ = [str(source / "src" / name.replace(".", "/"))]
        sys.modules[name] = package
    annotations: Any = types.ModuleType("jaxtyping")
    annotations.Array, annotations.Float = jax.Array, _Shaped
    sys.modules["jaxtyping"] = annotations


def _controller(
    variant: str, problem: Problem, model: Model, cost: Model
) -> tuple[Callable[..., Any], Any]:
    std, dt = problem["noise_std"], float(problem["dt"])
    shared: dict[str, Any] = {
        "nx": problem["start"].shape[0],
        "nu": std.shape[0],
        "noise_sigma": jnp.diag(std**2),
        "num_samples": int(problem["num_samples"]),
        "horizon": int(problem["horizon"]),
        "lambda_": float(problem["temperature"]),
        "U_init": jnp.tile(problem["default_control"], (int(problem["horizon"]), 1)),
    }
    bounds = {"min": problem["control_min"], "max": problem["control_max"]}
    if variant == "smooth":
        shared.update({f"action_{name}": value for name, value in bounds.items()})
        shared["noise_sigma"] = jnp.diag((std / dt) ** 2)
        weight = float(problem["smoothness_weight"])
        module = importlib.import_module("jax_mppi.smppi")
        config, state = module.create(**shared, delta_t=dt, w_action_seq_cost=weight)
        return jax.jit(lambda s, x: module.command(config, s, x, model, cost)), state
    shared.update({f"u_{name}": value for name, value in bounds.items()})
    shared["u_init"] = problem["default_control"]
    if variant == "kernel":
        module = importlib.import_module("jax_mppi.kmppi")
        kernel, knots = module.RBFKernel(float(problem["length_scale"])), int(problem["num_knots"])
        config, state, kernel = module.create(**shared, num_support_pts=knots, kernel=kernel)
        return jax.jit(lambda s, x: module.command(config, s, x, model, cost, kernel)), state
    module = importlib.import_module("jax_mppi.mppi")
    config, state = module.create(**shared)
    return jax.jit(lambda s, x: module.command(config, s, x, model, cost)), state


def _timed(
    command: Callable[..., Any], state: Any, start: jax.Array, runs: int
) -> dict[str, float]:
    seconds: list[float] = []
    while len(seconds) < 4 + runs and (len(seconds) < 24 or sum(seconds[4:]) < 10.0):
        began = time.perf_counter()
        control, state = command(state, start)
        jax.block_until_ready((control, state))  # type: ignore[no-untyped-call]
        seconds.append(time.perf_counter() - began)
    p50, p99 = 1e3 * np.percentile(seconds[4:], [50, 99])
    return {"compile_seconds": seconds[0], "p50_ms": float(p50), "p99_ms": float(p99)}


def _probe(problem: Problem, model: Model, cost: Model) -> float:
    def advance(state: jax.Array, control: jax.Array) -> tuple[jax.Array, jax.Array]:
        state = model(state, control)
        return state, cost(state, control)

    _, paid = jax.lax.scan(advance, problem["start"], problem["probe"])
    return float(paid.sum())


def _quadrotor(problem: Problem) -> tuple[Model, Model]:
    create = importlib.import_module("jax_mppi.dynamics.quadrotor").create_quadrotor_dynamics
    goal = problem["goal"]

    def cost(state: jax.Array, control: jax.Array) -> jax.Array:
        away = [state[i] - goal[i] for i in range(3)]
        total: jax.Array = sum((d * d for d in away), jnp.zeros(()))
        return total + 0.01 * sum((u * u for u in control), jnp.zeros(()))

    return create(dt=float(problem["dt"])), cost


def _drive(problem: Problem) -> tuple[Model, Model]:
    create = importlib.import_module("jax_mppi.dynamics.ugv").create_diffdrive_dynamics
    values, goal, origin = problem["cost_map"], problem["goal"], problem["origin"]
    resolution, (rows, columns) = float(problem["resolution"]), values.shape

    def cost(state: jax.Array, control: jax.Array) -> jax.Array:
        x, y = state[0], state[1]
        column = jnp.clip((x - origin[0]) / resolution - 0.5, 0.0, columns - 1.0)
        row = jnp.clip((y - origin[1]) / resolution - 0.5, 0.0, rows - 1.0)
        i = jnp.minimum(row.astype(jnp.int32), rows - 2)
        j = jnp.minimum(column.astype(jnp.int32), columns - 2)
        v, u = row - i, column - j
        paid = (1 - v) * ((1 - u) * values[i, j] + u * values[i, j + 1])
        paid += v * ((1 - u) * values[i + 1, j] + u * values[i + 1, j + 1])
        return paid + jnp.sqrt((x - goal[0]) ** 2 + (y - goal[1]) ** 2)

    return create(dt=float(problem["dt"])), cost


if __name__ == "__main__":
    main()
