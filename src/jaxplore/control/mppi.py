"""Model predictive path integral control."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_OUTCOMES, MOST_SAMPLES, MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, ControlVector, Key, Scalar, StateVector, Vector
from jaxplore._xla import cut
from jaxplore.control import devices
from jaxplore.control.base import Info, ModelBasedController, SampledPlan
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.evaluation import evaluate_samples
from jaxplore.control.inspection import roll_out_plan
from jaxplore.control.model_checks import check_call, check_parts
from jaxplore.control.mppi_state import MPPIState, SampledControls, shift_state
from jaxplore.control.parameterisations import ControlSpace, Direct, Parameterisation, Samples
from jaxplore.control.proposals import GaussianProposal, Proposal, SamplingContext
from jaxplore.control.risk import MeanVariance, Risk
from jaxplore.control.rollout import Outcomes
from jaxplore.control.smoothing import SavitzkyGolay
from jaxplore.control.weighting import Softmax, Weighting, effective_sample_size
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class MPPI(ModelBasedController):
    """Model predictive path integral control.

    Minimises over control sequences U the expected cost

        x_{t+1} = step(x_t, u_t, dt),   J = sum_t stage(x_{t+1}, u_t) + terminal(x_T) + sequence(U)

    by sampling parameters v around those of the last solution and averaging them,

        v <- sum_k w_k v_k,   w = weighting(J, log q - log p)

    with q the density that samples are drawn from and p that of the uncontrolled system.

    A step has three parts. `sample` shifts the last solution by the control period and draws
    control sequences. `evaluate` rolls them out. `update` computes the weights and the new
    solution. Controls are clipped before they are rolled out, and the clipped samples are averaged,
    so the bounds do not bias the mean.

    A variant of MPPI is a choice of three parts, in any combination:

    - proposal: `GaussianProposal`, `BiasedProposal`, `InjectedProposal`, over sources of noise
    - parameterisation: `Direct`, `Smooth` (SMPPI), `Knots` (kernel and spline MPPI)
    - weighting: `Softmax`, `AdaptiveSoftmax`, `Elite` (CEM)

    Source: Williams, Wagener, Goldfain, Drews, Rehg, Boots, Theodorou, "Information theoretic MPC
    for model-based reinforcement learning", ICRA 2017, Algorithm 2.

    Args:
        dynamics: model of the robot.
        cost: cost to minimise.
        horizon: number of model steps in a plan, T.
        num_samples: number of rollouts, K.
        temperature: temperature of the softmax, in units of cost; or give `weighting`.
        noise_std: (nu,) standard deviation of the Gaussian noise; or give `proposal`.
        dt: model step [s].
        control_period: time between commands [s]; one model step when absent.
        proposal: distribution that parameters are sampled from.
        parameterisation: map from parameters to controls; `Direct` when absent, which samples the
            controls themselves.
        weighting: map from costs to weights.
        smoothing: filter applied to the returned controls; none when absent.
        disturbance: distribution of what is uncertain in a rollout; none when absent.
        num_outcomes: number of outcomes of each control sequence, M, if there is a disturbance.
        risk: risk measure that makes one cost of the M outcomes; their mean when absent.
        interpolate_shift: whether a control period shorter than a model step interpolates the last
            solution. If false, the solution is shifted by whole model steps when they are due.
        mesh: devices that share the samples equally; one device when absent.

    Raises:
        ValueError: a part of another class; a horizon or a number of samples below 1; a step,
            period or temperature that is not positive; parts or bounds that do not fit the model;
            both or neither of two alternatives; a model or cost that returns the wrong shape.
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

    @_kinds.check_arguments
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
        self.horizon = _checks.positive_int("horizon", horizon, at_most=MOST_STEPS_AHEAD)
        self.num_samples = _checks.positive_int("num_samples", num_samples, at_most=MOST_SAMPLES)
        self.num_outcomes = _checks.positive_int(
            "num_outcomes", num_outcomes, at_most=MOST_OUTCOMES
        )
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
        self.interpolate_shift = _kinds.flag("interpolate_shift", interpolate_shift)
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
        """Return the initial state. The first step begins with a shift, like every other.

        Args:
            controls: (T, nu) first nominal; the model's default control throughout when absent.

        Raises:
            ValueError: controls of another shape.
        """
        space, size = self._space, self.dynamics.control_size
        if controls is None:
            controls = jnp.broadcast_to(space.default, (self.horizon, size))
        accepted = f"({self.horizon}, {size}), a control for each step of the horizon"
        controls = _checks.of_shape("controls", controls, (self.horizon, size), accepted=accepted)
        history = 0 if self.smoothing is None else self.smoothing.history
        return MPPIState(
            nominal=self.parameterisation.init(controls, space),
            proposal=self.proposal.init(self._num_parameters, size),
            applied=space.default,
            past=jnp.broadcast_to(space.default, (history, size)),
            phase=jnp.zeros(()),
        )

    def at_period(self, control_period: ArrayLike) -> "MPPI":
        """Return a copy of this controller that is called every `control_period` seconds."""
        period = _checks.scalar("control_period", control_period, above=0.0)
        same: MPPI = eqx.tree_at(lambda controller: controller.control_period, self, period)
        return same

    def resume(self, state: MPPIState, controls: Float[Array, "T0 nu"]) -> MPPIState:
        """Return a state that continues the plan of another MPPI controller, of any horizon.

        The plan is cut to this horizon, or extended with the default control. The adapted spread of
        the proposal and the history of the smoothing filter start anew.

        Args:
            state: last state of the other controller.
            controls: (T0, nu) its last plan, `Info.controls`.
        """
        # Built from a fresh state: the nominal and the adapted spread of another horizon have
        # another shape.
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
        """Sample control sequences, evaluate them, and update the nominal.

        Args:
            state: state from `init` or the last step.
            observation: (nx,) observed state of the robot.
            belief: what the robot knows of the world; whatever the cost reads.
            key: random key of this step.
            perturbations: (P, nu, K) perturbations to use instead of the proposal's noise.
            shift: whether to shift the last solution by the control period first. Without a shift,
                the step refines the plan for the same moment.

        Returns:
            The control (nu,), the new state, and `Info`.

        Raises:
            ValueError: as of `Controller.step`.
        """
        observation = check_call(self.dynamics, state, MPPIState, observation, key)
        sampled = self.sample(state, key=key, perturbations=perturbations, shift=shift)
        return self.update(sampled, self.evaluate(sampled, observation, belief))

    def sample(
        self,
        state: MPPIState,
        *,
        key: Key,
        perturbations: Samples | None = None,
        shift: bool = True,
    ) -> SampledControls:
        """Shift the last solution and sample control sequences around it.

        `evaluate` and `update` complete the step. A controller that computes costs in another way,
        as `Portfolio` does, calls `update` with its own costs.

        Args:
            state: as of `step`.
            key: as of `step`.
            perturbations: as of `step`.
            shift: as of `step`.
        """
        state = self._shift(state) if shift else state
        # Always split, so that adding a disturbance does not change the samples.
        sample_key, outcome_key = jax.random.split(key)
        context = SamplingContext(self.parameterisation, state.nominal, self._space)
        samples = self.proposal.sample(
            state.proposal,
            context,
            self.num_samples,
            key=sample_key,
            perturbations=perturbations,
        )
        if self.mesh is not None:
            # Sharded before decoding, so that each device decodes the samples that it rolls out.
            samples = devices.shard_samples(samples, self.mesh)
        controls, samples = self.parameterisation.decode(state.nominal, samples, context.space)
        # The samples are used by the rollouts and by the mean. Unless they are materialised here,
        # XLA fuses the noise generator into both and draws it twice.
        controls, samples = cut((controls, samples))

        outcomes = None
        if self.disturbance is not None:
            kind, sizes = (self.disturbance, self.risk), (self.horizon, self.num_outcomes)
            outcomes = Outcomes.draw(*kind, self.dynamics, *sizes, key=outcome_key)
        return SampledControls(state, context, samples, controls, outcomes)

    def evaluate(
        self,
        sampled: SampledControls,
        initial: StateVector | Float[Array, "nx K"],
        belief: Any = None,
    ) -> Float[Array, " K"]:
        """Roll out sampled control sequences and return their costs (K,).

        Args:
            sampled: control sequences from `sample`.
            initial: (nx,) state that all rollouts start from, or (nx, K) one for each.
            belief: as of `step`.
        """
        return evaluate_samples(
            self.dynamics, self.cost, sampled, initial, self.dt, belief, self.mesh
        )

    def update(
        self, sampled: SampledControls, costs: Float[Array, " K"]
    ) -> tuple[ControlVector, MPPIState, Info]:
        """Compute importance weights and update the nominal control sequence.

            v <- sum_k w_k v_k,   w = weighting(J, log q - log p)

        Args:
            sampled: control sequences from `sample`.
            costs: (K,) cost of each sequence. Sequences whose cost is not finite get no weight.

        Returns:
            The control (nu,), the new state, and `Info`.
        """
        state, context, samples = sampled.state, sampled.context, sampled.samples
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        log_ratio = self.proposal.log_ratio(state.proposal, context, samples)
        weights = self.weighting.weights(costs, log_ratio)
        # If no rollout is finite, all weights are 0 and the shifted nominal is kept.
        kept = (1.0 - jnp.sum(weights)) * context.centre
        mean = jnp.einsum("k,puk->pu", weights, samples) + kept
        nominal = self.parameterisation.update(state.nominal, mean, context.space)
        controls = self.parameterisation.controls(nominal, context.space)
        if self.smoothing is not None:
            # A fitted polynomial may exceed the bounds that the controls keep.
            controls = context.space.clip(self.smoothing.smooth(state.past, controls))
        memory = self.proposal.adapt(state.proposal, context, weights, samples)
        info = Info(
            controls=controls,
            weights=weights,
            costs=costs,
            effective_sample_size=effective_sample_size(weights),
            is_finite=jnp.any(jnp.isfinite(costs)),
            log_ratio=log_ratio,
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
        """Return the trajectories that `step` samples, undisturbed, and the cost of each term.

        Args:
            state: as of `step`.
            observation: as of `step`.
            belief: as of `step`.
            key: as of `step`; the same key gives the same samples.
            num_trajectories: number of the K samples to return, taken at even distances.
        """
        observation = check_call(self.dynamics, state, MPPIState, observation, key)
        wanted = _checks.whole_number("num_trajectories", num_trajectories, at_least=0)
        sampled = self.sample(state, key=key)
        costs = self.evaluate(sampled, observation, belief)
        _, _, info = self.update(sampled, costs)
        parts, known = (self.dynamics, self.cost), (self.dt, belief)
        return roll_out_plan(*parts, sampled, info, observation, *known, wanted)

    def _shift(self, state: MPPIState) -> MPPIState:
        """Move the nominal and the memory on by one control period."""
        return shift_state(
            state,
            self.control_period / self.dt,
            self._space,
            self.parameterisation,
            self.proposal,
            is_interpolated=self.interpolate_shift,
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
