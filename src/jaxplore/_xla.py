"""Spare XLA work: values that several outputs share, and programs of a single operation."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def on_device(values: np.ndarray) -> Array:
    """Return a NumPy array that nobody else holds as a JAX array.

    `jnp.asarray` copies it by a program, which is compiled for every shape. This may share its
    memory instead.
    """
    shared: Array = jax.device_put(values)
    return shared


def compute(function: Callable[..., Any], *values: Any) -> Array:
    """Return the array `function(xp, *values)`: `xp` is `numpy`, or `jax.numpy` for traced values.

    Outside of `jax.jit`, JAX compiles a program for each operation and shape. Constructors compute
    a few numbers once, for which NumPy gives the same float32 values at once.
    """
    if any(isinstance(value, jax.core.Tracer) for value in values):
        traced: Array = function(jnp, *values)
        return traced
    return on_device(np.asarray(function(np, *map(np.asarray, values))))


def cut[Tree](tree: Tree) -> Tree:
    """Return `tree` unchanged, behind an optimization barrier if it runs on a CPU.

    The CPU back end emits one loop per output, and each loop recomputes what the outputs share. A
    step of a robot model has one output per state component, and all share the derivatives: the
    step of a quadrotor would be computed up to 13 times. A cut makes shared values be computed once
    and read. Other back ends fuse several outputs into one kernel, where a cut would only cost
    memory traffic.
    """
    result: Tree = jax.lax.platform_dependent(
        tree,
        cpu=jax.lax.optimization_barrier,
        default=lambda unchanged: unchanged,
    )
    return result
