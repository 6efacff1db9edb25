"""References of the strategic layer: positions for the robot to follow, made from the belief."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.gradient_reference import GradientReference


class ReferenceStart(NamedTuple):
    """Where a reference begins, and how the robot moves there.

    Args:
        position: (3,) position of the robot (x, y, z) [m].
        heading: heading [rad].
        speed: forward speed [m/s]; negative if it drives backwards.
    """

    position: Float[Array, "3"]
    heading: Scalar
    speed: Scalar

    @property
    def pose(self) -> Pose:
        """Pose (x, y, yaw) of the robot [m, m, rad]."""
        return jnp.append(self.position[:2], self.heading)


class StrategicReference(eqx.Module):
    """A rule by which the strategic layer makes a reference.

    `gradient_reference` sets the speed, the number of steps and the time step.
    """

    gradient_reference: eqx.AbstractVar[GradientReference]

    @abc.abstractmethod
    def __call__(
        self, belief: Belief, potential: ScalarField, start: ReferenceStart
    ) -> Float[Array, "T 3"]:
        """Compute the positions (x, y, z) after 1 ...

        T steps [m] by the information of a scan at each place around the robot, `potential` [nat];
        the z of `start` is kept.
        """


class ClimbingReference(StrategicReference):
    """Ascend the information field, or descend the guidance field where that ends at more.

    The field around the robot is flat where all within reach is known, and has low local maxima.
    An ascent ends there. The guidance field leads through the whole map to the remaining
    information, and in the end to the goal. Both references are computed. The ascent is chosen if
    the information at its end is greater by more than `min_gain`.

    A car cannot drive along any line, and gets the descent, that of its lattice (`descend`).

    Source: `field_gradient_trajectory` of the quadrotor design notes. The descent of the guidance
    field is an addition.

    Args:
        gradient_reference: gradient ascent that makes the positions; the notes' 40 steps of 0.05 s
            at 2 m/s when absent.
        min_gain: information by which the ascent must exceed the descent [nat].

    Raises:
        ValueError: a negative gain.
    """

    gradient_reference: GradientReference
    min_gain: Scalar

    @_kinds.check_arguments
    def __init__(
        self, gradient_reference: GradientReference | None = None, min_gain: ArrayLike = 1.0
    ) -> None:
        self.gradient_reference = (
            GradientReference() if gradient_reference is None else gradient_reference
        )
        self.min_gain = _checks.scalar("min_gain", min_gain, at_least=0.0)

    def __call__(
        self, belief: Belief, potential: ScalarField, start: ReferenceStart
    ) -> Float[Array, "T 3"]:
        """Compute the positions after 1 ... T steps [m]."""
        traced = _drive(self.gradient_reference, belief.guidance, start)
        if traced is not None:
            return traced
        climbing = self.gradient_reference(potential, belief.grid, start.position)
        guided = descend(self.gradient_reference, belief.guidance, belief, start)
        gain = potential(climbing[-1, :2]) - potential(guided[-1, :2])
        return jnp.where(gain > self.min_gain, climbing, guided)


def descend(
    gradient_reference: GradientReference,
    field: GuidanceField,
    belief: Belief,
    start: ReferenceStart,
) -> Float[Array, "T 3"]:
    """Compute the positions of a robot that descends a cost-to-go field (T, 3) [m].

    A field over headings is that of a car, whose positions are those of the motions of its lattice
    at no more than its speeds. In any other `gradient_reference` ascends the negative cost. z is
    kept.
    """
    traced = _drive(gradient_reference, field, start)
    if traced is not None:
        return traced
    # Ascending the negative field reuses the handling of walls and flat places.
    heights = ScalarField(-field.values, field.frame, -field.outside)
    return gradient_reference(heights, belief.grid, start.position)


def _drive(
    gradient_reference: GradientReference, field: GuidanceField, start: ReferenceStart
) -> Float[Array, "T 3"] | None:
    """Return the positions of a car that descends a field; None for any other robot."""
    pace = gradient_reference
    steps = pace.dt * jnp.stack([pace.speed, pace.reverse_speed])
    poses = field.trace_path(start.pose, start.speed, steps, pace.num_steps)
    if poses is None:
        return None
    height = jnp.broadcast_to(start.position[2], (pace.num_steps, 1))
    return jnp.concatenate([poses[:, :2], height], axis=1)
