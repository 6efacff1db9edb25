"""The last metre to a goal or a dock in a volume: a position controller takes over."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Flag, Key, Scalar, StateVector
from jaxplore.belief.belief import part
from jaxplore.belief.volume_belief import GoalKnowledge, VolumeBelief
from jaxplore.control.base import Controller, Info, ModelBasedController, SampledPlan
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.dynamics.base import State
from jaxplore.dynamics.quadrotor import Quadrotor, position_upwards
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower

AWAY = 0.8
"""Distance of what moves beyond which the position controller takes over [m]."""
ROUNDING = 1e-4
"""Difference of clearances that does not count [m]."""
POINTS = 9
"""Points of the straight line to the goal at which the clearance is read."""


class GoalApproach(ModelBasedController):
    """Flies with another controller, and over the last metre to a goal with a position controller.

    The goal is that of the belief, or the place of an errand while that is due, such as a dock. The
    place at which it comes to rest is that with room next to it (`GoalKnowledge.place`).
    Within `near` of it, where the straight line to it keeps the robot's radius from all that
    is not known to be free, and where nothing that moves is within 0.8 m, the command is that of
    `QuadrotorFollower`. It comes to rest there, and turns to the heading of the goal if it has one.
    Sampled commands vary by more than the speed at which a robot is at rest.

    Args:
        flying: controller that flies to the goal, such as that of `volume_explorer`.
        near: distance from the goal at which the position controller takes over [m].

    Raises:
        ValueError: a controller of another class or for another robot, a distance that is not
            positive.
    """

    belief_type: ClassVar[type] = VolumeBelief

    flying: Controller
    dynamics: Quadrotor
    near: Scalar
    follower: QuadrotorFollower

    def __init__(self, flying: Controller, dynamics: Quadrotor, near: ArrayLike = 0.75) -> None:
        _kinds.instance("flying", flying, Controller)
        _kinds.instance("dynamics", dynamics, Quadrotor)
        self.flying, self.dynamics = flying, dynamics
        self.near = _checks.scalar("near", near, above=0.0)
        self.follower = QuadrotorFollower()

    def init(self) -> Any:
        """Return the initial state, that of the controller that flies."""
        return self.flying.init()

    def step(
        self, state: Any, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, Any, Info]:
        """Compute one control; see `Controller.step`."""
        control, after, info = self.flying.step(state, observation, belief, key=key)
        follower, errand = self.follower, belief.errand
        if belief.goal is None and errand is not None:
            place, is_due, fits = errand.place, errand.is_due, jnp.array(True)
        else:
            # The goal is the place of an errand while that is due.
            goal: GoalKnowledge = part(belief, "goal")
            place, is_due, fits = goal.place, jnp.array(True), goal.fits
            if goal.heading is not None:
                follower = eqx.tree_at(
                    lambda each: each.heading,
                    follower,
                    goal.heading,
                    is_leaf=lambda each: each is None,
                )
        # A mirror in z: the model has z down.
        target = position_upwards(place)
        held = follower.control(self.dynamics, observation, target, jnp.zeros(3))
        held = jnp.clip(held, self.dynamics.control_min, self.dynamics.control_max)
        takes_over = is_due & fits & self._takes_over(observation, belief, place)
        return jnp.where(takes_over, held, control), after, info

    def _takes_over(self, observation: StateVector, belief: Any, place: Float[Array, "3"]) -> Flag:
        """Check whether the place is near, and the straight line to it is free."""
        here = position_upwards(observation)
        gap = place - here
        shares = jnp.linspace(0.0, 1.0, POINTS)[:, None]
        line: Float[Array, "9 3"] = here + shares * gap
        room = jax.vmap(belief.clearance)(line)
        # Where the robot is nearer to something than its radius, it may fly away from that.
        is_open = room.min() >= jnp.minimum(self.dynamics.radius, room[0] - ROUNDING)
        is_free: Flag = is_open & (jnp.sum(gap * gap) < self.near * self.near)
        if belief.obstacles is None:
            return is_free
        state = State(observation, self.dynamics, self.dynamics.default_control)
        is_alone: Flag = is_free & (MovingObstacleCost().room(state, belief.obstacles) > AWAY)
        return is_alone

    def inspect(
        self,
        state: Any,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of the controller that flies."""
        return self.flying.inspect(
            state, observation, belief, key=key, num_trajectories=num_trajectories
        )

    def at_period(self, control_period: ArrayLike) -> "GoalApproach":
        """Return a copy that is called every `control_period` seconds."""
        return GoalApproach(self.flying.at_period(control_period), self.dynamics, self.near)
