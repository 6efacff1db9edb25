"""MPPI below a slow strategic layer; what the informative controllers share in all spaces."""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Scalar, StateVector
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.control.model_checks import check_call
from jaxplore.control.mppi import MPPI, MPPIState
from jaxplore.planning.strategy.follower import Follower


class InformativeState(NamedTuple):
    """State of informative MPPI.

    `plan` is the last result of the strategic layer; it is meaningless before the first step. `age`
    is the number of commands since that result. The strategic layer runs again when it reaches the
    number of commands per strategy period.
    """

    mppi: MPPIState
    plan: Any
    age: Count


class StrategicMPPI(Controller):
    """MPPI at every command, and a strategic layer every `strategy_period` [s], a multiple of the
    control period, whose plan its costs read until the next one. If there is a follower, it turns
    the reference of the plan into controls, and the `BiasedProposal` of `mppi` draws a share of the
    samples around these."""

    belief_type: ClassVar[type]

    mppi: eqx.AbstractVar[MPPI]
    follower: eqx.AbstractVar[Follower | None]
    strategy_period: eqx.AbstractVar[Scalar]

    @property
    @abc.abstractmethod
    def has_reference(self) -> bool:
        """Whether the strategic layer makes a reference."""

    @abc.abstractmethod
    def blank_plan(self) -> Any:
        """Return a plan with the shapes of all others, before the first one."""

    @abc.abstractmethod
    def strategic_plan(self, belief: Any, observation: StateVector) -> Any:
        """Run the strategic layer at the observed state (nx,), and return its plan."""

    @abc.abstractmethod
    def extend_belief(self, belief: Any, observation: StateVector, plan: Any, age: Scalar) -> Any:
        """Return the belief that the costs read: the robot's own, with the strategic plan.

        `age` is the time since the strategic layer made the plan [s].
        """

    def place(self, observation: StateVector) -> Float[Array, " D"]:
        """Return the position of the robot on which the strategic layer depends [m]."""
        return self.mppi.dynamics.position(observation)

    def path(self, reference: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
        """Return positions of the reference in the frame of the model [m]."""
        return reference

    def follower_of(self, plan: Any) -> Follower | None:
        """Return the follower of a plan."""
        return self.follower

    def at_period(self, control_period: ArrayLike) -> "StrategicMPPI":
        """Return a copy of this controller that is called every `control_period` seconds.

        The strategy period must be a whole number of these periods.
        """
        mppi = self.mppi.at_period(control_period)
        _check_periods(self.strategy_period, mppi.control_period)
        same: StrategicMPPI = eqx.tree_at(lambda each: each.mppi, self, mppi)
        return same

    def init(self) -> InformativeState:
        """Return the initial state. The strategic layer runs in the first step."""
        return InformativeState(self.mppi.init(), self.blank_plan(), self._commands_per_strategy)

    def step(
        self,
        state: InformativeState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
    ) -> tuple[ControlVector, InformativeState, Info]:
        """Run the strategic layer if it is due, then plan with MPPI. There must be a belief."""
        model = self.mppi.dynamics
        observation = check_call(model, state, InformativeState, observation, key)
        mppi, known, plan, age = self._prepare(state, observation, belief)
        control, inner, info = mppi.step(state.mppi, observation, known, key=key)
        return control, InformativeState(inner, plan, age + 1), info

    def inspect(
        self,
        state: InformativeState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of MPPI and the reference; see `Controller.inspect`."""
        model = self.mppi.dynamics
        observation = check_call(model, state, InformativeState, observation, key)
        mppi, known, _, _ = self._prepare(state, observation, belief)
        plan = mppi.inspect(
            state.mppi, observation, known, key=key, num_trajectories=num_trajectories
        )
        if not self.has_reference:
            return plan
        return plan._replace(reference=self.path(known.reference))

    def _prepare(
        self, state: InformativeState, observation: StateVector, belief: Any
    ) -> tuple[MPPI, Any, Any, Count]:
        """Return MPPI with its bias, the belief of its costs, the strategic plan and its age."""
        if belief is None:
            kind = self.belief_type.__name__
            raise ValueError(f"belief is None; accepted: a {kind}, which this controller plans on")
        _kinds.instance("belief", belief, self.belief_type)
        mppi = self.mppi
        # A plan around an unknown position would be meaningless, so a lost robot keeps its plan.
        is_placed = jnp.isfinite(self.place(observation)).all()
        is_due = (state.age >= self._commands_per_strategy) & is_placed
        plan = jax.lax.cond(
            is_due,
            lambda: self.strategic_plan(belief, observation),
            lambda: state.plan,
        )
        age = jnp.where(is_due, 0, state.age)
        # Costs read one belief, so what the strategic layer found is added to the robot's own.
        known = self.extend_belief(
            belief, observation, plan, age.astype(jnp.float32) * mppi.control_period
        )
        follower = self.follower_of(plan)
        if follower is not None:
            # The reference has its own time grid and age: it is read at the times of the rollout.
            times = mppi.dt * jnp.arange(1, mppi.horizon + 1, dtype=jnp.float32)
            positions = self.path(jax.vmap(known.reference_at)(times))
            controls = follower(mppi.dynamics, observation, positions, mppi.dt)
            mppi = eqx.tree_at(_bias, mppi, controls)
        return mppi, known, plan, age

    @property
    def _commands_per_strategy(self) -> Count:
        return jnp.round(self.strategy_period / self.mppi.control_period).astype(jnp.int32)


@_kinds.check_arguments
def check_strategy(
    mppi: MPPI, reference: object, follower: Follower | None, period: ArrayLike
) -> Scalar:
    """Return the strategy period [s], after the checks of the parts of a `StrategicMPPI`."""
    is_biased = isinstance(mppi.proposal, BiasedProposal)
    if is_biased != (follower is not None) or (is_biased and reference is None):
        raise ValueError(
            f"proposal is {type(mppi.proposal).__name__} with follower {follower!r} and "
            f"reference {reference!r}; accepted: a BiasedProposal with both, or another "
            "proposal without a follower"
        )
    strategy_period = _checks.scalar("strategy_period", period, above=0.0)
    _check_periods(strategy_period, mppi.control_period)
    return strategy_period


def _check_periods(strategy_period: Scalar, control_period: Scalar) -> None:
    """Raise a `ValueError` if a strategy period is not a whole number of control periods."""
    if _kinds.is_traced(strategy_period, control_period):
        return
    # Compared with a tolerance: periods such as 0.2 and 0.02 are not exact in float32.
    ratio = float(strategy_period) / float(control_period)
    if abs(ratio - round(ratio)) > 1e-3 * ratio or round(ratio) < 1:
        raise ValueError(
            f"strategy_period is {float(strategy_period):g} s; accepted: a whole "
            f"number of control periods of {float(control_period):g} s"
        )


def _bias(mppi: MPPI) -> Any:
    """Return the leaf of the reference controls, for `eqx.tree_at`."""
    proposal: Any = mppi.proposal
    return proposal.reference
