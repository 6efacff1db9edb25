"""Bounds that several models share: their checks, and how a robot brakes within them."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, Vector
from jaxplore._xla import compute, on_device
from jaxplore.dynamics.integrators import Integrator


def speed_range(min_speed: ArrayLike, max_speed: ArrayLike) -> tuple[Scalar, Scalar]:
    """Return both speeds as float32 scalars; requires max_speed > 0 and min_speed < max_speed."""
    highest = _checks.scalar("max_speed", max_speed, above=0.0)
    # A traced maximum has no number that the minimum could be compared with.
    below = None if _kinds.is_traced(max_speed) else float(np.asarray(max_speed).item())
    return _checks.scalar("min_speed", min_speed, below=below), highest


def positive(name: str, value: Vector, size: int) -> ControlVector:
    """Return `value` as `size` positive numbers (size,); a single number is repeated."""
    # The numbers of a traced value are unknown, so only its shape matters, in the broadcast below.
    if not _kinds.is_traced(value):
        accepted = f"one positive number, or {size}"
        array = _checks.floats(name, value, accepted)
        if array.shape not in ((), (size,)) or not (np.isfinite(array) & (array > 0.0)).all():
            raise ValueError(f"{name} is {value!r}; accepted: {accepted}")
        return on_device(np.broadcast_to(array, (size,)).copy())
    return jnp.broadcast_to(jnp.asarray(value, jnp.float32), (size,))


def radius_of_robot(value: ArrayLike) -> Scalar:
    """Return the radius of a robot [m]; warn if its unit is likely to be another one."""
    radius = _checks.scalar("radius", value, above=0.0)
    _checks.warn_above("radius", radius, 50.0, "a radius is in metres, not in centimetres")
    return radius


class BrakingLimits(eqx.Module):
    """Bounds of an acceleration [m/s^2]: `speeding` while |v| grows, `braking` while it shrinks."""

    speeding: Scalar
    braking: Scalar

    def clip(self, acceleration: Scalar, speed: Scalar, dt: Scalar) -> Scalar:
        """Return the acceleration that the bounds admit over a step of `dt` seconds.

        A robot that brakes to zero within the step spends the rest of it speeding up in the other
        direction, and the bound is the mean of both over the step.
        """
        sign = jnp.where(speed < 0.0, -1.0, 1.0)
        magnitude = sign * speed
        reverses = magnitude < self.braking * dt
        rest = dt - magnitude / self.braking
        # A step of no length reverses nothing, and must not divide by zero.
        mean = (magnitude + self.speeding * rest) / jnp.where(reverses, dt, 1.0)
        hardest = jnp.where(reverses, mean, self.braking)
        return sign * jnp.clip(sign * acceleration, -hardest, self.speeding)


def acceleration_range(
    max_acceleration: ArrayLike, max_deceleration: ArrayLike | None, min_speed: Scalar
) -> tuple[Scalar, Scalar, BrakingLimits | None]:
    """Return the bounds of an acceleration, and the limits that depend on the sign of the speed.

    Without `max_deceleration` there are no such limits. A robot that drives backwards may brake in
    both directions, so both bounds are then the larger one.
    """
    speeding = _checks.scalar("max_acceleration", max_acceleration, above=0.0)
    if max_deceleration is None:
        return compute(lambda _, high: -high, speeding), speeding, None
    braking = _checks.scalar("max_deceleration", max_deceleration, above=0.0)
    widest = compute(lambda xp, *each: xp.maximum(*each), speeding, braking)

    def bound(xp: Any, slowest: Any, widest: Any, forwards: Any) -> Any:
        return xp.where(slowest < 0.0, widest, forwards)

    low = compute(lambda xp, *each: -bound(xp, *each), min_speed, widest, braking)
    high = compute(bound, min_speed, widest, speeding)
    return low, high, BrakingLimits(speeding, braking)


def acceleration_to(
    target: ArrayLike, speed: Scalar, drag: Scalar, integrator: Integrator, dt: Scalar
) -> Scalar:
    """Return the acceleration that brings a speed with linear drag to a target in one step.

    It is exact for the integrator: the speed after a step is linear in the acceleration.
    """
    nothing, unit = jnp.zeros((1,), speed.dtype), jnp.ones((1,), speed.dtype)

    def rate(state: Array, control: Array) -> Array:
        return control - drag * state

    free = integrator(rate, speed[None], nothing, dt)[0]
    gain = integrator(rate, nothing, unit, dt)[0]
    return jnp.subtract(target, free) / gain


def shrink(control: ControlVector, bounds: ControlVector) -> ControlVector:
    """Return the control (nu,), shrunk to lie within +-bounds (nu,); it keeps its direction."""
    excess = jnp.max(jnp.abs(control) / bounds)
    within: ControlVector = control / jnp.maximum(excess, 1.0)
    return within


def bound_of_speed(robot: Any, *, is_least: bool = False) -> Scalar | None:
    """Return the greatest speed of a robot, or the least one, negative backwards [m/s].

    It is the attribute `max_speed` or `min_speed`, else the bound of the control `v`. None for a
    model with neither.
    """
    found: Scalar | None = getattr(robot, "min_speed" if is_least else "max_speed", None)
    if found is None and "v" in robot.control_names:
        # The speed is a control, and its bound is that of the control.
        bounds = robot.control_min if is_least else robot.control_max
        found = bounds[robot.control_names.index("v")]
    return found
