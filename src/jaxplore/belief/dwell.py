"""Track the time that the robot spends near each place, and discount information by it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Pose, Scalar
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.window import Window

DWELL_RADIUS = 0.5
"""Standard deviation of the Gaussian around the robot in which time counts as spent there [m]."""
GIVEN_UP = 2.0
"""Dwell time that is added where a place is given up, in units of the patience."""
REACH = 8.0
"""Standard deviations beyond which no time is added: it would be less than 1e-13 of the time."""


def add_dwell(
    dwell: Float[Array, "rows columns"],
    frame: GridFrame,
    pose: Pose,
    elapsed: Scalar,
    memory: Scalar,
) -> Float[Array, "rows columns"]:
    """Return the dwell time at each node after the robot has stayed at a pose [s].

        dwell <- dwell exp(-elapsed / memory) + elapsed exp(-(|node - position| / DWELL_RADIUS)^2 /
        2)

    A pose that is not finite adds nothing.
    """
    height, width = dwell.shape
    window = Window.around(pose[:2], REACH * DWELL_RADIUS, frame, (height, width))
    rows, columns = jnp.mgrid[: window.shape[0], : window.shape[1]]
    nodes = frame.cell_centre(window.corner + jnp.stack([rows, columns], axis=-1))
    distance = jnp.linalg.norm(nodes - pose[:2], axis=-1)
    stay = elapsed * jnp.exp(-0.5 * (distance / DWELL_RADIUS) ** 2)
    dwell = dwell * jnp.exp(-elapsed / memory)
    # A lost robot has no finite pose. A NaN would stay in the dwell times of all later updates.
    return window.write(dwell, window.read(dwell) + jnp.where(jnp.isfinite(stay), stay, 0.0))


def with_given_up(
    dwell: Float[Array, "*N"],
    before: Float[Array, "*N"],
    information: Float[Array, "*N"],
    min_information: Scalar,
    patience: Scalar,
) -> Float[Array, "*N"]:
    """Return the dwell time, longer where looks have taken away the worth of a place [s].

    `GIVEN_UP` times the patience [s] is added where the discounted information of a scan was at
    least `min_information` at the last update (`before`) and is less now [nat].
    """
    least = min_information / dwell_discount(dwell, patience)
    is_given_up = (before >= least) & (information < least)
    return jnp.where(is_given_up, dwell + GIVEN_UP * patience, dwell)


def dwell_discount(dwell: Float[Array, "*N"], patience: Scalar) -> Float[Array, "*N"]:
    """Return the factor `exp(-dwell / patience)` on information near which the robot has stayed.

    It makes the robot give up what it cannot observe.
    """
    return jnp.exp(-dwell / patience)
