"""Informative MPPI for a quadrotor in both architectures, and baselines."""

from typing import Any

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS_AHEAD
from jaxplore._spelling import match_spelling
from jaxplore._types import ArrayLike, Vector
from jaxplore._xla import compute
from jaxplore.belief.perception import Perception
from jaxplore.belief.roadmap import TurnsOnTheSpot
from jaxplore.belief.zones import Zones
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.control.mppi import MPPI
from jaxplore.control.proposals import Proposal
from jaxplore.costs.exploration import (
    GuidanceCost,
    HomingCost,
    LocalInformationCost,
    PotentialCost,
    StrategyReferenceCost,
)
from jaxplore.costs.tracking import GoalCost
from jaxplore.dynamics._bounds import bound_of_speed
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.gain import CellSensor
from jaxplore.information.pose import PoseInformation
from jaxplore.information.trajectory import TrajectoryInformation
from jaxplore.planning.presets.flight import FieldNumbers, Flight
from jaxplore.planning.strategy.followers import follower_for
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.strategy.informative import InformativeMPPI
from jaxplore.planning.strategy.random_walk import RandomWalk
from jaxplore.planning.strategy.references import ClimbingReference, StrategicReference
from jaxplore.planning.strategy.target_choices import RemainingInformation, TrajectoryChoice
from jaxplore.planning.strategy.targets import TargetChoice, TargetReference, Targets
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar

ARCHITECTURES = ("two-layer", "parallel")
BASELINE_WEIGHT = 10.0
"""Weight of the distance from the target where nothing else attracts [1/m]; that of guidance."""


@_kinds.check_arguments
def informative_mppi(
    robot: Dynamics,
    architecture: str = "two-layer",
    *,
    resolution: float,
    sensor_model: CellSensor | None = None,
    goal: Vector | None = None,
    flight: Flight | None = None,
    fields: FieldNumbers | None = None,
    bias_fraction: ArrayLike = 0.5,
    likelihood_ratio: bool = False,
    reference: StrategicReference | None = None,
    target_choice: TargetChoice | None = None,
    reference_speed: ArrayLike = 2.0,
    reference_steps: int = 40,
    by_heading: bool = False,
    goal_when_explored: bool = True,
    reference_weight: ArrayLike = 1.0,
    local_weight: ArrayLike = 10.0,
    field_weight: ArrayLike = 20.0,
    guidance_weight: ArrayLike = 10.0,
    goal_weight: ArrayLike = 0.2,
) -> InformativeMPPI:
    """Build informative MPPI with the costs and defaults for a quadrotor, for any robot.

    Two-layer: MPPI tracks a reference that ascends the information field, with half of its samples
    around the controls that follow it. Parallel: MPPI reads the field, without reference and bias.
    Both also have a guidance cost, the cost to go through the whole map to the remaining
    information. With a `target_choice`, two-layer goes from zone to zone: the sequential
    architecture. The reference of a car is the way down its lattice of headings.

    The function has more than 60 lines because it is the one place of these numbers.

    Args:
        robot: model of the robot.
        architecture: "two-layer" or "parallel".
        resolution: side of a map cell [m].
        sensor_model: inverse sensor model; `line_of_sight` when absent.
        goal: goal position (x, y) or (x, y, z) [m]; none when absent.
        flight: parameters of MPPI and of safety.
        fields: parameters of the information fields.
        bias_fraction: share of the samples around the reference's controls.
        likelihood_ratio: whether these are weighted by their likelihood ratio. Without it, the plan
            is biased towards the reference, as in Biased-MPPI.
        reference: reference of the two-layer architecture; when absent it leads to the target of
            `target_choice`.
        target_choice: rule that chooses the target of the reference, see `zone_choice`: the
            sequential architecture. When absent the reference climbs the field.
        reference_speed: speed along the reference; no more than the robot's [m/s].
        reference_steps: length of the reference in steps of `flight.dt`.
        by_heading: whether to read the field at the robot's heading instead of the best heading.
        goal_when_explored: whether the goal attracts only once the map is explored.
        reference_weight: weight of the squared distance from the reference [1/m^2].
        local_weight: weight of the information of a short-range scan [1/nat].
        field_weight: weight of the information field [1/nat].
        guidance_weight: weight of the guidance cost [1/m].
        goal_weight: weight of the distance from the goal [1/m].

    Raises:
        ValueError: an unknown architecture, a reference or target choice for the parallel one, a
            value that a part does not accept.
    """
    _checks.positive_int("reference_steps", reference_steps, at_most=MOST_STEPS_AHEAD)
    _kinds.flag("by_heading", by_heading)
    _checks.scalar("goal_weight", goal_weight)
    _checks.scalar("reference_speed", reference_speed, above=0.0)
    _checks.scalar("bias_fraction", bias_fraction, at_least=0.0, at_most=1.0)
    _kinds.flag("goal_when_explored", goal_when_explored)
    _kinds.flag("likelihood_ratio", likelihood_ratio)
    architecture = match_spelling(architecture, ARCHITECTURES)
    if architecture not in ARCHITECTURES:
        raise ValueError(f"architecture is {architecture!r}; accepted: {', '.join(ARCHITECTURES)}")
    for name, given in (("reference", reference), ("target_choice", target_choice)):
        if architecture == "parallel" and given is not None:
            raise ValueError(
                f"{name} is given for the parallel architecture, which follows no reference; "
                "accepted: none, or architecture 'two-layer'"
            )
    flight = Flight() if flight is None else flight
    fields = FieldNumbers() if fields is None else fields
    model = InverseSensorModel.line_of_sight() if sensor_model is None else sensor_model
    cost = (
        flight.cost(robot)
        + _checks.scalar("field_weight", field_weight) * PotentialCost(by_heading)
        + _checks.scalar("local_weight", local_weight) * LocalInformationCost()
        + _checks.scalar("guidance_weight", guidance_weight) * GuidanceCost()
    )
    if goal is not None:
        cost = cost + _checks.scalar("goal_weight", goal_weight) * (
            HomingCost(goal) if goal_when_explored else GoalCost(goal)
        )
    proposal: Proposal | None = None
    follower = None
    if architecture != "parallel":
        cost = cost + _checks.scalar("reference_weight", reference_weight) * StrategyReferenceCost()
        follower = follower_for(robot)
        # Only the shape of these controls matters: every step replaces them by those of the
        # reference.
        shape = flight.horizon, robot.control_size
        default = compute(lambda xp, rest: xp.broadcast_to(rest, shape), robot.default_control)
        proposal = BiasedProposal(
            flight.sampling(robot).proposal,
            default,
            bias_fraction,
            likelihood_ratio=likelihood_ratio,
        )
        if reference is None:
            walk = _walk(robot, reference_speed, reference_steps, flight.dt)
            reference = (
                ClimbingReference(walk)
                if target_choice is None
                else TargetReference(target_choice, walk)
            )
    return InformativeMPPI(
        flight.mppi(robot, cost, proposal),
        fields.sensor(model, resolution),
        fields.short_range_field(resolution),
        model,
        reference=reference,
        follower=follower,
        strategy_period=fields.field_period,
        altitude=flight.altitude,
    )


