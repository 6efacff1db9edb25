"""Costs of the ground: slope and roughness, low traversability, tipping over."""

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.chassis import Chassis, Stance


class TerrainCost(Cost):
    """Cost of the slope and roughness of the ground under the robot,

        (slope / steep)^2 + roughness / rough

    The robot then drives around a hill if the detour costs less, and prefers smooth ground. Reads
    `belief.ground`; without it the ground is level and the cost is 0.

    Args:
        steep: slope that costs 1 [m/m].
        rough: roughness that costs 1 [m].

    Raises:
        ValueError: a value that is not positive.
    """

    steep: Scalar
    rough: Scalar

    def __init__(self, steep: ArrayLike = 0.3, rough: ArrayLike = 0.05) -> None:
        self.steep = _checks.scalar("steep", steep, above=0.0)
        self.rough = _checks.scalar("rough", rough, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the cost of the ground at the position of the robot."""
        if belief.ground is None:
            return jnp.zeros(())
        slope = belief.ground.slope_field(state.position) / self.steep
        return slope * slope + belief.ground.roughness_field(state.position) / self.rough


class TraversabilityCost(Cost):
    """Cost of low traversability, with a barrier near the lowest one that is allowed,

        (1 - traversability)^2 + barrier * ((threshold + margin - traversability)_+ / margin)^2

    Reads `belief.ground`; without it all ground is traversable and the cost is 0. Cells below the
    threshold are obstacles to the robot in any case. The barrier keeps it from driving along their
    edge.

    Args:
        barrier: cost of being at the threshold.
        margin: traversability above the threshold below which the barrier counts.

    Raises:
        ValueError: a negative barrier, a margin that is not positive.
    """

    barrier: Scalar
    margin: Scalar

    def __init__(self, barrier: ArrayLike = 10.0, margin: ArrayLike = 0.1) -> None:
        self.barrier = _checks.scalar("barrier", barrier, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the cost of the ground at the position of the robot."""
        if belief.ground is None:
            return jnp.zeros(())
        left = belief.ground.traversability_field(state.position)
        lost = 1.0 - left
        short = jnp.maximum(belief.ground.threshold + self.margin - left, 0.0) / self.margin
        return lost * lost + self.barrier * short * short


class StabilityCost(Cost):
    """Barrier before a vehicle tips over or a wheel leaves the ground,

        sum over u of across, along, wheels of ((u - limit)_+ / (1 - limit))^2

    with the shares u of what the vehicle withstands (`Chassis.stability`): each costs 1 where a
    wheel leaves the ground. The plane under the wheels is that of `belief.ground`; without it the
    ground is level, and what counts is the acceleration: braking, and speed in a curve.

    Args:
        chassis: chassis of the vehicle.
        limit: share above which the cost begins, in [0, 1).

    Raises:
        ValueError: a chassis of another class, a limit outside [0, 1).
    """

    chassis: Chassis
    limit: Scalar

    @_kinds.check_arguments
    def __init__(self, chassis: Chassis, limit: ArrayLike = 0.6) -> None:
        self.chassis = chassis
        self.limit = _checks.scalar("limit", limit, at_least=0.0, below=1.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the barrier at the pose of the robot and under its acceleration."""
        level = Stance(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        ground = belief.ground
        stance = (
            level if ground is None else ground.stance(self.chassis, state.position, state.heading)
        )
        used = self.chassis.stability(stance, *state.dynamics.acceleration(state.values, control))
        total = jnp.zeros(())
        for share in used:
            over = jnp.maximum(share - self.limit, 0.0) / (1.0 - self.limit)
            total = total + over * over
        return total
