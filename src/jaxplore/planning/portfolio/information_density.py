"""A fusion that selects the plan along which scans have the most information."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Scalar, StateVector
from jaxplore.belief.belief import part
from jaxplore.control.trajectory import rollout_states
from jaxplore.information.field import InformationField
from jaxplore.planning.portfolio.fusion import Candidates, Fused, Fusion, Situation, select_member


class InformationDensity(Fusion):
    """Selects the plan of greatest information density, for members that search different regions.

    The density of a plan is the mean over its steps of the information of a scan from the pose
    there [nat per beam]. Plans that collide more than the safest one are left out. The member of
    the last step keeps the plan until another density exceeds its own by `hysteresis`, so that the
    robot does not turn between two regions at every step.

    Source: the design notes for ground vehicles, "regional decomposition: select based on
    information density".

    Args:
        hysteresis: excess of another density that replaces the member, as a share of its own.

    Raises:
        ValueError: a negative hysteresis.
    """

    hysteresis: Scalar

    def __init__(self, hysteresis: ArrayLike = 0.2) -> None:
        self.hysteresis = _checks.scalar("hysteresis", hysteresis, at_least=0.0)

    def init(self) -> Any:
        """Return the initial memory: no member is selected."""
        return jnp.asarray(-1, jnp.int32)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Select the plan of greatest density."""
        densities = self.densities(candidates, situation)
        hazards = jnp.where(jnp.isnan(candidates.hazards), jnp.inf, candidates.hazards)
        is_choice = (hazards <= jnp.min(hazards)) & jnp.isfinite(densities)
        is_last = jnp.arange(densities.shape[0]) == memory
        kept = jnp.where(is_last, densities * (1.0 + self.hysteresis), densities)
        index = jnp.argmax(jnp.where(is_choice, kept, -jnp.inf)).astype(jnp.int32)
        return select_member(candidates, index), index

    def densities(self, candidates: Candidates, situation: Situation) -> Float[Array, " N"]:
        """Compute the information density of each plan (N,) [nat per beam].

        Args:
            candidates: plans of the members.
            situation: current state and belief of the robot, with the model step.

        Raises:
            ValueError: a situation without a model step, a belief without an information field.
        """
        state, dt = situation.state, situation.dt
        if dt is None:
            raise ValueError("dt of the situation is None; accepted: the model step of the plans")
        field: InformationField = part(situation.belief, "information")
        model = state.dynamics

        def information_at(values: StateVector) -> Scalar:
            return field(model.position(values), model.heading(values)) / field.num_beams

        def density(controls: Float[Array, "T nu"]) -> Scalar:
            return jnp.mean(
                jax.vmap(information_at)(rollout_states(model, state.values, controls, dt))
            )

        found: Array = jax.vmap(density)(candidates.controls)
        return found
