"""Range noise: in which cell a beam that ends in cell j is measured to end.

    G_kj = P(measured in cell k | first hit in cell j)

Zhang, Henderson, Sze and Karaman, "FSMI", IJRR 2020, eq. 22 (Gaussian), section V (banded) and
section VI (uniform). A reading that noise puts before the first cell or behind the last one says
nothing about a cell and is discarded, as in their Theorem 1: columns of G add up to at most 1.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import Scalar, Vector


class RangeNoise(eqx.Module):
    """How readings scatter over the cells of a beam."""

    @abc.abstractmethod
    def measured(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell, `sum_j G_kj P(e_j)`.

        Args:
            hit: (n,) probability that the beam's first hit is in each cell.
            edges: (n + 1,) distances at which the cells begin and end.
            cell_size: side of a grid cell in the unit of `edges`, None if the cells are not those
                of a grid; static. It bounds the number of cells in a band.
        """


class GaussianNoise(RangeNoise):
    """Gaussian noise about the middle of the cell that was hit, exact for cells of any length.

        G_kj = Phi((l_{k+1} - mu_j) / std) - Phi((l_k - mu_j) / std)

    With `truncation` only cells count some part of which is at most so many standard deviations
    from mu_j (banded FSMI): O(n) instead of O(n^2) where the cells are those of a grid, and of the
    readings 4 sigma lose less than 1e-4.

    Args:
        std: standard deviation, in the unit of the beam's edges [m].
        truncation: in standard deviations; None for none. The width of the band is static and
            follows from `std` as it is given here.

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

    def measured(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        middle = 0.5 * (edges[1:] + edges[:-1])
        n = hit.shape[0]
        width = n
        if self.reach is not None and cell_size is not None:
            # Of a length d a ray lies in at most sqrt(2) d + 3 cells.
            width = math.ceil(math.sqrt(2.0) * (self.reach / cell_size + 0.75)) + 2
        if width >= n:
            return hit @ self._share(jnp.broadcast_to(edges, (n, n + 1)), middle[:, None])
        # By distance in cells: row j holds cells j - width ... j + width.
        near = jnp.arange(n)[:, None] + jnp.arange(-width, width + 2)
        share = self._share(edges[jnp.clip(near, 0, n)], middle[:, None])
        spread = jnp.pad(hit[:, None] * share, ((width, width), (0, 0)))
        total = jnp.zeros(n)
        for shift in range(2 * width + 1):
            total = total + spread[2 * width - shift : 2 * width - shift + n, shift]
        return total

    def _share(self, edges: Array, centre: Array) -> Array:
        """Share of the readings about `centre` between each two edges; 0 out of reach."""
        distance = edges - centre
        until = 0.5 * jax.scipy.special.erf(distance / (self.std * math.sqrt(2.0)))
        share = jnp.maximum(until[:, 1:] - until[:, :-1], 0.0)
        if self.reach is None:
            return share
        is_near = (distance[:, :-1] <= self.reach) & (distance[:, 1:] >= -self.reach)
        return jnp.where(is_near, share, 0.0)


class ToeplitzNoise(RangeNoise):
    """Noise that depends on the number of cells between hit and reading only: `G_kj = g(k - j)`.

    So it is for any noise when all cells are equally long. One sliding sum, no matrix.

    Args:
        weights: g for -h ... h cells, an odd number of values, each >= 0, adding up to at most 1.

    Raises:
        ValueError: an even number of weights, a negative one, a sum above 1.
    """

    weights: Float[Array, " width"]

    def __init__(self, weights: Vector) -> None:
        if not isinstance(weights, jax.core.Tracer):
            values = np.asarray(weights, np.float32)
            if values.ndim != 1 or len(values) % 2 == 0:
                raise ValueError(
                    f"weights has shape {values.shape}; accepted: an odd number of them"
                )
            if not ((values >= 0.0).all() and values.sum() <= 1.0 + 1e-5):
                raise ValueError(f"weights is {weights!r}; accepted: values >= 0 with a sum <= 1")
        self.weights = jnp.asarray(weights, jnp.float32)

    @classmethod
    def gaussian(
        cls, std: float, cell_size: float = 1.0, truncation: float = 4.0
    ) -> "ToeplitzNoise":
        """Return Gaussian noise for cells of one length.

        Args:
            std: standard deviation.
            cell_size: length of a cell, in the same unit.
            truncation: standard deviations up to which cells count.
        """
        std = _checks.number("std", std, above=0.0)
        cell_size = _checks.number("cell_size", cell_size, above=0.0)
        reach = _checks.number("truncation", truncation, above=0.0) * std
        # As in the band above: cells that begin within reach of the middle of the one that was hit.
        width = math.ceil(reach / cell_size + 0.5) - 1

        def until(cells: float) -> float:
            return 0.5 * math.erfc(-cells * cell_size / (std * math.sqrt(2.0)))

        return cls([until(d + 0.5) - until(d - 0.5) for d in range(-width, width + 1)])

    def measured(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        n, width = hit.shape[0], self.weights.shape[0] // 2
        padded = jnp.pad(hit, width)
        total = jnp.zeros(n)
        for shift in range(2 * width + 1):
            total = total + self.weights[2 * width - shift] * padded[shift : shift + n]
        return total


class UniformNoise(RangeNoise):
    """Noise uniform over the cell that was hit and `half_width` on either side: Uniform-FSMI.

    `G_kj = 1 / (2 h + 1)` for `|k - j| <= h`, by prefix sums, O(1) per cell whatever h. With
    h = 0 there is no noise.

    Args:
        half_width: h [cells]; static.

    Raises:
        ValueError: a width that is not a whole number >= 0.
    """

    half_width: int = eqx.field(static=True)

    def __init__(self, half_width: int = 0) -> None:
        self.half_width = _checks.whole_number("half_width", half_width, at_least=0)

    def measured(
        self, hit: Float[Array, " n"], edges: Float[Array, " n+1"], cell_size: float | None
    ) -> Float[Array, " n"]:
        """Return the probability of a reading in each cell."""
        if self.half_width == 0:
            return hit
        n, width = hit.shape[0], self.half_width
        until = jnp.pad(jnp.cumsum(jnp.pad(hit, width)), (1, 0))
        return (until[2 * width + 1 :] - until[:n]) / (2 * width + 1)
