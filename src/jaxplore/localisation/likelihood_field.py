"""The likelihood field of a known map: how well the ends of beams fit its walls."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import GridMask, Key, Pose, Scalar
from jaxplore.geometry.motion import transform_points
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.field import ScalarField
from jaxplore.maps.occupancy_grid import OccupancyGrid

Poses = Float[Array, "K 3"]
Points = Float[Array, "B 2"]


class LikelihoodField(eqx.Module):
    """A known map as a particle filter reads it: distances from its walls, and its free cells.

    The distance is that of `clearance_field` from the nearest occupied cell, up to a bound. Unlike
    there nothing off the map is occupied: a beam that ends off the map is as far from any wall as
    the bound. Else each pose at the edge of the map that looks outwards would fit best of all.

    Args:
        distance: distance of a point from the nearest occupied cell, at most the bound [m].
        free_before: number of free cells (H * W,) up to each cell, that cell included.
    """

    distance: ScalarField
    free_before: Int[Array, " C"]

    @classmethod
    def of(cls, grid: OccupancyGrid, max_distance: float) -> "LikelihoodField":
        """Return the likelihood field of a map.

        Args:
            grid: known map.
            max_distance: bound of the distance [m]; static.
        """
        on_map = grid.is_on_map
        occupied = grid.is_occupied if on_map is None else grid.is_occupied & on_map
        values = _wall_distances(occupied, grid, max_distance)
        distance = ScalarField(values, grid.frame, jnp.full((), max_distance, jnp.float32))
        return cls(distance, jnp.cumsum(grid.is_free.reshape(-1).astype(jnp.int32)))

    def log_likelihood(
        self,
        pose: Pose,
        points: Points,
        is_counted: Bool[Array, " B"],
        distance_std: Scalar,
        outlier_share: Scalar,
    ) -> Scalar:
        """Return the logarithm of the likelihood of the ends of beams, seen from a pose.

            sum_b log((1 - outlier_share) exp(-d_b^2 / (2 distance_std^2)) + outlier_share)

        d_b is the distance of the end of beam b from the nearest occupied cell.

        Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, section 6.4, table 6.3; here
        each factor is scaled so that it is 1 at a wall.

        Args:
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            points: ends (B, 2) of beams, in the frame of the robot [m].
            is_counted: mask (B,) of the beams that count.
            distance_std: standard deviation of the distance from a wall [m].
            outlier_share: least likelihood of a beam, that of one which fits nothing on the map.
        """
        distance = self.distances(pose, points)
        fit = jnp.exp(-0.5 * (distance / distance_std) ** 2)
        each = jnp.log((1.0 - outlier_share) * fit + outlier_share)
        return jnp.where(is_counted, each, 0.0).sum()

    def distances(self, pose: Pose, points: Points) -> Float[Array, " B"]:
        """Return the distances (B,) of the ends of beams from walls, seen from a pose [m].

        Args:
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            points: ends (B, 2) of beams, in the frame of the robot [m].
        """
        return jax.vmap(self.distance)(transform_points(pose, points))

    @property
    def is_free(self) -> GridMask:
        """Mask (H, W) of the free cells."""
        before = jnp.concatenate([jnp.zeros(1, jnp.int32), self.free_before[:-1]])
        return (self.free_before > before).reshape(self.distance.values.shape)

    def random_poses(self, number: int, key: Key) -> Poses:
        """Return poses (number, 3) that are uniform over the free cells and all yaws.

        Without a free cell they are in the last one of the map.

        Args:
            number: number of poses; static.
            key: random key.
        """
        keys = jax.random.split(key, 3)
        count = jnp.maximum(self.free_before[-1], 1)
        rank = jax.random.randint(keys[0], (number,), 0, count)
        # The first cell before which, itself included, there are more free cells than the rank.
        flat = jnp.searchsorted(self.free_before, rank, side="right")
        flat = jnp.minimum(flat, self.free_before.size - 1)
        cell = jnp.stack(jnp.divmod(flat, self.distance.values.shape[1]), axis=-1)
        within = jax.random.uniform(keys[1], (number, 2))
        position = self.distance.frame.to_world(cell.astype(jnp.float32) + within)
        yaw = jax.random.uniform(keys[2], (number, 1), minval=-math.pi, maxval=math.pi)
        return jnp.concatenate([position, yaw], axis=1)


def _wall_distances(
    occupied: GridMask, grid: OccupancyGrid, max_distance: float
) -> Float[Array, "H W"]:
    """Return the distances (H, W) of the centres of cells from occupied cells of the map [m]."""
    # Everything off the arrays counts as blocked, so that border is moved out of the bound.
    margin = math.ceil(max_distance / grid.resolution + 0.5) + 1
    rows, columns = occupied.shape
    wide = jnp.pad(occupied, margin)
    # The frame is that of the map: of it only the size of the cells is read.
    values = clearance_field(wide, grid.frame, max_distance).values
    return values[margin : margin + rows, margin : margin + columns]
