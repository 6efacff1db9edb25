"""What every controller does."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Flag, Key, Scalar, StateVector
from jaxplore.control.rollout import Trajectory


class Members(NamedTuple):
    """What the members of a controller that holds several say about a step.

    Args:
        controls: (N, nu) what each would do now.
        costs: (N,) of their plans under one common objective.
        uncertainties: (N,) spread of each one's weighted samples, in half ranges of the controls.
        effective_sample_sizes: (N,) of each one's rollouts.
        shares: (N,) how much of each is in the control that is returned; adds up to 1.
        diversity: mean distance between two members' controls, in half ranges [root mean square
            over the controls].
        is_replaced: whether a member's plan took the place of their mixture.
    """

    controls: Float[Array, "N nu"]
    costs: Float[Array, " N"]
    uncertainties: Float[Array, " N"]
    effective_sample_sizes: Float[Array, " N"]
    shares: Float[Array, " N"]
    diversity: Scalar
    is_replaced: Flag

    @classmethod
    def blank(cls, number: int, control_size: int) -> "Members":
        """Return zeros in the shapes of `number` members."""
        each = jnp.zeros(number)
        return cls(
            jnp.zeros((number, control_size)),
            each,
            each,
            each,
            each,
            jnp.zeros(()),
            jnp.array(False),
        )


class Info(NamedTuple):
    """What a controller says about a step.

    Args:
        controls: (T, nu) the plan; its first row is the control that is returned. For several
            controls per command, apply the first n and call again n model steps later, with
            `at_period(n * dt)`.
        weights: (K,) weight of each rollout; adds up to 1, or to 0 if none was finite. Of a
            controller that holds N members, those of all their rollouts, each with 1 / N.
        costs: (K,) cost of each rollout; infinite where it was not finite.
        effective_sample_size: `1 / sum of weights^2`, between 1 and K; 0 if none was finite. Of a
            controller that holds several members, the mean of theirs.
        is_finite: whether any rollout was finite. If not, the control is that of the shifted
            nominal.
        members: of a controller that holds several; None of any other.
    """

    controls: Float[Array, "T nu"]
    weights: Float[Array, " K"]
    costs: Float[Array, " K"]
    effective_sample_size: Scalar
    is_finite: Flag
    members: Members | None = None


class SampledPlan(NamedTuple):
    """A look into one step, for drawing and for finding out why.

    Args:
        nominal: what the plan leads to, and its cost by term.
        best: the rollout of least cost, and its cost by term.
        samples: (N, T + 1, nx) states of some rollouts.
        weights: (N,) their weights.
        reference: (R, D) positions that the plan is to follow [m]; none by default.
    """

    nominal: Trajectory
    best: Trajectory
    samples: Float[Array, "N T+1 nx"]
    weights: Float[Array, " N"]
    reference: Float[Array, "R D"] | None = None

    @classmethod
    def of(cls, followed: Trajectory, weights: Float[Array, " N"]) -> "SampledPlan":
        """Return what stacked trajectories show: the nominal one, the best one, N samples."""
        nominal, best = (jax.tree.map(lambda leaf, i=i: leaf[i], followed) for i in (0, 1))
        return cls(nominal, best, followed.states[2:], weights)


class Controller(eqx.Module):
    """A feedback law with a state of its own.

    `init` makes that state, `step` maps an observed robot state and a belief to a control. All
    controllers are used alike, so they nest and compare.
    """

    @abc.abstractmethod
    def init(self) -> Any:
        """Return the state before the first step. To reset a controller is to begin with it."""

    @abc.abstractmethod
    def step(
        self, state: Any, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, Any, Info]:
        """Return the control (nu,), the controller's new state and what it says about the step."""

    @abc.abstractmethod
    def inspect(
        self,
        state: Any,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` sees with the same arguments: trajectories, and the cost by term."""

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members of a controller that holds several; none of any other."""
        return ()

    @abc.abstractmethod
    def at_period(self, control_period: ArrayLike) -> "Controller":
        """Return this controller for commands that are `control_period` seconds apart."""
