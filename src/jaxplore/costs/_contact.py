"""Where the discs that cover a robot are, and when they are too close to something."""

import jax.numpy as jnp

from jaxplore._types import Scalar
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.footprint import Disc

Lever = tuple[Scalar, ...]
"""From a robot's position to the centre of a disc, (x, y) [m]; empty: it is there."""


def levers(state: State) -> tuple[Lever, ...]:
    """Return the way to each of the discs that cover the robot.

    That of a robot which is a disc itself is empty: its heading is not read, nothing is added.
    """
    footprint = state.dynamics.footprint
    if isinstance(footprint, Disc):
        return ((),)
    sin, cos = sin_cos(state.heading)
    return tuple((ahead * cos, ahead * sin) for ahead in footprint.offsets)


def shifted(components: tuple[Scalar, ...], lever: Lever) -> tuple[Scalar, ...]:
    """Return a vector moved by a lever; a height stays."""
    moved = tuple(a + b for a, b in zip(components, lever, strict=False))
    return moved + components[len(moved) :]


def contact(state: State, margin: Scalar, reaction_time: Scalar) -> Scalar:
    """Return the distance of a disc's centre at which the robot is too close [m]."""
    return state.dynamics.footprint.radius + margin + reaction_time * jnp.abs(state.speed)


def depth(distance: Scalar, too_close: Scalar) -> Scalar:
    """Return by how much a distance is too small, in 5 cm."""
    return jnp.maximum(too_close - distance, 0.0) / 0.05


def penalty(distance: Scalar, clearance: Scalar, too_close: Scalar, collision: Scalar) -> Scalar:
    """Return what a distance costs: a little below `clearance`, `collision` for 5 cm too close."""
    near = jnp.maximum(clearance - distance, 0.0) / clearance
    deep = depth(distance, too_close)
    return near * near + collision * deep * deep
