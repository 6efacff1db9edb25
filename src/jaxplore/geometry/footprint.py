"""What a robot covers of the ground."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar


class Footprint(eqx.Module):
    """Outline of a robot on the ground, in its own frame: x ahead, the origin at its position.

    Equal discs with their centres along the heading cover it together, so that costs which know
    only distances from a point hold for all of the robot:

        the footprint is within the union over i of the discs of `radius` around (offsets_i, 0)

    The number of discs C is static.
    """

    offsets: eqx.AbstractVar[Float[Array, " C"]]
    radius: eqx.AbstractVar[Scalar]


class Disc(Footprint):
    """Disc around the robot's position; it covers itself.

    Args:
        radius: [m].

    Raises:
        ValueError: a negative radius, or none that is finite.
    """

    radius: Scalar

    def __init__(self, radius: ArrayLike) -> None:
        self.radius = _checks.scalar("radius", radius, at_least=0.0)

    # mypy takes what a subclass has to provide for a field; computed, it cannot disagree.
    @property  # type: ignore[misc]
    def offsets(self) -> Float[Array, " C"]:  # type: ignore[override]
        """Centre of the one disc along the heading, (1,) [m]: 0."""
        return jnp.zeros(1)


class Rectangle(Footprint):
    """Rectangle along the heading, covered by C discs, one for each of C equal parts:

        l = front + rear
        offsets_i = -rear + (i + 1/2) l / C,  radius = sqrt((l / (2 C))^2 + (width / 2)^2)

    More discs follow the outline more closely, and costs evaluate each.

    Source: Ziegler and Stiller, "Fast collision checking for intelligent vehicle motion planning",
    IV 2010.

    Args:
        front: from the origin to the front edge [m].
        rear: from the origin to the rear edge, positive backwards [m].
        width: [m].
        num_discs: C, static; the length over the width, rounded up, when absent. In traced code,
            where lengths are not known, it has to be given.

    Raises:
        ValueError: a front or width that is not positive, a negative rear, a number of discs below
            1, or none beside traced lengths.
    """

    front: Scalar
    rear: Scalar
    width: Scalar
    num_discs: int = eqx.field(static=True)

    def __init__(
        self,
        front: ArrayLike,
        rear: ArrayLike,
        width: ArrayLike,
        num_discs: int | None = None,
    ) -> None:
        self.front = _checks.scalar("front", front, above=0.0)
        self.rear = _checks.scalar("rear", rear, at_least=0.0)
        self.width = _checks.scalar("width", width, above=0.0)
        if num_discs is None:
            if _checks.is_traced(front, rear, width):
                raise ValueError(
                    "num_discs is None; accepted: a whole number >= 1 where lengths are traced"
                )
            length = np.float64(self.front) + np.float64(self.rear)
            # Less a rounding error: a length of exactly three widths needs three discs.
            num_discs = max(1, math.ceil(length / np.float64(self.width) - 1e-6))
        self.num_discs = _checks.positive_int("num_discs", num_discs)

    @property
    def length(self) -> Scalar:
        """From the rear edge to the front edge [m]."""
        return self.front + self.rear

    @property  # type: ignore[misc]
    def offsets(self) -> Float[Array, " C"]:  # type: ignore[override]
        """Centres of the discs along the heading, (C,) from the rear to the front [m]."""
        shares = (np.arange(self.num_discs, dtype=np.float32) + 0.5) / np.float32(self.num_discs)
        return jnp.asarray(shares) * self.length - self.rear

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs [m]."""
        return jnp.hypot(0.5 / self.num_discs * self.length, 0.5 * self.width)
