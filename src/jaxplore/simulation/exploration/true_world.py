"""The true world around the robot at a moment: what is measured in it, and what is touched."""

import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Flag, GridMask, Key, Pose, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import compose
from jaxplore.maps.collision import discs_clearance, footprint_clearance
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.robot.robot import Told
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.mount import LidarMount, ScanMotion, project_scan
from jaxplore.simulation.exploration.moving_discs import START_OF_MOVING, MovingDiscs


class TrueWorld(eqx.Module):
    """The true world at a moment.

    `grid` has the walls that have appeared. `ground` is None if it is level. `find_moving` returns
    what moves. `is_told` says whether scans tell which beams ended at moving obstacles.
    `traversable` (H, W) are the cells that the robot may enter; None if it may enter all.
    """

    grid: OccupancyGrid
    ground: Ground | None
    find_moving: Callable[[], MovingDiscs | None]
    is_told: bool = eqx.field(static=True, default=True)
    traversable: GridMask | None = None

    @property
    def moving(self) -> MovingDiscs | None:
        """What moves beside the robot; None if nothing does."""
        # Within a branch that is taken at the rate of scans it costs nothing in other steps.
        return self.find_moving()

    @property
    def discs(self) -> Float[Array, "M 3"] | None:
        """(x, y, radius) of each moving obstacle [m]; None without any."""
        moving = self.moving
        return None if moving is None else moving.discs

    def scans(
        self, sensors: Sequence[Sensor], pose: Pose, key: Key, motion: ScanMotion | None = None
    ) -> tuple[Scan, ...]:
        """Simulate a scan of each sensor from a true pose, around the robot's centre.

        A lidar with a mount measures where it truly is. The robot undoes its mount, and its motion
        by what it knows of it. Without `motion`, the robot stands.
        """
        discs = self.discs
        # The first sensor has the step's own key, so further sensors do not change its noise.
        keys = [key, *(jax.random.fold_in(key, k) for k in range(1, len(sensors)))]
        return tuple(
            self._scan(sensor, sensor.mount, pose, each, motion)
            if isinstance(sensor, Lidar) and sensor.mount is not None
            else sensor.scan(
                *(self.grid, pose), key=each, ground=self.ground, movers=discs, is_told=self.is_told
            )
            for sensor, each in zip(sensors, keys, strict=True)
        )

    def _scan(
        self, sensor: Lidar, mount: LidarMount, pose: Pose, key: Key, motion: ScanMotion | None
    ) -> Scan:
        """Return the scan around the robot's centre of a lidar with a mount."""
        nothing = jnp.zeros(3)
        true, known, duration = (
            ScanMotion(nothing, nothing, jnp.zeros(())) if motion is None else motion
        )
        known = jnp.where(jnp.isfinite(known).all(), known, nothing)
        times, movers = mount.times(sensor.num_beams, duration), None
        moving = self.moving
        if moving is not None:
            now, velocities, radius = moving
            places = now[:, None] + times[:, None] * velocities[:, None]
            radii = jnp.broadcast_to(radius[:, None, None], (*places.shape[:2], 1))
            movers = jnp.concatenate([places, radii], axis=-1)
        starts = jax.vmap(compose, (None, 0))(pose, mount.poses(true, times))
        scan = sensor.scan(
            *(self.grid, pose),
            key=key,
            ground=self.ground,
            movers=movers,
            is_told=self.is_told,
            starts=starts,
        )
        return project_scan(scan, sensor, mount.poses(known, times))

    def tell(
        self, sensors: Sequence[Sensor], pose: Pose, noise: Float[Array, "2"], key: Key
    ) -> Told | None:
        """Measure the moving obstacles in sight of any sensor, for a robot that is told of them.

        `noise` are standard deviations of positions [m] and velocities [m/s]. The result is None
        without moving obstacles.
        """
        now = self.moving
        if now is None:
            return None
        position_std, velocity_std = noise
        keys = jax.random.split(jax.random.fold_in(key, START_OF_MOVING), 2)
        in_sight = [sensor.sees(self.grid, pose, now.positions, self.ground) for sensor in sensors]
        return Told(
            now.positions + position_std * jax.random.normal(keys[0], now.positions.shape),
            now.velocities + velocity_std * jax.random.normal(keys[1], now.velocities.shape),
            functools.reduce(jnp.logical_or, in_sight),
            position_std,
            pose,
        )

    def clearance(self, robot: Dynamics, state: StateVector, reach: int) -> Scalar:
        """Compute the distance from the robot's edge to the nearest solid cell or obstacle [m].

        `reach` cells are examined in each direction, see `clearance_reach`.
        """
        room = self._room(~self.grid.is_free, robot, state, reach)
        moving = self.moving
        if moving is None:
            return room
        position, heading = robot.position(state), robot.heading(state)
        gap = discs_clearance(moving.positions, moving.radius, position, heading, robot.footprint)
        return jnp.minimum(room, gap)

    def check_move(
        self, robot: Dynamics, before: StateVector, after: StateVector, reach: int
    ) -> tuple[StateVector, Flag]:
        """Return the state (nx,) after a move, and whether the move would have led to a collision.

        If so, the robot is stopped. Where `after` is not finite, it does not move. For `reach`, see
        `clearance`.
        """
        is_finite = jnp.all(jnp.isfinite(after))
        is_collision = is_finite & (self.clearance(robot, after, reach) < 0.0)
        moved = jnp.where(is_finite, after, before)
        return jnp.where(is_collision, robot.resolve_collision(before, after), moved), is_collision

    def is_untraversable(self, robot: Dynamics, state: StateVector, reach: int) -> Flag:
        """Check whether part of the robot is where it may not be; see `clearance`."""
        if self.traversable is None:
            return jnp.array(False)
        return self._room(~self.traversable, robot, state, reach) < 0.0

    def _room(self, solid: GridMask, robot: Dynamics, state: StateVector, reach: int) -> Scalar:
        position, heading = robot.position(state), robot.heading(state)
        return footprint_clearance(
            solid, self.grid.frame, position, heading, robot.footprint, reach
        )
