"""The true volume around the robot at a moment: what is measured in it, and what is touched."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Flag, Key, Scalar, StateVector
from jaxplore.dynamics.quadrotor import Quadrotor, attitude_upwards, position_upwards
from jaxplore.maps.voxel_grid import FREE_BELOW, VoxelGrid
from jaxplore.robot.robot import Told
from jaxplore.sensing.volume import VolumeScan, VolumeSensor
from jaxplore.simulation.volume.people import Cylinders


class TrueVolume(NamedTuple):
    """The true volume at a moment.

    `grid` has the walls that have appeared. `people` are the moving obstacles; None without any.
    """

    grid: VoxelGrid
    people: Cylinders | None

    def scans(
        self, sensors: tuple[VolumeSensor, ...], state: StateVector, key: Key
    ) -> tuple[VolumeScan, ...]:
        """Simulate a scan of each sensor from a true state (nx,)."""
        place = position_upwards(state), attitude_upwards(state)
        keys = jax.random.split(key, len(sensors))
        scans = [
            sensor.scan(self.grid, *place, key=each)
            for sensor, each in zip(sensors, keys, strict=True)
        ]
        if self.people is None:
            return tuple(scans)
        return tuple(
            self.people.block(scan, sensor, *place)
            for scan, sensor in zip(scans, sensors, strict=True)
        )

    def tell(
        self,
        sensors: tuple[VolumeSensor, ...],
        state: StateVector,
        noise: Float[Array, "2"],
        key: Key,
    ) -> Told | None:
        """Measure the moving obstacles in sight of any sensor; None without any.

        `noise` are standard deviations of positions [m] and velocities [m/s].
        """
        if self.people is None:
            return None
        place = position_upwards(state), attitude_upwards(state)
        return self.people.tell(sensors, self.grid, *place, noise, key)

    def sees(
        self, sensors: tuple[VolumeSensor, ...], state: StateVector, points: Float[Array, "M 3"]
    ) -> Bool[Array, " M"]:
        """Return which points (x, y, z) [m] any sensor sees from a true state (nx,)."""
        place = position_upwards(state), attitude_upwards(state)
        views = [each.sees(self.grid, *place, points) for each in sensors]
        return jnp.stack(views).any(axis=0)

    def clearance(self, robot: Quadrotor, state: StateVector, reach: int) -> Scalar:
        """Return the distance from the robot's edge to the nearest solid voxel or person [m].

        Solid voxels count up to `reach` voxels away in each direction.
        """
        room = self._room(robot, state, reach)
        if self.people is None:
            return room
        return jnp.minimum(room, self.people.gap(position_upwards(state)) - robot.radius)

    def check_move(
        self, robot: Quadrotor, before: StateVector, after: StateVector, reach: int
    ) -> tuple[StateVector, Flag]:
        """Return the state (nx,) after a move, and whether the move would have led to a collision.

        If so, the robot keeps its position and attitude, at rest. Where `after` is not finite, it
        does not move. For `reach`, see `clearance`.
        """
        is_finite = jnp.all(jnp.isfinite(after))
        is_collision = is_finite & (self.clearance(robot, after, reach) < 0.0)
        moved = jnp.where(is_finite, after, before)
        return jnp.where(is_collision, stop_robot(robot, before), moved), is_collision

    def _room(self, robot: Quadrotor, state: StateVector, reach: int) -> Scalar:
        world = self.grid
        grid = world.to_grid(position_upwards(state))
        centre = jnp.floor(jnp.where(jnp.isfinite(grid), grid, 0.0)).astype(jnp.int32)
        offsets = jnp.stack(
            jnp.meshgrid(*[jnp.arange(-reach, reach + 1)] * 3, indexing="ij")
        ).reshape(3, -1)
        voxels = centre[:, None] + offsets
        # Off the volume nothing is known to be free.
        solid = world.at(voxels, outside=0.0) >= FREE_BELOW
        low = voxels.astype(grid.dtype)
        # Distance from the centre of the robot to each voxel, which is a cube.
        gap = jnp.maximum(jnp.maximum(low - grid[:, None], grid[:, None] - low - 1.0), 0.0)
        squared = jnp.where(solid, jnp.sum(gap * gap, axis=0), float(reach**2))
        return jnp.sqrt(jnp.min(squared)) * world.resolution - robot.radius


def stop_robot(robot: Quadrotor, state: StateVector) -> StateVector:
    """Return the state of a robot that keeps its position and attitude, at rest."""
    still = jnp.asarray([name.startswith(("v", "w")) for name in robot.state_names])
    return jnp.where(still, 0.0, state)
