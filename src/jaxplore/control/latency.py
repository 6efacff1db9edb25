"""Latency of commands: predict the state in which a command takes effect, and plan from there."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ArrayLike, StateVector
from jaxplore.dynamics.base import Dynamics


def predicted_state(
    dynamics: Dynamics,
    state: StateVector,
    controls: Float[Array, "N nu"],
    durations: Float[Array, " N"],
    max_step: ArrayLike = 0.02,
) -> StateVector:
    """Return the state (nx,) after controls that are held one after the other.

    The number of slots N is static, so one compiled program serves every latency: a slot of a
    duration of zero or less changes nothing.

    Args:
        dynamics: model of the robot.
        state: state (nx,) at the start.
        controls: (N, nu) controls, the first to take effect first.
        durations: (N,) time for which each is held [s].
        max_step: longest model step [s]; longer slots are divided into equal steps.
    """

    def hold(reached: Array, slot: tuple[Array, Array]) -> tuple[Array, None]:
        control, duration = slot
        # In float32 a whole number of steps may divide to slightly more.
        steps = jnp.ceil(jnp.maximum(duration, 0.0) / max_step - 1e-3).astype(jnp.int32)
        steps = jnp.where(duration > 0.0, jnp.maximum(steps, 1), 0)
        dt = duration / jnp.maximum(steps, 1).astype(duration.dtype)
        return jax.lax.fori_loop(
            0, steps, lambda _, values: dynamics.step(values, control, dt), reached
        ), None

    reached, _ = jax.lax.scan(hold, state, (controls, durations))
    return reached
