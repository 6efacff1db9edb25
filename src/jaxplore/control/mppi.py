"""Model predictive path integral control (MPPI), a step from top to bottom.

A step samples control sequences around the last solution, evaluates the costs of their rollouts, on
one device or on several, and updates the solution by their weighted mean.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_OUTCOMES, MOST_SAMPLES, MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Scalar, StateVector, Vector
from jaxplore._xla import cut
from jaxplore.control.base import Info, ModelBasedController, SampledPlan
from jaxplore.control.disturbance import Disturbance
from jaxplore.control.model_checks import check_call, check_parts, without_belief
from jaxplore.control.parameterisations import (
    ControlSpace,
    Direct,
    Parameterisation,
    Samples,
    Sequence,
    shift_sequence,
)
from jaxplore.control.proposals import GaussianProposal, Proposal, SamplingContext
from jaxplore.control.risk import MeanVariance, Risk
from jaxplore.control.rollout import Outcomes, rollout_costs
from jaxplore.control.trajectory import Trajectory, rollout
from jaxplore.control.weighting import Softmax, Weighting, effective_sample_size
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class SavitzkyGolay(eqx.Module):
    """Savitzky-Golay filter: the middle of a polynomial fitted to a window around each control.

    The window reaches back over applied controls, so that the first planned control has a full
    window and continues the applied ones smoothly. Only the applied controls are smoothed, not the
    nominal of the next step: otherwise smoothing would accumulate over the steps. All sizes are
    static.

    Source: Savitzky and Golay, Analytical Chemistry 1964; used by nav2's MPPI controller.

    Args:
        window: number of controls in a window, odd.
        order: order of the polynomial, below the window.

    Raises:
        ValueError: an even window, an order that is not below the window.
    """

    window: int = eqx.field(static=True)
    order: int = eqx.field(static=True)

    def __init__(self, window: int = 9, order: int = 2) -> None:
        self.window = _checks.positive_int("window", window)
        self.order = _checks.whole_number("order", order, at_least=0)
        if self.window % 2 == 0:
            raise ValueError(f"window is {window}; accepted: an odd number of controls")
        if self.order >= self.window:
            raise ValueError(f"order is {order}; accepted: less than the window, {window}")

    @property
    def history(self) -> int:
        """Number of applied controls that the window reaches back."""
        return self.window // 2

    def check(self, horizon: int) -> None:
        """Raise a `ValueError` if the window is longer than the applied and planned controls."""
        if self.window > horizon + self.history:
            raise ValueError(
                f"window is {self.window}; accepted: at most {2 * horizon - 1} for a horizon of "
                f"{horizon}"
            )

    def smooth(self, past: Float[Array, "H nu"], planned: Sequence) -> Sequence:
        """Return the smoothed planned controls (T, nu).

        Args:
            past: applied controls (H, nu), oldest first.
            planned: planned controls (T, nu).
        """
        import scipy.signal  # slow to import, and few need it

        # The filter is linear: filter the identity at compile time, then multiply by the matrix.
        length = past.shape[0] + planned.shape[0]
        unit = scipy.signal.savgol_filter(np.eye(length), self.window, self.order, axis=0)
        matrix = jnp.asarray(unit[past.shape[0] :], jnp.float32)
        return matrix @ jnp.concatenate([past, planned])


class MPPIState(NamedTuple):
    """State of MPPI between steps.

    Args:
        nominal: last solution, as the parameterisation stores it; with `Direct` it is the control
            sequence (T, nu) itself.
        proposal: memory of the proposal; empty unless the proposal adapts.
        applied: (nu,) control of the last step.
        past: (H, nu) controls applied before that one, one per model step, newest last. H is the
            number of past controls that the smoothing filter reads.
        phase: fraction of a model step by which the nominal lags behind, if shifts are not
            interpolated.
    """

    nominal: Any
    proposal: Any
    applied: ControlVector
    past: Float[Array, "H nu"]
    phase: Scalar


class SampledControls(NamedTuple):
    """Control sequences that were sampled and have not been evaluated yet.

    Args:
        state: state of the controller after the shift.
        context: nominal and parameterisation that the proposal sampled around.
        samples: (P, nu, K) parameters as they took effect, that is after clipping.
        controls: (T, nu, K) control sequences of these parameters.
        outcomes: draws of the disturbance; None without one.
    """

    state: MPPIState
    context: SamplingContext
    samples: Samples
    controls: Float[Array, "T nu K"]
    outcomes: Outcomes | None


def shift_state(
    state: MPPIState,
    steps: Scalar,
    space: ControlSpace,
    parameterisation: Parameterisation,
    proposal: Proposal,
    *,
    is_interpolated: bool,
) -> MPPIState:
    """Move the nominal and the memories on by a number of model steps, not necessarily whole.

    With `is_interpolated` a part of a model step interpolates the nominal. Without it, the nominal
    is shifted by whole model steps when they are due.
    """
    phase = state.phase
    if not is_interpolated:
        # In float32, 20 periods of 0.05 s add up to slightly less than a step of 1 s.
        due = phase + steps
        steps = jnp.floor(due + 1e-3)
        phase = due - steps
    # Proposals adapt per row of parameters, of which there may be fewer than model steps.
    rows = steps * (parameterisation.num_parameters(space.horizon) / space.horizon)
    planned = parameterisation.controls(state.nominal, space)
    # The first planned control has been applied; where it differs (a portfolio applies the fused
    # control), the smoothing filter must see what was applied.
    timeline = jnp.concatenate([state.past, state.applied[None], planned[1:]])
    return MPPIState(
        nominal=parameterisation.shift(state.nominal, steps, space),
        proposal=proposal.shift(state.proposal, rows),
        applied=state.applied,
        past=shift_sequence(timeline, steps, space.default)[: state.past.shape[0]],
        phase=phase,
    )


def auto_mesh(mesh: Mesh) -> Mesh:
    """Return a mesh of the same devices whose axes the compiler may shard automatically.

    The axes of a user's mesh may be of the explicit kind.
    """
    return Mesh(mesh.devices, mesh.axis_names)


def shard_samples(samples: Samples, mesh: Mesh) -> Samples:
    """Return the samples, sharded over the devices along their last axis."""
    sharding = NamedSharding(mesh, _spec(None, None, mesh.axis_names))
    shared: Samples = jax.lax.with_sharding_constraint(  # type: ignore[no-untyped-call]
        samples, sharding
    )
    return shared


def map_over_devices(
    costs: Callable[[Array, Array, Any], Array],
    mesh: Mesh,
    initial: Float[Array, "*nx_K"],
    controls: Float[Array, "T nu K"],
    arrays: Any,
) -> Float[Array, " K"]:
    """Evaluate the costs of samples, each on the device that holds it.

    The devices exchange nothing until the weights are computed. The initial state is (nx,) of all
    samples, or (nx, K) of each. The pytree `arrays`, the third argument of `costs`, is replicated
    on all devices.
    """
    samples = mesh.axis_names
    over_devices = jax.shard_map(
        costs,
        mesh=mesh,
        in_specs=(
            _spec() if initial.ndim == 1 else _spec(None, samples),
            _spec(None, None, samples),
            _spec(),
        ),
        out_specs=_spec(samples),
        # The loop over time starts with a state that is equal on all devices and then varies, which
        # the check would refuse.
        check_vma=False,
    )
    total: Array = over_devices(initial, controls, arrays)
    return total


def check_divisible(num_samples: int, mesh: Mesh) -> None:
    """Raise a `ValueError` if the samples cannot be divided evenly among the devices."""
    if num_samples % mesh.size:
        raise ValueError(
            f"num_samples is {num_samples}; accepted: a multiple of the {mesh.size} "
            "devices of the mesh"
        )


def _spec(*axes: Any) -> Spec:
    return Spec(*axes)  # type: ignore[no-untyped-call]


def evaluate_samples(
    dynamics: Dynamics,
    cost: Cost,
    sampled: SampledControls,
    initial: StateVector | Float[Array, "nx K"],
    dt: Scalar,
    belief: Any,
    mesh: Mesh | None,
    steps: Count | None = None,
) -> Float[Array, " K"]:
    """Roll out sampled control sequences and return their costs, from one state (nx,) or from one
    each, (nx, K). `mesh` are the devices that share the samples; None for one device. `steps` of
    the rollouts are simulated, see `rollout_costs`; all when None."""
    everything = (dynamics, cost, dt, belief, sampled.state.applied, sampled.outcomes, steps)
    # `shard_map` takes arrays only: everything else is closed over.
    arrays, static = eqx.partition(everything, eqx.is_array)

    def costs(start: Array, controls: Array, arrays: Any) -> Array:
        model, terms, step, knowledge, applied, outcomes, number = eqx.combine(arrays, static)
        return rollout_costs(
            model,
            terms,
            start,
            controls,
            step,
            knowledge,
            applied=applied,
            outcomes=outcomes,
            steps=number,
        )

    try:
        if mesh is None:
            return costs(initial, sampled.controls, arrays)
        return map_over_devices(costs, mesh, initial, sampled.controls, arrays)
    except (AttributeError, TypeError) as error:
        # A cost that a user wrote asks None for what it knows.
        name = without_belief(dynamics, cost, sampled.controls.shape[0])
        if belief is not None or name is None or "NoneType" not in str(error):
            raise
        raise ValueError(
            f"belief is None, and {name} reads it ({error}); accepted: step(state, "
            "observation, belief, key=key)"
        ) from error


def roll_out_plan(
    dynamics: Dynamics,
    cost: Cost,
    sampled: SampledControls,
    info: Info,
    observation: StateVector,
    dt: Scalar,
    belief: Any,
    num_trajectories: int,
) -> SampledPlan:
    """Roll out the plan of a step, its best sample and some of the others, undisturbed.

    All start at `observation` (nx,), with the model step `dt` [s]. The others are at most
    `num_trajectories` samples.
    """
    chosen = choose_samples(sampled.controls.shape[-1], num_trajectories)

    def simulate(controls: Array) -> Trajectory:
        return rollout(
            dynamics, cost, observation, controls, dt, belief, applied=sampled.state.applied
        )

    sequences = jnp.moveaxis(sampled.controls, -1, 0)
    best = sequences[jnp.argmin(info.costs)]
    shown = jnp.concatenate([info.controls[None], best[None], sequences[chosen]])
    return SampledPlan.from_trajectories(jax.vmap(simulate)(shown), info.weights[chosen])


def choose_samples(num_samples: int, most: int) -> np.ndarray:
    """Return the numbers of the samples that are shown, at most `most`, at even distances.

    A mixture orders its samples by component, so the first few would show one component only.
    """
    return np.linspace(0, num_samples - 1, min(most, num_samples)).round().astype(int)


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
        self.mesh = None if mesh is None else auto_mesh(mesh)
        num_controls = dynamics.control_size
        self.proposal.check(self._num_parameters, self.horizon, num_controls, self.num_samples)
        if smoothing is not None:
            smoothing.check(self.horizon)
        if disturbance is not None:
            disturbance.check(dynamics, self.num_outcomes)
        if mesh is not None:
            check_divisible(self.num_samples, mesh)
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
            samples = shard_samples(samples, self.mesh)
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
