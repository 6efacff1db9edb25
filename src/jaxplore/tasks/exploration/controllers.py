"""Controllers of exploration runs, from settings."""

import math
from collections.abc import Mapping
from typing import Any

from jaxplore._checks import warn_user
from jaxplore.belief.perception import Perception
from jaxplore.belief.zones import Zones
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.integrators import Euler
from jaxplore.dynamics.uncertain import UncertainRobot
from jaxplore.parts.localisation.settings import LOCALISATION
from jaxplore.parts.registry import control_arguments
from jaxplore.planning.portfolio.contextual import ROLES, Contextual
from jaxplore.planning.portfolio.fusion import Fusion
from jaxplore.planning.portfolio.portfolio import Portfolio
from jaxplore.planning.portfolio.safe_fusion import SafeFusion, fusion_by_name
from jaxplore.planning.portfolio.voting import WeightedVote
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.presets.flight import FieldNumbers, Flight
from jaxplore.planning.presets.ground_vehicle import Mission, ground_portfolio
from jaxplore.planning.presets.quadrotor import (
    goal_mppi,
    informative_mppi,
    random_walk,
    zone_choice,
)
from jaxplore.planning.presets.target_explorer import target_explorer
from jaxplore.planning.strategy.targets import TargetChoice
from jaxplore.planning.strategy.uncertainty_aware import UncertaintyAware
from jaxplore.sensing.lidar import Lidar
from jaxplore.settings.architectures import BASELINES, GROUND
from jaxplore.settings.code_names import is_own
from jaxplore.settings.defaults import arguments
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.tasks.exploration.fleet import cost_of_others, has_others
from jaxplore.tasks.exploration.settings import Settings
from jaxplore.tasks.exploration.world import RunWorld, surroundings
from jaxplore.tasks.robot import build_robot
from jaxplore.tasks.user_code import import_controller, import_rule


def build_controller(
    settings: Settings, world: RunWorld, scenario: ExplorationScenario
) -> Controller:
    """Build the controller of the architecture that settings name, which the world may not
    allow."""
    robot, perception = scenario.robot, scenario.perception
    _check_errands(settings, scenario)
    told = control_arguments(settings, surroundings(settings, world, float(robot.radius)))
    options: dict[str, Any] = {
        "has_moving_obstacles": has_others(settings),
        "moving_obstacle_cost": cost_of_others(settings),
        **told,
    }
    if settings.architecture == "explorer":
        uncertain = _uncertain_robot(scenario, settings.rates.sensing)
        given = LOCALISATION.find_section(settings)
        controller = explorer(
            robot,
            uncertain=uncertain,
            **({} if given is None else arguments(given, explorer)),
            **options,
            **arguments(settings.controller, explorer),
        )
        return controller if uncertain is None else UncertaintyAware(controller)
    if settings.architecture == "portfolio":
        return _portfolio(settings, world, told)
    own = import_rule(settings.architecture) if is_own(settings.architecture) else None
    if own is not None or settings.architecture in BASELINES:
        return target_explorer(
            robot,
            settings.architecture if own is None else own,
            perception,
            world.grid,
            # A choice is due when the fields that it reads are new.
            every=max(1, round(settings.rates.control / settings.rates.fields)),
            **options,
            **arguments(settings.controller, explorer),
        )
    if is_own(settings.architecture):
        return import_controller(settings.architecture, scenario)
    return _quadrotor_controller(settings, robot, world, perception, told)


def _check_errands(settings: Settings, scenario: ExplorationScenario) -> None:
    """Check that a robot whose parts send it somewhere follows the guidance field: neither the
    architecture nor the goal of a portfolio may be apart from it."""
    sent = [part.name for part in scenario.perception.parts if part.has_errands]
    if not sent or is_own(settings.architecture):
        return
    if settings.architecture not in GROUND:
        raise ValueError(
            f"setting {sent[0]} is given beside the architecture {settings.architecture}; "
            f"accepted: with {', '.join(GROUND)}, which follow the guidance field"
        )
    if scenario.perception.is_goal_apart:
        raise ValueError(
            f"setting {sent[0]} is given beside a goal in a portfolio; accepted: the explorer, or "
            "no goal"
        )


