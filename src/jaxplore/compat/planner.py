"""A planner without memory: a function of the state, the last solution and the temperature."""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.compat._inputs import Inputs, Structure, put_together, take_apart
from jaxplore.compat.batch import Batch, rollout_batch
from jaxplore.control.base import Info
from jaxplore.control.mppi import MPPI
from jaxplore.control.parameterisations import shifted
from jaxplore.control.weighting import Softmax


class PlannedControl(NamedTuple):
    """What a planner returns.

    Args:
        optimal: (T, nu) the weighted mean of the samples; its first row is to be applied.
        nominal: (T, nu) `optimal` one step later, the default control in its last row: around it
            the next step samples.
        info: about the step.
        batch: the rollouts, on request; without the disturbance, if there is one.
    """

    optimal: Float[Array, "T nu"]
    nominal: Float[Array, "T nu"]
    info: Info
    batch: Batch | None


# No equinox.Module, whose methods take a tenth of a millisecond to call, but a pytree like one.
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Planner:
    """MPPI as a pure function of what it is given, compiled once:

        planned = planner.step(
            temperature=50.0, nominal_input=nominal, initial_state=state, key=key
        )

    For loops of one's own that keep the nominal themselves. What remembers more than a nominal,
    such as a covariance that adapts, begins anew with each step: use the `MPPI` for that.

    Args:
        mppi: whose parts plan. Its weighting is a `Softmax`, whose temperature is an argument of
            each step.

    Raises:
        ValueError: a weighting without a temperature that could be given.
    """

    mppi: MPPI

    def __post_init__(self) -> None:
        # What is made of a planner within a transformation need not hold a controller.
        if isinstance(self.mppi, MPPI) and not isinstance(self.mppi.weighting, Softmax):
            raise ValueError(
                f"weighting is {type(self.mppi.weighting).__name__}; accepted: Softmax, whose "
                "temperature a step is given"
            )

    @property
    def initial_nominal(self) -> Float[Array, "T nu"]:
        """The default control at all times (T, nu)."""
        model = self.mppi.dynamics
        return jnp.broadcast_to(model.default_control, (self.mppi.horizon, model.control_size))

    def step(
        self,
        *,
        temperature: ArrayLike,
        nominal_input: Rows,
        initial_state: Vector,
        key: Key,
        belief: Any = None,
        applied: Vector | None = None,
        return_batch: bool = False,
    ) -> PlannedControl:
        """Plan once.

        Args:
            temperature: of the softmax [units of cost]; another one does not recompile.
            nominal_input: (T, nu) to sample around.
            initial_state: (nx,).
            key: randomness.
            belief: whatever the cost reads.
            applied: (nu,) the control given out last, for costs of changes; the default control
                when absent.
            return_batch: whether to return all rollouts, (T, nx, M); static.

        Raises:
            ValueError: a temperature that is not positive, a nominal or state of another shape.
        """
        horizon, num_controls, num_states = self._sizes
        nominal = _array("nominal_input", nominal_input, (horizon, num_controls))
        state = _array("initial_state", initial_state, (num_states,))
        before = None if applied is None else _array("applied", applied, (num_controls,))
        heat: Any = temperature
        if not _checks.is_traced(temperature):
            plain = (
                temperature if isinstance(temperature, (int, float)) else np.asarray(temperature)
            )
            # A NumPy number goes into a compiled call as it is; to make an array takes longer.
            heat = np.float32(_checks.number("temperature", plain, above=0.0))
        known, structure = take_apart(belief)
        planned: PlannedControl = _plan(
            self._inputs.arrays,
            heat,
            nominal,
            state,
            key,
            before,
            known,
            structures=(self._inputs.structure, structure),
            return_batch=return_batch,
        )
        return planned

    @functools.cached_property
    def _sizes(self) -> tuple[int, int, int]:
        """Of the horizon, the controls and the state."""
        model = self.mppi.dynamics
        return self.mppi.horizon, model.control_size, model.state_size

    @functools.cached_property
    def _inputs(self) -> Inputs:
        """The controller taken apart, once: that takes a tenth of a millisecond."""
        return take_apart(self.mppi)


def _array(name: str, value: Vector | Rows, shape: tuple[int, ...]) -> Any:
    """Return float32 of that shape; what is on a device stays there, what is not stays in NumPy."""
    array: Any = value
    if not isinstance(value, jax.Array):
        try:
            array = np.asarray(value, np.float32)
        except (TypeError, ValueError):
            raise ValueError(f"{name} is {value!r}; accepted: numbers, {shape}") from None
    elif value.dtype != jnp.float32:
        array = value.astype(jnp.float32)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; accepted: {shape}")
    return array


@functools.partial(jax.jit, static_argnames=("structures", "return_batch"))
def _plan(
    arrays: tuple[Array, ...],
    temperature: Scalar,
    nominal: Float[Array, "T nu"],
    initial: StateVector,
    key: Key,
    applied: ControlVector | None,
    known: tuple[Array, ...],
    *,
    structures: tuple[Structure, Structure],
    return_batch: bool,
) -> PlannedControl:
    mppi: MPPI = put_together(Inputs(arrays, structures[0]))
    belief = put_together(Inputs(known, structures[1]))
    mppi = eqx.tree_at(lambda parts: parts.weighting.temperature, mppi, temperature)
    before = mppi.dynamics.default_control if applied is None else applied
    memory = mppi.init(nominal)._replace(applied=before)
    sampled = mppi.sample(memory, key=key, shift=False)
    costs = mppi.evaluate(sampled, initial, belief)
    _, _, info = mppi.update(sampled, costs)
    batch = None
    if return_batch:
        everything = (mppi.dynamics, mppi.cost, initial, sampled.controls, mppi.dt, belief)
        batch = rollout_batch(*everything, applied=before)
    later = shifted(info.controls, jnp.ones(()), mppi.dynamics.default_control)
    return PlannedControl(info.controls, later, info, batch)
