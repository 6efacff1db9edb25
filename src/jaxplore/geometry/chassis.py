"""Describe how a vehicle stands on its wheels, and when it tips over."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, Flag, Scalar

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""


class Stance(NamedTuple):
    """The plane that fits the ground under four wheels best.

    Args:
        ahead: slope of the plane along the heading, positive uphill [m/m].
        left: slope of the plane to the left of the heading, positive uphill [m/m].
        twist: distance of the ground under each wheel from the plane [m], positive where it is
            above the plane on the front left. The four distances are equal, and their signs
            alternate around the vehicle.
    """

    ahead: Scalar
    left: Scalar
    twist: Scalar

    @property
    def pitch(self) -> Scalar:
        """Pitch of a vehicle on the plane [rad]; positive is nose down, as in REP 103."""
        return -jnp.arctan(self.ahead)

    @property
    def roll(self) -> Scalar:
        """Roll of a vehicle on the plane [rad]; positive is left side up, as in REP 103."""
        return jnp.arctan(self.left / jnp.sqrt(1.0 + self.ahead * self.ahead))


class Stability(NamedTuple):
    """How much of what the vehicle withstands is used; at 1 a wheel leaves the ground.

    Args:
        across: load transfer between the left and the right wheels, as a share of the whole load;
            above 1 the vehicle tips over to a side.
        along: load transfer between the front and the rear wheels, likewise.
        wheels: twist of the ground, as a share of the travel of the suspension; above 1 a wheel
            hangs in the air.
    """

    across: Scalar
    along: Scalar
    wheels: Scalar

    @property
    def is_tipped(self) -> Flag:
        """Whether the vehicle tips over."""
        return jnp.maximum(self.across, self.along) > 1.0

    @property
    def is_hanging(self) -> Flag:
        """Whether a wheel hangs in the air."""
        return self.wheels > 1.0


class Chassis(eqx.Module):
    """Four wheels and the centre of mass of a vehicle, in its frame: x ahead, y to the left.

    The wheels are at (offset +- wheelbase / 2, +- track / 2). The centre of mass is above the
    middle between them.

    Args:
        wheelbase: distance between the axles [m].
        track: distance between the left and the right wheels [m].
        mass_height: height of the centre of mass above the ground [m].
        suspension: how far each wheel moves up and down from the plane of the four [m]; the
            compliance of tyres and frame of a vehicle without a suspension.
        offset: x of the middle between the axles, seen from the position of the model [m]: half the
            wheelbase for a model of the rear axle.

    Raises:
        ValueError: a length that is not positive, an offset that is not finite.
    """

    wheelbase: Scalar
    track: Scalar
    mass_height: Scalar
    suspension: Scalar
    offset: Scalar

    def __init__(
        self,
        wheelbase: ArrayLike,
        track: ArrayLike,
        mass_height: ArrayLike = 0.25,
        suspension: ArrayLike = 0.05,
        offset: ArrayLike = 0.0,
    ) -> None:
        self.wheelbase = _checks.scalar("wheelbase", wheelbase, above=0.0)
        self.track = _checks.scalar("track", track, above=0.0)
        self.mass_height = _checks.scalar("mass_height", mass_height, above=0.0)
        self.suspension = _checks.scalar("suspension", suspension, above=0.0)
        self.offset = _checks.scalar("offset", offset)

    def stance(
        self, front_left: Scalar, front_right: Scalar, rear_left: Scalar, rear_right: Scalar
    ) -> Stance:
        """Return the least-squares plane through the ground under the wheels.

        Args:
            front_left: elevation of the ground under the front left wheel [m].
            front_right: that under the front right one.
            rear_left: that under the rear left one.
            rear_right: that under the rear right one.
        """
        front, rear = front_left + front_right, rear_left + rear_right
        left, right = front_left + rear_left, front_right + rear_right
        return Stance(
            ahead=(front - rear) / (2.0 * self.wheelbase),
            left=(left - right) / (2.0 * self.track),
            twist=(front_left - front_right - rear_left + rear_right) / 4.0,
        )

    def stability(
        self, stance: Stance, acceleration: Scalar, side_acceleration: Scalar
    ) -> Stability:
        """Return how much of what the vehicle withstands is used.

        With a and b the slopes of the plane ahead and to the left, n = sqrt(1 + a^2 + b^2),
        accelerations a_x and a_y in the frame of the vehicle, h the height of the centre of mass,
        L the wheelbase and W the track, the load transfer ratios are

            across = 2 h / W |n a_y / g + b / sqrt(1 + a^2)|
            along  = 2 h / L |n a_x / g + a n / sqrt(1 + a^2)|
            wheels = |twist| / suspension

        At 1 the line of gravity and inertia through the centre of mass meets the edge of the
        rectangle of the wheels. The curvature of the ground along the path is neglected.

        Source: Papadopoulos and Rey, "A new measure of tipover stability margin for mobile
        manipulators", ICRA 1996, for a rectangle of wheels; Rajamani, "Vehicle Dynamics and
        Control", section 15.3, load transfer ratio.

        Args:
            stance: the plane under the wheels.
            acceleration: acceleration a_x along the heading [m/s^2].
            side_acceleration: acceleration a_y to the left: in a curve the speed times the turn
                rate [m/s^2].
        """
        squared = 1.0 + stance.ahead * stance.ahead
        along, whole = jnp.sqrt(squared), jnp.sqrt(squared + stance.left * stance.left)
        to_left = whole * side_acceleration / GRAVITY + stance.left / along
        ahead = whole * acceleration / GRAVITY + stance.ahead * whole / along
        return Stability(
            across=2.0 * self.mass_height / self.track * jnp.abs(to_left),
            along=2.0 * self.mass_height / self.wheelbase * jnp.abs(ahead),
            wheels=jnp.abs(stance.twist) / self.suspension,
        )
