"""MPPI for ground robots: the default explorer, and driving to waypoints."""

from typing import Any

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Vector
from jaxplore.control.mppi import MPPI
from jaxplore.control.noise import Noise
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.control.weighting import Weighting
from jaxplore.costs.base import Cost
from jaxplore.costs.effort import ControlCost
from jaxplore.costs.exploration import (
    CertainInformationCost,
    GuidanceCost,
    InformationCost,
    UncertaintyCost,
)
from jaxplore.costs.heading_for import ToGoalCost
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.costs.occlusion import OcclusionCost
from jaxplore.costs.terrain import StabilityCost
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.uncertain import UncertainRobot
from jaxplore.geometry.chassis import Chassis
from jaxplore.planning.presets.sampling import sampling

TIPPING = 100.0
"""Cost of a step at which a wheel leaves the ground, in units of the obstacles' weight: that of
being 5 cm too close to one."""

HIDDEN = 10.0
"""Cost of a step that is 1 m/s too fast for what may come out of hiding, in units of the obstacles'
weight. Over a horizon of 2 s it is as much as 1 m of guidance."""


@_kinds.check_arguments
def explorer(
    robot: Dynamics,
    *,
    horizon: int = 40,
    num_samples: int = 1000,
    temperature: ArrayLike = 0.3,
    effective_share: ArrayLike = 0.05,
    noise_std: Vector | None = None,
    dt: ArrayLike = 0.05,
    parameterisation: Parameterisation | str = "knots",
    noise: Noise | str = "gaussian",
    weighting: Weighting | str = "adaptive",
    clearance: ArrayLike = 0.4,
    obstacle_weight: ArrayLike = 1.0,
    information_weight: ArrayLike = 2.0,
    guidance_weight: ArrayLike = 1.0,
    control_weight: ArrayLike = 0.01,
    has_moving_obstacles: bool = False,
    moving_obstacle_cost: MovingObstacleCost | None = None,
    occlusion_cost: OcclusionCost | None = None,
    chassis: Chassis | None = None,
    uncertain: UncertainRobot | None = None,
    uncertainty_weight: ArrayLike = 0.0,
) -> MPPI:
    """Build MPPI that explores, with weights that work on any map.

    Guidance is a distance to go in metres, summed over the horizon. Of two rollouts, the one that
    is 1 cm nearer on average over 40 steps costs 0.4 less, and at the temperature 0.3 its weight is
    four times as high. Information, in nats per beam, decides between paths of similar guidance.
    Being 5 cm too close to an obstacle costs 100 per step, and to a moving one as well.

    How far the costs of the rollouts spread depends on the robot: a speed that is a control acts at
    once, an acceleration over the horizon. So the temperature is raised where fewer than
    `effective_share` of the samples would count, and the plan is not the noise of a few of them.
    With the noise at a few knots the commands are smooth.

    With "direct" and "softmax" the controller is MPPI of Williams et al. with its likelihood ratio.

    Args:
        robot: model of the robot.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            which raises its temperature where fewer would; that of the elite.
        noise_std: (nu,) standard deviations of the controls; half the range between their bounds
            when absent. With P `Knots`, each of which lasts for T / P steps, `std sqrt(P / T)`,
            which spreads the sum of the controls as much. With `Smooth`, whose rates add up from
            command to command, `std / (dt sqrt(T / 2))`: as much after T / 2 commands.
        dt: model step [s].
        parameterisation: parameterisation of the controls, or its name: direct, smooth or knots
            (splines through 8 knots).
        noise: source of noise, or its name: gaussian, coloured (pink), sobol or bank.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite.
        clearance: distance kept from obstacles [m]; see `ObstacleCost`.
        obstacle_weight: weight of `ObstacleCost`.
        information_weight: weight of `InformationCost`.
        guidance_weight: weight of `GuidanceCost`.
        control_weight: weight of `ControlCost`.
        has_moving_obstacles: whether the belief holds moving obstacles, to which `obstacle_weight`
            times a `MovingObstacleCost` applies; without it the robot sees them as parts of the map
            only, where they were.
        moving_obstacle_cost: that cost; `MovingObstacleCost()` when absent.
        occlusion_cost: cost of driving fast past places that can hide somebody, to which 10 times
            `obstacle_weight` applies; for a belief with tracks. None for none.
        chassis: chassis of a vehicle that can tip over, to which 100 times `obstacle_weight` a
            `StabilityCost` applies: tipping over costs as much per step as being 5 cm too close to
            an obstacle.
        uncertain: the robot with the variance of its position, for a robot that localises itself:
            its rollouts then pay `uncertainty_weight` times an `UncertaintyCost`, and information
            counts less where the position will be uncertain (`CertainInformationCost`). The
            controller needs an `UncertaintyAware` around it. None for neither.
        uncertainty_weight: weight of `UncertaintyCost`, the trade-off between exploring and knowing
            the position; 0 for plans that do not know it.

    Raises:
        ValueError: a value that a part does not accept.
    """
    informed: Cost = InformationCost() if uncertain is None else CertainInformationCost()
    weight = _checks.scalar("obstacle_weight", obstacle_weight)
    obstacles: Cost = weight * ObstacleCost(clearance)
    if _kinds.flag("has_moving_obstacles", has_moving_obstacles):
        moving = MovingObstacleCost() if moving_obstacle_cost is None else moving_obstacle_cost
        obstacles = obstacles + weight * moving
    if occlusion_cost is not None:
        obstacles = obstacles + (HIDDEN * weight) * occlusion_cost
    if chassis is not None:
        obstacles = obstacles + (TIPPING * weight) * StabilityCost(chassis)
    uncertainty = _checks.scalar("uncertainty_weight", uncertainty_weight, at_least=0.0)
    if uncertain is not None:
        obstacles = obstacles + uncertainty * UncertaintyCost()
    return _ground_mppi(
        robot if uncertain is None else uncertain,
        obstacles
        + _checks.scalar("information_weight", information_weight) * informed
        + _checks.scalar("guidance_weight", guidance_weight) * GuidanceCost()
        + _checks.scalar("control_weight", control_weight) * ControlCost(),
        horizon=horizon,
        num_samples=num_samples,
        temperature=temperature,
        effective_share=effective_share,
        noise_std=noise_std,
        dt=dt,
        parameterisation=parameterisation,
        noise=noise,
        weighting=weighting,
    )


