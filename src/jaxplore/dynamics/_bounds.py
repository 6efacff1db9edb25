"""Check bounds that several models share."""

import jax.numpy as jnp
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, Vector
from jaxplore._xla import on_device


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
