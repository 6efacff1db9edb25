"""MPPI for a quadrotor that explores a volume."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS_AHEAD
from jaxplore._spelling import match_spelling
from jaxplore._types import ArrayLike
from jaxplore._xla import compute
from jaxplore.belief.volume import VolumePerception
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.control.mppi import MPPI
from jaxplore.costs.base import Cost
from jaxplore.costs.bounds import SpeedLimitCost
from jaxplore.costs.effort import QuadraticControlCost
from jaxplore.costs.exploration import PotentialCost, StrategyReferenceCost
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.costs.volume import (
    AttitudeCost,
    BlindFlightCost,
    VolumeGoalCost,
    VolumeGuidanceCost,
    VolumeInformationCost,
)
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.planning.presets.flight import Flight
from jaxplore.planning.presets.target_explorer import check_rule
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower
from jaxplore.planning.strategy.target_rules import TargetRule
from jaxplore.planning.strategy.volume_informative import VolumeInformativeMPPI
from jaxplore.planning.strategy.volume_reference import VolumeReference
from jaxplore.planning.strategy.volume_targets import VolumeTargetExplorer

ARCHITECTURES = ("two-layer", "parallel")
"""Architectures of informative MPPI in a volume."""
RAMP = 0.1
"""Share of the cost of being near obstacles, but for that of contact, on the way to a goal."""
BLIND_AMONG_PEOPLE = 4.0
"""Factor of the cost of flying where the camera does not look, where something moves: without it
the nose was 15 to 25 degrees off the way, and people came from just beside the view."""
MAX_SPEED = 2.0
"""Greatest speed without a cost where none is given [m/s]."""


@_kinds.check_arguments
def volume_explorer(
    robot: Quadrotor,
    *,
    horizon: int = 30,
    num_samples: int = 512,
    dt: ArrayLike = 0.05,
    control_period: ArrayLike = 0.05,
    temperature: ArrayLike = 0.1,
    max_speed: ArrayLike = MAX_SPEED,
    clearance: ArrayLike = 0.6,
    obstacle_weight: ArrayLike = 20.0,
    guidance_weight: ArrayLike = 2.0,
    information_weight: ArrayLike = 20.0,
    blind_weight: ArrayLike = 0.5,
    attitude_weight: ArrayLike = 2.0,
    speed_weight: ArrayLike = 10.0,
    control_weight: ArrayLike = 0.01,
    has_goal: bool = False,
    has_moving_obstacles: bool = False,
) -> MPPI:
    """Build MPPI with which a quadrotor explores a volume, or flies to a goal in it.

    The quadrotor descends the cost-to-go to the remaining information, looks where there is much of
    it and where it flies, and keeps away from all that is not known to be free. With a goal, it
    descends the cost-to-go to that, looks where the way leads, and comes to rest there.

    Args:
        robot: model of the robot.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        dt: model step [s].
        control_period: time between commands [s].
        temperature: temperature of the softmax, in units of the cost of one step.
        max_speed: greatest speed without a cost [m/s].
        clearance: distance kept from what is not known to be free [m].
        obstacle_weight: weight of `ObstacleCost`.
        guidance_weight: weight of `VolumeGuidanceCost`, with a goal of `VolumeGoalCost`.
        information_weight: weight of `VolumeInformationCost`.
        blind_weight: weight of `BlindFlightCost`, which counts fourfold where something moves.
        attitude_weight: weight of `AttitudeCost`.
        speed_weight: weight of `SpeedLimitCost`.
        control_weight: weight of `QuadraticControlCost`.
        has_goal: whether the perception has a goal; information then has no cost.
        has_moving_obstacles: whether the belief holds moving obstacles, to which `obstacle_weight`
            times a `MovingObstacleCost` applies.

    Raises:
        ValueError: a robot that is no quadrotor, a value that a part does not accept.
    """
    _kinds.flag("has_goal", has_goal)
    keep = _checks.scalar("clearance", clearance, above=0.0)
    fastest = _checks.scalar("max_speed", max_speed, above=0.0)

    # No reaction time: it counts the speed ahead, and a quadrotor flies to all sides.
    collision = 5.0 * (1.0 / RAMP if has_goal else 1.0)
    near: Cost = ObstacleCost(keep, collision=collision, margin=0.05, reaction_time=0.0)

    def scale_cost(name: str, weight: ArrayLike, cost: Cost) -> Cost:
        return _checks.scalar(name, weight) * cost

    looking = scale_cost("information_weight", information_weight, VolumeInformationCost())
    way = VolumeGoalCost() if has_goal else VolumeGuidanceCost()
    if has_goal:
        near = RAMP * near
    cost = scale_cost("obstacle_weight", obstacle_weight, near) + scale_cost(
        "guidance_weight", guidance_weight, way
    )
    if not has_goal:
        cost = cost + looking
    blind: Cost = BlindFlightCost()
    if _kinds.flag("has_moving_obstacles", has_moving_obstacles):
        blind = BLIND_AMONG_PEOPLE * blind
        moving = MovingObstacleCost(clearance=1.2, collision=5.0, margin=0.15, reaction_time=0.2)
        cost = cost + scale_cost("obstacle_weight", obstacle_weight, moving)
    cost = (
        cost
        + scale_cost("blind_weight", blind_weight, blind)
        + scale_cost("attitude_weight", attitude_weight, AttitudeCost())
        + scale_cost("speed_weight", speed_weight, SpeedLimitCost(fastest))
        + scale_cost(
            "control_weight",
            control_weight,
            QuadraticControlCost(np.ones(robot.control_size)),
        )
    )
    flight = Flight(
        horizon=horizon,
        num_samples=num_samples,
        dt=dt,
        control_period=_checks.scalar("control_period", control_period, above=0.0),
        temperature=temperature,
        effective_share=0.05,
    )
    return flight.mppi(robot, cost)


@_kinds.check_arguments
def volume_informative_mppi(
    robot: Quadrotor,
    architecture: str = "two-layer",
    *,
    perception: VolumePerception,
    grid: VoxelGrid,
    strategy_period: ArrayLike = 0.2,
    bias_fraction: ArrayLike = 0.5,
    likelihood_ratio: bool = False,
    reference_speed: ArrayLike = 2.0,
    reference_steps: int = 40,
    reference_weight: ArrayLike = 1.0,
    field_weight: ArrayLike = 5.0,
    **flying: Any,
) -> VolumeInformativeMPPI:
    """Build informative MPPI for a quadrotor in a volume.

    Two-layer: MPPI tracks a reference that descends the cost-to-go, with a share of its samples
    around the controls that follow it. Parallel: MPPI reads the information of the best heading,
    which leads the robot to where more is seen, without reference and bias. Both have all costs of
    `volume_explorer`.

    Args:
        robot: model of the robot.
        architecture: "two-layer" or "parallel".
        perception: perception of the scenario.
        grid: a map with the shape and resolution of the scenario's.
        strategy_period: time between runs of the strategic layer, that between fields [s].
        bias_fraction: share of the samples around the reference's controls.
        likelihood_ratio: whether these are weighted by their likelihood ratio. Without it, the plan
            is biased towards the reference, as in Biased-MPPI.
        reference_speed: speed along the reference; no more than `max_speed` [m/s].
        reference_steps: length of the reference in model steps.
        reference_weight: weight of `StrategyReferenceCost`, two-layer [1/m^2].
        field_weight: weight of `PotentialCost`, parallel.
        flying: parameters of `volume_explorer`, which makes MPPI and its costs.

    Raises:
        ValueError: a robot that is no quadrotor, an unknown architecture, a part of another class,
            or a value that a part does not accept.
    """
    _kinds.flag("likelihood_ratio", likelihood_ratio)
    _checks.positive_int("reference_steps", reference_steps, at_most=MOST_STEPS_AHEAD)
    _checks.scalar("bias_fraction", bias_fraction, at_least=0.0, at_most=1.0)
    architecture = match_spelling(architecture, ARCHITECTURES)
    if architecture not in ARCHITECTURES:
        raise ValueError(f"architecture is {architecture!r}; accepted: {', '.join(ARCHITECTURES)}")
    mppi = volume_explorer(robot, **flying)
    field = _checks.scalar("field_weight", field_weight) * PotentialCost()
    tracking = _checks.scalar("reference_weight", reference_weight) * StrategyReferenceCost()
    speed = compute(
        lambda xp, wanted, most: xp.minimum(wanted, most),
        _checks.scalar("reference_speed", reference_speed, above=0.0),
        _checks.scalar("max_speed", flying.get("max_speed", MAX_SPEED), above=0.0),
    )
    reference = VolumeReference(speed, reference_steps, mppi.dt)
    # Only the shape of these controls matters: every step replaces them by those of the reference.
    shape = mppi.horizon, robot.control_size
    controls = compute(lambda xp, rest: xp.broadcast_to(rest, shape), robot.default_control)
    gaussian: Any = mppi.proposal
    biased = BiasedProposal(gaussian, controls, bias_fraction, likelihood_ratio=likelihood_ratio)
    is_parallel = architecture == "parallel"
    # The cost of a rollout is the mean over its steps, as that of `Flight.mppi`.
    cost = mppi.cost + (1.0 / mppi.horizon) * (field if is_parallel else tracking)
    proposal = mppi.proposal if is_parallel else biased
    mppi = eqx.tree_at(lambda each: (each.cost, each.proposal), mppi, (cost, proposal))
    return VolumeInformativeMPPI(
        mppi,
        perception,
        grid,
        reference=None if is_parallel else reference,
        follower=None if is_parallel else QuadrotorFollower(),
        strategy_period=strategy_period,
    )


@_kinds.check_arguments
def volume_target_explorer(
    robot: Quadrotor,
    rule: TargetRule | str,
    perception: VolumePerception,
    grid: VoxelGrid,
    *,
    every: int = 4,
    min_information: ArrayLike = 0.2,
    min_frontier: ArrayLike = 0.4,
    near: ArrayLike = 0.4,
    **flying: Any,
) -> VolumeTargetExplorer:
    """Build an explorer that flies through a volume from target to target.

    Args:
        robot: model of the robot.
        rule: rule that chooses the next target, or its name in `RULES`.
        perception: perception of the scenario.
        grid: a map with the shape and resolution of the scenario's.
        every: number of commands between choices: 4 for commands at 20 Hz and fields at 5 Hz.
        min_information: information of its best view below which a place is not visited
            [nat m^3].
        min_frontier: minimum area of a frontier, and of a cluster [m^2].
        near: length of the path to a target at which it counts as reached [m].
        flying: parameters of `volume_explorer`, which flies. A robot with a full-circle sensor
            flies with an `information_weight` of 0: the rule alone decides where to look. Any other
            robot must turn its sensor to the target, and stays until it has scanned it.

    Raises:
        ValueError: a rule that is not in `RULES`, a part of another class, or a value that a part
            rejects.
    """
    rule = check_rule(rule)
    if not perception.needs_turning:
        flying = {**flying, "information_weight": 0.0}
    return VolumeTargetExplorer(
        volume_explorer(robot, **flying),
        rule,
        perception,
        grid,
        every=every,
        min_information=min_information,
        min_frontier=min_frontier,
        near=near,
    )
