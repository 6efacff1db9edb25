"""A world, a robot in it, its sensor, and how often everything happens."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Count, GridMask, Position, Scalar, StateVector, Vector
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.perception import Perception
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.collision import clearance_reach
from jaxplore.simulation.faults import Faults
from jaxplore.simulation.reachability import reachable_cells


class Scenario(eqx.Module):
    """What is simulated: a robot that starts somewhere in a world of which it knows little.

    It is finished at the target coverage, or, if there is a goal, within `goal_radius` of it with
    less than `max_unknown` of its map unknown (or at the target coverage).

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
        sensing_rate: scans and map updates [Hz]; a whole fraction of the control rate.
        field_rate: updates of the information and guidance fields [Hz]; likewise. The first is at
            the first step, the others at the end of each period.
        target_coverage: share of the reachable cells at which exploration is finished.
        prior: what the robot knows beforehand, a map of the world's cells; nothing when absent.
        goal: (x, y) to be at in the end [m]; none when absent.
        goal_radius: distance at which the goal is reached [m].
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map is explored.
        altitude: z of the start, for robots that have one [m].
        hover_time: simulated after the end [s].
        faults: what goes wrong on purpose.

    Raises:
        ValueError: a perception made for another range, resolution or goal; a start that is off the
            map, in a wall, in unknown space, or so close to either that the robot touches it; a
            rate that is not positive, above the control rate or no whole fraction of it; a target
            outside (0, 1]; a prior or walls of another shape; a goal off the map or in a wall.
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
    prior: OccupancyGrid
    goal: Position | None
    goal_radius: Scalar
    max_unknown: Scalar
    hover_steps: Count
    faults: Faults | None
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
        prior: OccupancyGrid | None = None,
        goal: Vector | None = None,
        goal_radius: ArrayLike = 1.5,
        max_unknown: ArrayLike = 0.05,
        altitude: float = 0.0,
        hover_time: float = 0.0,
        faults: Faults | None = None,
    ) -> None:
        pose = np.asarray(_checks.vector("start", start, 3), np.float64)
        self.world, self.robot, self.lidar = world, robot, lidar
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.goal_radius = _checks.scalar("goal_radius", goal_radius, above=0.0)
        self.max_unknown = _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)
        if perception is None:
            perception = Perception(
                lidar,
                world.resolution,
                robot.radius,
                goal=self.goal,
                max_unknown=self.max_unknown,
            )
        self.perception = perception
        goals = [None if each is None else each.tolist() for each in (perception.goal, self.goal)]
        if goals[0] != goals[1]:
            raise ValueError(
                f"perception has the goal {goals[0]}; accepted: the scenario's, {goals[1]}"
            )
        if self.goal is not None and float(world.at(self.goal)) >= FREE_THRESHOLD:
            raise ValueError(f"goal is {self.goal.tolist()}; accepted: a place in free space")
        self.prior = OccupancyGrid.unknown(world.shape, world.frame) if prior is None else prior
        walls = None if faults is None else faults.walls
        for name, shape in (("prior", self.prior.shape), ("walls", getattr(walls, "shape", None))):
            if shape not in (None, world.shape):
                raise ValueError(f"{name} has shape {shape}; accepted: the world's, {world.shape}")
        if not _is_same_frame(self.prior, world):
            raise ValueError(
                f"prior has cells of {self.prior.resolution:g} m at "
                f"{self.prior.frame.origin.tolist()}; accepted: the world's, "
                f"{world.resolution:g} m at {world.frame.origin.tolist()}"
            )
        self.faults = faults
        if self.perception.lidar.max_range != lidar.max_range or (
            self.perception.resolution != world.resolution
        ):
            raise ValueError(
                f"perception is for a range of {self.perception.lidar.max_range:g} m and cells of "
                f"{self.perception.resolution:g} m; accepted: those of the scenario, "
                f"{lidar.max_range:g} m and {world.resolution:g} m"
            )
        state = robot.at_pose(*(float(value) for value in pose))
        if "z" in robot.state_names:
            z = _checks.number("altitude", altitude)
            state = state.at[robot.state_names.index("z")].set(z)
        self.start = state
        self.reachable = jnp.asarray(reachable_cells(world, pose, float(robot.radius)))
        self.clearance_reach = clearance_reach(float(robot.radius), world.resolution)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = jnp.asarray(1.0 / rate, jnp.float32)
        self.steps_per_scan = _whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = _whole_steps("field_rate", field_rate, rate)
        hover = _checks.number("hover_time", hover_time, at_least=0.0)
        self.hover_steps = jnp.asarray(round(hover * rate), jnp.int32)
        self.target_coverage = _checks.scalar(
            "target_coverage", target_coverage, above=0.0, at_most=1.0
        )


def _is_same_frame(grid: OccupancyGrid, other: OccupancyGrid) -> bool:
    is_same = np.allclose(grid.frame.origin, other.frame.origin, rtol=1e-6, atol=1e-6)
    return is_same and grid.resolution == other.resolution


def _whole_steps(name: str, rate: float, control_rate: float) -> Array:
    checked = _checks.number(name, rate, above=0.0, at_most=control_rate)
    ratio = control_rate / checked
    if abs(ratio - round(ratio)) > 1e-3 * ratio:
        raise ValueError(
            f"{name} is {rate!r}; accepted: a whole fraction of the control rate of "
            f"{control_rate:g} Hz, such as {control_rate / max(1, round(ratio)):g}"
        )
    return jnp.asarray(round(ratio), jnp.int32)
