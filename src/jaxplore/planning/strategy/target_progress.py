"""Targets to which a robot comes no nearer, and that it therefore avoids for a while."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Count, Flag, Scalar

LEAST = 0.2
"""Distance by which the robot must come nearer for it to count [m]."""
PATIENCE = 75
"""Choices without coming nearer after which a target is given up: 15 s of choices at 5 Hz."""
MEMORY = 600
"""Choices for which a target that was given up is avoided: two minutes."""
RADIUS, MOST_DOUBLINGS = 1.0, 4
"""Distance around such a target within which all places are avoided [m], and how often it doubles
with one target after another given up."""


class TargetProgress(NamedTuple):
    """How near a robot has come to its target, and where it could not get.

    A passage that the robot fits in on the map may be one that it cannot take, because of noise or
    of something that the map does not show. A target to which it comes no nearer is then avoided
    for two minutes, with all places within 1 m. If it comes no nearer to the next one either, the
    distance doubles, up to 16 m: what lies beyond one passage is avoided together.

    Args:
        best: least distance from the target so far [m].
        waiting: number of choices since.
        stalls: number of targets that were given up one after another.
        avoided: number of choices for which each place is still avoided.
    """

    best: Scalar
    waiting: Count
    stalls: Count
    avoided: Int[Array, "*nodes"]

    @classmethod
    def begin(cls, shape: tuple[int, ...]) -> "TargetProgress":
        """Return the progress before the first choice, on a lattice of places of this shape."""
        nothing = jnp.zeros((), jnp.int32)
        return cls(jnp.asarray(jnp.inf), nothing, nothing, jnp.zeros(shape, jnp.int32))

    @property
    def may_be(self) -> Bool[Array, "*nodes"]:
        """Mask of the places that are not avoided."""
        return self.avoided == 0

    def update(
        self,
        distance: Float[Array, "*nodes"],
        node: Int[Array, " n"],
        is_on_the_way: Flag,
        spacing: float,
    ) -> "TargetProgress":
        """Return the progress at the time of a choice.

        `distance` is the length of the path to each place [m], and `spacing` the distance between
        places [m]. `is_on_the_way` is whether there is a target, `node`, that the robot has not
        reached yet.
        """
        here = distance[tuple(node)]
        is_nearer = here < self.best - LEAST
        waiting = jnp.where(is_on_the_way & ~is_nearer, self.waiting + 1, 0)
        gives_up = waiting >= PATIENCE
        radius = RADIUS * 2.0 ** jnp.minimum(self.stalls, MOST_DOUBLINGS).astype(jnp.float32)
        index = jnp.stack(jnp.meshgrid(*map(jnp.arange, distance.shape), indexing="ij"))
        gap = (index - node.reshape(-1, *[1] * distance.ndim)).astype(jnp.float32) * spacing
        is_near = jnp.sum(gap * gap, axis=0) <= radius * radius
        left = jnp.maximum(self.avoided - 1, 0)
        stalls = jnp.where(gives_up, self.stalls + 1, jnp.where(is_nearer, 0, self.stalls))
        return TargetProgress(
            jnp.where(is_nearer, here, self.best),
            jnp.where(gives_up, 0, waiting),
            stalls,
            jnp.where(gives_up & is_near, MEMORY, left),
        )

    def towards(self, distance: Scalar, is_new: Flag) -> "TargetProgress":
        """Return the progress after a choice of a target; the path to it is `distance` [m] long.

        `is_new` is whether it is another target than before.
        """
        return self._replace(
            best=jnp.where(is_new, distance, self.best),
            waiting=jnp.where(is_new, 0, self.waiting),
        )
