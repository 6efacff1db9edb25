"""Portfolios for ground vehicles: objectives, and three decompositions into members."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, Vector
from jaxplore._xla import compute
from jaxplore.control.mppi import MPPI
from jaxplore.control.noise import Noise
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.control.weighting import Weighting
from jaxplore.costs.base import Cost
from jaxplore.costs.collision import CollisionCost
from jaxplore.costs.effort import ControlCost
from jaxplore.costs.exploration import GuidanceCost, InformationCost
from jaxplore.costs.heading_for import RegionCost, ToGoalCost
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.costs.obstacles import ObstacleCost
from jaxplore.costs.occlusion import OcclusionCost
from jaxplore.costs.terrain import StabilityCost, TerrainCost, TraversabilityCost
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.chassis import Chassis
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.fusion import Fusion
from jaxplore.planning.portfolio.portfolio import Portfolio
from jaxplore.planning.presets.sampling import sampling

Weights = Mapping[str, Mapping[str, float]]

ROLE_WEIGHTS: Weights = {
    "explorer": {"information": 0.7, "goal": 0.1, "safety": 0.2},
    "balanced": {"information": 0.4, "goal": 0.4, "safety": 0.2},
    "exploiter": {"information": 0.1, "goal": 0.7, "safety": 0.2},
    "cautious": {"information": 0.2, "goal": 0.2, "safety": 0.4, "terrain": 0.2},
}
"""Weights of the four roles by objective, from the design notes for ground vehicles."""
HORIZONS = {"short": 0.5, "middle": 1.0, "long": 2.0}
"""Horizons of a temporal decomposition, as multiples of the horizon of the template."""
REGIONS = {"left": 0.5 * math.pi, "forward": 0.0, "right": -0.5 * math.pi}
"""Preferred directions of a regional decomposition, from the current heading [rad]."""
REGION_WEIGHT = 0.3
"""Weight of the region of a member, in addition to the balanced weights."""
FLOORS = {
    "information": 0.02,
    "goal": 0.02,
    "safety": 0.05,
    "terrain": 0.05,
    "movers": 0.05,
    "effort": 0.05,
    "region": 0.02,
}
"""Lower bound of the spread of each objective, per step of the horizon [unit of the objective].

For information and goal it is 2 cm of the cost to go. Safety costs 1 per step at an obstacle."""
COLLISION = 100.0
"""Cost of a rollout that is 5 cm deep in an obstacle in all steps, or has a wheel that is about to
leave the ground, in spreads of an objective.

