"""Exploration as a reinforcement-learning agent sees it."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxplore._types import Count, Flag, GridValues, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.geometry.angles import sin_cos
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.belief_picture import belief_picture
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.report.exploration.mission import MissionFrame
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.frames import part_frames
from jaxplore.simulation.exploration.recording import part_reports
from jaxplore.simulation.exploration.state import ExplorationState, max_ranges
from jaxplore.simulation.robot_fields import footprint_corners
from jaxplore.simulation.scenario import AgentView, state_bounds
from jaxplore.simulation.state import Moment

WHOLE_MAP = 100.0
"""Total reward for making an unknown map certain."""


class ExplorationView(AgentView):
    """Exploration as an agent sees it: the belief in, the information gained out.

    `view_cells` is the side of the observed square of the map around the robot [cells]; None for
    the whole map. `map_shape` are the map's rows and columns, and `num_reachable` is the number of
    cells that the robot's centre can reach. `hover_steps` steps are simulated after the end.
    `has_goal` says whether the robot must end at a goal.
    """

    frame: GridFrame
    sensors: tuple[Sensor, ...]
    num_reachable: Scalar
    hover_steps: Count
    has_goal: bool = eqx.field(static=True)
    map_shape: tuple[int, int] = eqx.field(static=True)

    def observation(
        self, state: ExplorationState, moment: Moment, belief: Belief
    ) -> dict[str, Array]:
        """Return the belief, the pose, the state and the last scan.

        `belief` is the occupancy probability of each cell (H, W), or of the cells around the robot
        (N, N), columns ahead and rows to the left. `pose` is the observed pose (x, y, yaw)
        [m, m, rad], yaw in [-pi, pi]. `state` (nx,) is the observed state, with the same yaw.
        `scan` (B,) are the ranges of the last scan, sensor by sensor [m].
        """
        robot, observed, grid = self.scenario.robot, moment.observed, belief.grid
        x, y, yaw = robot.pose(observed)
        yaw = jnp.arctan2(jnp.sin(yaw), jnp.cos(yaw))
        pose = jnp.stack([x, y, yaw])
        # A run's yaw is not wrapped, but the observation space bounds it.
        is_yaw = jnp.asarray([name == "yaw" for name in robot.state_names])
        side, (rows, columns) = self.view_cells, self.map_shape
        return {
            "belief": grid.probability[:rows, :columns]
            if side is None
            else _around(grid, pose, side),
            "pose": pose,
            "scan": state.ranges,
            "state": jnp.where(is_yaw, yaw, observed),
        }

    def observation_bounds(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the bounds of `observation`: the corners of the map, and the sensors' ranges."""
        robot, side = self.scenario.robot, self.view_cells
        rows, columns = self.map_shape
        corners = np.array([(0, 0), (0, columns), (rows, 0), (rows, columns)], np.float32)
        placed = np.asarray(self.frame.to_world(jnp.asarray(corners)))
        pose = np.append(placed.min(axis=0), -np.pi), np.append(placed.max(axis=0), np.pi)
        low, high = state_bounds(robot)
        # The model does not bound the pose, but the robot cannot leave the map.
        for name, least, greatest in zip(("x", "y", "yaw"), *pose, strict=True):
            if name in robot.state_names:
                column = robot.state_names.index(name)
                low[column], high[column] = least, greatest
        shape = self.map_shape if side is None else (side, side)
        reach = max_ranges(self.sensors)
        return {
            "belief": (np.zeros(shape, np.float32), np.ones(shape, np.float32)),
            "pose": pose,
            "scan": (np.zeros_like(reach), reach),
            "state": (low, high),
        }

    def reward(self, before: ExplorationState, after: ExplorationState) -> Scalar:
        """Return `100 (H_before - H_after) / (ln 2 * reachable cells)`.

        H is the entropy of the belief over the reachable cells [nat]. The rewards of a run on an
        unknown map add up to about 100, less the share of the first scan. A reward may be negative:
        noise can make cells less certain.
        """
        most = math.log(2.0) * self.num_reachable
        return WHOLE_MAP / most * (before.progress.entropy - after.progress.entropy)

    def is_contact(self, record: ExplorationRecord) -> Flag:
        """Check whether the step would have led to a collision."""
        return record.is_collision

    def has_ended(self, state: ExplorationState, ahead: ExplorationState) -> Flag:
        """Check whether the scenario is finished at the present position."""
        # The state one step ahead includes the present scan, which may complete the coverage or
        # what a part is about. But the robot has moved, so a goal is checked where it is.
        known = state if self.has_goal else ahead
        return known.finished > self.hover_steps

    def facts(self, state: ExplorationState) -> dict[str, Scalar]:
        """Return the coverage, and the entropy over the reachable cells [nat]."""
        return {"coverage": state.progress.coverage, "entropy": state.progress.entropy}

    def picture(self, state: ExplorationState, moment: Moment, trail: np.ndarray) -> np.ndarray:
        """Draw the belief, the trail, the last scan, what parts show and the robot.

        It is for spectators: it shows targets that were not found yet, which no observation tells.
        """
        robot, frame, known = self.scenario.robot, self.frame, state.belief
        task: Any = self.scenario
        about = task.truths, task.perception, known.parts, state.truths
        shown = jax.tree.map(np.asarray, part_frames(about[0], *about[2:]))
        now = MissionFrame(step=int(moment.step), time=float(moment.time), parts=shown)
        pose = np.asarray(robot.pose(moment.observed))
        angles = pose[2] + np.concatenate([sensor.beam_angles for sensor in self.sensors])
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return belief_picture(
            state.belief.grid.crop(state.belief.grid.probability),
            np.asarray(frame.origin),
            frame.resolution,
            path=trail,
            heading=float(pose[2]),
            radius=float(robot.radius),
            footprint=footprint_corners(robot.footprint),
            scan=pose[:2] + np.asarray(state.ranges)[:, None] * directions,
            parts=part_reports(*about, known.grid),
            frame=now,
        )


def _around(grid: OccupancyGrid, pose: Pose, size: int) -> GridValues:
    """Sample the map around a pose, columns ahead and rows to the left; 1 off the map."""
    along = grid.resolution * (jnp.arange(size, dtype=jnp.float32) + 0.5 - 0.5 * size)
    left, ahead = jnp.meshgrid(along, along, indexing="ij")
    x, y, yaw = pose
    sin, cos = sin_cos(yaw)
    return grid.at(jnp.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1))