def _walk(robot: Dynamics, speed: ArrayLike, num_steps: int, dt: ArrayLike) -> GradientReference:
    """Build the pace of a reference: that of the robot where it is slower."""

    def at_most(bound: ArrayLike | None) -> ArrayLike:
        if bound is None:
            return speed
        return compute(lambda xp, speed, bound: xp.minimum(speed, xp.abs(bound)), speed, bound)

    backwards = at_most(bound_of_speed(robot, is_least=True)) if robot.can_reverse else None
    if not robot.turning_radius > 0.0:
        backwards = None
    return GradientReference(at_most(bound_of_speed(robot)), num_steps, dt, backwards)


def zone_choice(
    zones: Zones,
    goal: Vector,
    perception: Perception,
    lidar: Lidar,
    *,
    method: str = "remaining",
    distance_weight: ArrayLike | None = None,
    depleted: ArrayLike = 0.35,
) -> TargetChoice:
    """Build the rule that chooses the next zone for the sequential architecture.

    Args:
        zones: zones to explore.
        goal: goal position (x, y) after the last zone [m].
        perception: perception of the scenario, whose clearance the routes keep, on paths that its
            robot can drive.
        lidar: sensor whose scans along the route are predicted by the methods other than
            "remaining".
        method: "remaining", the information that remains in a zone, see `RemainingInformation`; or
            a method of `TrajectoryInformation`, the information of the scans along the route.
        distance_weight: weight of the length of the route; the default of the method when absent.
        depleted: share of its information below which a zone counts as explored. It exceeds what
            can never be seen, such as the inside of walls, which no scan reaches.

    Raises:
        ValueError: an unknown method, or a value that a part rejects.
    """
    locomotion = perception.locomotion
    # A lattice of headings with a node at each cell would take far longer than the other fields.
    stride = 1 if isinstance(locomotion, TurnsOnTheSpot) else perception.field_sensor.stride
    targets = Targets(
        zones,
        goal,
        depleted=depleted,
        required_clearance=perception.required_clearance,
        stride=stride,
        locomotion=locomotion,
    )
    # The methods differ in unit, so each has its own default weight.
    weight: dict[str, Any] = {} if distance_weight is None else {"weight": distance_weight}
    if method == "remaining":
        return RemainingInformation(targets, **weight)
    scans = TrajectoryInformation(PoseInformation(lidar, perception.sensor_model), method)
    return TrajectoryChoice(targets, scans, **weight)


@_kinds.check_arguments
def goal_mppi(robot: Dynamics, goal: Vector, flight: Flight | None = None) -> MPPI:
    """Build MPPI that drives to a goal and ignores information, as a baseline.

    Args:
        robot: model of the robot.
        goal: goal position (x, y) or (x, y, z) [m].
        flight: parameters of MPPI and of safety.
    """
    flight = Flight() if flight is None else flight
    cost = flight.cost(robot) + BASELINE_WEIGHT * GoalCost(goal)
    return flight.mppi(robot, cost)


@_kinds.check_arguments
def random_walk(robot: Dynamics, flight: Flight | None = None) -> RandomWalk:
    """Build a random walk with the speed and the safety costs of an explorer, as a baseline.

    Args:
        robot: model of the robot.
        flight: parameters of MPPI and of safety.
    """
    flight = Flight() if flight is None else flight
    mppi = flight.mppi(robot, flight.cost(robot))
    # Scaled to the mean over the steps, like all other terms.
    return RandomWalk(mppi, BASELINE_WEIGHT / flight.horizon)
