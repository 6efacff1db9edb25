"""Times of jax_mppi's parallel informative simulation, in the environment of `make bench`.

    python jax_mppi_informative.py SOURCE STEPS

SOURCE is the unpacked package: its build needs a CUDA tool chain, its JAX part does not, so only
that part is imported. Its own `examples/i_mppi/i_mppi_parallel_simulation.py` runs as it is, with
all its numbers, up to the simulation that it builds; plots and the progress bar, which are not
installed, are stood in for, and nothing is called back while it runs. The simulation, of STEPS
steps, is compiled as the script does it, and then the step that it scans over alone.

Lines of JSON on stdout: first what compiling took and the sizes; then, for each line on stdin, the
times of STEPS single steps and the mean of a step of the whole simulation.
"""

import contextlib
import importlib
import inspect
import io
import json
import sys
import time
import types
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import jax
import jax.numpy as jnp


class _CapturedError(Exception):
    """Ends the script where its simulation would begin."""


def main() -> None:
    """Compile; then time the step and the simulation, turn by turn."""
    source, steps = Path(sys.argv[1]), int(sys.argv[2])
    given, start, controller = _capture(source)
    tools: Any = importlib.import_module("sim_utils")
    simulation = tools.build_parallel_sim_fn(
        **{**given, "sim_steps": steps, "progress_callback": None}
    )
    began = time.perf_counter()
    compiled = simulation.lower(start, controller).compile()
    compile_seconds = time.perf_counter() - began

    config, grid = given["info_field_config"], given["grid_map_obj"].grid
    field, origin = tools.compute_info_field(given["fsmi_module"], grid, start[:3], config)
    reference = jnp.zeros((config.ref_horizon, 3))  # Step 0 makes one.
    carry: Any = (start, controller, field, origin, grid, reference, jnp.array(0, jnp.int32))
    step = jax.jit(inspect.getclosurevars(simulation.__wrapped__).nonlocals["step_fn"])
    _wait(step(carry, jnp.asarray(0)))
    sizes = {
        "samples": given["mppi_config"].num_samples,
        "horizon": given["mppi_config"].horizon,
        "cells": list(grid.shape),
        "nodes": list(field.shape),
    }
    print(json.dumps({"compile_seconds": compile_seconds, **sizes}), flush=True)

    now, every = 0, config.field_update_interval
    for _ in sys.stdin:
        single = []
        for t in range(now, now + every + steps):
            index = jnp.asarray(t)
            began = time.perf_counter()
            carry, _ = _wait(step(carry, index))
            single.append((t % every == 0, 1e3 * (time.perf_counter() - began)))
        now += every + steps
        began = time.perf_counter()
        _wait(compiled(start, controller))
        mean = 1e3 * (time.perf_counter() - began) / steps
        # The first steps warm up what ran before has cooled.
        print(json.dumps({"single": single[every:], "loop_mean_ms": mean}), flush=True)


def _wait(result: Any) -> Any:
    return jax.block_until_ready(result)  # type: ignore[no-untyped-call]


def _capture(source: Path) -> tuple[dict[str, Any], Any, Any]:
    """Return what the script builds its simulation from: parts, first state, controller."""
    _prepare_imports(source)
    script: Any = importlib.import_module("i_mppi_parallel_simulation")

    def build(**given: Any) -> Any:
        def simulate(*initial: Any) -> None:
            raise _CapturedError(given, *initial)

        return simulate

    script.build_parallel_sim_fn = build
    sys.argv = sys.argv[:1]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            script.main()
    except _CapturedError as captured:
        given, start, controller = captured.args
        return given, start, controller
    raise RuntimeError("i_mppi_parallel_simulation.py ran no simulation")


def _prepare_imports(source: Path) -> None:
    """Import modules without their packages' __init__, which load what is not installed."""
    for name in ("jax_mppi", "jax_mppi.dynamics", "jax_mppi.i_mppi"):
        package = types.ModuleType(name)
        package.__path__ = [str(source / "src" / name.replace(".", "/"))]
        sys.modules[name] = package
    for name in ("jaxtyping", "matplotlib", "matplotlib.pyplot", "tqdm", "viz_utils"):
        sys.modules[name] = MagicMock()
    sys.path.insert(0, str(source / "examples" / "i_mppi"))


if __name__ == "__main__":
    main()
