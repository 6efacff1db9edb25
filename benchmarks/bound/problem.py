"""A known map, a start, a robot and its sensors: what a bound is computed for."""

import dataclasses
import math
from functools import cached_property

import numpy as np

from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.report.drawing.picture import to_frame
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.tasks.exploration.build import build_scenario
from jaxplore.tasks.exploration.settings import Settings
from jaxplore.tasks.exploration.world import build_world
from jaxplore.tasks.robot import build_robot


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A known map, a start, a robot and its sensors.

    Positions are *grid coordinates* (row, column) in cells, as those of `GridFrame`.

    Args:
        world: the true map.
        sensors: sensors that see over a full circle.
        reachable: (H, W) cells that count for coverage: those that the robot's centre can reach.
        start: (2,) start, in grid coordinates [cells].
        speed: greatest speed of the robot [m/s]; None if its model has none.
        acceleration: greatest acceleration of the robot [m/s^2]; None if it has none.
        scan_period: time between two scans [s].
        radius: radius of the robot [m].
        known: (H, W) cells that are known to be free in advance; none when absent.
        ground: ground of the map; level when absent.

    Raises:
        ValueError: a sensor that does not see over a full circle; a start that is not reachable.
    """

    world: OccupancyGrid
    sensors: tuple[Sensor, ...]
    reachable: np.ndarray
    start: np.ndarray
    speed: float | None
    acceleration: float | None
    scan_period: float
    radius: float
    known: np.ndarray | None = None
    ground: Ground | None = None

    def __post_init__(self) -> None:
        for sensor in self.sensors:
            if not sensor.is_full_circle:
                degrees = math.degrees(sensor.field_of_view)
                raise ValueError(
                    f"field_of_view of a sensor is {degrees:.0f} degrees; accepted: 360, because "
                    "a tour has no headings"
                )
        if not self.reachable.any():
            raise ValueError("reachable has no cells; accepted: a start with room around it")

    @classmethod
    def from_settings(cls, settings: Settings) -> "Problem":
        """Build the problem that an exploration run with these settings has.

        Raises:
            ValueError: a goal or targets, which end a run otherwise than by coverage; a robot that
                cannot turn on the spot; an inverse sensor model with which one scan does not make
                a cell free; what `Problem` rejects.
        """
        robot = build_robot(settings.robot)
        world = build_world(settings, float(robot.radius))
        scenario = build_scenario(settings, robot, world)
        if world.goal is not None or scenario.ends_by_parts:
            raise ValueError(
                "the run has a goal or targets; accepted: runs that end by coverage alone"
            )
        if float(robot.turning_radius) > 0.0:
            raise ValueError(
                f"robot.model is {settings.robot.model!r}; accepted: robots that turn on the spot"
            )
        model = scenario.perception.sensor_model
        if float(1.0 / (1.0 + np.exp(-float(model.free)))) >= FREE_THRESHOLD:
            raise ValueError(
                f"sensor_model makes a cell free by {float(model.free):g} in log-odds; accepted: "
                "a model with which one scan is enough"
            )
        return cls.from_scenario(scenario)

    @classmethod
    def from_scenario(cls, scenario: ExplorationScenario) -> "Problem":
        """Build the problem of a scenario; its goal and targets are not read."""
        robot, world = scenario.robot, scenario.world
        reachable = np.asarray(scenario.reachable)
        highest = getattr(robot, "max_speed", None)
        names = robot.control_names
        is_driven = "a" in names
        return cls(
            world,
            scenario.sensors,
            reachable,
            _to_grid(np.asarray(robot.position(scenario.start)), world),
            None if highest is None else float(highest),
            float(robot.control_max[names.index("a")]) if is_driven else None,
            scenario.steps_per_measurement * float(scenario.control_period),
            float(robot.radius),
            np.asarray(scenario.prior.is_free) & reachable,
            scenario.ground,
        )

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.world.resolution

    @property
    def max_range(self) -> float:
        """Greatest range of the sensors [m]."""
        return max(sensor.max_range for sensor in self.sensors)

    @cached_property
    def cells(self) -> np.ndarray:
        """Reachable cells (R, 2) as (row, column)."""
        return np.argwhere(self.reachable)

    @property
    def num_cells(self) -> int:
        """Number of reachable cells, R."""
        return len(self.cells)

    @cached_property
    def free(self) -> np.ndarray:
        """Mask (H, W) of the free cells."""
        return np.asarray(self.world.is_free)

    @property
    def scan_step(self) -> float:
        """Distance between two scans at full speed [cells]; a cell if there is no full speed."""
        if self.speed is None:
            return 1.0
        return self.speed * self.scan_period / self.resolution

    def needed(self, share: float) -> int:
        """Return the number of cells that a coverage takes."""
        # The judge compares in float32, where 0.99 N cells of N may fall on either side.
        return math.ceil(share * self.num_cells - 1e-6)

    def to_grid(self, points: np.ndarray) -> np.ndarray:
        """Return the grid coordinates (..., 2) of world points (x, y) [m]."""
        return _to_grid(points, self.world)

    def to_world(self, grid: np.ndarray) -> np.ndarray:
        """Return the world points (..., 2) as (x, y) [m] of grid coordinates."""
        x, y, yaw = (float(each) for each in np.asarray(self.world.frame.origin))
        across, up = grid[..., 1] * self.resolution, grid[..., 0] * self.resolution
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.stack([x + cos * across - sin * up, y + sin * across + cos * up], axis=-1)

    def heading(self, first: np.ndarray, last: np.ndarray) -> float:
        """Return the heading from one place to another in the world [rad]."""
        down, right = last - first
        return math.atan2(down, right) + float(np.asarray(self.world.frame.origin)[2])

    def seconds(self, metres: float) -> float | None:
        """Return the least time of a way [s]: from rest, then at full speed, turns for nothing.

        With the speed v and the acceleration a it is L / v + v / (2 a), or sqrt(2 L / a) on a way
        on which v is not reached. None if the robot has no greatest speed.

        Args:
            metres: length of the way, L [m].
        """
        if self.speed is None:
            return None
        if self.acceleration is None:
            return metres / self.speed
        needed = 0.5 * self.speed**2 / self.acceleration
        if metres < needed:
            return math.sqrt(2.0 * metres / self.acceleration)
        return metres / self.speed + 0.5 * self.speed / self.acceleration


def _to_grid(points: np.ndarray, world: OccupancyGrid) -> np.ndarray:
    along: np.ndarray = to_frame(points, np.asarray(world.frame.origin)) / world.resolution
    return along[..., ::-1]
