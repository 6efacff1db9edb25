"""Exploration experiments, from settings."""

from typing import Any

import jax

from jaxplore.belief.car import car_motion
from jaxplore.belief.perception import Perception
from jaxplore.control.base import Controller
from jaxplore.control.guard import MotionGuard
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal import Goal
from jaxplore.maps.terrain import TerrainMap
from jaxplore.parameters import set_parameters
from jaxplore.parts.registry import Equipment, build_parts, control_arguments
from jaxplore.sensing.base import Sensor
from jaxplore.settings.defaults import arguments
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.scenario import Scenario
from jaxplore.tasks.exploration.controllers import build_controller
from jaxplore.tasks.exploration.fleet import build_fleet
from jaxplore.tasks.exploration.settings import Settings, make_exploration_settings
from jaxplore.tasks.exploration.world import (
    RunWorld,
    build_world,
    is_ros_map,
    surroundings,
)
from jaxplore.tasks.robot import (
    build_robot,
    build_sensor_model,
    build_sensors,
    with_adaptive_horizon,
    with_latency,
)


def build_exploration(settings: Settings, map_shape: tuple[int, int] | None = None) -> Experiment:
    """Build the experiment that settings describe.

    `map_shape` are the rows and columns of the map's arrays, see `OccupancyGrid.pad`; they are
    chosen when None. The run does not depend on them, but runs of one shape share a program.
    """
    robot = build_robot(settings.robot)
    world = build_world(settings, float(robot.radius))
    if map_shape is not None:
        ground = None if world.ground is None else world.ground.pad(map_shape)
        world = world._replace(grid=world.grid.pad(map_shape), ground=ground)
    return build_in(settings, robot, world)


def build_in(settings: Settings, robot: Dynamics, world: RunWorld) -> Experiment:
    """Build the experiment that settings describe in a given world; their map is not read."""
    scenario = build_scenario(settings, robot, world)
    controller = build_controller(settings, world, scenario)
    controller = set_parameters(controller, settings.parameters)
    controller = with_adaptive_horizon(controller, settings.adaptive_horizon)
    controller = with_latency(controller, settings, scenario)
    both: tuple[Controller, Scenario] = (controller, scenario)
    if settings.fleet is not None:
        both = build_fleet(settings.fleet, settings, scenario, controller, world.datum)
    return Experiment(
        *both,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def build_scenario(settings: Settings, robot: Dynamics, world: RunWorld) -> ExplorationScenario:
    """Build the scenario that settings describe in a world that is given; see `build_in`."""
    sensors = build_sensors(settings)
    around = surroundings(settings, world, float(robot.radius))
    equipment = build_parts(settings, around)
    if not world.is_placed:
        parts = tuple(part.unplaced() for part in equipment.parts)
        equipment = Equipment(parts, (), equipment.perception, (), equipment.scenario)
    perception = _perception(settings, robot, world, sensors, equipment)
    ground = world.ground
    numbers = {**arguments(settings, Goal), "max_unknown": _choose_max_unknown(settings)}
    goal = None if world.goal is None else Goal(world.goal[:2], **numbers)
    scenario = ExplorationScenario(
        world.grid if ground is None else TerrainMap(world.grid, ground),
        robot,
        sensors,
        world.start,
        perception=perception,
        prior=world.prior,
        goal=goal,
        altitude=settings.altitude,
        truths=equipment.truths,
        datum=world.datum,
        **equipment.scenario,
        **arguments(settings, ExplorationScenario),
        **arguments(settings.rates, ExplorationScenario),
    ).with_disturbances(equipment.disturbances)
    # A quadrotor's camera does not show where people come from: with the limit of speeds it lost
    # half of its way, and touched as many of them per metre.
    is_flying = "z" in robot.state_names
    told = {} if is_flying else control_arguments(settings, around)
    occlusion = told.get("occlusion_cost")
    return scenario.with_guard(MotionGuard(occlusion=occlusion) if settings.guard else None)


def _choose_max_unknown(settings: Settings) -> float | None:
    """Return the share of unknown cells at which the goal is next; None for the default."""
    if settings.max_unknown is None and settings.returns:
        # A robot that shall come back explores all that it can.
        return 0.0
    return settings.max_unknown


def _perception(
    settings: Settings,
    robot: Dynamics,
    world: RunWorld,
    sensors: tuple[Sensor, ...],
    equipment: Equipment,
) -> Perception:
    goal = None if world.goal is None else world.goal[:2]
    # When absent, the default of `Perception` applies, not that of the scenario.
    share = _choose_max_unknown(settings)
    unknown: dict[str, Any] = {} if share is None else {"max_unknown": share}
    return Perception(
        sensors,
        world.grid.resolution,
        robot.radius,
        sensor_model=build_sensor_model(settings.sensor_model),
        goal=goal,
        goal_heading=None if goal is None else settings.goal_heading,
        ground=world.ground,
        parts=equipment.parts,
        # Only the portfolio has an objective that reads the cost to go to the goal on its own.
        is_goal_apart=settings.architecture == "portfolio"
        and goal is not None
        and not settings.returns,
        car=car_motion(robot),
        **equipment.perception,
        **arguments(settings.fields, Perception),
        **unknown,
    )


def with_start(entries: dict[str, Any]) -> dict[str, Any]:
    """Return settings entries with a start, where neither they nor the map have one.

    It is the position with the greatest clearance, heading along x. A map without a place for the
    robot raises a ValueError.
    """
    settings = make_exploration_settings(entries)
    if settings.start is not None or not is_ros_map(settings):
        return entries
    world = build_world(settings, float(build_robot(settings.robot).radius))
    return {**entries, "start": tuple(world.datum.round_to_map(world.start).tolist())}


def choose_architectures(entries: dict[str, Any]) -> tuple[str, ...]:
    """Return the architectures to compare by default.

    A portfolio is compared with the explorer. Otherwise the quadrotor architectures that the map
    allows are compared.
    """
    if make_exploration_settings(entries).architecture == "portfolio":
        return ("explorer", "portfolio")
    # The architectures below are those of a quadrotor, so its defaults apply.
    settings = make_exploration_settings({**entries, "architecture": "two-layer"})
    world = build_world(settings, settings.robot.radius)
    has_goal, has_zones = world.goal is not None, bool(world.zones)
    allowed = {
        "two-layer": True,
        "parallel": True,
        "sequential": has_goal and has_zones,
        "random-walk": True,
        "goal": has_goal,
    }
    return tuple(name for name, is_allowed in allowed.items() if is_allowed)
