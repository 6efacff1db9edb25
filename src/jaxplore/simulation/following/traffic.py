"""True obstacles that move along a path, or stand on it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._checks import array, one_each
from jaxplore._limits import MOST_OBSTACLES
from jaxplore._types import Scalar, Vector
from jaxplore.belief.obstacles import Obstacles
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.path import Path, PathPoint


class Traffic(eqx.Module):
    """N obstacles beside a path, each at a constant offset and rate. At time t the n-th is at

        phi_n(t) = phi_n + rate_n t,   p_n = the point offset_n to the left of phi_n(t)

    heading along the path. With a rate of 0 it stands, with a negative one it is oncoming.

    Args:
        path: path along which the obstacles move.
        phi: (N,) arc lengths of the obstacles at the start [m].
        offsets: (N,) distances to the left of the path [m].
        rates: (N,) speeds along the path [m/s].
        outlines: outlines of the obstacles in their own frame, x ahead; or give `radii`.
        radii: (N,) radii of discs, or one number [m].

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, negative radii, both or
            neither of two alternatives, an offset beyond the room beside the path.
    """

    path: Path
    phi: Float[Array, " N"]
    offsets: Float[Array, " N"]
    rates: Float[Array, " N"]
    outlines: Outlines

    @_kinds.check_arguments
    def __init__(
        self,
        path: Path,
        phi: Vector,
        offsets: Vector,
        rates: Vector,
        outlines: Outlines | None = None,
        *,
        radii: Vector | None = None,
    ) -> None:
        self.path = path
        self.phi = array("phi", phi, ("N",), may_be_empty=True)
        number = self.phi.shape[0]
        self.offsets = one_each("offsets", offsets, number)
        self.rates = one_each("rates", rates, number)
        if (outlines is None) == (radii is None):
            raise ValueError(f"outlines is {outlines!r}, radii is {radii!r}; accepted: one of them")
        if outlines is None:
            outlines = Outlines.discs(jnp.zeros((number, 2)), one_each("radii", radii, number))
        elif outlines.number != number:
            raise ValueError(f"outlines has {outlines.number}; accepted: {number}, one for each")
        self.outlines = outlines
        if not _kinds.is_traced(self.offsets, path.half_widths):
            _check_offsets(path, np.asarray(self.offsets))

    @classmethod
    def random(
        cls,
        path: Path,
        number: int,
        *,
        seed: int,
        radius: float = 0.2,
        rates: tuple[float, float] = (0.5, 1.5),
        clear: float = 6.0,
    ) -> "Traffic":
        """Place discs along a path at random offsets, up to half of the room on either side.

        Args:
            path: path with half widths.
            number: N.
            seed: seed of the obstacles' positions.
            radius: radius of the discs [m].
            rates: least and greatest speed along the path [m/s].
            clear: length of the path without obstacles after its start [m].

        Raises:
            ValueError: a path without room for them, numbers that are not positive.
        """
        count = _checks.whole_number("number", number, at_least=0, at_most=MOST_OBSTACLES)
        size = _checks.number("radius", radius, above=0.0)
        length, free = float(path.length), _checks.number("clear", clear, at_least=0.0)
        narrow = float(np.asarray(path.half_widths).min())
        if not (np.isfinite(narrow) and narrow > size):
            raise ValueError(
                f"path has {narrow:.3g} m on either side; accepted: half widths above the radius "
                f"of the obstacles, {size:g}"
            )
        slow, fast = (float(rate) for rate in rates)
        if not (np.isfinite([slow, fast]).all() and slow <= fast):
            raise ValueError(f"rates is {tuple(rates)}; accepted: the least and the greatest")
        if free >= length:
            raise ValueError(f"clear is {clear!r}; accepted: less than the length, {length:g}")
        rng = np.random.default_rng(seed)
        # Each obstacle has an equal part of the path and stays away from the part's ends, so that
        # neighbours start apart.
        share = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / max(count, 1)
        sides = rng.uniform(-1.0, 1.0, count) * 0.5 * (narrow - size)
        return cls(
            path,
            free + (length - free) * share,
            sides,
            rng.uniform(slow, fast, count),
            radii=size,
        )

    @property
    def number(self) -> int:
        """Number of obstacles, N."""
        return self.phi.shape[0]

    def at(self, time: Scalar) -> Obstacles:
        """Return the true positions and motion of the obstacles at a time since the start [s]."""

        def place(phi: Scalar, offset: Scalar, rate: Scalar, corners: Array) -> tuple[Array, ...]:
            point: PathPoint = self.path.at(phi + rate * time)
            ahead = jnp.stack([point.cos, point.sin])
            centre = point.position + offset * point.normal
            turned = corners[:, :1] * ahead + corners[:, 1:] * point.normal
            # The inner side of a bend is shorter, so an obstacle at an offset is slower or faster
            # than its rate along the path.
            velocity = rate * (1.0 - point.curvature * offset) * ahead
            return centre, turned + centre, velocity, rate * point.curvature

        everything = (self.phi, self.offsets, self.rates, self.outlines.corners)
        centres, corners, velocities, turn_rates = jax.vmap(place)(*everything)
        outlines = Outlines(corners, self.outlines.radii)
        return Obstacles(outlines, velocities, turn_rates, centres=centres)


def _check_offsets(path: Path, offsets: np.ndarray) -> None:
    # An obstacle travels along the whole path, so the narrowest place limits its offset.
    left, right = np.asarray(path.half_widths).min(axis=0)
    for index, offset in enumerate(offsets):
        if not -right <= offset <= left:
            raise ValueError(
                f"offsets[{index}] is {offset:g}; accepted: {-right:g} to {left:g}, on the path"
            )
