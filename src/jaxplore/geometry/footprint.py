"""Describe the area that a robot covers on the ground, as discs."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DISCS
from jaxplore._types import ArrayLike, Scalar


class Footprint(eqx.Module):
    """Footprint of a robot on the ground, in the robot's frame: x ahead, origin at its position.

    C equal discs with their centres on the x axis cover the footprint:

        footprint is a subset of the union over i of the discs of `radius` around (offsets_i, 0)

    So a cost that knows only the distance from a point to an obstacle can be evaluated for the
    whole robot. C is static.
    """

    offsets: eqx.AbstractVar[Float[Array, " C"]]
    radius: eqx.AbstractVar[Scalar]


class Disc(Footprint):
    """Disc around the robot's position.

    Args:
        radius: radius of the disc [m].

    Raises:
        ValueError: a radius that is negative or not finite.
    """

    radius: Scalar

    def __init__(self, radius: ArrayLike) -> None:
        self.radius = _checks.scalar("radius", radius, at_least=0.0)

    # A property instead of a field, so that it cannot disagree with the fields it follows from.
    @property  # type: ignore[misc]
    def offsets(self) -> Float[Array, " C"]:  # type: ignore[override]
        """Position of the single disc along the heading, (1,) [m]: 0."""
        return jnp.zeros(1)


class Rectangle(Footprint):
    """Rectangle along the heading, cut into C equal parts with one disc around each:

        l = front + rear
        offsets_i = -rear + (i + 1/2) l / C,  radius = sqrt((l / (2 C))^2 + (width / 2)^2)

    More discs follow the outline more closely, but costs are evaluated for each disc.

    Source: Ziegler and Stiller, "Fast collision checking for intelligent vehicle motion planning",
    IV 2010.

    Args:
        front: distance from the origin to the front edge [m].
        rear: distance from the origin to the rear edge, positive backwards [m].
        width: width of the rectangle [m].
        num_discs: number of discs, C; static. By default the length over the width, rounded up. It
            must be given if the lengths are traced.

    Raises:
        ValueError: a front or width that is not positive, a negative rear, fewer than one disc, or
            no number of discs beside traced lengths.
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
            if _kinds.is_traced(front, rear, width):
                raise ValueError(
                    "num_discs is None; accepted: a whole number >= 1 where lengths are traced"
                )
            length = np.float64(self.front) + np.float64(self.rear)
            # Tolerate rounding: a length of exactly three widths needs three discs, not four.
            num_discs = max(1, math.ceil(length / np.float64(self.width) - 1e-6))
        self.num_discs = _checks.positive_int("num_discs", num_discs, at_most=MOST_DISCS)

    @property
    def length(self) -> Scalar:
        """Length of the rectangle along the heading [m]."""
        return self.front + self.rear

    @property  # type: ignore[misc]
    def offsets(self) -> Float[Array, " C"]:  # type: ignore[override]
        """Positions of the disc centres along the heading, (C,) from rear to front [m]."""
        shares = (np.arange(self.num_discs, dtype=np.float32) + 0.5) / np.float32(self.num_discs)
        return jnp.asarray(shares) * self.length - self.rear

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs [m]."""
        return jnp.hypot(0.5 / self.num_discs * self.length, 0.5 * self.width)
