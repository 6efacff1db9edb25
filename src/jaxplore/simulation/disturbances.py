"""What a simulated robot differs by from its model, and what fails: one pair around each task."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.simulation.faults import Faults
from jaxplore.simulation.variation import Drawn, Variation


class Disturbances(NamedTuple):
    """What fails, and the distribution of the true robot over episodes; either may be absent."""

    faults: Faults | None
    variation: Variation | None

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands of any episode [control periods]."""
        faults, variation = self
        delay = 0 if faults is None else faults.control_delay
        return delay + (0 if variation is None else variation.control_delay[1])

    def draw(self, key: Key | None, model: Dynamics) -> Drawn | None:
        """Return the variation of the episode of a key; None if the robot does not vary."""
        return None if self.variation is None else self.variation.draw(key, model)

    def observe(
        self,
        model: Dynamics,
        truth: StateVector,
        last: StateVector,
        drawn: Drawn | None,
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> tuple[StateVector, Flag, Flag]:
        """Return the measured state (nx,), whether there is no scan, and whether a fault is active.

        `truth` (nx,) is what the base would measure without errors at a time since the start [s].
        `last` (nx,) is what was measured before. `key` is that of the step.
        """
        if self.variation is not None and drawn is not None:
            truth = self.variation.observe(model, truth, drawn, key)
        if self.faults is None:
            return truth, jnp.array(False), jnp.array(False)
        observed = self.faults.observe(truth, last, time, period)
        return observed, self.faults.is_blind(time), self.faults.is_active(time)

    def delay(
        self, pending: Float[Array, "D nu"], control: ControlVector, drawn: Drawn | None
    ) -> tuple[Float[Array, "D nu"], ControlVector]:
        """Return the pending commands (D, nu), oldest first, and the one that takes effect."""
        if self.variation is not None and drawn is not None:
            return self.variation.delay(pending, control, drawn)
        if self.faults is not None:
            return self.faults.delay(pending, control)
        return pending, control

    def true_robot(self, model: Dynamics, drawn: Drawn | None, key: Key, step: Count) -> Dynamics:
        """Return the robot that moves in a step of an episode; `key` is that of the run."""
        if self.variation is None or drawn is None:
            return model
        return self.variation.robot(model, drawn, jax.random.fold_in(key, step))
