"""Look up the expected information of a scan at any pose and field of view in O(1)."""

import dataclasses
import math
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._types import GridValues, Position, Scalar
from jaxplore.information.heading_field import HeadingField, at_nodes_figure
from jaxplore.maps.field import Stencil, gather, stencil
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class InformationField(eqx.Module):
    """Expected information of a scan at any position, heading and field of view, in O(1).

    `sectors[d, row, column]` is the information of the beams in the d-th of D equal sectors of the
    circle at a node. `cumulative[d]` is the sum over the first d sectors. With S the cumulative
    information, interpolated linearly over direction,

        I(x, y, yaw, fov) = S(yaw + fov / 2) - S(yaw - fov / 2)                          [nat]

    (theory: a circular prefix sum over directions). Over the full circle it is `total`. The field
    is exact at the nodes, bilinear between them, and 0 beyond the outermost nodes.

    `source` is the occupancy (H, W) from which the field was computed; `FieldSensor.update`
    recomputes only what changed since.
    """

    sectors: Float[Array, "D rows columns"]
    cumulative: Float[Array, "D+1 rows columns"]
    source: GridValues
    frame: GridFrame
    field_of_view: float = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)

    @property
    def total(self) -> Float[Array, "rows columns"]:
        """Information of a full circle of beams at each node [nat]."""
        return self.cumulative[-1]

    def without_directions(self) -> "InformationField":
        """Return the field with nothing but `total`, which is small."""
        return dataclasses.replace(
            self,
            sectors=self.sectors[:0],
            cumulative=self.cumulative[-1:],
            source=jnp.zeros((0, 0)),
        )

    def __call__(
        self, position: Position, heading: Scalar, field_of_view: float | None = None
    ) -> Scalar:
        """Return the expected information [nat] of a scan in a field of view in (0, 2 pi] (static),
        by default the sensor's own, around the heading."""
        position = _checks.position("position", position)
        _checks.of_shape("heading", heading, ())
        view = self._view(field_of_view)
        height, width = self.cumulative.shape[1:]
        nodes = stencil((height, width), self.frame.to_grid(position), 0.0)
        # A full circle needs no interpolation over direction, and does not depend on the heading.
        if view >= 2.0 * math.pi - 1e-6:
            return gather(self.cumulative, nodes, 0.0, self.sectors.shape[0])
        # Converting NaN to an index is undefined, so a heading that is not finite is replaced here
        # and masked at the end.
        is_finite = jnp.isfinite(heading)
        # Sectors are counted from the x axis of the lattice, not of the world.
        centre = jnp.where(is_finite, heading, 0.0) - self.frame.origin[2]
        upper, lower = (self._until(nodes, centre + part * view) for part in (0.5, -0.5))
        return jnp.where(is_finite, upper - lower, 0.0)

    def plot(self, heading: float | None = None) -> "Figure":
        """Draw the field in the world, with a colour bar.

        Args:
            heading: heading of the sensor [rad]; a full circle of beams when absent.

        Raises:
            ValueError: a heading that is not finite.
        """
        if heading is None:
            return lattice_figure(self.total, self.frame, "information, full circle [nat]")
        angle = _checks.scalar("heading", heading)
        return at_nodes_figure(self, self.frame, self.total.shape, angle)

    def at_headings(self, num_headings: int, field_of_view: float | None = None) -> HeadingField:
        """Return the information at the nodes for equally spaced headings.

        Args:
            num_headings: number of headings, N; heading n is `n 2 pi / N` from the lattice's x
                axis.
            field_of_view: field of view, in (0, 2 pi] [rad]; by default the sensor's own.

        Raises:
            ValueError: no headings, a field of view outside (0, 2 pi].
        """
        count = _checks.positive_int("num_headings", num_headings, at_most=MOST_DIRECTIONS)
        view = self._view(field_of_view)
        sectors = self.sectors.shape[0]
        # Fraction of each sector within the view of each heading. The view may wrap around the
        # circle, so sectors are repeated for several turns.
        covered = np.zeros((count, sectors))
        width = 2.0 * math.pi / sectors
        low = width * np.arange(sectors)
        for index, centre in enumerate(2.0 * math.pi / count * np.arange(count)):
            for turn in 2.0 * math.pi * np.arange(-2, 3):
                end = np.minimum(low + turn + width, centre + view / 2.0)
                begin = np.maximum(low + turn, centre - view / 2.0)
                covered[index] += np.maximum(end - begin, 0.0) / width
        values = jnp.einsum("nd,dhw->hwn", jnp.asarray(covered, jnp.float32), self.sectors)
        return HeadingField(values, self.frame)

    def _view(self, field_of_view: float | None) -> float:
        if field_of_view is None:
            return self.field_of_view
        return _checks.number(
            "field_of_view", field_of_view, above=0.0, at_most=2.0 * math.pi + 1e-6
        )

    def _until(self, nodes: Stencil, angle: Scalar) -> Scalar:
        """Return S(angle), extended beyond one turn by `S(angle + 2 pi) = S(angle) + total`."""
        sectors = self.sectors.shape[0]
        sector = angle * (sectors / (2.0 * math.pi))
        turns = jnp.floor(sector / sectors)
        # Rounding may give a whole turn, or slightly more. It belongs to the end of the last
        # sector, because `cumulative` has no entry behind that.
        within = jnp.clip(sector - turns * sectors, 0.0, float(sectors))
        first = jnp.minimum(within.astype(jnp.int32), sectors - 1)
        share = within - first.astype(within.dtype)
        before = gather(self.cumulative, nodes, 0.0, first)
        after = gather(self.cumulative, nodes, 0.0, first + 1)
        return (
            before + share * (after - before) + turns * gather(self.cumulative, nodes, 0.0, sectors)
        )
