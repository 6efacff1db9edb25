"""Builds what is run: controller, scenario, steps and key."""

import math

import jax

from jaxplore.parameters import set_parameters
from jaxplore.build.controllers import controller_of
from jaxplore.build.parts import robot_of, sensor_model_of, sensors_of
from jaxplore.build.place import place_of
from jaxplore.belief.perception import MAX_UNKNOWN, Perception
from jaxplore.belief.idleness import IdlenessMap
from jaxplore.maps.terrain import TerrainMap
from jaxplore.settings.exploration import Settings
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.experiment import Experiment as Experiment
from jaxplore.simulation.exploration.scenario import ExplorationScenario


def build(settings: Settings) -> Experiment:
    """Return the controller, scenario, number of steps and key that settings describe.

    Raises:
        ValueError: a map that cannot be read, a start that is not possible, a part that does not
            accept its settings.
    """
    robot = robot_of(settings.robot)
    place = place_of(settings, float(robot.radius))
    world, ground = place.world, place.ground
    sensors = sensors_of(settings)
    model = sensor_model_of(settings.sensor_model)
    goal = None if place.goal is None else place.goal[:2]
    is_portfolio = settings.architecture == "portfolio"
    watch = settings.watch
    perception = Perception(
        sensors,
        world.resolution,
        robot.radius,
        sensor_model=model,
        goal=goal,
        max_unknown=MAX_UNKNOWN if settings.max_unknown is None else settings.max_unknown,
        ground=ground,
        watch=None if watch is None else IdlenessMap(watch.memory, watch.weight),
        is_goal_apart=is_portfolio and goal is not None,
        **settings.fields.model_dump(),
    )
    scenario = ExplorationScenario(
        world if ground is None else TerrainMap(world, ground),
        robot,
        sensors,
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
        targets=place.targets or None,
        moving_obstacles=MovingObstacles(place.movers) if place.movers else None,
    )
    view = math.radians(settings.lidar.field_of_view_degrees)
    controller = controller_of(settings, robot, place, model, view)
    return Experiment(
        set_parameters(controller, settings.parameters),
        scenario,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def comparable(settings: Settings) -> tuple[str, ...]:
    """Return the architectures for quadrotors that the map of some settings allows.

    Raises:
        ValueError: a map that cannot be read.
    """
    place = place_of(settings, settings.robot.radius)
    has_goal, has_zones = place.goal is not None, bool(place.zones)
    allowed = {
        "two-layer": True,
        "parallel": True,
        "sequential": has_goal and has_zones,
        "random-walk": True,
        "goal": has_goal,
    }
    return tuple(name for name, is_allowed in allowed.items() if is_allowed)