@_kinds.check_arguments
def waypoint_mppi(
    robot: Dynamics,
    *,
    horizon: int = 30,
    num_samples: int = 256,
    temperature: ArrayLike = 0.3,
    effective_share: ArrayLike = 0.05,
    noise_std: Vector | None = None,
    dt: ArrayLike = 0.05,
    parameterisation: Parameterisation | str = "direct",
    noise: Noise | str = "gaussian",
    weighting: Weighting | str = "softmax",
    clearance: ArrayLike = 0.4,
    obstacle_weight: ArrayLike = 1.0,
    guidance_weight: ArrayLike = 1.0,
    control_weight: ArrayLike = 0.01,
) -> MPPI:
    """Build MPPI that descends `Belief.to_goal` and avoids cells that are not known to be free.

    Args:
        robot: model of the robot, a ground robot.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            which raises its temperature where fewer would; that of the elite.
        noise_std: (nu,) standard deviations of the controls; half the range between their bounds
            when absent. With P `Knots`, each of which lasts for T / P steps, `std sqrt(P / T)`,
            which spreads the sum of the controls as much. With `Smooth`, whose rates add up from
            command to command, `std / (dt sqrt(T / 2))`: as much after T / 2 commands.
        dt: model step [s].
        parameterisation: parameterisation of the controls, or its name: direct, smooth or knots
            (splines through 8 knots).
        noise: source of noise, or its name: gaussian, coloured (pink), sobol or bank.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite.
        clearance: distance kept from obstacles [m]; see `ObstacleCost`.
        obstacle_weight: weight of `ObstacleCost`.
        guidance_weight: weight of `ToGoalCost`.
        control_weight: weight of `ControlCost`.

    Raises:
        ValueError: a robot that flies, a value that a part does not accept.
    """
    # No term of the cost holds an altitude.
    if "z" in robot.state_names:
        raise ValueError(f"robot is a {type(robot).__name__}; accepted: a robot on the ground")
    return _ground_mppi(
        robot,
        _checks.scalar("obstacle_weight", obstacle_weight) * ObstacleCost(clearance)
        + _checks.scalar("guidance_weight", guidance_weight) * ToGoalCost()
        + _checks.scalar("control_weight", control_weight) * ControlCost(),
        horizon=horizon,
        num_samples=num_samples,
        temperature=temperature,
        effective_share=effective_share,
        noise_std=noise_std,
        dt=dt,
        parameterisation=parameterisation,
        noise=noise,
        weighting=weighting,
    )


def _ground_mppi(
    robot: Dynamics,
    cost: Cost,
    *,
    horizon: int,
    num_samples: int,
    noise_std: Vector | None,
    dt: ArrayLike,
    **numbers: Any,
) -> MPPI:
    """Build MPPI whose noise is half the range of each control unless it is given."""
    sizes: dict[str, Any] = {"horizon": horizon, "num_samples": num_samples, "dt": dt}
    std = robot.control_half_range if noise_std is None else noise_std
    parts = sampling(std, **sizes, importance=1.0, **numbers)
    return MPPI(robot, cost, **sizes, **parts._asdict())
