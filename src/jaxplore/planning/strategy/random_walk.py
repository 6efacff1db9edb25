"""Random walk: the baseline that any explorer must beat."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Position, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.control.mppi import MPPI, MPPIState
from jaxplore.costs.base import SumCost
from jaxplore.costs.tracking import GoalCost


class RandomWalkState(NamedTuple):
    """State of the random walk.

    `target` is (x, y) [m]. `step` is the number of commands since the first target was drawn.
    """

    mppi: MPPIState
    target: Position
    step: Count


class RandomWalk(Controller):
    """MPPI towards a target that is drawn at fixed intervals, in a uniformly random direction.

    Given the costs of an explorer other than those on information, it keeps the same clearance and
    speed limit, which makes the comparison fair.

    Args:
        mppi: MPPI with all costs except the distance to the target.
        weight: weight of the distance to the target [1/m].
        distance: distance from the robot at which targets are drawn [m].
        period: time between targets [s].

    Raises:
        ValueError: a value that is not positive.
    """

    mppi: MPPI
    distance: Scalar
    period: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        mppi: MPPI,
        weight: ArrayLike = 1.0,
        distance: ArrayLike = 3.0,
        period: ArrayLike = 2.0,
    ) -> None:
        # The goal is a leaf of the cost: a new target does not recompile.
        pull = _checks.scalar("weight", weight, above=0.0) * GoalCost([0.0, 0.0])
        self.mppi = eqx.tree_at(lambda inner: inner.cost, mppi, SumCost((pull, mppi.cost)))
        self.distance = _checks.scalar("distance", distance, above=0.0)
        self.period = _checks.scalar("period", period, above=0.0)

    def init(self) -> RandomWalkState:
        """Return the initial state."""
        return RandomWalkState(self.mppi.init(), jnp.zeros(2), jnp.zeros((), jnp.int32))

    def at_period(self, control_period: ArrayLike) -> "RandomWalk":
        """Return a copy of this controller that is called every `control_period` seconds."""
        mppi = self.mppi.at_period(control_period)
        same: RandomWalk = eqx.tree_at(lambda controller: controller.mppi, self, mppi)
        return same

    def step(
        self,
        state: RandomWalkState,
        observation: StateVector,
        belief: Belief | None = None,
        *,
        key: Key,
    ) -> tuple[ControlVector, RandomWalkState, Info]:
        """Draw a new target if one is due, and plan towards the target."""
        model = self.mppi.dynamics
        observation = check_call(model, state, RandomWalkState, observation, key)
        mppi, target, inner_key = self._prepare(state, observation, key)
        control, inner, info = mppi.step(state.mppi, observation, belief, key=inner_key)
        # Counting begins with the first target, so that a robot which is lost at first draws a
        # target as soon as its position is known.
        has_target = (state.step > 0) | jnp.isfinite(self.mppi.dynamics.position(observation)).all()
        step = jnp.where(has_target, state.step + 1, 0)
        return control, RandomWalkState(inner, target, step), info

    def inspect(
        self,
        state: RandomWalkState,
        observation: StateVector,
        belief: Belief | None = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of MPPI; see `Controller.inspect`."""
        model = self.mppi.dynamics
        observation = check_call(model, state, RandomWalkState, observation, key)
        mppi, _, inner_key = self._prepare(state, observation, key)
        return mppi.inspect(
            state.mppi, observation, belief, key=inner_key, num_trajectories=num_trajectories
        )

    def _prepare(
        self, state: RandomWalkState, observation: StateVector, key: Key
    ) -> tuple[MPPI, Position, Key]:
        """Return MPPI with its target, the target, and the key for MPPI."""
        target_key, inner_key = jax.random.split(key)
        every = jnp.maximum(jnp.round(self.period / self.mppi.control_period), 1.0)
        angle = jax.random.uniform(target_key, maxval=2.0 * jnp.pi)
        offset = self.distance * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        drawn = self.mppi.dynamics.position(observation) + offset
        is_due = (state.step % every.astype(jnp.int32) == 0) & jnp.isfinite(drawn).all()
        target = jnp.where(is_due, drawn, state.target)
        mppi: MPPI = eqx.tree_at(_goal, self.mppi, target)
        return mppi, target, inner_key


def _goal(mppi: MPPI) -> Any:
    """Return the leaf of the goal, for `eqx.tree_at`."""
    cost: Any = mppi.cost
    return cost.costs[0].cost.goal
