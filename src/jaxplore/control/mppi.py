"""Model predictive path integral control."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Scalar, StateVector, Vector
from jaxplore._xla import cut
from jaxplore.control import devices
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.draft import Draft, MPPIState
from jaxplore.control.parameterisations import (
    ControlSpace,
    Direct,
    Parameterisation,
    Samples,
    shifted,
)
from jaxplore.control.proposals import GaussianProposal, Proposal, SamplingContext
from jaxplore.control.risk import MeanVariance, Risk
from jaxplore.control.rollout import Outcomes, Trajectory, check_parts, rollout, rollout_costs
from jaxplore.control.smoothing import SavitzkyGolay
from jaxplore.control.weighting import Softmax, Weighting, effective_sample_size
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class MPPI(Controller):
    """Model predictive path integral control.

    Minimises over control sequences U the expected cost of

        x_{t+1} = step(x_t, u_t, dt),   J = sum_t stage(x_{t+1}, u_t) + terminal(x_T) + sequence(U)

    by sampling parameters v around those of the last solution and averaging them,

        v <- sum_k w_k v_k,   w = weighting(J, log q - log p)

    Each step first shifts the last solution by the control period, then samples. Controls are
    clipped before use, and what took effect is averaged, so that bounds bias nothing.

    MPPI = proposal x parameterisation x weighting; any of them go together, and a variant is
    another part:

    - proposal: `GaussianProposal`, `BiasedProposal`, `InjectedProposal`, over sources of noise
    - parameterisation: `Direct`, `Smooth` (SMPPI), `Knots` (kernel and spline MPPI)
    - weighting: `Softmax`, `AdaptiveSoftmax`, `Elite` (CEM)

    Source: Williams, Wagener, Goldfain, Drews, Rehg, Boots, Theodorou, "Information theoretic MPC
    for model-based reinforcement learning", ICRA 2017, Algorithm 2.

    Args:
        dynamics: the model.
        cost: what to minimise.
        horizon: model steps ahead, T.
        num_samples: rollouts, K.
        temperature: of the softmax, in units of cost; or give `weighting`.
        noise_std: (nu,) standard deviation of the Gaussian noise; or give `proposal`.
        dt: model step [s].
        control_period: time between commands [s]; one model step when absent.
        proposal: distribution of the samples.
        parameterisation: how parameters become controls; the controls themselves when absent.
        weighting: how costs become weights.
        smoothing: of the controls that are given out; none when absent.
        disturbance: what outcomes are uncertain by; none when absent.
        num_outcomes: outcomes of each control sequence, M, if there is a disturbance.
        risk: how the outcomes' costs become one; their mean when absent.
        interpolate_shift: whether a control period of part of a model step interpolates the last
            solution; otherwise it is shifted by whole steps when they are due.
        mesh: devices over which the samples are spread, all of them; one device when absent.

    Raises:
        ValueError: horizon or samples < 1, a step, period or temperature that is not positive,
            parts or bounds that do not fit the model, both or neither of two alternatives, a model
            or cost that returns another shape than it should.
    """

    dynamics: Dynamics
    cost: Cost
    proposal: Proposal
    parameterisation: Parameterisation
    weighting: Weighting
    smoothing: SavitzkyGolay | None
    disturbance: Disturbance | None
    risk: Risk
    dt: Scalar
    control_period: Scalar
    horizon: int = eqx.field(static=True)
    num_samples: int = eqx.field(static=True)
    num_outcomes: int = eqx.field(static=True)
    interpolate_shift: bool = eqx.field(static=True)
    mesh: Mesh | None = eqx.field(static=True)

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
        smoothing: SavitzkyGolay | None = None,
        disturbance: Disturbance | None = None,
        num_outcomes: int = 1,
        risk: Risk | None = None,
        interpolate_shift: bool = True,
        mesh: Mesh | None = None,
    ) -> None:
        if (proposal is None) == (noise_std is None):
            given = f"noise_std is {noise_std!r} and proposal is {proposal!r}"
            raise ValueError(f"{given}; accepted: one of them")
        if weighting is not None and temperature is not None:
            given = f"temperature is {temperature!r} beside a weighting"
            raise ValueError(f"{given}; accepted: one of them")
        if disturbance is None and (risk is not None or num_outcomes != 1):
            raise ValueError(
                f"risk is {risk!r} and num_outcomes is {num_outcomes} without a disturbance; "
                "accepted: a disturbance that makes outcomes differ"
            )
        self.dynamics = dynamics
        self.cost = cost
        self.horizon = _checks.positive_int("horizon", horizon)
        self.num_samples = _checks.positive_int("num_samples", num_samples)
        self.num_outcomes = _checks.positive_int("num_outcomes", num_outcomes)
        self.dt = _checks.scalar("dt", dt, above=0.0)
        period = self.dt if control_period is None else control_period
        self.control_period = _checks.scalar("control_period", period, above=0.0)
        self.proposal = GaussianProposal(noise_std) if proposal is None else proposal
        self.parameterisation = Direct() if parameterisation is None else parameterisation
        if weighting is None:
            weighting = Softmax(0.1 if temperature is None else temperature)
        self.weighting = weighting
        self.smoothing = smoothing
        self.disturbance = disturbance
        self.risk = MeanVariance() if risk is None else risk
        self.interpolate_shift = interpolate_shift
        self.mesh = None if mesh is None else devices.auto_mesh(mesh)
        num_controls = dynamics.control_size
        self.proposal.check(self._num_parameters, self.horizon, num_controls, self.num_samples)
        if smoothing is not None:
            smoothing.check(self.horizon)
        if disturbance is not None:
            disturbance.check(dynamics, self.num_outcomes)
        if mesh is not None:
            devices.check_divisible(self.num_samples, mesh)
        check_parts(dynamics, cost, self.horizon)

    def init(self, controls: Float[Array, "T nu"] | None = None) -> MPPIState:
        """Return the state before the first step, which begins with a shift.

        Args:
            controls: (T, nu) to start from; the model's default control when absent.
        """
        space, size = self._space, self.dynamics.control_size
        if controls is None:
            controls = jnp.broadcast_to(space.default, (self.horizon, size))
        history = 0 if self.smoothing is None else self.smoothing.history
        return MPPIState(
            nominal=self.parameterisation.init(controls, space),
            proposal=self.proposal.init(self._num_parameters, size),
            applied=space.default,
            past=jnp.broadcast_to(space.default, (history, size)),
            phase=jnp.zeros(()),
        )

    def at_period(self, control_period: ArrayLike) -> "MPPI":
        """Return this controller for commands that are `control_period` seconds apart."""
        period = _checks.scalar("control_period", control_period, above=0.0)
        same: MPPI = eqx.tree_at(lambda controller: controller.control_period, self, period)
        return same

    def resume(self, state: MPPIState, controls: Float[Array, "T0 nu"]) -> MPPIState:
        """Return the state that goes on from another controller's plan, of any horizon.

        Its controls are cut off, or continued with the default control. What a proposal adapted to
        and a smoothing looks back on starts anew.

        Args:
            state: the other controller's.
            controls: its plan: `Info.controls` of the last step.
        """
        missing = max(self.horizon - controls.shape[0], 0)
        more = jnp.broadcast_to(self._space.default, (missing, controls.shape[1]))
        fresh = self.init(jnp.concatenate([controls[: self.horizon], more]))
        past = jnp.broadcast_to(state.applied, fresh.past.shape)
        return fresh._replace(applied=state.applied, past=past, phase=state.phase)

    def step(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        perturbations: Samples | None = None,
        shift: bool = True,
    ) -> tuple[ControlVector, MPPIState, Info]:
        """Plan once.

        Args:
            state: from `init` or the last step.
            observation: (nx,) the robot's state.
            belief: what the robot knows; whatever the cost reads.
            key: randomness.
            perturbations: (P, nu, K) to be added to the proposal's means instead of its noise.
            shift: whether the last solution is first moved on by the control period; without, the
                plan for the same moment is refined.

        Returns:
            The control (nu,), the new state, and `Info`.
        """
        draft = self.draft(state, key=key, perturbations=perturbations, shift=shift)
        return self.conclude(draft, self.price(draft, observation, belief))

    def draft(
        self,
        state: MPPIState,
        *,
        key: Key,
        perturbations: Samples | None = None,
        shift: bool = True,
    ) -> Draft:
        """Return the first half of a step: control sequences that are to be priced.

        `price` and `conclude` are the rest; who prices otherwise leaves out `price`.

        Args:
            state: as of `step`.
            key: as of `step`.
            perturbations: as of `step`.
            shift: as of `step`.
        """
        state = self._shift(state) if shift else state
        sample_key, outcome_key = jax.random.split(key)
        around = SamplingContext(self.parameterisation, state.nominal, self._space)
        samples = self.proposal.sample(
            state.proposal,
            around,
            self.num_samples,
            key=sample_key,
            perturbations=perturbations,
        )
        if self.mesh is not None:
            samples = devices.shard_samples(samples, self.mesh)
        controls, samples = self.parameterisation.decode(state.nominal, samples, around.space)
        # Without a cut the noise is drawn once for the rollouts and again for the mean.
        controls, samples = cut((controls, samples))

        outcomes = None
        if self.disturbance is not None:
            kind, sizes = (self.disturbance, self.risk), (self.horizon, self.num_outcomes)
            outcomes = Outcomes.draw(*kind, self.dynamics, *sizes, key=outcome_key)
        return Draft(state, around, samples, controls, outcomes)

    def price(
        self, draft: Draft, initial: StateVector | Float[Array, "nx K"], belief: Any = None
    ) -> Float[Array, " K"]:
        """Return what drafted sequences cost.

        Args:
            draft: from `draft`.
            initial: (nx,) the robot's state, or (nx, K) one for each sequence.
            belief: as of `step`.
        """
        everything = (
            self.dynamics,
            self.cost,
            self.dt,
            belief,
            draft.state.applied,
            draft.outcomes,
        )
        arrays, static = eqx.partition(everything, eqx.is_array)

        def costs(start: Array, controls: Array, arrays: Any) -> Array:
            dynamics, cost, dt, knowledge, applied, outcomes = eqx.combine(arrays, static)
            return rollout_costs(
                dynamics, cost, start, controls, dt, knowledge, applied=applied, outcomes=outcomes
            )

        if self.mesh is None:
            return costs(initial, draft.controls, arrays)
        return devices.map_over_devices(costs, self.mesh, initial, draft.controls, arrays)

    def conclude(
        self, draft: Draft, costs: Float[Array, " K"]
    ) -> tuple[ControlVector, MPPIState, Info]:
        """Return the second half of a step: what follows if the drafted sequences cost this.

        Args:
            draft: from `draft`.
            costs: (K,); sequences of a cost that is not finite get no weight.
        """
        state, around, samples = draft.state, draft.around, draft.samples
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        log_ratio = self.proposal.log_ratio(state.proposal, around, samples)
        weights = self.weighting.weights(costs, log_ratio)
        # Without a finite rollout all weights are 0 and the shifted nominal stays.
        kept = (1.0 - jnp.sum(weights)) * around.centre
        mean = jnp.einsum("k,puk->pu", weights, samples) + kept
        nominal = self.parameterisation.update(state.nominal, mean, around.space)
        controls = self.parameterisation.controls(nominal, around.space)
        if self.smoothing is not None:
            controls = around.space.clip(self.smoothing.smooth(state.past, controls))
        memory = self.proposal.adapt(state.proposal, around, weights, samples)
        info = Info(
            controls=controls,
            weights=weights,
            costs=costs,
            effective_sample_size=effective_sample_size(weights),
            is_finite=jnp.any(jnp.isfinite(costs)),
        )
        after = MPPIState(nominal, memory, controls[0], state.past, state.phase)
        return controls[0], after, info

    def inspect(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` would see, with undisturbed trajectories and the cost of each term.

        Args:
            state: as given to `step`.
            observation: (nx,).
            belief: as of `step`.
            key: the same key samples the same parameters as `step`.
            num_trajectories: how many of the K samples are returned, spread over all of them.
        """
        plan = self.draft(state, key=key)
        costs = self.price(plan, observation, belief)
        _, _, info = self.conclude(plan, costs)
        count = min(num_trajectories, self.num_samples)
        # A mixture orders its samples by component: the first few would be one of them only.
        chosen = np.linspace(0, self.num_samples - 1, count).round().astype(int)

        def follow(controls: Array) -> Trajectory:
            parts, known = (self.dynamics, self.cost), (self.dt, belief)
            return rollout(*parts, observation, controls, *known, applied=plan.state.applied)

        sampled = jnp.moveaxis(plan.controls, -1, 0)
        best = sampled[jnp.argmin(info.costs)]
        shown = jnp.concatenate([info.controls[None], best[None], sampled[chosen]])
        return SampledPlan.of(jax.vmap(follow)(shown), info.weights[chosen])

    def _shift(self, state: MPPIState) -> MPPIState:
        """Return the state as seen one control period later."""
        steps = self.control_period / self.dt
        phase = state.phase
        if not self.interpolate_shift:
            # A sum of 20 periods of 0.05 must come to a whole step, whatever was rounded.
            due = phase + steps
            steps = jnp.floor(due + 1e-3)
            phase = due - steps
        space = self._space
        rows = steps * (self._num_parameters / self.horizon)
        planned = self.parameterisation.controls(state.nominal, space)
        timeline = jnp.concatenate([state.past, state.applied[None], planned[1:]])
        return MPPIState(
            nominal=self.parameterisation.shift(state.nominal, steps, space),
            proposal=self.proposal.shift(state.proposal, rows),
            applied=state.applied,
            past=shifted(timeline, steps, space.default)[: state.past.shape[0]],
            phase=phase,
        )

    @property
    def _space(self) -> ControlSpace:
        model = self.dynamics
        return ControlSpace(
            model.control_min, model.control_max, model.default_control, self.dt, self.horizon
        )

    @property
    def _num_parameters(self) -> int:
        return self.parameterisation.num_parameters(self.horizon)
