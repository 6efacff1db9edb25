"""MPPI for ground robots: the default explorer, and driving to waypoints."""

from typing import Any

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Vector
from jaxplore.control.mppi import MPPI
from jaxplore.costs.base import Cost
from jaxplore.costs.effort import ControlCost
from jaxplore.costs.exploration import GuidanceCost, InformationCost
from jaxplore.costs.heading_for import ToGoalCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.dynamics.base import Dynamics


def explorer(
    robot: Dynamics,
    *,
    horizon: int = 40,
    num_samples: int = 1000,
    temperature: ArrayLike = 0.3,
    noise_std: Vector | None = None,
    dt: ArrayLike = 0.05,
    clearance: ArrayLike = 0.4,
    obstacle_weight: ArrayLike = 1.0,
    information_weight: ArrayLike = 2.0,
    guidance_weight: ArrayLike = 1.0,
    control_weight: ArrayLike = 0.01,
) -> MPPI:
    """Build MPPI that explores, with weights that work on any map.

    Guidance is a distance to go in metres, summed over the horizon. Of two rollouts, the one that
    is 1 cm nearer on average over 40 steps costs 0.4 less, and at the temperature 0.3 its weight is
    four times as high. Information, in nats per beam, decides between paths of similar guidance.
    Being 5 cm too close to an obstacle costs 100 per step.

    Args:
        robot: model of the robot.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: temperature of the softmax.
        noise_std: (nu,) standard deviations of the controls; half the range between their bounds
            when absent.
        dt: model step [s].
        clearance: distance kept from obstacles [m]; see `ObstacleCost`.
        obstacle_weight: weight of `ObstacleCost`.
        information_weight: weight of `InformationCost`.
        guidance_weight: weight of `GuidanceCost`.
        control_weight: weight of `ControlCost`.

    Raises:
        ValueError: a value that a part does not accept.
    """
    _kinds.instance("robot", robot, Dynamics)
    return _ground_mppi(
        robot,
        _checks.scalar("obstacle_weight", obstacle_weight) * ObstacleCost(clearance)
        + _checks.scalar("information_weight", information_weight) * InformationCost()
        + _checks.scalar("guidance_weight", guidance_weight) * GuidanceCost()
        + _checks.scalar("control_weight", control_weight) * ControlCost(),
        horizon=horizon,
        num_samples=num_samples,
        temperature=temperature,
        noise_std=noise_std,
        dt=dt,
    )


def waypoint_mppi(
    robot: Dynamics,
    *,
    horizon: int = 30,
    num_samples: int = 256,
    temperature: ArrayLike = 0.3,
    noise_std: Vector | None = None,
    dt: ArrayLike = 0.05,
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
        temperature: temperature of the softmax.
        noise_std: (nu,) standard deviations of the controls; half the range between their bounds
            when absent.
        dt: model step [s].
        clearance: distance kept from obstacles [m]; see `ObstacleCost`.
        obstacle_weight: weight of `ObstacleCost`.
        guidance_weight: weight of `ToGoalCost`.
        control_weight: weight of `ControlCost`.

    Raises:
        ValueError: a robot that flies, a value that a part does not accept.
    """
    _kinds.instance("robot", robot, Dynamics)
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
        noise_std=noise_std,
        dt=dt,
    )


def _ground_mppi(robot: Dynamics, cost: Cost, *, noise_std: Vector | None, **numbers: Any) -> MPPI:
    """Build MPPI whose noise is half the range of each control unless it is given."""
    noise = robot.control_half_range if noise_std is None else noise_std
    return MPPI(robot, cost, noise_std=noise, **numbers)