An objective varies by about its spread, so no weighting of the objectives makes up for it."""


class Mission(NamedTuple):
    """The task of a vehicle, which determines the objectives of the members.

    Args:
        goal: goal position (x, y) [m]; None for exploration alone.
        has_terrain: whether the ground has slopes or rough parts.
        has_moving_obstacles: whether there are moving obstacles.
        chassis: chassis of a vehicle that can tip over; None if it cannot.
        occlusion_cost: cost of driving fast past places that can hide somebody; None for none.
    """

    goal: Vector | None = None
    has_terrain: bool = False
    has_moving_obstacles: bool = False
    chassis: Chassis | None = None
    occlusion_cost: OcclusionCost | None = None


def objectives(
    mission: Mission, clearance: ArrayLike = 0.4, *, is_guided: bool = True
) -> dict[str, Cost]:
    """Build the objectives of a mission by name; `clearance` [m] is kept from obstacles.

    | name | cost | when |
    | --- | --- | --- |
    | information | 2 `InformationCost`, fading, + `GuidanceCost` if guided | always |
    | goal | `ToGoalCost`; without a goal `GuidanceCost` | always |
    | safety | `ObstacleCost` without its hard part | always |
    | terrain | `TerrainCost` + `TraversabilityCost` | on terrain |
    | movers | `MovingObstacleCost` without collisions, `OcclusionCost` | if something moves |
    | effort | `ControlCost` | always |

    Without a goal, the exploiter is guided to the remaining information that is known.
    """
    _kinds.flag("is_guided", is_guided)
    seen = 2.0 * InformationCost(is_fading=True)
    chosen: dict[str, Cost] = {
        "information": seen + GuidanceCost() if is_guided else seen,
        "goal": GuidanceCost() if mission.goal is None else ToGoalCost(),
        # Collisions are part of the hard cost instead, which no weight can reduce.
        "safety": ObstacleCost(clearance, collision=0.0),
    }
    if mission.has_terrain:
        chosen["terrain"] = TerrainCost() + TraversabilityCost()
    if mission.has_moving_obstacles:
        chosen["movers"] = MovingObstacleCost(collision=None)
        if mission.occlusion_cost is not None:
            chosen["movers"] = chosen["movers"] + mission.occlusion_cost
    chosen["effort"] = ControlCost()
    return chosen


@_kinds.check_arguments
def ground_portfolio(
    robot: Dynamics,
    mission: Mission | None = None,
    *,
    members: tuple[str, ...] | Weights | None = None,
    decomposition: str = "roles",
    fusion: Fusion | str | None = None,
    common: Mapping[str, float] | None = None,
    effort: float = 0.02,
    horizon: int = 30,
    num_samples: int = 1000,
    temperature: ArrayLike = 0.05,
    noise_share: ArrayLike = 0.5,
    dt: ArrayLike = 0.05,
    parameterisation: Parameterisation | str = "knots",
    noise: Noise | str = "gaussian",
    weighting: Weighting | str = "softmax",
    effective_share: ArrayLike = 0.05,
    clearance: ArrayLike = 0.4,
    margin: ArrayLike = 0.01,
) -> Portfolio:
    """Build a portfolio for a ground vehicle.

    Objectives are divided by their spread over the rollouts, see `Portfolio`, and the temperature
    is in the same unit. No member accepts a collision for a better objective (`CollisionCost`), nor
    a wheel that leaves the ground (`StabilityCost`), if the mission names the chassis.

    | decomposition | members | what differs |
    | --- | --- | --- |
    | "roles" | explorer, balanced, exploiter, cautious | weights (`ROLE_WEIGHTS`) |
    | "temporal" | short, middle, long | horizons (`HORIZONS`), weights of balanced |
    | "regional" | left, forward, right | regions (`REGIONS`), weights of balanced |

    Without a goal, "goal" is the guidance to the remaining information, and "information" is what a
    scan from the robot's pose sees. Where a member has no weight for "goal", "information" includes
    the guidance for all members.

    The function has more than 60 lines because it is the one place of these numbers.

    Args:
        robot: model of the robot. The integrator `Euler()` is accurate enough for planning: its
            error is millimetres, and it saves a fifth of the time.
        mission: task of the vehicle; exploration of level ground without moving obstacles when
            absent.
        members: names of some members of the decomposition, or custom weights by member and
            objective; all of the decomposition when absent.
        decomposition: name of the rule by which members differ, see the table.
        fusion: rule that fuses the members' plans, or its name; `SafeFusion()` when absent. A
            `Contextual` given by name has the mission's goal.
        common: weights of the objective by which plans are compared; those of the exploiter when
            absent. Its cost to go, to the goal or to remaining information, accounts for the route
            beyond the horizon. If no member has these objectives, the mean of
            the weights of the members.
        effort: weight of "effort" in every member that does not set one.
        horizon: model steps ahead, T.
        num_samples: rollouts of each member, K.
        temperature: temperature of the softmax; the least one of the adaptive softmax.
        noise_share: standard deviation of the controls, as a share of half their range; scaled as
            in `explorer`.
        dt: model step [s].
        parameterisation: parameterisation of the controls, or its name: direct, smooth or knots
            (splines through 8 knots).
        noise: source of noise, or its name: gaussian, coloured (pink), sobol or bank.
        weighting: weighting of the rollouts, or its name: softmax, adaptive or elite.
        effective_share: share of the samples that count: the least one of the adaptive softmax,
            that of the elite.
        clearance: distance kept from obstacles [m].
        margin: distance by which the robot is enlarged in the collision check [m]. It is less than
            what paths keep in narrow passages, so that the robot can drive them, slowly.

    Raises:
        ValueError: an unknown decomposition, member or objective, or a value that a part rejects.
    """
    if not _kinds.is_traced(effort):
        effort = _checks.number("effort", effort, at_least=0.0)
    mission = Mission() if mission is None else mission
    weights, horizons = _weights(decomposition, members, mission, effort), None
    # Without a goal, the guidance is the objective "goal". As a part of "information" as well, it
    # would make all roles plan alike. A member without a weight for "goal" needs it there.
    is_guided = mission.goal is not None or not all(row.get("goal") for row in weights.values())
    terms: dict[str, Cost | list[Cost]] = {**objectives(mission, clearance, is_guided=is_guided)}
    steps = _checks.positive_int("horizon", horizon, at_most=MOST_STEPS_AHEAD)
    length = compute(lambda _, dt: dt * steps, _checks.scalar("dt", dt, above=0.0))
    if decomposition == "temporal":
        horizons = jnp.stack([HORIZONS[name] * length for name in weights])
    elif decomposition == "regional":
        terms["region"] = [RegionCost(REGIONS[name]) for name in weights]
        weights = {name: {**row, "region": REGION_WEIGHT} for name, row in weights.items()}
    if common is None:
        # Members with weights of their own may have none of the exploiter's objectives. Effort
        # alone could not tell which plan is better.
        weighed = {name for row in weights.values() for name, weight in row.items() if weight > 0.0}
        wanted = {"effort": effort, **_fit(ROLE_WEIGHTS["exploiter"], mission)}
        wanted = {name: weight for name, weight in wanted.items() if name in weighed}
        common = wanted if wanted.keys() - {"effort"} else None
    if fusion == "contextual":
        fusion = Contextual(tuple(weights), goal=mission.goal)
    hard: Cost = CollisionCost(margin)
    if mission.chassis is not None:
        hard = hard + StabilityCost(mission.chassis)
    return Portfolio(
        _template(
            robot,
            # COLLISION is the cost of a whole rollout, and costs are sums over its steps.
            (COLLISION / horizon) * hard,
            horizon=horizon,
            num_samples=num_samples,
            temperature=temperature,
            noise_share=noise_share,
            dt=dt,
            parameterisation=parameterisation,
            noise=noise,
            weighting=weighting,
            effective_share=effective_share,
        ),
        terms,
        weights,
        common=common,
        fusion=fusion,
        horizons=horizons,
        floors={name: FLOORS[name] * horizon for name in terms},
    )


def _template(
    robot: Dynamics,
    cost: Cost,
    *,
    horizon: int,
    num_samples: int,
    noise_share: ArrayLike,
    dt: ArrayLike,
    **numbers: Any,
) -> MPPI:
    """Build the MPPI controller of which the members are copies."""
    sizes: dict[str, Any] = {"horizon": horizon, "num_samples": num_samples, "dt": dt}
    share = _checks.scalar("noise_share", noise_share, above=0.0)
    std = compute(lambda _, *each: each[0] * each[1], share, robot.control_half_range)
    # No likelihood ratio: over tens of steps it would reduce the effective sample size to about
    # one in a thousand.
    return MPPI(robot, cost, **sizes, **sampling(std, **sizes, **numbers)._asdict())


def _weights(
    decomposition: str,
    members: tuple[str, ...] | Weights | None,
    mission: Mission,
    effort: float,
) -> dict[str, dict[str, float]]:
    balanced = ROLE_WEIGHTS["balanced"]
    known: dict[str, Weights] = {
        "roles": ROLE_WEIGHTS,
        "temporal": dict.fromkeys(HORIZONS, balanced),
        "regional": dict.fromkeys(REGIONS, balanced),
    }
    if not isinstance(decomposition, str) or decomposition not in known:
        raise ValueError(f"decomposition is {decomposition!r}; accepted: {', '.join(known)}")
    if isinstance(members, Mapping):
        if decomposition != "roles":
            raise ValueError(
                f"members is {dict(members)!r} beside the decomposition {decomposition!r}; "
                "accepted: weights of one's own with 'roles'"
            )
        # The portfolio refuses a row of zeros too, but the effort that is added below would hide
        # it.
        for name, row in members.items():
            if not any(row.values()):
                raise ValueError(
                    f"weights is {dict(row)!r} of member {name!r}; accepted: a weight that is not 0"
                )
        return {name: {"effort": effort, **row} for name, row in members.items()}
    rows = known[decomposition]
    if members is not None and not isinstance(members, (list, tuple)):
        text = _kinds.describe(members)
        raise ValueError(f"members is {text}; accepted: some of {', '.join(rows)}")
    chosen = tuple(rows) if members is None else tuple(members)
    if not chosen:
        raise ValueError(f"members is {members!r}; accepted: at least one of {', '.join(rows)}")
    for name in chosen:
        if name not in rows:
            text = _kinds.describe(name)
            raise ValueError(f"members has {text}; accepted: {', '.join(rows)}")
    return {name: {"effort": effort, **_fit(rows[name], mission)} for name in chosen}


def _fit(row: Mapping[str, float], mission: Mission) -> dict[str, float]:
    """Adapt the weights of a role to a mission; moving obstacles weigh as much as static ones."""
    fitted = dict(row)
    if not mission.has_terrain:
        # On level ground the weight of the terrain is added to the weight of safety.
        fitted["safety"] = fitted["safety"] + fitted.pop("terrain", 0.0)
    if mission.has_moving_obstacles:
        fitted["movers"] = row["safety"]
    return fitted
