"""The interface of all controllers."""

import abc
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._describe import describe_fields
from jaxplore._types import ArrayLike, ControlVector, Flag, Key, Scalar, StateVector
from jaxplore.control.trajectory import Trajectory
from jaxplore.dynamics.base import Dynamics


class Members(NamedTuple):
    """Diagnostics of one step for each of the N members of a controller that combines several.

    Args:
        controls: (N, nu) first control of each member's plan.
        costs: (N,) cost of each member's plan under the common objective.
        uncertainties: (N,) spread of each member's weighted samples, in half ranges of the
            controls.
        effective_sample_sizes: (N,) effective sample size of each member's rollouts.
        shares: (N,) weight of each member in the returned control; adds up to 1.
        diversity: mean over pairs of members of the distance between their controls, in half
            ranges [root mean square over the controls].
        is_replaced: whether one member's plan replaced the mixture of all.
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
        """Return zeros for `number` members: the shapes that a recording needs in advance."""
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
    """Diagnostics of one step of a controller.

    Args:
        controls: (T, nu) planned controls; the first row is the control that is returned. To apply
            n controls per command, call again n model steps later, with `at_period(n * dt)`.
        weights: (K,) weight of each rollout; adds up to 1, or to 0 if no rollout was finite. With N
            members, the weights of all their rollouts, each divided by N.
        costs: (K,) cost of each rollout; infinite where it was not finite.
        effective_sample_size: `1 / sum of weights^2`, between 1 and K; 0 if no rollout was finite.
            With several members, the mean over members.
        is_finite: whether any rollout was finite. If none was, the control is that of the shifted
            nominal.
        members: diagnostics of each member; None for a controller without members.
        log_ratio: (K,) `log q - log p` of each rollout, up to a constant; see `Proposal.log_ratio`.
            With the temperature l, the total cost that the softmax weighs is `costs + l log_ratio`.
            None for a controller without a proposal.
    """

    controls: Float[Array, "T nu"]
    weights: Float[Array, " K"]
    costs: Float[Array, " K"]
    effective_sample_size: Scalar
    is_finite: Flag
    members: Members | None = None
    log_ratio: Float[Array, " K"] | None = None

    @classmethod
    def of_law(cls, control: ControlVector) -> "Info":
        """Return the diagnostics of a feedback law without rollouts: those of a single rollout."""
        one = jnp.ones(1)
        return cls(control[None], one, jnp.zeros(1), one[0], jnp.array(True))


class SampledPlan(NamedTuple):
    """Trajectories of one step, for drawing and debugging.

    Args:
        nominal: trajectory of the plan, with the cost of each term.
        best: rollout of least cost, with the cost of each term.
        samples: (N, T + 1, nx) states of N rollouts.
        weights: (N,) weights of these rollouts.
        reference: (R, D) positions that the plan should follow [m]; None without a reference.
        sample_terms: cost of each term of the N rollouts (N,), by name, summed over time as in
            `Trajectory.terms`; empty if the controller does not tell them.
    """

    nominal: Trajectory
    best: Trajectory
    samples: Float[Array, "N T+1 nx"]
    weights: Float[Array, " N"]
    reference: Float[Array, "R D"] | None = None
    sample_terms: Mapping[str, Float[Array, " N"]] = {}

    @classmethod
    def from_trajectories(
        cls, trajectories: Trajectory, weights: Float[Array, " N"]
    ) -> "SampledPlan":
        """Split a stack of N + 2 trajectories into the nominal, the best one and N samples."""
        nominal, best = (jax.tree.map(lambda leaf, i=i: leaf[i], trajectories) for i in (0, 1))
        terms = {name: paid[2:] for name, paid in trajectories.terms.items()}
        return cls(nominal, best, trajectories.states[2:], weights, sample_terms=terms)


class Controller(eqx.Module):
    """A feedback law with an explicit state.

    `init` returns the initial state. `step` maps an observed robot state and a belief to a control.
    All controllers share this interface, so one may contain another, and any two can be compared
    in the same simulation.
    """

    def __repr__(self) -> str:
        return describe_fields(self)

    @abc.abstractmethod
    def init(self) -> Any:
        """Return the initial state. Reset a controller by starting from it again."""

    @abc.abstractmethod
    def step(
        self, state: Any, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, Any, Info]:
        """Compute one control.

        Args:
            state: the controller's state, from `init` or the last step.
            observation: (nx,) observed state of the robot.
            belief: what the robot knows of the world; whatever the costs read.
            key: random key of this step.

        Returns:
            The control (nu,), the controller's new state, and diagnostics.

        Raises:
            ValueError: a state of another controller, an observation of another size, something
                else than a key, no belief for a cost that reads one.
        """

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
        """Return the trajectories and costs that `step` computes for the same arguments.

        Args:
            state: as of `step`.
            observation: as of `step`.
            belief: as of `step`.
            key: as of `step`; the same key gives the same samples.
            num_trajectories: number of sampled rollouts to return.
        """

    def __hash__(self) -> int:
        # `jax.jit` hashes the method that it is given, and with it the controller.
        raise TypeError(
            f"{type(self).__name__} holds arrays, which have no hash; accepted: "
            "equinox.filter_jit(controller.step) instead of jax.jit"
        )

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members; empty for a controller without members."""
        return ()

    @abc.abstractmethod
    def at_period(self, control_period: ArrayLike) -> "Controller":
        """Return a copy of this controller that is called every `control_period` seconds."""


class ModelBasedController(Controller):
    """A controller that plans with a model of the robot, `dynamics`.

    A controller around it, such as an explorer, reads poses and speeds through this model.
    """

    dynamics: eqx.AbstractVar[Dynamics]
