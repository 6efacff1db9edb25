"""Wall-clock times of compiled functions."""

import dataclasses
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore.control.base import Controller
from jaxplore.simulation.chunks import CHUNK_SECONDS
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.simulation.scenario import Scenario


@dataclasses.dataclass(frozen=True)
class Timed:
    """Times of one function; compilation and warm-up apart."""

    compile_seconds: float
    seconds: list[float]

    @property
    def p50_ms(self) -> float:
        """The median [ms]."""
        return 1e3 * float(np.median(self.seconds))

    def row(self) -> dict[str, Any]:
        """Return the median, the 99th percentile, and the repetitions."""
        return percentiles(self.seconds)


REPEATS = 5
"""Number of parts of a measurement of which `python -m benchmarks --compare` knows the medians."""


def percentiles(seconds: Sequence[float]) -> dict[str, Any]:
    """Return the median and the 99th percentile of times [ms], and `repeats`: the medians of parts
    one after the other, which say how much the machine let the median vary meanwhile.

    Args:
        seconds: times in the order in which they were taken [s].
    """
    p50, p99 = 1e3 * np.percentile(seconds, [50, 99])
    parts = np.array_split(np.asarray(seconds), min(REPEATS, len(seconds)))
    repeats = [1e3 * float(np.median(part)) for part in parts]
    return {"p50_ms": float(p50), "p99_ms": float(p99), "repeats": repeats}


def timed(
    function: Callable[..., Any], *arguments: Any, runs: int = 200, warm_up: int = 3
) -> Timed:
    """Compile, warm up and time a function of pytrees of arrays."""
    compiled = eqx.filter_jit(function)
    began = time.perf_counter()
    _wait(compiled(*arguments))
    first = time.perf_counter() - began
    for _ in range(warm_up):
        _wait(compiled(*arguments))
    seconds = []
    for _ in range(runs):
        began = time.perf_counter()
        _wait(compiled(*arguments))
        seconds.append(time.perf_counter() - began)
    return Timed(first, seconds)


class TimedLoop:
    """A closed loop that runs on, some steps at a time, and says how long they took.

    Args:
        controller: controller of the robot.
        scenario: the task.
        key: random key of the run.
        chunk: greatest number of steps at a time.
    """

    def __init__(
        self, controller: Controller, scenario: Scenario, key: jax.Array, chunk: int
    ) -> None:
        self.controller = controller.at_period(scenario.control_period)
        self.scenario, self.key, self.chunk = scenario, key, chunk
        # A few steps at a time run the very program of `simulate`.
        self._capacity = max(chunk, round(CHUNK_SECONDS / float(scenario.period)))
        self.state = copy_tree(initial_loop_state(self.controller, scenario, key))

    def run(self, count: int) -> float:
        """Run a number of steps, and return how long they took [s]. The first call compiles."""
        began = time.perf_counter()
        given = self.controller, self.scenario, self.key, jnp.asarray(count, jnp.int32)
        self.state, _, _ = run_chunk(given, self.state, self._capacity)
        _wait(self.state)
        return time.perf_counter() - began

    def turns(self, steps: int) -> tuple[list[float], list[float]]:
        """Run chunks, and as many steps one at a time, in turns: both see the same noise.

        Args:
            steps: number of the steps that run one at a time.

        Returns:
            The time of a step in each chunk, and of each single step [s].
        """
        chunks: list[float] = []
        single: list[float] = []
        for _ in range(steps // self.chunk):
            chunks.append(self.run(self.chunk) / self.chunk)
            single.extend(self.run(1) for _ in range(self.chunk))
        return chunks, single


def measure_cases(
    function: Callable[..., dict[str, Any]],
    cases: Sequence[Sequence[object]],
    *,
    are_apart: bool = True,
    environment: Mapping[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Return the row of each case, measured in a process of its own, so that its memory is that of
    the process.

    Args:
        function: function of a module that returns the row of a case.
        cases: arguments of each case, which JSON can hold.
        are_apart: whether each has a process. Without one, nothing is imported and compiled again.
        environment: variables that are set for the process.
    """
    rows = []
    for each in cases:
        given = json.dumps(each)
        if not are_apart:
            rows.append(function(*json.loads(given)))
            continue
        name = f"{function.__module__}:{function.__name__}"
        command = [sys.executable, "-m", __spec__.name, name, given]
        folder = Path(__file__).parents[1]
        done = subprocess.run(
            command,
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            cwd=folder,
            env={**os.environ, **(environment or {})},
        )
        rows.append(json.loads(done.stdout.splitlines()[-1]))
        print(rows[-1], flush=True)
    return rows


def _wait(result: Any) -> None:
    for leaf in jax.tree.leaves(result):
        leaf.block_until_ready()


if __name__ == "__main__":
    module, name = sys.argv[1].split(":")
    row = getattr(importlib.import_module(module), name)(*json.loads(sys.argv[2]))
    print(json.dumps(row))
