"""Model predictive path integral control."""

import contextlib
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._fusion import cut
from jaxplore._types import ControlVector, Key, Scalar, StateVector, Vector
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.parameterisations import (
    ControlSpace,
    Direct,
    Parameterisation,
    Samples,
    shifted,
)
from jaxplore.control.proposals import GaussianProposal, Proposal, Surroundings
from jaxplore.control.risk import MeanVariance, Risk
from jaxplore.control.rollout import Outcomes, check_costs, check_state, rollout, rollout_costs
from jaxplore.control.smoothing import SavitzkyGolay
from jaxplore.control.weighting import Softmax, Weighting, effective_sample_size
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class MPPIState(NamedTuple):
    """What MPPI remembers between steps.

    Args:
        nominal: of the parameterisation; the control sequence (T, nu) itself with `Direct`.
        proposal: memory of the proposal; nothing unless it adapts.
        applied: (nu,) the control given out last.
        past: (H, nu) what was applied before, one per model step, newest last; as many as the
            smoothing looks back on.
        phase: part of a model step by which the nominal lags behind, if shifts do not interpolate.
    """

    nominal: Any
    proposal: Any
    applied: ControlVector
    past: Float[Array, "H nu"]
    phase: Scalar


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
        interpolate_shift: whether a control period that is not a whole number of model steps
            interpolates the last solution; otherwise it is shifted by whole steps when they are
            due.
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
            raise ValueError(
                f"noise_std is {noise_std!r} and proposal is {proposal!r}; accepted: one of them"
            )
        if weighting is not None and temperature is not None:
            raise ValueError(
                f"temperature is {temperature!r} beside a weighting; accepted: one of them"
            )
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
        self.control_period = (
            self.dt
            if control_period is None
            else _checks.scalar("control_period", control_period, above=0.0)
        )
        self.proposal = GaussianProposal(noise_std) if proposal is None else proposal
        self.parameterisation = Direct() if parameterisation is None else parameterisation
        if weighting is None:
            weighting = Softmax(0.1 if temperature is None else temperature)
        self.weighting = weighting
        self.smoothing = smoothing
        self.disturbance = disturbance
        self.risk = MeanVariance() if risk is None else risk
        self.interpolate_shift = interpolate_shift
        # Users' meshes may have axes of the explicit kind; here the compiler spreads what follows.
        self.mesh = None if mesh is None else Mesh(mesh.devices, mesh.axis_names)
        self._check_parts()

    def init(self, controls: Float[Array, "T nu"] | None = None) -> MPPIState:
        """Return the state before the first step, which begins with a shift.

        Args:
            controls: (T, nu) to start from; the model's default control when absent.
        """
        space = self._space
        if controls is None:
            controls = jnp.broadcast_to(space.default, (self.horizon, self.dynamics.control_size))
        history = 0 if self.smoothing is None else self.smoothing.history
        return MPPIState(
            nominal=self.parameterisation.init(controls, space),
            proposal=self.proposal.init(self._num_parameters, self.dynamics.control_size),
            applied=space.default,
            past=jnp.broadcast_to(space.default, (history, self.dynamics.control_size)),
            phase=jnp.zeros(()),
        )

    def at_period(self, control_period: ArrayLike) -> "MPPI":
        """Return this controller for commands that are `control_period` seconds apart."""
        period = _checks.scalar("control_period", control_period, above=0.0)
        same: MPPI = eqx.tree_at(lambda controller: controller.control_period, self, period)
        return same

    def resume(self, state: MPPIState, controls: Float[Array, "T0 nu"]) -> MPPIState:
        """Return the state that goes on from another controller's plan, of any horizon.

        Its controls are cut off, or continued with the default control. What a proposal has
        adapted to, and what a smoothing has looked back on, starts anew.

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
        return self.conclude(draft, self._costs(draft, observation, belief))

    def draft(
        self,
        state: MPPIState,
        *,
        key: Key,
        perturbations: Samples | None = None,
        shift: bool = True,
    ) -> "Draft":
        """Return the first half of a step: control sequences that are to be priced.

        For who prices them otherwise than by this controller's cost: `conclude` is the other half.

        Args:
            state: as of `step`.
            key: as of `step`.
            perturbations: as of `step`.
            shift: as of `step`.
        """
        state = self._shift(state) if shift else state
        sample_key, outcome_key = jax.random.split(key)
        around = Surroundings(self.parameterisation, state.nominal, self._space)
        samples = self.proposal.sample(
            state.proposal,
            around,
            self.num_samples,
            key=sample_key,
            perturbations=perturbations,
        )
        if self.mesh is not None:
            spread = _spec(None, None, self.mesh.axis_names)
            samples = jax.lax.with_sharding_constraint(  # type: ignore[no-untyped-call]
                samples, NamedSharding(self.mesh, spread)
            )
        controls, samples = self.parameterisation.decode(state.nominal, samples, around.space)
        # Without a cut the noise is drawn once for the rollouts and again for the mean.
        controls, samples = cut((controls, samples))

        outcomes = None
        if self.disturbance is not None:
            outcomes = Outcomes.draw(
                self.disturbance,
                self.risk,
                self.dynamics,
                self.horizon,
                self.num_outcomes,
                key=outcome_key,
            )
        return Draft(state, around, samples, controls, outcomes)

    def conclude(
        self, draft: "Draft", costs: Float[Array, " K"]
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
        mean = jnp.einsum("k,puk->pu", weights, samples)
        mean = mean + (1.0 - jnp.sum(weights)) * around.centre
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

    def step_with_gains(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> tuple[ControlVector, MPPIState, Info, Float[Array, "nu nx"]]:
        """Plan once, and say how the control would change with the observed state.

            K = du_0 / dx_0 = sum_k (du_0 / dJ_k) (dJ_k / dx_0)^T

        is the derivative of the whole step for the noise that was drawn: through the weighting, the
        parameterisation and the smoothing, exactly. For the softmax and controls sampled directly
        it is `-(1 / lambda) sum_k w_k eps_k (dJ_k/dx_0 - sum_j w_j dJ_j/dx_0)^T`. With it a
        controller follows its plan between plans, `u = u_0 + K (x - x_0)`: see `FeedbackMPPI`.

        Model and cost must be differentiable; rollouts whose derivative is not finite are left
        out.

        Source: Belvedere, Ziegltrum, Turrisi, Modugno, "Feedback-MPPI: Fast Sampling-Based MPC via
        Rollout Differentiation", 2025, eq. 17.

        Args:
            state: as of `step`.
            observation: (nx,).
            belief: as of `step`.
            key: as of `step`.
            perturbations: as of `step`.

        Returns:
            What `step` returns, and the gains (nu, nx).
        """
        plan = self.draft(state, key=key, perturbations=perturbations)
        samples = plan.samples.shape[-1]
        each = jnp.broadcast_to(observation[:, None], (observation.shape[0], samples))
        costs, pull_back = jax.vjp(lambda initial: self._costs(plan, initial, belief), each)
        (slopes,) = pull_back(jnp.ones_like(costs))
        usable = jnp.isfinite(costs) & jnp.all(jnp.isfinite(slopes), axis=0)
        slopes = jnp.where(usable, slopes, 0.0)
        sensitivity = jax.jacrev(lambda values: self.conclude(plan, values)[0])(costs)
        sensitivity = jnp.where(jnp.isfinite(sensitivity), sensitivity, 0.0)
        return *self.conclude(plan, costs), sensitivity @ slopes.T

    def inspect(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` would see, with trajectories and the cost of each term.

        Trajectories are those of the undisturbed model.

        Args:
            state: as given to `step`.
            observation: (nx,).
            belief: as of `step`.
            key: the same key samples the same parameters as `step`.
            num_trajectories: how many of the K samples are returned, spread over all of them.
        """
        plan = self.draft(state, key=key)
        costs = self._costs(plan, observation, belief)
        _, _, info = self.conclude(plan, costs)
        count = min(num_trajectories, self.num_samples)
        # A mixture orders its samples by component: the first few would be one of them only.
        chosen = np.linspace(0, self.num_samples - 1, count).round().astype(int)

        def follow(controls: Array) -> Any:
            return rollout(
                self.dynamics,
                self.cost,
                observation,
                controls,
                self.dt,
                belief,
                applied=plan.state.applied,
            )

        return SampledPlan(
            nominal=follow(info.controls),
            best=follow(plan.controls[:, :, jnp.argmin(info.costs)]),
            samples=jax.vmap(lambda controls: follow(controls).states, in_axes=-1)(
                plan.controls[:, :, chosen]
            ),
            weights=info.weights[chosen],
        )

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

    def _costs(
        self, plan: "Draft", initial: StateVector | Float[Array, "nx K"], belief: Any
    ) -> Float[Array, " K"]:
        everything = (self.dynamics, self.cost, self.dt, belief, plan.state.applied, plan.outcomes)
        arrays, static = eqx.partition(everything, eqx.is_array)

        def costs(start: Array, controls: Array, arrays: Any) -> Array:
            dynamics, cost, dt, knowledge, applied, outcomes = eqx.combine(arrays, static)
            return rollout_costs(
                dynamics, cost, start, controls, dt, knowledge, applied=applied, outcomes=outcomes
            )

        if self.mesh is None:
            return costs(initial, plan.controls, arrays)
        # Each device rolls out its own samples; nothing is exchanged before the weights.
        samples = self.mesh.axis_names
        over_devices = jax.shard_map(
            costs,
            mesh=self.mesh,
            in_specs=(
                _spec() if initial.ndim == 1 else _spec(None, samples),
                _spec(None, None, samples),
                _spec(),
            ),
            out_specs=_spec(samples),
            # The loop over time begins with the same state on all devices, which would not pass.
            check_vma=False,
        )
        total: Array = over_devices(initial, plan.controls, arrays)
        return total

    @property
    def _space(self) -> ControlSpace:
        model = self.dynamics
        return ControlSpace(
            model.control_min, model.control_max, model.default_control, self.dt, self.horizon
        )

    @property
    def _num_parameters(self) -> int:
        return self.parameterisation.num_parameters(self.horizon)

    def _check_parts(self) -> None:
        model, size = self.dynamics, self.dynamics.control_size
        for name in ("control_min", "control_max"):
            bound = getattr(model, name)
            if jnp.shape(bound) != (size,):
                raise ValueError(
                    f"{name} of {type(model).__name__} has shape {jnp.shape(bound)}; "
                    f"accepted: ({size},), one per name in control_names"
                )
        if not _checks.is_traced(model.control_min, model.control_max):
            low, high = np.asarray(model.control_min), np.asarray(model.control_max)
            if not (low <= high).all():
                raise ValueError(
                    f"control_min of {type(model).__name__} is {low.tolist()}; accepted: at most "
                    f"control_max, {high.tolist()}"
                )
        self.proposal.check(self._num_parameters, self.horizon, size, self.num_samples)
        if self.smoothing is not None:
            self.smoothing.check(self.horizon)
        if self.disturbance is not None:
            self.disturbance.check(model, self.num_outcomes)
        if self.mesh is not None and self.num_samples % self.mesh.size:
            raise ValueError(
                f"num_samples is {self.num_samples}; accepted: a multiple of the {self.mesh.size} "
                "devices of the mesh"
            )
        state, control, number = jnp.zeros(model.state_size), jnp.zeros(size), jnp.zeros(())
        reached = jax.eval_shape(
            lambda x, u, t, dt: model.step_at(x, u, t, dt), state, control, number, number
        )
        check_state(model, reached.shape)
        for _, term in self.cost.terms():
            # A cost that reads the belief fails here, whatever the error: it is checked in `step`.
            with contextlib.suppress(AttributeError, TypeError):
                check_costs(model, term, self.horizon, None)


def _spec(*axes: Any) -> Spec:
    return Spec(*axes)  # type: ignore[no-untyped-call]


class Draft(NamedTuple):
    """A step half done: what was sampled, before it is priced.

    Args:
        state: of the controller, moved on.
        around: what was sampled around.
        samples: (P, nu, K) parameters as they take effect.
        controls: (T, nu, K) the sequences that they are.
        outcomes: uncertain ones, if there is a disturbance.
    """

    state: MPPIState
    around: Surroundings
    samples: Samples
    controls: Float[Array, "T nu K"]
    outcomes: Outcomes | None
