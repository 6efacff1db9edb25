"""Model range noise: the distribution of readings over the cells of a beam.

    G_kj = P(reading in cell k | first hit in cell j)

A reading before the first or behind the last cell concerns no cell and is discarded, so the columns
of G add up to at most 1.

Source: Zhang, Henderson, Sze and Karaman, "FSMI", IJRR 2020, eq. 22 (Gaussian), section V (banded),
section VI (uniform), Theorem 1 (discarded readings).
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Scalar, Vector


class RangeNoise(eqx.Module):
    """Distribution of readings over the cells of a beam; abstract."""

    @abc.abstractmethod
    def apply(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell, `sum_j G_kj P(e_j)`.

        Args:
            hit: probability (n,) that the beam's first hit is in each cell.
            edges: distances (n + 1,) at which the cells begin and end.
            cell_size: side of a grid cell in the unit of `edges`, or None if the cells are not grid
                cells; static. It bounds the number of cells in a band.
        """


class GaussianNoise(RangeNoise):
    """Gaussian noise about the middle of the cell that was hit, exact for cells of any length:

        G_kj = Phi((l_{k+1} - mu_j) / std) - Phi((l_k - mu_j) / std)

    With `truncation`, only cells within this many standard deviations of mu_j count (banded FSMI).
    For grid cells this takes O(n) instead of O(n^2); at 4 standard deviations less than 1e-4 of the
    readings are lost.

    Args:
        std: standard deviation, in the unit of the beam's edges [m].
        truncation: reach of the noise in standard deviations; None for no truncation. The width of
            the band is static: it follows from the `std` given here.

    Raises:
        ValueError: a value that is not positive, a truncation with a traced `std`.
    """

    std: Scalar
    reach: float | None = eqx.field(static=True)

    def __init__(self, std: ArrayLike, truncation: float | None = None) -> None:
        self.std = _checks.scalar("std", std, above=0.0)
        self.reach = None
        if truncation is not None:
            width = _checks.number("truncation", truncation, above=0.0)
            if isinstance(std, jax.core.Tracer):
                raise ValueError("std is traced; accepted with a truncation: a number")
            self.reach = width * float(np.asarray(std))

    def apply(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        middle = 0.5 * (edges[1:] + edges[:-1])
        n = hit.shape[0]
        width = n
        if self.reach is not None and cell_size is not None:
            # A ray of length d lies in at most sqrt(2) d + 3 cells, one of them the hit cell
            # itself. It begins in the middle of that cell, up to 0.71 cells before its end.
            width = math.ceil(math.sqrt(2.0) * (self.reach / cell_size + 0.75)) + 2
        if width >= n:
            return hit @ self._share(jnp.broadcast_to(edges, (n, n + 1)), middle[:, None])
        # Store the band by offset, row j for cells j - width ... j + width, and sum its diagonals.
        near = jnp.arange(n)[:, None] + jnp.arange(-width, width + 2)
        # Beyond both ends of the beam the last edge repeats: cells of length zero get no reading.
        share = self._share(edges[jnp.clip(near, 0, n)], middle[:, None])
        spread = jnp.pad(hit[:, None] * share, ((width, width), (0, 0)))
        total = jnp.zeros(n)
        for shift in range(2 * width + 1):
            total = total + spread[2 * width - shift : 2 * width - shift + n, shift]
        return total

    def _share(self, edges: Array, centre: Array) -> Array:
        """Return the probability of a reading between neighbouring edges, for a hit at `centre`;
        0 beyond the reach."""
        distance = edges - centre
        until = 0.5 * jax.scipy.special.erf(distance / (self.std * math.sqrt(2.0)))
        share = jnp.maximum(until[:, 1:] - until[:, :-1], 0.0)
        if self.reach is None:
            return share
        is_near = (distance[:, :-1] <= self.reach) & (distance[:, 1:] >= -self.reach)
        return jnp.where(is_near, share, 0.0)


class ToeplitzNoise(RangeNoise):
    """Noise that depends only on the number of cells between hit and reading: `G_kj = g(k - j)`.

    This holds for any noise if all cells are equally long. It is one sliding sum without a matrix.

    Args:
        weights: values of g for -h ... h cells: an odd number of values >= 0 with a sum <= 1.

    Raises:
        ValueError: an even number of weights, a negative one, a sum above 1.
    """

    weights: Float[Array, " width"]

    def __init__(self, weights: Vector) -> None:
        if not isinstance(weights, jax.core.Tracer):
            values = _checks.floats("weights", weights, "an odd number of values >= 0")
            if values.ndim != 1 or len(values) % 2 == 0:
                raise ValueError(
                    f"weights has shape {values.shape}; accepted: an odd number of them"
                )
            # In single precision weights that add up to 1 may exceed it by rounding.
            if not ((values >= 0.0).all() and values.sum() <= 1.0 + 1e-5):
                raise ValueError(f"weights is {weights!r}; accepted: values >= 0 with a sum <= 1")
        self.weights = jnp.asarray(weights, jnp.float32)

    @classmethod
    def gaussian(
        cls, std: float, cell_size: float = 1.0, truncation: float = 4.0
    ) -> "ToeplitzNoise":
        """Build Gaussian noise for cells of equal length.

        Args:
            std: standard deviation of the noise.
            cell_size: length of a cell, in the unit of `std`.
            truncation: reach of the noise in standard deviations.
        """
        std = _checks.number("std", std, above=0.0)
        cell_size = _checks.number("cell_size", cell_size, above=0.0)
        reach = _checks.number("truncation", truncation, above=0.0) * std
        # As for `GaussianNoise`, cells count that begin within reach of the middle of the hit cell.
        width = math.ceil(reach / cell_size + 0.5) - 1

        def until(cells: float) -> float:
            return 0.5 * math.erfc(-cells * cell_size / (std * math.sqrt(2.0)))

        return cls([until(d + 0.5) - until(d - 0.5) for d in range(-width, width + 1)])

    def apply(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        n, width = hit.shape[0], self.weights.shape[0] // 2
        padded = jnp.pad(hit, width)
        total = jnp.zeros(n)
        for shift in range(2 * width + 1):
            # A reading in cell k comes from the hit in cell k + shift - width, so g runs backwards.
            total = total + self.weights[2 * width - shift] * padded[shift : shift + n]
        return total


class UniformNoise(RangeNoise):
    """Noise that is uniform over the hit cell and `half_width` cells on either side: Uniform-FSMI.

    `G_kj = 1 / (2 h + 1)` for `|k - j| <= h`. Prefix sums make it O(1) per cell for any h. With
    h = 0 there is no noise.

    Args:
        half_width: number of cells on either side, h; static.

    Raises:
        ValueError: a width that is not a whole number >= 0.
    """

    half_width: int = eqx.field(static=True)

    def __init__(self, half_width: int = 0) -> None:
        self.half_width = _checks.whole_number("half_width", half_width, at_least=0)

    def apply(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        if self.half_width == 0:
            return hit
        # Differences of prefix sums give the sliding sum; padding lets it run beyond both ends.
        n, width = hit.shape[0], self.half_width
        until = jnp.pad(jnp.cumsum(jnp.pad(hit, width)), (1, 0))
        return (until[2 * width + 1 :] - until[:n]) / (2 * width + 1)