def _quadrotor_controller(
    settings: Settings,
    robot: Dynamics,
    world: RunWorld,
    perception: Perception,
    told: Mapping[str, Any],
) -> Controller:
    """Build informative MPPI or one of its baselines."""
    if "occlusion_cost" in told:
        warn_user(
            f"architecture {settings.architecture} knows nothing of people, and brakes only for "
            "those that its sensor shows; explorer and portfolio keep away from them"
        )
    given = settings.informative
    flight = Flight(
        **arguments(given, Flight),
        control_period=1.0 / settings.rates.control,
        altitude=settings.altitude,
        max_speed=settings.robot.max_speed,
    )
    if settings.architecture == "random-walk":
        return random_walk(robot, flight)
    goal = world.goal
    # A world's goal may have a height, which a robot on the ground has no state for.
    if goal is not None and "z" not in robot.state_names:
        goal = goal[:2]
    if settings.architecture == "goal":
        if goal is None:
            raise ValueError("goal is missing; accepted: a position, for the architecture goal")
        return goal_mppi(robot, goal, flight)
    view = math.radians(settings.lidar.field_of_view_degrees)
    is_sequential = settings.architecture == "sequential"
    return informative_mppi(
        robot,
        "parallel" if settings.architecture == "parallel" else "two-layer",
        target_choice=_zone_choice(settings, world, perception, view) if is_sequential else None,
        resolution=world.grid.resolution,
        sensor_model=perception.sensor_model,
        goal=goal,
        flight=flight,
        fields=FieldNumbers(
            **arguments(given, FieldNumbers),
            field_of_view=view,
            field_period=1.0 / settings.rates.fields,
        ),
        **arguments(given, informative_mppi),
    )


def _zone_choice(
    settings: Settings, world: RunWorld, perception: Perception, view: float
) -> TargetChoice:
    if world.goal is None or not world.zones:
        raise ValueError(
            "architecture is 'sequential', which goes from zone to zone and then to the goal; "
            "accepted: a world with both"
        )
    return zone_choice(
        Zones.from_rectangles(world.zones, world.grid),
        world.goal[:2],
        perception,
        Lidar(settings.lidar.num_beams, settings.lidar.max_range, view),
        **arguments(settings.informative, zone_choice),
    )


def _portfolio(settings: Settings, world: RunWorld, told: dict[str, Any]) -> Portfolio:
    given = settings.portfolio
    # The way back is the guidance's, once nothing is left to learn.
    goal = None if world.goal is None or settings.returns else world.goal[:2]
    return ground_portfolio(
        # Within a plan Euler's error is millimetres, and it saves a fifth of the time.
        build_robot(settings.robot, Euler()),
        Mission(
            goal,
            has_terrain=world.ground is not None,
            **{"has_moving_obstacles": has_others(settings), **told},
        ),
        members=given.members if given.weights is None else given.weights,
        fusion=_fusion(settings, goal),
        **arguments(given, ground_portfolio),
    )


def _fusion(settings: Settings, goal: tuple[float, ...] | None) -> Fusion:
    given = settings.portfolio
    if given.fusion == "weighted-vote":
        fusion: Fusion = WeightedVote(**arguments(given, WeightedVote))
    elif given.fusion == "contextual":
        names = tuple(given.members or ROLES) if given.weights is None else tuple(given.weights)
        fusion = Contextual(names, goal=goal, **arguments(given, Contextual))
    else:
        fusion = fusion_by_name(given.fusion)
    return SafeFusion(fusion, **arguments(given, SafeFusion)) if given.is_safe else fusion


def _uncertain_robot(scenario: ExplorationScenario, rate: float) -> UncertainRobot | None:
    """Return the robot with the variance of its position; None if plans do not know it.

    `rate` is that of the scans [Hz].
    """
    known = scenario.localisation
    if known is None or known.certainty is None:
        return None
    added = known.localiser.expected_odometry.variance_per_metre
    return UncertainRobot(scenario.robot, known.certainty.blank(), added, rate)
