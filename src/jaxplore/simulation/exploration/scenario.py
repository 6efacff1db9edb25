"""A world, a robot in it, its sensors, and how often everything happens."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Count, GridMask, Position, Rows, Scalar, StateVector, Vector
from jaxplore.belief.perception import MAX_UNKNOWN, Perception, as_sensors
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.maps.terrain import TerrainMap
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.collision import clearance_reach
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.exploration.reachability import reachable_cells
from jaxplore.simulation.faults import Faults


class Scenario(eqx.Module):
    """What is simulated: a robot that starts somewhere in a world of which it knows little.

    It is finished at the target coverage, or, if there is a goal, within `goal_radius` of it with
    less than `max_unknown` of its map unknown (or at the target coverage). A goal apart (see
    `Perception`) is for a robot that goes there first and looks around on the way. With `targets`
    it is finished when the first sensor has seen all of them. Without a target coverage, a goal
    and targets, as on a patrol, it is not finished before its time is up.

    Whatever the world does not know to be free is solid. *Reachable* are the free cells to which
    the centre of the robot's disc can get from the start; coverage is the share of them that the
    robot's map knows to be free.

    The ground of a terrain map is known to the robot; what stands on it is not. Cells that may not
    be entered are no walls: the robot can get onto them, which is recorded.

    Args:
        world: the true map, hidden from the robot; with the ground if it is a terrain map.
        robot: the plant.
        sensors: what it carries, one or several; the first leads, see `Perception`.
        start: pose (x, y, yaw) [m, m, rad]; the robot stands still there.
        perception: how scans become a belief; made for the sensors and the world when absent.
        control_rate: [Hz].
        sensing_rate: scans and map updates [Hz]; a whole fraction of the control rate.
        field_rate: updates of the information and guidance fields [Hz]; likewise. The first is at
            the first step, the others at the end of each period.
        target_coverage: share of the reachable cells at which exploration is finished; None for
            never.
        prior: what the robot knows beforehand, a map of the world's cells; nothing when absent.
        goal: (x, y) to be at in the end [m]; none when absent.
        goal_radius: distance at which the goal is reached [m]; when absent 1.5, or 0.25 for a
            goal apart.
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map is explored; when
            absent 0.05, or for a goal apart 1: it is reached when the robot is there.
        altitude: z of the start, for robots that have one [m].
        hover_time: simulated after the end [s].
        faults: what goes wrong on purpose.
        targets: (M, 2) what is to be seen [m]; nothing when absent.
        movers: obstacles that move. The robot has a tracker for them, which measures those in sight
            of any of its sensors. Where on their way they begin depends on the run's key.
        tracking_noise: standard deviations of the tracker's positions [m] and velocities [m/s].

    Raises:
        ValueError: a perception made for another range, resolution or goal; a start that is off the
            map, in a wall, in unknown space, or so close to either that the robot touches it; a
            rate that is not positive, above the control rate or no whole fraction of it; a target
            coverage outside (0, 1]; a prior or walls of another shape; a goal off the map, in a
            wall, or where the robot cannot get from its start; a target off the map or in a
            wall.
    """

    world: OccupancyGrid
    robot: Dynamics
    sensors: tuple[Sensor, ...]
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
    ground: Ground | None
    targets: Float[Array, "M 2"]
    movers: MovingObstacles | None
    tracking_noise: Float[Array, "2"]
    clearance_reach: int = eqx.field(static=True)

    def __init__(
        self,
        world: OccupancyGrid | TerrainMap,
        robot: Dynamics,
        sensors: Sensor | Sequence[Sensor],
        start: Vector,
        *,
        perception: Perception | None = None,
        control_rate: float = 50.0,
        sensing_rate: float = 10.0,
        field_rate: float = 5.0,
        target_coverage: ArrayLike | None = 0.99,
        prior: OccupancyGrid | None = None,
        goal: Vector | None = None,
        goal_radius: ArrayLike | None = None,
        max_unknown: ArrayLike | None = None,
        altitude: float = 0.0,
        hover_time: float = 0.0,
        faults: Faults | None = None,
        targets: Rows | None = None,
        movers: MovingObstacles | None = None,
        tracking_noise: Vector = (0.05, 0.1),
    ) -> None:
        pose = np.asarray(_checks.vector("start", start, 3), np.float64)
        self.ground = None
        if isinstance(world, TerrainMap):
            self.ground = world.ground
            world = world.grid
        self.world, self.robot, self.sensors = world, robot, as_sensors(sensors)
        self.movers = None if movers is None or movers.radius.shape[0] == 0 else movers
        self.tracking_noise = _checks.vector("tracking_noise", tracking_noise, 2)
        if (np.asarray(self.tracking_noise) < 0.0).any():
            raise ValueError(
                f"tracking_noise is {self.tracking_noise.tolist()}; accepted: 2 numbers >= 0"
            )
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        is_apart = perception is not None and perception.is_goal_apart
        if goal_radius is None:
            goal_radius = 0.25 if is_apart else 1.5
        if max_unknown is None:
            max_unknown = 1.0 if is_apart else MAX_UNKNOWN
        self.goal_radius = _checks.scalar("goal_radius", goal_radius, above=0.0)
        self.max_unknown = _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)
        if perception is None:
            perception = Perception(
                self.sensors,
                world.resolution,
                robot.radius,
                goal=self.goal,
                max_unknown=self.max_unknown,
                ground=self.ground,
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
        ranges, known = (
            [sensor.max_range for sensor in each] for each in (self.sensors, perception.sensors)
        )
        if known != ranges or perception.resolution != world.resolution:
            raise ValueError(
                f"perception is for ranges of {known} m and cells of {perception.resolution:g} m; "
                f"accepted: those of the scenario, {ranges} m and {world.resolution:g} m"
            )
        if not _is_same_ground(perception.ground, self.ground):
            kind = "no" if perception.ground is None else "another"
            raise ValueError(f"perception has {kind} ground; accepted: that of the world")
        state = robot.at_pose(*(float(value) for value in pose))
        if "z" in robot.state_names:
            z = _checks.number("altitude", altitude)
            state = state.at[robot.state_names.index("z")].set(z)
        self.start = state
        passable = world if self.ground is None else _with_closed(world, self.ground)
        self.reachable = jnp.asarray(reachable_cells(passable, pose, float(robot.radius)))
        if self.goal is not None:
            self._check_goal(self.goal)
        self.targets = self._checked_targets(targets)
        self.clearance_reach = clearance_reach(robot.footprint, world.resolution)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = jnp.asarray(1.0 / rate, jnp.float32)
        self.steps_per_scan = _whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = _whole_steps("field_rate", field_rate, rate)
        hover = _checks.number("hover_time", hover_time, at_least=0.0)
        self.hover_steps = jnp.asarray(round(hover * rate), jnp.int32)
        # A share that no coverage reaches.
        self.target_coverage = (
            jnp.asarray(2.0, jnp.float32)
            if target_coverage is None
            else _checks.scalar("target_coverage", target_coverage, above=0.0, at_most=1.0)
        )

    @property
    def num_targets(self) -> int:
        """How many targets there are."""
        return int(self.targets.shape[0])

    def _check_goal(self, goal: Position) -> None:
        rows, columns = np.nonzero(np.asarray(self.reachable))
        centres = self.world.frame.cell_centre(jnp.asarray(np.stack([rows, columns], axis=-1)))
        nearest = float(jnp.min(jnp.linalg.norm(centres - goal, axis=-1)))
        if nearest > float(self.goal_radius):
            raise ValueError(
                f"goal is {goal.tolist()}, which a robot of radius {float(self.robot.radius):g} m "
                f"cannot reach from its start: {nearest:.2f} m is the nearest it gets; accepted: a "
                f"goal within {float(self.goal_radius):g} m of where it can go"
            )

    def _checked_targets(self, targets: Rows | None) -> Float[Array, "M 2"]:
        if targets is None:
            return jnp.zeros((0, 2))
        given = np.asarray(targets, np.float32)
        if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != 2:
            raise ValueError(f"targets has shape {given.shape}; accepted: (M, 2) with M >= 1")
        for index, spot in enumerate(given):
            if not np.isfinite(spot).all() or float(self.world.at(jnp.asarray(spot))) >= (
                FREE_THRESHOLD
            ):
                raise ValueError(
                    f"targets[{index}] is {spot.tolist()}; accepted: a place in free space"
                )
        return jnp.asarray(given)


def _is_same_ground(ground: Ground | None, other: Ground | None) -> bool:
    if ground is None or other is None:
        return ground is other
    layers = ((each.elevation, each.is_traversable) for each in (ground, other))
    (height, open_), (other_height, other_open) = layers
    return np.array_equal(height, other_height) and np.array_equal(open_, other_open)


def _with_closed(world: OccupancyGrid, ground: Ground) -> OccupancyGrid:
    """Return the world with cells that may not be entered as solid as walls."""
    closed = jnp.where(ground.is_traversable, world.probability, 1.0)
    return OccupancyGrid(closed, world.resolution, world.frame.origin)


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
