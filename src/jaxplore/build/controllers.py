"""What decides, from settings."""

from jaxplore.control.base import Controller
from jaxplore.control.knots import Knots
from jaxplore.control.parameterisations import Direct, Parameterisation
from jaxplore.control.smooth import Smooth
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.integrators import Euler
from jaxplore.build.parts import robot_of
from jaxplore.build.place import Place
from jaxplore.belief.perception import safe_stride
from jaxplore.information.pose import PoseInformation
from jaxplore.information.trajectory import TrajectoryInformation
from jaxplore.belief.zones import Zones
from jaxplore.planning.presets.quadrotor import (
    FieldNumbers,
    Flight,
    goal_mppi,
    informative_mppi,
    random_walk,
)
from jaxplore.planning.portfolio.contextual import ROLES, Contextual
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.portfolio.fusion import Fusion
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.presets.ground_vehicle import Mission, ground_portfolio
from jaxplore.planning.portfolio.portfolio import Portfolio
from jaxplore.planning.portfolio.safe_fusion import SafeFusion, fusion_by_name
from jaxplore.planning.strategy.target_explorer import TargetExplorer
from jaxplore.planning.strategy.target_rules import RULES
from jaxplore.planning.strategy.targets import (
    RemainingInformation,
    TargetChoice,
    TargetReference,
    Targets,
    TrajectoryChoice,
)
from jaxplore.planning.portfolio.voting import WeightedVote
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.settings.exploration import BASELINES, Settings


def controller_of(
    settings: Settings, robot: Dynamics, place: Place, model: InverseSensorModel, view: float
) -> Controller:
    """Return what decides.

    Raises:
        ValueError: an architecture that the place does not allow, a part that does not accept its
            settings.
    """
    if settings.architecture == "explorer":
        return explorer(robot, **settings.controller.model_dump())
    if settings.architecture == "portfolio":
        return _portfolio(settings, place)
    if settings.architecture in BASELINES:
        return _target_explorer(settings, robot, place)
    given = settings.informative.model_dump()
    given["parameterisation"] = _parameterisation(given["parameterisation"], given["horizon"])
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
    settings: Settings, place: Place, model: InverseSensorModel, view: float
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


def _parameterisation(name: str, horizon: int) -> Parameterisation:
    if name == "knots":
        return Knots(min(8, horizon))
    return Smooth() if name == "smooth" else Direct()


def _portfolio(settings: Settings, place: Place) -> Portfolio:
    given = settings.portfolio
    # Within the steps of a plan Euler is millimetres off, and takes a fifth of the time away.
    robot = robot_of(settings.robot, Euler())
    goal = None if place.goal is None else place.goal[:2]
    return ground_portfolio(
        robot,
        Mission(goal, has_terrain=place.ground is not None, has_movers=bool(place.movers)),
        members=given.members if given.weights is None else given.weights,
        decomposition=given.decomposition,
        fusion=_fusion(settings, goal),
        common=given.common,
        parameterisation=_parameterisation(given.parameterisation, given.horizon),
        **given.model_dump(include=set(_PORTFOLIO)),
    )


def _target_explorer(settings: Settings, robot: Dynamics, place: Place) -> TargetExplorer:
    """Return an explorer by a rule, that drives as `explorer` does."""
    fields, world = settings.fields, place.world
    given = settings.controller.model_dump()
    looks_around = settings.camera is None and settings.lidar.field_of_view_degrees >= 360.0
    if looks_around:
        # How it drives is the tracker's; what is worth seeing is the rule's alone. A robot that
        # does not see all around has to turn to what it came for, and stays until it did.
        given["information_weight"] = 0.0
    tracker = explorer(robot, **given)
    return TargetExplorer(
        tracker,
        RULES[settings.architecture](),
        world.frame,
        world.shape,
        safe_stride(fields.node_spacing, world.resolution, float(robot.radius)),
        required_clearance=float(robot.radius) + fields.margin,
        min_information=fields.min_information,
        stays=not looks_around,
        every=max(1, round(settings.rates.control / settings.rates.fields)),
    )


_PORTFOLIO = (
    "effort",
    "horizon",
    "num_samples",
    "temperature",
    "noise_share",
    "dt",
    "clearance",
    "margin",
)
"""Settings of a portfolio that `ground_portfolio` takes by the same name."""


def _fusion(settings: Settings, goal: tuple[float, ...] | None) -> Fusion:
    """Return how plans become one."""
    given = settings.portfolio
    if given.fusion == "weighted-vote":
        fusion: Fusion = WeightedVote(given.vote_temperature)
    elif given.fusion == "contextual":
        names = tuple(given.members or ROLES) if given.weights is None else tuple(given.weights)
        fusion = Contextual(
            names,
            goal=goal,
            near_goal=given.near_goal,
            near_obstacle=given.near_obstacle,
            rich_information=given.rich_information,
            hysteresis=given.hysteresis,
        )
    else:
        fusion = fusion_by_name(given.fusion)
    return SafeFusion(fusion, regret=given.regret) if given.is_safe else fusion
