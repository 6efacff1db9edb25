"""The pilot of a real robot, from settings."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplore import _checks
from jaxplore.belief.car import car_motion
from jaxplore.belief.perception import Perception
from jaxplore.costs.base import Cost
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.maps.files.ros import map_datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.onboard.following import Following, blank_path
from jaxplore.onboard.goals import GoalChooser
from jaxplore.onboard.motors import Motors
from jaxplore.onboard.options import PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.session import Session
from jaxplore.parameters import set_parameters
from jaxplore.parts.localisation.settings import (
    LOCALISATION,
    LocalisationSettings,
    make_localisation,
)
from jaxplore.parts.registry import CAPABILITIES, control_arguments
from jaxplore.planning.presets.path_following import PathFollowing, mpcc
from jaxplore.planning.strategy.target_rules import RULES, DiscountedInformation
from jaxplore.robot.localisation import Localisation
from jaxplore.settings.code_names import is_own
from jaxplore.settings.defaults import arguments
from jaxplore.settings.node import NodeSettings, check_sensors, part_node
from jaxplore.settings.readers import read_values
from jaxplore.simulation.exploration.reachability import open_spot
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.tasks.exploration.build import build_in, build_scenario
from jaxplore.tasks.exploration.settings import OFFICE, Settings, make_exploration_settings
from jaxplore.tasks.exploration.world import ENOUGH, RunWorld, surroundings
from jaxplore.tasks.robot import build_robot, build_sensor_model, build_sensors
from jaxplore.tasks.user_code import import_rule

NO_PART = (
    *("map", "is_map_known", "world", "start", "goal", "office", "terrain", "camera"),
    *("altitude", "latency", "guard"),
    *(each.name for each in CAPABILITIES if not each.is_on_board),
)
"""Settings of a simulated world, and of parts that a pilot does not have or has of its own."""


def make_node_settings(entries: dict[str, object]) -> tuple[Settings, NodeSettings]:
    """Check settings entries of a node: those of a run, and the section `node`.

    Entries that describe a simulated world are not read. A node that chooses goals must get its
    pose from another program.
    """
    run, node = part_node(entries)
    check_sensors(node)
    given = {name: value for name, value in run.items() if name not in NO_PART}
    if node.pose == "external":
        # That of a simulated robot: this one gets its pose.
        given.pop("localisation", None)
    elif node.mode == "goal":
        raise ValueError(
            "setting node.pose is 'internal' with node.mode goal; accepted: external, the pose in "
            "the map of another program"
        )
    else:
        localisation = given.get("localisation")
        method = "matching" if node.map is None else "particles"
        if localisation is None or isinstance(localisation, dict):
            given["localisation"] = {"method": method, **(localisation or {})}
    for each in CAPABILITIES:
        own = given.get(each.name, {})
        if each.on_board and isinstance(own, dict):
            own = {name: value for name, value in own.items() if value is not None}
            given[each.name] = {**each.on_board, **own}
    # The office stands in for the map: a robot finds its own.
    # The guard is that of a simulated robot: a pilot has its own checks.
    settings = make_exploration_settings({**given, "map": OFFICE, "guard": False})
    if settings.fleet is not None:
        raise ValueError(
            f"setting fleet.robots is {settings.fleet.robots}; accepted: no section fleet, for "
            "each robot of a fleet has a node of its own"
        )
    _check_parts(settings, node)
    check_no_mount(settings, "node.lidar_x, node.lidar_y and node.lidar_yaw_degrees")
    return settings, node


def _check_parts(settings: Settings, node: NodeSettings) -> None:
    """Check that no capability is given that the mode of the node would not use.

    A chooser of goals has a map alone, and a robot on the path of another program goes nowhere of
    its own.
    """
    for each in CAPABILITIES:
        is_given = each.is_optional and each.find_section(settings) is not None
        if not is_given or node.mode == "control":
            continue
        if node.mode == "goal" or each.sends_robot:
            raise ValueError(
                f"setting {each.name} is given with node.mode {node.mode}; accepted: without it, "
                "or node.mode control"
            )


def check_no_mount(settings: Settings, others: str) -> None:
    """Check that settings neither move the lidar from the robot's centre nor turn it.

    Those settings are for `jaxplore run`. `others` names what says where the lidar is instead.
    """
    for name in ("x", "y", "yaw_degrees", "is_turning"):
        value = getattr(settings.lidar, name)
        if value:
            raise ValueError(
                f"setting lidar.{name} is {value}, which is for `jaxplore run`; accepted: "
                f"{type(value)()}, beside {others}"
            )


def build_goal_chooser(settings: Settings) -> GoalChooser:
    """Build the chooser of goals. An architecture of the user's own must be a rule."""
    robot = build_robot(settings.robot)
    perception = Perception(
        build_sensors(settings),
        settings.resolution,
        robot.radius,
        sensor_model=build_sensor_model(settings.sensor_model),
        car=car_motion(robot),
        **arguments(settings.fields, Perception),
    )
    if is_own(settings.architecture):
        rule = import_rule(settings.architecture)
        if rule is None:
            raise ValueError(
                f"architecture is {settings.architecture!r}, no rule; accepted: a TargetRule, for "
                "goals"
            )
    else:
        rule = RULES.get(settings.architecture, DiscountedInformation)()
    return GoalChooser(perception, rule, max_speed=settings.robot.max_speed)


