"""People in a volume: upright cylinders that walk on its floor."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import Key, Scalar
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.robot.robot import Told
from jaxplore.sensing.volume import Rotation, VolumeScan, VolumeSensor
from jaxplore.simulation.exploration.moving_discs import START_OF_MOVING, MovingDiscs

HEIGHT = 1.8
"""Height of people over the lower face of the volume [m]."""
ANKLE = 0.3
"""Height over that face above which what is solid stands in their way [m]."""
SHOWN = (0.4, 0.9, 1.4)
"""Heights at which a sensor that sees the middle of somebody sees them [m]."""


class Cylinders(NamedTuple):
    """Upright cylinders at a moment: middles (M, 2), velocities (M, 2) [m/s], radii (M,), and the
    heights of the lower face of the volume and of their tops [m]."""

    positions: Float[Array, "M 2"]
    velocities: Float[Array, "M 2"]
    radii: Float[Array, " M"]
    floor: Scalar
    top: Scalar

    @classmethod
    def of(cls, moving: MovingDiscs, world: VoxelGrid) -> "Cylinders":
        """Return the cylinders over moving discs."""
        floor = world.origin[2]
        return cls(*moving, floor, floor + HEIGHT)

    def block(
        self, scan: VolumeScan, sensor: VolumeSensor, position: Float[Array, "3"], turn: Rotation
    ) -> VolumeScan:
        """Return a scan whose rays end at the cylinders.

        Such a ray has a shorter range and no return: the sensor tells that what it met moves, and
        the map keeps nothing of it.

        Args:
            scan: scan of the world without them.
            sensor: the sensor.
            position: position (x, y, z) of the sensor [m].
            turn: rotation from the body to the world.
        """
        ways = turn @ jnp.asarray(sensor.directions)

        def meet(cylinder: tuple[Array, Array]) -> Float[Array, " R"]:
            return distance_along(position, ways, *cylinder, self.top)

        met = jax.vmap(meet)((self.positions, self.radii)).min(axis=0)
        is_before = met < scan.ranges
        ranges = jnp.where(is_before, jnp.maximum(met, 1e-3), scan.ranges)
        return VolumeScan(ranges, scan.is_return & ~is_before)

    def gap(self, place: Float[Array, "3"]) -> Scalar:
        """Return the distance of a place (x, y, z) from the nearest cylinder, 0 inside [m]."""
        away = self.positions - place[:2]
        beside = jnp.maximum(jnp.sqrt(jnp.sum(away * away, axis=1)) - self.radii, 0.0)
        above = jnp.maximum(place[2] - self.top, 0.0)
        return jnp.sqrt(beside * beside + above * above).min()

    def tell(
        self,
        sensors: tuple[VolumeSensor, ...],
        world: VoxelGrid,
        position: Float[Array, "3"],
        turn: Rotation,
        noise: Float[Array, "2"],
        key: Key,
    ) -> Told:
        """Measure those of which a sensor sees the middle at some height.

        `noise` are standard deviations of positions [m] and velocities [m/s].
        """
        number = self.radii.shape[0]
        heights = self.floor + jnp.asarray(SHOWN)
        columns = jnp.repeat(self.positions, len(SHOWN), axis=0)
        points = jnp.column_stack([columns, jnp.tile(heights, number)])
        seen = jnp.stack([each.sees(world, position, turn, points) for each in sensors])
        is_seen: Bool[Array, " M"] = seen.any(axis=0).reshape(number, len(SHOWN)).any(axis=1)
        keys = jax.random.split(jax.random.fold_in(key, START_OF_MOVING), 2)
        shape = self.positions.shape
        return Told(
            self.positions + noise[0] * jax.random.normal(keys[0], shape),
            self.velocities + noise[1] * jax.random.normal(keys[1], shape),
            is_seen,
            noise[0],
            jnp.zeros(3),
        )


def distance_along(
    start: Float[Array, "3"], ways: Float[Array, "3 R"], middle: Array, radius: Array, top: Scalar
) -> Float[Array, " R"]:
    """Return the distance (R,) along rays at which they enter an upright cylinder [m].

    It is infinite for a ray that misses it. The cylinder has no lower end. `ways` are unit vectors.
    """
    x, y = start[0] - middle[0], start[1] - middle[1]
    level = ways[0] * ways[0] + ways[1] * ways[1]
    along = ways[0] * x + ways[1] * y
    # Of (p + t w)^2 = r^2, level t^2 + 2 along t + rest = 0.
    rest = x * x + y * y - radius * radius
    root = along * along - level * rest
    is_crossing = (root >= 0.0) & (level > 0.0)
    width, scale = jnp.sqrt(jnp.where(is_crossing, root, 0.0)), jnp.where(level > 0.0, level, 1.0)
    enters, leaves = (-along - width) / scale, (-along + width) / scale
    # A ray straight up or down is between the sides everywhere, or nowhere.
    is_inside = rest <= 0.0
    enters = jnp.where(is_crossing, enters, jnp.where(is_inside & (level <= 0.0), 0.0, jnp.inf))
    leaves = jnp.where(is_crossing, leaves, jnp.where(is_inside & (level <= 0.0), jnp.inf, 0.0))
    sinks = jnp.where(ways[2] == 0.0, 1.0, ways[2])
    at_top = (top - start[2]) / sinks
    is_level = ways[2] == 0.0
    below = jnp.where(is_level, jnp.where(start[2] <= top, 0.0, jnp.inf), 0.0)
    low = jnp.where(ways[2] < 0.0, at_top, below)
    high = jnp.where(ways[2] > 0.0, at_top, jnp.inf)
    first = jnp.maximum(jnp.maximum(enters, low), 0.0)
    return jnp.where(first <= jnp.minimum(leaves, high), first, jnp.inf)


def floor_plan(world: VoxelGrid) -> OccupancyGrid:
    """Return the map on which people walk: what is solid between their ankles and their heads."""
    side = world.resolution
    low = min(world.shape[0] - 1, round(ANKLE / side))
    high = max(low + 1, round(HEIGHT / side))
    solid = ~np.asarray(world.is_free)[low:high].all(axis=0)
    x, y = np.asarray(world.origin, np.float64)[:2].tolist()
    return OccupancyGrid(np.where(solid, 1.0, 0.0).astype(np.float32), side, (x, y, 0.0))
