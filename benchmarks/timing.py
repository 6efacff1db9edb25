"""Wall-clock times of compiled functions."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np


@dataclasses.dataclass(frozen=True)
class Timed:
    """Times of one function; compilation and warm-up apart."""

    compile_seconds: float
    p50_ms: float
    p99_ms: float
    runs: int


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
    p50, p99 = 1e3 * np.percentile(seconds, [50, 99])
    return Timed(first, float(p50), float(p99), runs)


def _wait(result: Any) -> None:
    for leaf in jax.tree.leaves(result):
        leaf.block_until_ready()
