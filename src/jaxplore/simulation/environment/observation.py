"""What an environment shows: the belief, the pose, the state and the scan."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Count, GridValues, Key, Pose, StateVector
from jaxplore.geometry.angles import sin_cos
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.simulation.exploration.closed_loop import robot_pose, scan_all, world_at
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.exploration.scenario import Scenario


class Observation(NamedTuple):
    """What the robot knows when it is to decide.

    Args:
        belief: (H, W) probability of each cell of the map; or (N, N) of the cells around the robot,
            columns ahead and rows to the left.
        pose: where it takes itself to be (x, y, yaw) [m, m, rad], yaw in [-pi, pi].
        state: (nx,) of its model, as it is told; the yaw is that of the pose.
        scan: (B,) ranges of its last scan, of one sensor after the other [m].
    """

    belief: GridValues
    pose: Pose
    state: StateVector
    scan: Float[Array, " B"]


def observe(
    scenario: Scenario,
    grid: OccupancyGrid,
    told: StateVector,
    scan: Float[Array, " B"],
    view_cells: int | None,
) -> Observation:
    """Return what the robot knows.

    Args:
        scenario: where and how.
        grid: the map that it has made.
        told: (nx,) the state that it takes for its own.
        scan: (B,) ranges of its last scan [m].
        view_cells: side of the square that is observed of the map [cells]; all of it when absent.
    """
    x, y, yaw = robot_pose(scenario.robot, told)
    yaw = jnp.arctan2(jnp.sin(yaw), jnp.cos(yaw))
    pose = jnp.stack([x, y, yaw])
    is_yaw = jnp.asarray([name == "yaw" for name in scenario.robot.state_names])
    return Observation(
        belief=grid.probability if view_cells is None else _around(grid, pose, view_cells),
        pose=pose,
        state=jnp.where(is_yaw, yaw, told),
        scan=scan,
    )


def last_scan(
    scenario: Scenario, state: StateVector, step: Count, movers: MovingObstacles | None, key: Key
) -> Float[Array, " B"]:
    """Return the ranges that the closed loop measured in a step, of one sensor after the other [m].

    Args:
        scenario: where and how.
        state: (nx,) of the robot then.
        step: its number.
        movers: what moves, as it began.
        key: of the whole run.
    """
    scan_key, _ = jax.random.split(jax.random.fold_in(key, step))
    time = scenario.control_period * step.astype(jnp.float32)
    pose = robot_pose(scenario.robot, state)
    scans = scan_all(scenario, world_at(scenario, step), pose, movers, time, scan_key)
    return jnp.concatenate([scan.ranges for scan in scans])


def _around(grid: OccupancyGrid, pose: Pose, size: int) -> GridValues:
    """Return the probabilities around a pose, columns ahead and rows to the left; 1 off the map."""
    along = grid.resolution * (jnp.arange(size, dtype=jnp.float32) + 0.5 - 0.5 * size)
    left, ahead = jnp.meshgrid(along, along, indexing="ij")
    x, y, yaw = pose
    sin, cos = sin_cos(yaw)
    return grid.at(jnp.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1))
