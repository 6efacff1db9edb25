"""Times of jax_mppi's information layer, in the environment that `make bench` sets up.

    python jax_mppi_information.py SOURCE PROBLEM.npz

SOURCE is the unpacked package: its build needs a CUDA tool chain, its JAX part does not, so only
that part is imported. PROBLEM holds the map, the pose and the path; the result is JSON on stdout.
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


def main() -> None:
    """Time the field and the trajectory methods on the problem given."""
    source, problem = Path(sys.argv[1]), np.load(sys.argv[2], allow_pickle=False)
    fsmi = _import(source)
    grid, position, path = (jnp.asarray(problem[name]) for name in ("grid", "position", "path"))
    resolution, origin = float(problem["resolution"]), jnp.zeros(2)

    field_sensor = fsmi.FSMIModule(
        fsmi.FSMIConfig(num_beams=12, max_range=10.0), origin, resolution
    )
    config = fsmi.InfoFieldConfig()
    field = jax.jit(lambda g, p: fsmi.compute_info_field(field_sensor, g, p, config)[0])
    sensor = fsmi.FSMIModule(fsmi.FSMIConfig(num_beams=16, max_range=5.0), origin, resolution)
    methods = {
        "direct": lambda g, p: fsmi.fsmi_trajectory_direct(sensor, p, g, 1, 1.0),
        "discount": lambda g, p: fsmi.fsmi_trajectory_discounted(sensor, p, g, 1, 1.0),
        "filtered": lambda g, p: fsmi.fsmi_trajectory_filtered(sensor, p, g, 1, 1.0),
    }
    print(
        json.dumps(
            {
                "field_ms": _median(field, grid, position),
                "field": np.asarray(field(grid, position)).tolist(),
                "trajectory_ms": {
                    name: _median(jax.jit(method), grid, path) for name, method in methods.items()
                },
            }
        )
    )


def _median(function: Callable[..., Any], *arguments: Any, runs: int = 30) -> float:
    for _ in range(3):
        jax.block_until_ready(function(*arguments))  # type: ignore[no-untyped-call]
    seconds = []
    for _ in range(runs):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))  # type: ignore[no-untyped-call]
        seconds.append(time.perf_counter() - began)
    return 1e3 * float(np.median(seconds))


def _import(source: Path) -> Any:
    """Import the module without its packages' __init__, which load what is not installed."""
    for name in ("jax_mppi", "jax_mppi.i_mppi"):
        package = types.ModuleType(name)
        package.__path__ = [str(source / "src" / name.replace(".", "/"))]
        sys.modules[name] = package
    return importlib.import_module("jax_mppi.i_mppi.fsmi")


if __name__ == "__main__":
    main()
