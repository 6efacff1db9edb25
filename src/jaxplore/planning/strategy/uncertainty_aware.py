"""A controller whose rollouts know how uncertain the robot's position is and will be."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._types import ArrayLike, ControlVector, Key, StateVector
from jaxplore.belief.belief import Belief, part
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.mppi import MPPI
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.uncertain import UncertainRobot


class UncertaintyAware(Controller):
    """Plans with an `UncertainRobot` by the position's variance that the belief holds.

    Args:
        controller: MPPI of an `UncertainRobot`.

    Raises:
        ValueError: something else than MPPI of an `UncertainRobot`.
    """

    controller: MPPI

    @_kinds.check_arguments
    def __init__(self, controller: MPPI) -> None:
        _kinds.instance("dynamics of controller", controller.dynamics, UncertainRobot)
        self.controller = controller

    @property
    def dynamics(self) -> Dynamics:
        """Model of the robot, without the variance."""
        assert isinstance(self.controller.dynamics, UncertainRobot)
        return self.controller.dynamics.physical

    def init(self) -> Any:
        """Return the initial state."""
        return self.controller.init()

    def step(
        self, state: Any, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, Any, Info]:
        """Compute one control."""
        controller, observed = self._with_certainty(observation, belief)
        return controller.step(state, observed, belief, key=key)

    def inspect(
        self,
        state: Any,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories and costs that `step` computes for the same arguments."""
        controller, observed = self._with_certainty(observation, belief)
        return controller.inspect(
            state, observed, belief, key=key, num_trajectories=num_trajectories
        )

    def at_period(self, control_period: ArrayLike) -> "UncertaintyAware":
        """Return a copy of this controller that is called every `control_period` seconds."""
        return UncertaintyAware(self.controller.at_period(control_period))

    def _with_certainty(
        self, observation: StateVector, belief: Belief
    ) -> tuple[MPPI, Float[Array, " n"]]:
        """Return the controller with the belief's certainty, and the state with the variance."""
        controller: MPPI = eqx.tree_at(
            lambda each: each.dynamics.virtual.certainty, self.controller, part(belief, "certainty")
        )
        return controller, jnp.append(observation, part(belief, "position_variance"))
