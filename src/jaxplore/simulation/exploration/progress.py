"""Statistics of the known map."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxplore._types import Count, GridMask, GridValues, Scalar
from jaxplore.belief.zones import UNKNOWN, entropy_proxy
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid, entropy
from jaxplore.report.exploration.data import MapProgress


class MapSums(NamedTuple):
    """Sums over the cells of a map, or over those of a window of it.

    `reachable` is the number of cells that the robot's centre can reach, `free` and `unknown` how
    many of these are known to be free and unknown. `unknown_map` is the number of all cells that
    are unknown. `entropy` is that of the reachable cells [nat], and `rest` what rounding has left
    out of it [nat].
    """

    reachable: Count
    free: Count
    unknown: Count
    unknown_map: Count
    entropy: Scalar
    rest: Scalar

    @classmethod
    def none(cls) -> "MapSums":
        """Return the sums over no cells."""
        number, nothing = jnp.zeros((), jnp.int32), jnp.zeros(())
        return cls(number, number, number, number, nothing, nothing)

    @classmethod
    def of(cls, probability: GridValues, reachable: GridMask) -> "MapSums":
        """Return the sums over cells (h, w), from their probability of occupancy on a map."""

        def count(cells: GridMask) -> Count:
            return jnp.sum(cells, dtype=jnp.int32)

        unknown = entropy_proxy(probability) > UNKNOWN
        return cls(
            reachable=count(reachable),
            free=count((probability < FREE_THRESHOLD) & reachable),
            unknown=count(unknown & reachable),
            unknown_map=count(unknown),
            entropy=jnp.sum(jnp.where(reachable, entropy(probability), 0.0)),
            rest=jnp.zeros(()),
        )

    def update(self, before: "MapSums", after: "MapSums") -> "MapSums":
        """Return the sums of a map of which a window has changed from `before` to `after`."""
        # A map has a million nat, of which a scan changes some hundred. What is rounded off is
        # carried along (Kahan 1965), so that it does not add up over a run.
        change = (after.entropy - before.entropy) + self.rest
        total = self.entropy + change
        return MapSums(
            reachable=self.reachable,
            free=self.free + (after.free - before.free),
            unknown=self.unknown + (after.unknown - before.unknown),
            unknown_map=self.unknown_map + (after.unknown_map - before.unknown_map),
            entropy=total,
            rest=change - (total - self.entropy),
        )


def map_progress(sums: MapSums, grid: OccupancyGrid) -> MapProgress:
    """Compute coverage, entropy and the shares of unknown cells of a map."""

    def share(total: Scalar) -> Scalar:
        return total / sums.reachable.astype(jnp.float32)

    height, width = (jnp.asarray(side, jnp.float32) for side in grid.sides)
    return MapProgress(
        coverage=share(sums.free.astype(jnp.float32)),
        entropy=sums.entropy,
        unknown=share(sums.unknown.astype(jnp.float32)),
        unknown_map=sums.unknown_map.astype(jnp.float32) / (height * width),
    )
