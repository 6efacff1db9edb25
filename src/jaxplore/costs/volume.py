"""Costs of flight in a volume: guidance, information, looking where one flies."""

import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import part
from jaxplore.belief.volume_belief import GoalKnowledge, VolumeBelief
from jaxplore.costs._arrival import with_overrun
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length


class VolumeGuidanceCost(Cost):
    """Cost-to-go to the remaining information [m], bounded around that of the robot:

        min(max(U(x), U(x_0) - reach), U(x_0) + reach)

    with U the cost-to-go and x_0 the position for which the belief was made. U cannot change by
    more than `reach` along a path within the horizon. Where it does, there is a wall or unknown
    space between, and such a cliff would outweigh a collision.

    Args:
        reach: largest change of the cost-to-go that counts [m].

    Raises:
        ValueError: a reach that is not positive.
    """

    reach: Scalar

    def __init__(self, reach: ArrayLike = 20.0) -> None:
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: VolumeBelief
    ) -> Scalar:
        """Compute the bounded cost-to-go at the position of the robot."""
        here, cost = belief.guidance(belief.position), belief.guidance(state.place(3))
        return jnp.minimum(jnp.maximum(cost, here - self.reach), here + self.reach)


class VolumeGoalCost(Cost):
    """Cost of the way to the goal, and of not facing it [m]:

        U(x) + 2 e(U(x)) + turning (|w| - h . w)

    with U the cost-to-go, bounded as that of `VolumeGuidanceCost`, e the distance by which the
    robot would overrun the goal, h the heading, and w the level direction of the way
    (`GoalKnowledge`). The camera then sees what is unknown on the way.

    Args:
        turning: cost of facing sideways [m].
        reach: largest change of the cost-to-go that counts [m].

    Raises:
        ValueError: a negative turning, a reach that is not positive. When traced, a belief without
            a goal.
    """

    turning: Scalar
    guidance: VolumeGuidanceCost

    def __init__(self, turning: ArrayLike = 0.5, reach: ArrayLike = 20.0) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)
        self.guidance = VolumeGuidanceCost(reach)

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: VolumeBelief
    ) -> Scalar:
        """Compute the cost of the way."""
        goal: GoalKnowledge = part(belief, "goal")
        sin, cos = sin_cos(state.heading)
        along, across = jnp.unstack(goal.way)
        missing = length(along, across) - (cos * along + sin * across)
        cost = self.guidance.stage(state, control, t, belief)
        return with_overrun(state, cost) + self.turning * missing


class VolumeInformationCost(Cost):
    """Reward for the information of a scan with this position and heading, and for turning to what
    is out of view: the negative attention of the belief [nat m^3].

    The sensor is taken to be level: a quadrotor that accelerates looks up or down for a moment.
    """

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: VolumeBelief
    ) -> Scalar:
        """Compute the negative attention."""
        return -belief.attention(state.place(3), state.heading)


class BlindFlightCost(Cost):
    """Cost of flying where the camera does not look, with v the velocity in the frame of the
    heading:

        (-v_ahead)_+^2 + side v_left^2 [m^2/s^2]

    Source: perception-aware flight, as in Falanga, Foehn, Lu and Scaramuzza, "PAMPC", IROS 2018,
    with the direction of flight in place of a point of interest.

    Args:
        side: cost of flying sideways, of that of flying backwards.

    Raises:
        ValueError: a negative cost.
    """

    side: Scalar

    def __init__(self, side: ArrayLike = 0.6) -> None:
        self.side = _checks.scalar("side", side, at_least=0.0)

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: VolumeBelief
    ) -> Scalar:
        """Compute the cost of the velocity."""
        sin, cos = sin_cos(state.heading)
        ahead = cos * state["vx"] + sin * state["vy"]
        left = cos * state["vy"] - sin * state["vx"]
        backwards = jnp.maximum(-ahead, 0.0)
        return backwards * backwards + self.side * left * left


class AttitudeCost(Cost):
    """Cost of tilt and of body rates, `(1 - cos tilt)^2 + rates |omega|^2`.

    Args:
        rates: cost of 1 rad/s.

    Raises:
        ValueError: a negative cost.
    """

    rates: Scalar

    def __init__(self, rates: ArrayLike = 0.025) -> None:
        self.rates = _checks.scalar("rates", rates, at_least=0.0)

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: VolumeBelief
    ) -> Scalar:
        """Compute the cost of the attitude."""
        # The cosine of the tilt is 1 - 2 (qx^2 + qy^2).
        tilted = 2.0 * (state["qx"] * state["qx"] + state["qy"] * state["qy"])
        squared = sum(state[name] * state[name] for name in ("wx", "wy", "wz"))
        return tilted * tilted + self.rates * squared
