"""The robots of a fleet that one process computes, and how it hears of those of the others."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

type Meet = Callable[[list[np.ndarray]], list[np.ndarray]]
"""Function from arrays (M, ...) of the robots of this process to the same (N, ...) of all robots.
It waits until every process has called it."""


class Share(eqx.Module):
    """The robots of a fleet that this process computes: all of them, unless there are several.

    Every process runs the same closed loop, with the states of all robots, and does the costly
    part, scans, fields and controls, for its own robots. What follows from them is gathered. So all
    processes take the same decisions, and the run is that of one process.

    `mine` are the places of the own robots in the fleet, and `number` is that of all robots. `meet`
    is how to hear of the others; None if all robots are here.
    """

    mine: tuple[int, ...] = eqx.field(static=True)
    number: int = eqx.field(static=True)
    meet: Meet | None = eqx.field(static=True, default=None)

    @classmethod
    def whole(cls, number: int) -> "Share":
        """Return the share of a process that computes all robots."""
        return cls(tuple(range(number)), number)

    @property
    def is_whole(self) -> bool:
        """Whether all robots are here."""
        return self.meet is None

    def select[T](self, things: Sequence[T]) -> tuple[T, ...]:
        """Return the things of the own robots, of those of all."""
        return tuple(things[i] for i in self.mine)

    def gather(self, rows: Sequence[Any]) -> list[Any]:
        """Return one pytree of each robot, from those of the own robots; traced.

        All have the same structure and shapes.
        """
        if self.meet is None:
            return list(rows)
        leaves, structure = jax.tree.flatten(jax.tree.map(lambda *own: jnp.stack(own), *rows))
        shapes = [
            jax.ShapeDtypeStruct((self.number, *leaf.shape[1:]), leaf.dtype)  # type: ignore[no-untyped-call]
            for leaf in leaves
        ]
        meet = self.meet

        def wait(*given: Any) -> list[np.ndarray]:
            return meet([np.asarray(each) for each in given])

        # The order of the meetings is that of the program, which is the same in all processes.
        found = io_callback(wait, shapes, *leaves, ordered=True)
        return [
            jax.tree.unflatten(structure, [leaf[i] for leaf in found]) for i in range(self.number)
        ]

    def gather_on_host(self, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return one array of each robot, from those of the own robots; on the host."""
        if self.meet is None:
            return list(arrays)
        return list(self.meet([np.stack(arrays)])[0])


def check_share(share: Share, kinds: Sequence[Any], name: str) -> None:
    """Check that several processes can compute the robots: two or more, and all equal.

    `kinds` are the distinct things of the robots; the message calls them `name`.
    """
    if share.number < 2 or len(kinds) > 1:
        raise ValueError(
            f"{name} are {share.number} of {len(kinds)} kinds; accepted in several processes: two "
            "or more equal robots"
        )
