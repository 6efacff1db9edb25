"""Where XLA's CPU back end needs to be told not to fuse.

It makes one loop per output and computes again, in each of them, whatever the outputs share. A step
of a model has as many outputs as the state has components, and all share the same derivatives: the
step of a quadrotor is computed up to 13 times. Values that are cut are computed once and read.
Other back ends fuse several outputs into one kernel, where a cut would only cost memory traffic.
"""

from typing import TypeVar

import jax

Tree = TypeVar("Tree")


def cut[Tree](tree: Tree) -> Tree:
    """Return `tree`, computed once before whatever reads it; on a CPU only."""
    result: Tree = jax.lax.platform_dependent(
        tree,
        cpu=jax.lax.optimization_barrier,
        default=lambda unchanged: unchanged,
    )
    return result
