"""MPPI as a pure function of the state, the nominal sequence and the temperature."""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.compat._inputs import Inputs, Structure, join_arrays, split_arrays
from jaxplore.compat.batch import RolloutBatch, rollout_batch
from jaxplore.control.base import Info
from jaxplore.control.mppi import MPPI
from jaxplore.control.parameterisations import shifted
from jaxplore.control.weighting import Softmax


class PlannedControl(NamedTuple):
    """Result of a planning step.

    Args:
        optimal: optimised control sequence (T, nu), the weighted mean of the samples; apply its
            first row.
        nominal: nominal control sequence (T, nu) of the next step: `optimal` shifted by one step,
            with the default control in the last row.
        info: diagnostics of the step.
        batch: rollouts if they were requested, without the disturbance of the controller.
    """

    optimal: Float[Array, "T nu"]
    nominal: Float[Array, "T nu"]
    info: Info
    batch: RolloutBatch | None


# A registered dataclass is a pytree like an equinox.Module, whose method calls, however, take a
# tenth of a millisecond each.
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Planner:
    """MPPI as a pure function of its arguments, compiled once:

        planned = planner.step(
            temperature=50.0, nominal_input=nominal, initial_state=state, key=key
        )

    It is meant for control loops that keep the nominal sequence themselves. Parts with more memory
    than a nominal, such as an adaptive covariance, start anew in each step: use `MPPI` for them.

    Args:
        mppi: controller whose parts are used. Its weighting must be a `Softmax`, because the
            temperature is an argument of each step.

    Raises:
        ValueError: a weighting other than `Softmax`.
    """

    mppi: MPPI

    def __post_init__(self) -> None:
        # JAX transformations rebuild the planner with placeholders instead of a controller.
        if isinstance(self.mppi, MPPI) and not isinstance(self.mppi.weighting, Softmax):
            raise ValueError(
                f"weighting is {type(self.mppi.weighting).__name__}; accepted: Softmax, whose "
                "temperature a step is given"
            )

    @property
    def initial_nominal(self) -> Float[Array, "T nu"]:
        """Nominal control sequence (T, nu) for the first step: the default control."""
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
        """Optimise the nominal control sequence by one MPPI step.

        Args:
            temperature: temperature of the softmax [units of cost]; changing it does not recompile.
            nominal_input: nominal control sequence (T, nu) around which the step samples.
            initial_state: present state (nx,).
            key: random key.
            belief: belief of the robot, which is passed to the cost.
            applied: control (nu,) that was applied last, for costs of control changes; the default
                control if None.
            return_batch: whether to return all rollouts (T, nx, M); static.

        Raises:
            ValueError: a temperature that is not positive, a nominal or state of another shape.
        """
        horizon, num_controls, num_states = self._sizes
        nominal = _array("nominal_input", nominal_input, (horizon, num_controls))
        state = _array("initial_state", initial_state, (num_states,))
        before = None if applied is None else _array("applied", applied, (num_controls,))
        heat: Any = temperature
        if not _kinds.is_traced(temperature):
            plain = (
                temperature if isinstance(temperature, (int, float)) else np.asarray(temperature)
            )
            # Pass a NumPy number: converting it to a JAX array first would take longer.
            heat = np.float32(_checks.number("temperature", plain, above=0.0))
        known, structure = split_arrays(belief)
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
        """Sizes of the horizon, the control and the state."""
        model = self.mppi.dynamics
        return self.mppi.horizon, model.control_size, model.state_size

    @functools.cached_property
    def _inputs(self) -> Inputs:
        """Arrays and structure of the controller, cached: to split it takes a tenth of a ms."""
        return split_arrays(self.mppi)


def _array(name: str, value: Vector | Rows, shape: tuple[int, ...]) -> Any:
    """Return `value` as a float32 array of a shape; JAX arrays stay on their device, others become
    NumPy arrays."""
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
    mppi: MPPI = join_arrays(Inputs(arrays, structures[0]))
    belief = join_arrays(Inputs(known, structures[1]))
    mppi = eqx.tree_at(lambda parts: parts.weighting.temperature, mppi, temperature)
    before = mppi.dynamics.default_control if applied is None else applied
    memory = mppi.init(nominal)._replace(applied=before)
    # The caller's nominal is already that of this step: `PlannedControl.nominal` is shifted below.
    sampled = mppi.sample(memory, key=key, shift=False)
    costs = mppi.evaluate(sampled, initial, belief)
    _, _, info = mppi.update(sampled, costs)
    # Rollouts are recomputed with all states, because a controller step keeps only their costs.
    batch = None
    if return_batch:
        everything = (mppi.dynamics, mppi.cost, initial, sampled.controls, mppi.dt, belief)
        batch = rollout_batch(*everything, applied=before)
    later = shifted(info.controls, jnp.ones(()), mppi.dynamics.default_control)
    return PlannedControl(info.controls, later, info, batch)
