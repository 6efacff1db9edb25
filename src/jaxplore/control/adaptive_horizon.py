"""A horizon that each step chooses anew, by speed, clearance or information nearby."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Scalar, StateVector
from jaxplore.belief.belief import part
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.control.mppi import MPPI, MPPIState, SampledControls, evaluate_samples, roll_out_plan
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.information.field import InformationField


class HorizonRule(eqx.Module):
    """Chooses a horizon between the shortest and the longest by a quantity q; abstract.

        share = clip((q - at_shortest) / (at_longest - at_shortest), 0, 1)

    Either of the two numbers may be the larger one. A subclass writes `quantity`.

    Args:
        at_shortest: value of the quantity at which the horizon is the shortest.
        at_longest: value at which it is the longest.

    Raises:
        ValueError: a number that is not finite, equal numbers.
    """

    at_shortest: Scalar
    at_longest: Scalar

    def __init__(self, at_shortest: ArrayLike, at_longest: ArrayLike) -> None:
        self.at_shortest = _checks.scalar("at_shortest", at_shortest)
        self.at_longest = _checks.scalar("at_longest", at_longest)
        is_known = not _kinds.is_traced(self.at_shortest, self.at_longest)
        if is_known and float(self.at_shortest) == float(self.at_longest):
            raise ValueError(
                f"at_longest is {at_longest!r}; accepted: another number than at_shortest"
            )

    @abc.abstractmethod
    def quantity(self, state: State, belief: Any) -> Scalar:
        """Return the quantity that the horizon depends on.

        Args:
            state: the robot at the start of the plan.
            belief: what the robot knows of the world.
        """

    def share(self, state: State, belief: Any) -> Scalar:
        """Return where the horizon lies between the shortest, 0, and the longest, 1."""
        width = self.at_longest - self.at_shortest
        share = (self.quantity(state, belief) - self.at_shortest) / width
        # A robot that is nowhere, or a field that ends here, has the longest horizon.
        return jnp.where(jnp.isnan(share), 1.0, jnp.clip(share, 0.0, 1.0))


class HorizonBySpeed(HorizonRule):
    """A fast robot plans for a longer time, since it needs longer to stop [m/s]."""

    def __init__(self, at_shortest: ArrayLike = 0.0, at_longest: ArrayLike = 1.0) -> None:
        super().__init__(at_shortest, at_longest)

    def quantity(self, state: State, belief: Any) -> Scalar:
        """Return the magnitude of the forward speed [m/s]."""
        return jnp.abs(state.speed)


class HorizonByClearance(HorizonRule):
    """A robot among obstacles plans for a shorter time than one in the open [m]."""

    def __init__(self, at_shortest: ArrayLike = 0.3, at_longest: ArrayLike = 1.5) -> None:
        super().__init__(at_shortest, at_longest)

    def quantity(self, state: State, belief: Any) -> Scalar:
        """Return the distance to the nearest cell that is not known to be free [m]."""
        clearance: Scalar = part(belief, "clearance")(state.position)
        return clearance


class HorizonByInformation(HorizonRule):
    """A robot that sees much from where it is plans for a shorter time [nat/beam]."""

    def __init__(self, at_shortest: ArrayLike = 0.05, at_longest: ArrayLike = 0.0) -> None:
        super().__init__(at_shortest, at_longest)

    def quantity(self, state: State, belief: Any) -> Scalar:
        """Return the information of a scan from here [nat/beam]."""
        field: InformationField = part(belief, "information")
        information: Scalar = field(state.position, state.heading) / field.num_beams
        return information


class AdaptiveHorizon(Controller):
    """MPPI whose horizon H lies between two numbers of steps, chosen anew in each step:

        H = round(min_horizon + share (max_horizon - min_horizon))

    Only the first H steps are rolled out, and the terminal cost is that of the state after them.
    The sum of the stage costs is times T / H, so that the temperature means the same for every H.
    Parameters beyond H are not perturbed: the plan keeps what it had there. H is an array, so
    another horizon compiles nothing, and a short one takes less time. The plan has no derivative in
    reverse mode.

    Args:
        controller: MPPI; its own horizon T is the length of the plan.
        rule: rule by which the horizon is chosen.
        min_horizon: least number of steps.
        max_horizon: greatest number of steps; T when absent.

    Raises:
        ValueError: a controller that is not MPPI, a number below 1 or above T, a `min_horizon`
            above `max_horizon`.
    """

    controller: MPPI
    rule: HorizonRule
    min_horizon: Scalar
    max_horizon: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        controller: MPPI,
        rule: HorizonRule,
        min_horizon: int,
        max_horizon: int | None = None,
    ) -> None:
        self.controller, self.rule = controller, rule
        length = controller.horizon
        most = length if max_horizon is None else max_horizon
        longest = _checks.whole_number("max_horizon", most, at_least=1)
        if longest > length:
            raise ValueError(
                f"max_horizon is {longest}; accepted: at most the horizon of the controller, "
                f"{length}"
            )
        shortest = _checks.whole_number("min_horizon", min_horizon, at_least=1)
        if shortest > longest:
            raise ValueError(f"min_horizon is {shortest}; accepted: at most max_horizon, {longest}")
        self.min_horizon = jnp.asarray(shortest, jnp.float32)
        self.max_horizon = jnp.asarray(longest, jnp.float32)

    @property
    def dynamics(self) -> Dynamics:
        """Model of the robot."""
        return self.controller.dynamics

    @property
    def control_period(self) -> Scalar:
        """Time between commands [s]."""
        return self.controller.control_period

    def init(self) -> MPPIState:
        """Return the initial state, that of the inner controller."""
        return self.controller.init()

    def at_period(self, control_period: ArrayLike) -> "AdaptiveHorizon":
        """Return a copy of this controller that is called every `control_period` seconds."""
        inner = self.controller.at_period(control_period)
        same: AdaptiveHorizon = eqx.tree_at(lambda each: each.controller, self, inner)
        return same

    def steps(self, observation: StateVector, belief: Any = None) -> Count:
        """Return the number of steps H of a plan that begins at an observation (nx,)."""
        share = self.rule.share(State(observation, self.dynamics), belief)
        chosen = self.min_horizon + share * (self.max_horizon - self.min_horizon)
        return jnp.round(chosen).astype(jnp.int32)

    def step(
        self, state: MPPIState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, MPPIState, Info]:
        """Choose a horizon, and plan within it."""
        sampled, costs, _ = self._sample_within_horizon(state, observation, belief, key)
        return self.controller.update(sampled, costs)

    def inspect(
        self,
        state: MPPIState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories that `step` samples, in their whole length T."""
        wanted = _checks.whole_number("num_trajectories", num_trajectories, at_least=0)
        sampled, costs, observation = self._sample_within_horizon(state, observation, belief, key)
        _, _, info = self.controller.update(sampled, costs)
        inner = self.controller
        parts, known = (inner.dynamics, inner.cost), (inner.dt, belief)
        return roll_out_plan(*parts, sampled, info, observation, *known, wanted)

    def _sample_within_horizon(
        self, state: MPPIState, observation: StateVector, belief: Any, key: Key
    ) -> tuple[SampledControls, Float[Array, " K"], StateVector]:
        """Return the samples within the horizon, their costs, and the checked observation."""
        observation = check_call(self.dynamics, state, MPPIState, observation, key)
        inner, steps = self.controller, self.steps(observation, belief)
        sampled = inner.sample(state, key=key)
        context, rows = sampled.context, sampled.samples.shape[0]
        # Knots are fewer than steps, and the one after the end still shapes the steps before it.
        more = 0 if rows == inner.horizon else 1
        is_within = jnp.arange(rows) * inner.horizon < (steps + more * inner.horizon // rows) * rows
        centre = context.centre[..., None]
        samples = jnp.where(is_within[:, None, None], sampled.samples, centre)
        controls, samples = inner.parameterisation.decode(context.nominal, samples, context.space)
        sampled = sampled._replace(samples=samples, controls=controls)
        costs = evaluate_samples(
            inner.dynamics,
            inner.cost,
            sampled,
            observation,
            inner.dt,
            belief,
            inner.mesh,
            steps,
        )
        return sampled, costs, observation