def open_session(settings: Settings, node: NodeSettings) -> Session | None:
    """Return the session that settings name; None if they name none.

    Raises:
        ValueError: as of `Session`.
    """
    if node.session is None:
        return None
    values = read_values(settings)
    del values["map"]
    kept = {**values, "node": node.model_dump(mode="json", exclude={"session"})}
    facts: dict[str, object] = {
        "setting resolution": settings.resolution,
        **_map_facts(settings, node),
        "setting node.pose": node.pose,
        **{
            f"setting lidar.{name}": getattr(settings.lidar, name)
            for name in ("num_beams", "field_of_view_degrees", "max_range")
        },
    }
    return Session(Path(node.session), facts, kept)


def _map_facts(settings: Settings, node: NodeSettings) -> dict[str, object]:
    """Return what says which map a robot has."""
    if node.map is None:
        return {"setting node.map_size": node.map_size}
    grid = _known_world(node.map, settings).grid
    cells = np.ascontiguousarray(grid.probability)
    return {"cells of node.map": hashlib.sha256(cells.tobytes()).hexdigest()[:16]}


def build_pilot(
    settings: Settings,
    node: NodeSettings,
    *,
    is_obeyed: bool = True,
    session: Session | None = None,
) -> Pilot:
    """Build the pilot that settings describe.

    `is_obeyed` says whether the robot executes the commands; it does not in a replay. `session` is
    that of `open_session`; none when absent.
    """
    finder = _build_finder(settings)
    localisation, settings = _localisation(settings, node)
    robot = build_robot(settings.robot)
    if "z" in robot.state_names:
        raise ValueError(
            f"setting robot.model is {settings.robot.model!r}; accepted: a robot on the ground"
        )
    world = _blank_world(settings, node) if node.map is None else _known_world(node.map, settings)
    key = jax.random.key(settings.seed)
    told = control_arguments(settings, surroundings(settings, world, float(robot.radius)))
    motors = Motors(**arguments(node.motors, Motors))
    numbers = arguments(node, PilotOptions)
    options = PilotOptions(**numbers, is_obeyed=is_obeyed, motors=motors)
    if node.mode in ("follow", "controller"):
        if settings.adaptive_horizon.rule is not None:
            raise ValueError(
                f"setting adaptive_horizon.rule is {settings.adaptive_horizon.rule!r} with "
                f"node.mode {node.mode}; accepted: none"
            )
        following = _build_following(settings, node, robot, told)
        scenario = build_scenario(settings, following.model, world)
        controller = set_parameters(following.controller, settings.parameters)
        pilot = Pilot(
            *(scenario, controller, key, options, Following(scenario.perception), localisation),
            session=session,
            finder=finder,
            is_map_known=node.map is not None,
        )
    else:
        # The way back is one more source of the guidance field, which the explorer follows.
        if settings.architecture == "explorer":
            world = world._replace(goal=world.start[:2])
        made = build_in(settings, robot, world)
        assert isinstance(made.scenario, ExplorationScenario)
        pilot = Pilot(
            *(made.scenario, made.controller, key, options),
            localisation=localisation,
            occlusion=told.get("occlusion_cost"),
            session=session,
            finder=finder,
            is_map_known=node.map is not None,
        )
    pilot.is_started = node.is_autostarted
    return pilot


