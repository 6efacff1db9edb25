"""From settings to what is run: controller, scenario, steps and key."""

import math
from typing import NamedTuple

import jax

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.control.knots import Knots
from jaxplore.control.parameterisations import Direct
from jaxplore.control.smooth import Smooth
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.information.perception import Perception
from jaxplore.information.pose import PoseInformation
from jaxplore.information.trajectory import TrajectoryInformation
from jaxplore.information.zones import Zones
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.office import office, start_pose
from jaxplore.maps.world import World, is_world_file, three_zones
from jaxplore.planning.architectures import (
    FieldNumbers,
    Flight,
    goal_mppi,
    informative_mppi,
    random_walk,
)
from jaxplore.planning.explorer import explorer
from jaxplore.planning.gradient_reference import GradientReference
from jaxplore.planning.targets import (
    RemainingInformation,
    TargetChoice,
    TargetReference,
    Targets,
    TrajectoryChoice,
)
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.settings import OFFICE, ZONES, SensorModelSettings, Settings
from jaxplore.simulation.reachability import open_spot
from jaxplore.simulation.scenario import Scenario


class Experiment(NamedTuple):
    """What `simulate` takes."""

    controller: Controller
    scenario: Scenario
    num_steps: int
    key: Key


def build(settings: Settings) -> Experiment:
    """Return the controller, scenario, number of steps and key that settings describe.

    Raises:
        ValueError: a map that cannot be read, a start that is not possible, a part that does not
            accept its settings.
    """
    robot = _robot(settings)
    place = _place(settings, float(robot.radius))
    world = place.world
    view = math.radians(settings.lidar.field_of_view_degrees)
    lidar = Lidar(
        settings.lidar.num_beams, settings.lidar.max_range, view, settings.lidar.range_noise
    )
    model = _sensor_model(settings.sensor_model)
    goal = None if place.goal is None else place.goal[:2]
    perception = Perception(
        lidar,
        world.resolution,
        robot.radius,
        sensor_model=model,
        goal=goal,
        max_unknown=settings.max_unknown,
        **settings.fields.model_dump(),
    )
    scenario = Scenario(
        world,
        robot,
        lidar,
        place.start,
        perception=perception,
        control_rate=settings.rates.control,
        sensing_rate=settings.rates.sensing,
        field_rate=settings.rates.fields,
        target_coverage=settings.target_coverage,
        prior=place.prior,
        goal=goal,
        goal_radius=settings.goal_radius,
        max_unknown=settings.max_unknown,
        altitude=settings.altitude,
        hover_time=settings.hover_time,
    )
    return Experiment(
        _controller(settings, robot, place, model, view),
        scenario,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def comparable(settings: Settings) -> tuple[str, ...]:
    """Return the architectures for quadrotors that the map of some settings allows.

    Raises:
        ValueError: a map that cannot be read.
    """
    place = _place(settings, settings.robot.radius)
    has_goal, has_zones = place.goal is not None, bool(place.zones)
    allowed = {
        "two-layer": True,
        "parallel": True,
        "sequential": has_goal and has_zones,
        "random-walk": True,
        "goal": has_goal,
    }
    return tuple(name for name, is_allowed in allowed.items() if is_allowed)


class _Place(NamedTuple):
    """Where a run takes place."""

    world: OccupancyGrid
    start: tuple[float, float, float]
    prior: OccupancyGrid | None = None
    goal: tuple[float, ...] | None = None
    zones: tuple[tuple[float, ...], ...] = ()


def _robot(settings: Settings) -> Dynamics:
    given = settings.robot
    if given.model == "quadrotor":
        return Quadrotor(given.mass, radius=given.radius)
    return DifferentialDrive(**given.model_dump(exclude={"model", "mass"}))


def _sensor_model(settings: SensorModelSettings) -> InverseSensorModel:
    if settings.kind == "line_of_sight":
        return InverseSensorModel.line_of_sight()
    return InverseSensorModel(**settings.model_dump(exclude={"kind"}))


def _controller(
    settings: Settings, robot: Dynamics, place: _Place, model: InverseSensorModel, view: float
) -> Controller:
    if settings.architecture == "explorer":
        return explorer(robot, **settings.controller.model_dump())
    given = settings.informative.model_dump()
    parameterisation = {"direct": Direct(), "smooth": Smooth(), "knots": Knots(8)}
    given["parameterisation"] = parameterisation[given["parameterisation"]]
    period = 1.0 / settings.rates.control
    flight = Flight(
        **{name: given.pop(name) for name in Flight._fields if name in given},
        control_period=period,
        altitude=settings.altitude,
        max_speed=settings.robot.max_speed,
    )
    if settings.architecture == "random-walk":
        return random_walk(robot, flight)
    goal = place.goal
    if goal is not None and "z" not in robot.state_names:
        goal = goal[:2]
    if settings.architecture == "goal":
        if goal is None:
            raise ValueError("goal is missing; accepted: a position, for the architecture goal")
        return goal_mppi(robot, goal, flight)
    fields = FieldNumbers(
        **{name: given.pop(name) for name in FieldNumbers._fields if name in given},
        field_of_view=view,
        field_period=1.0 / settings.rates.fields,
    )
    for name in ("target_choice", "distance_weight", "depleted"):
        given.pop(name)
    reference = None
    if settings.architecture == "sequential":
        walk = GradientReference(given["reference_speed"], given["reference_steps"], flight.dt)
        reference = TargetReference(_target_choice(settings, place, model, view), walk)
    return informative_mppi(
        robot,
        "parallel" if settings.architecture == "parallel" else "two-layer",
        reference=reference,
        resolution=place.world.resolution,
        sensor_model=model,
        goal=goal,
        flight=flight,
        fields=fields,
        **given,
    )


def _target_choice(
    settings: Settings, place: _Place, model: InverseSensorModel, view: float
) -> TargetChoice:
    if place.goal is None or not place.zones:
        raise ValueError(
            "architecture is 'sequential', which goes from zone to zone and then to the goal; "
            "accepted: a world with both"
        )
    given = settings.informative
    targets = Targets(
        Zones.from_rectangles(place.zones, place.world),
        place.goal[:2],
        depleted=given.depleted,
        required_clearance=settings.robot.radius + settings.fields.margin,
    )
    weight = given.distance_weight
    if given.target_choice == "remaining":
        return RemainingInformation(targets, 0.05 if weight is None else weight)
    lidar = Lidar(settings.lidar.num_beams, settings.lidar.max_range, view)
    scans = TrajectoryInformation(PoseInformation(lidar, model), given.target_choice)
    return TrajectoryChoice(targets, scans, weight=1.0 if weight is None else weight)


def _place(settings: Settings, radius: float) -> _Place:
    if settings.map == OFFICE:
        grid = office(
            settings.office.seed,
            width=settings.office.width,
            height=settings.office.height,
            resolution=settings.resolution,
        )
        start = start_pose(grid) if settings.start is None else settings.start
        return _Place(grid, start, None, settings.goal)
    if settings.map == ZONES or is_world_file(settings.map):
        world = three_zones() if settings.map == ZONES else World.from_yaml(settings.map)
        start = world.start if settings.start is None else settings.start
        goal = world.goal if settings.goal is None else settings.goal
        return _Place(world.truth(), start, world.prior(), goal, world.zones)
    grid = OccupancyGrid.from_ros(settings.map)
    if grid.resolution < settings.resolution * (1.0 - 1e-6):
        grid = grid.resample(settings.resolution)
    if settings.start is None:
        x, y = open_spot(grid, radius)
        raise ValueError(
            f"start is missing; accepted: a pose in free space, for example {x:.2f} {y:.2f} 0"
        )
    return _Place(grid, settings.start, None, settings.goal)
