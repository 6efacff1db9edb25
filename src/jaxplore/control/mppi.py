"""Model predictive path integral control."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Scalar, StateVector, Vector
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.parameterisations import Direct, Parameterisation
from jaxplore.control.proposals import GaussianProposal, Proposal
from jaxplore.control.rollout import rollout, rollout_costs
from jaxplore.control.weighting import Softmax, Weighting
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.belief import Belief


class MPPIState(NamedTuple):
    """What MPPI remembers: the `nominal` parameters (T, nu)."""

    nominal: Float[Array, "T nu"]


class MPPI(Controller):
    """Model predictive path integral control (Williams et al., ICRA 2017).

    Minimises over control sequences U the expected cost of

        x_{t+1} = step(x_t, u_t, dt),   J = sum_t stage(x_{t+1}, u_t) + terminal(x_T)

    by sampling perturbations of a nominal sequence and averaging them with weights

        U <- U + sum_k w_k eps_k,   w = softmax(-(J + temperature * sum_t u_t^T Sigma^-1 eps_t)
                                                / temperature).

    Each step first shifts the last solution by the control period, then samples around it. The
    controls are clipped before use and the clipped perturbations are averaged, so that bounds bias
    nothing. MPPI = proposal x parameterisation x weighting: a variant is another part.

    Args:
        dynamics: the model.
        cost: what to minimise.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: of the softmax, in units of cost; or give `weighting`.
        noise_std: (nu,) standard deviation of the Gaussian noise; or give `proposal`.
        dt: model step [s].
        control_period: time between commands [s]; one model step when absent.
        proposal: distribution of the perturbations.
        parameterisation: how parameters become controls; the controls themselves when absent.
        weighting: how costs become weights.

    Raises:
        ValueError: horizon or samples < 1, a step, period or temperature that is not positive, a
            `noise_std` or bounds that do not fit the controls, both or neither of two alternatives.
    """

    dynamics: Dynamics
    cost: Cost
    proposal: Proposal
    parameterisation: Parameterisation
    weighting: Weighting
    dt: Scalar
    control_period: Scalar
    horizon: int = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)

    def __init__(
        self,
        dynamics: Dynamics,
        cost: Cost,
        *,
        horizon: int = 40,
        num_samples: int = 1000,
        temperature: ArrayLike | None = None,
        noise_std: Vector | None = None,
        dt: ArrayLike = 0.05,
        control_period: ArrayLike | None = None,
        proposal: Proposal | None = None,
        parameterisation: Parameterisation | None = None,
        weighting: Weighting | None = None,
    ) -> None:
        if (proposal is None) == (noise_std is None):
            raise ValueError(
                f"noise_std is {noise_std!r} and proposal is {proposal!r}; accepted: one of them"
            )
        if weighting is not None and temperature is not None:
            raise ValueError(
                f"temperature is {temperature!r} beside a weighting; accepted: one of them"
            )
        if proposal is None:
            proposal = GaussianProposal(jnp.asarray(noise_std, jnp.float32))
        size = dynamics.control_size
        for name in ("control_min", "control_max"):
            bound = getattr(dynamics, name)
            if jnp.shape(bound) != (size,):
                raise ValueError(
                    f"{name} of {type(dynamics).__name__} has shape {jnp.shape(bound)}; "
                    f"accepted: ({size},), one per name in control_names"
                )
        if isinstance(proposal, GaussianProposal) and proposal.noise_std.shape != (size,):
            raise ValueError(
                f"noise_std has shape {proposal.noise_std.shape}; "
                f"accepted: ({size},), one per control of {type(dynamics).__name__}"
            )
        self.dynamics = dynamics
        self.cost = cost
        self.proposal = proposal
        self.parameterisation = Direct() if parameterisation is None else parameterisation
        if weighting is None:
            weighting = Softmax(0.1 if temperature is None else temperature)
        self.weighting = weighting
        self.dt = _checks.scalar("dt", dt, above=0.0)
        self.control_period = (
            self.dt
            if control_period is None
            else _checks.scalar("control_period", control_period, above=0.0)
        )
        self.horizon = _checks.positive_int("horizon", horizon)
        self.num_samples = _checks.positive_int("num_samples", num_samples)

    def init(self) -> MPPIState:
        """Return the state before the first step: do nothing."""
        return MPPIState(self.parameterisation.init(self.horizon, self.dynamics.control_size))

    def at_period(self, control_period: ArrayLike) -> "MPPI":
        """Return this controller for commands that are `control_period` seconds apart."""
        period = _checks.scalar("control_period", control_period, above=0.0)
        same: MPPI = eqx.tree_at(lambda controller: controller.control_period, self, period)
        return same

    def step(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Belief,
        *,
        key: Key,
        perturbations: Float[Array, "T nu K"] | None = None,
    ) -> tuple[ControlVector, MPPIState, Info]:
        """Plan once.

        Args:
            state: from `init` or the last step.
            observation: (nx,) the robot's state.
            belief: what the robot knows.
            key: randomness.
            perturbations: (T, nu, K) to be used instead of the proposal's samples.

        Returns:
            The control (nu,), the new state, and `Info`.
        """
        nominal = self.parameterisation.shift(state.nominal, self.control_period / self.dt)
        controls, effective = self._sample(nominal, key, perturbations)
        costs = rollout_costs(self.dynamics, self.cost, observation, controls, self.dt, belief)
        importance = self.proposal.importance(nominal, effective)
        weights = self.weighting.weights(costs, importance)
        updated = nominal + jnp.einsum("k,tuk->tu", weights, effective)
        control = self.parameterisation.controls(updated, *self._bounds)[0]
        is_finite = jnp.any(jnp.isfinite(costs))
        squares = jnp.sum(weights * weights)
        info = Info(
            weights=weights,
            costs=jnp.where(jnp.isfinite(costs), costs, jnp.inf),
            effective_sample_size=jnp.where(
                squares > 0.0, 1.0 / jnp.where(squares > 0.0, squares, 1.0), 0.0
            ),
            is_finite=is_finite,
        )
        return control, MPPIState(updated), info

    def inspect(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Belief,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` would see, with trajectories and the cost of each term.

        Args:
            state: as given to `step`.
            observation: (nx,).
            belief: what the robot knows.
            key: the same key samples the same perturbations as `step`.
            num_trajectories: how many of the K samples are returned.
        """
        nominal = self.parameterisation.shift(state.nominal, self.control_period / self.dt)
        controls, _ = self._sample(nominal, key, None)
        _, after, info = self.step(state, observation, belief, key=key)
        count = min(num_trajectories, self.num_samples)

        def states(sequence: Array) -> Array:
            return rollout(self.dynamics, self.cost, observation, sequence, self.dt, belief).states

        return SampledPlan(
            nominal=rollout(
                self.dynamics,
                self.cost,
                observation,
                self.parameterisation.controls(after.nominal, *self._bounds),
                self.dt,
                belief,
            ),
            samples=jax.vmap(states, in_axes=-1)(controls[:, :, :count]),
            weights=info.weights[:count],
        )

    def _sample(self, nominal: Array, key: Key, perturbations: Array | None) -> tuple[Array, Array]:
        """Return control sequences (T, nu, K) and the perturbations that they come from."""
        if perturbations is None:
            steps, size = nominal.shape
            perturbations = self.proposal.sample((steps, size, self.num_samples), key=key)
        return self.parameterisation.perturb(nominal, perturbations, *self._bounds)

    @property
    def _bounds(self) -> tuple[ControlVector, ControlVector]:
        return self.dynamics.control_min, self.dynamics.control_max