def _blank_world(settings: Settings, node: NodeSettings) -> RunWorld:
    """Return the world of a robot that stands in the middle of its map, and knows nothing of it."""
    cells = max(2, round(node.map_size / settings.resolution))
    side = cells * settings.resolution
    # For the scenario, which checks that the robot fits, it is free.
    grid = OccupancyGrid(
        np.zeros((cells, cells), np.float32), settings.resolution, (-0.5 * side, -0.5 * side, 0.0)
    )
    return RunWorld(grid, (0.0, 0.0, 0.0), is_placed=False)


def _known_world(path: str, settings: Settings) -> RunWorld:
    """Return the world of a robot that knows a ROS map; it begins where there is room."""
    datum = map_datum(path)
    grid = OccupancyGrid.from_ros(path, datum=datum)
    if grid.resolution < settings.resolution * ENOUGH:
        grid = grid.resample(settings.resolution)
    radius = float(build_robot(settings.robot).radius)
    start = (*open_spot(grid, radius), 0.0)
    return RunWorld(grid, start, grid, datum=datum, is_placed=False)


def _build_finder(settings: Settings) -> ParticleLocaliser:
    """Build what finds a robot on the map of its session."""
    given = LOCALISATION.find_section(settings)
    if not isinstance(given, LocalisationSettings):
        given = LocalisationSettings()
    sensor = build_sensors(settings)[0]
    found = make_localisation(
        given.model_copy(update={"method": "particles", "most_uncertainty": None}),
        *(settings.robot.model, sensor, settings.resolution),
        is_map_known=True,
    ).localiser
    assert isinstance(found, ParticleLocaliser)
    return found


def _localisation(settings: Settings, node: NodeSettings) -> tuple[Localisation | None, Settings]:
    """Return how the pilot finds its pose, and the settings of its scenario, which knows it."""
    given = LOCALISATION.find_section(settings)
    if node.pose == "external" or not isinstance(given, LocalisationSettings):
        return None, settings
    method, why = "matching", "the robot makes its own map"
    if node.map is not None:
        method, why = "particles", "the robot knows its map, node.map"
    if given.method != method:
        raise ValueError(
            f"setting localisation.method is {given.method!r} with node.pose internal; accepted: "
            f"{method!r}, for {why}"
        )
    for name, accepted in (("uncertainty_weight", 0.0), ("most_uncertainty", None)):
        value = getattr(given, name)
        if value != accepted:
            raise ValueError(
                f"setting localisation.{name} is {value:g} with node.pose internal; accepted: "
                f"{'none' if accepted is None else '0'}, for plans of a robot know no uncertainty"
            )
    sensor = build_sensors(settings)[0]
    found = make_localisation(
        *(given, settings.robot.model, sensor, settings.resolution),
        is_map_known=node.map is not None,
    )
    return found, settings.model_copy(update={LOCALISATION.name: None})


def _build_following(
    settings: Settings, node: NodeSettings, robot: Dynamics, told: Mapping[str, Any]
) -> PathFollowing:
    """Build the contouring control of a robot that keeps clear of what its own map shows."""
    given = settings.controller
    near: Cost = ObstacleCost(given.clearance)
    if told.get("has_moving_obstacles"):
        near = near + MovingObstacleCost()
    avoidance = _checks.scalar("obstacle_weight", given.obstacle_weight) * near
    numbers = arguments(node.contouring, mpcc)
    if node.mode == "controller":
        # The angle is that of each path.
        numbers["end_heading"] = 0.0
    if not isinstance(robot, ContinuousDynamics):
        numbers["comfort_weight"] = None
    return mpcc(robot, blank_path(), other=avoidance, **numbers)
