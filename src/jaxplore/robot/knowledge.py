"""What a robot knows of what is left to learn, by its own map."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxplore._types import Position, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.exploration_field import leads_to_information
from jaxplore.belief.zones import UNKNOWN, entropy_proxy
from jaxplore.maps.occupancy_grid import OccupancyGrid


class Knowledge(NamedTuple):
    """What is left to learn.

    Args:
        idle: time since a place was last worth a visit [s].
        walls: share of the cells around known free space that are known to be walls; the others are
            unknown. It is counted for the target `walls` alone.
    """

    idle: Scalar
    walls: Scalar

    @classmethod
    def nothing(cls) -> "Knowledge":
        """Return the knowledge before the first scan."""
        return cls(jnp.zeros(()), jnp.zeros(()))

    def update(self, belief: Belief, position: Position, period: Scalar) -> "Knowledge":
        """Return the knowledge a period [s] later; the robot takes itself to be at `position`."""
        is_worth = leads_to_information(belief.guidance(position))
        if belief.is_sent is not None:
            # It goes on afterwards.
            is_worth = is_worth | belief.is_sent
        return self._replace(idle=jnp.where(is_worth, 0.0, self.idle + period))

    def count_walls(self, grid: OccupancyGrid) -> "Knowledge":
        """Return the knowledge with the share of walls of a map."""
        free = jnp.pad(grid.is_free, 1)
        beside = free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:]
        walls, unknown = (
            jnp.sum(beside & each, dtype=jnp.int32)
            for each in (grid.is_occupied, entropy_proxy(grid.probability) > UNKNOWN)
        )
        share = walls.astype(jnp.float32) / jnp.maximum(walls + unknown, 1).astype(jnp.float32)
        return self._replace(walls=share)
