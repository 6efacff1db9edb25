"""Stop XLA's CPU back end from computing shared values once per output.

The CPU back end emits one loop per output, and each loop recomputes what the outputs share. A step
of a robot model has one output per state component, and all share the derivatives: the step of a
quadrotor would be computed up to 13 times. `cut` makes shared values be computed once and read.
Other back ends fuse several outputs into one kernel, where a cut would only cost memory traffic.
"""

from typing import TypeVar

import jax

Tree = TypeVar("Tree")


def cut[Tree](tree: Tree) -> Tree:
    """Return `tree` unchanged, behind an optimization barrier if it runs on a CPU."""
    result: Tree = jax.lax.platform_dependent(
        tree,
        cpu=jax.lax.optimization_barrier,
        default=lambda unchanged: unchanged,
    )
    return result
