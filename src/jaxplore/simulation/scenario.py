"""A world, a robot in it, its sensor, and how often everything happens."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Count, GridMask, Scalar, StateVector, Vector
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.perception import Perception
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.collision import clearance_reach
from jaxplore.simulation.reachability import reachable_cells


class Scenario(eqx.Module):
    """What is simulated: a robot that starts somewhere in a world of which it knows nothing.

    Whatever the world does not know to be free is solid. *Reachable* are the free cells to which
    the centre of the robot's disc can get from the start; coverage is the share of them that the
    robot's map knows to be free.

    Args:
        world: the true map, hidden from the robot.
        robot: the plant.
        lidar: its sensor.
        start: pose (x, y, yaw) [m, m, rad]; the robot stands still there.
        perception: how scans become a belief; made for the lidar and the world when absent.
        control_rate: [Hz].
        sensing_rate: scans and map updates [Hz]; rounded to whole control periods.
        field_rate: updates of the information and guidance fields [Hz]; likewise.
        target_coverage: share of the reachable cells at which exploration is finished.

    Raises:
        ValueError: a perception made for another range or resolution; a start that is off the map,
            in a wall, in unknown space, or so close to either that the robot touches it; a rate
            that is not positive or above the control rate; a target outside (0, 1].
    """

    world: OccupancyGrid
    robot: Dynamics
    lidar: Lidar
    perception: Perception
    start: StateVector
    reachable: GridMask
    control_period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    target_coverage: Scalar
    clearance_reach: int = eqx.field(static=True)

    def __init__(
        self,
        world: OccupancyGrid,
        robot: Dynamics,
        lidar: Lidar,
        start: Vector,
        *,
        perception: Perception | None = None,
        control_rate: float = 50.0,
        sensing_rate: float = 10.0,
        field_rate: float = 5.0,
        target_coverage: ArrayLike = 0.99,
    ) -> None:
        pose = np.asarray(_checks.vector("start", start, 3), np.float64)
        self.world, self.robot, self.lidar = world, robot, lidar
        self.perception = (
            Perception(lidar, world.resolution, robot.radius) if perception is None else perception
        )
        if self.perception.lidar.max_range != lidar.max_range or (
            self.perception.resolution != world.resolution
        ):
            raise ValueError(
                f"perception is for a range of {self.perception.lidar.max_range:g} m and cells of "
                f"{self.perception.resolution:g} m; accepted: those of the scenario, "
                f"{lidar.max_range:g} m and {world.resolution:g} m"
            )
        self.start = robot.at_pose(*(float(value) for value in pose))
        self.reachable = jnp.asarray(reachable_cells(world, pose, float(robot.radius)))
        self.clearance_reach = clearance_reach(float(robot.radius), world.resolution)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = jnp.asarray(1.0 / rate, jnp.float32)
        self.steps_per_scan = _whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = _whole_steps("field_rate", field_rate, rate)
        self.target_coverage = _checks.scalar(
            "target_coverage", target_coverage, above=0.0, at_most=1.0
        )


def _whole_steps(name: str, rate: float, control_rate: float) -> Array:
    checked = _checks.number(name, rate, above=0.0, at_most=control_rate)
    return jnp.asarray(max(1, round(control_rate / checked)), jnp.int32)
