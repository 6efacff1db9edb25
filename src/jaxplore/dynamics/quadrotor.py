"""Model a quadrotor that takes thrust and body-rate commands."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Pose, Scalar, StateVector, Vector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import positive, radius_of_robot
from jaxplore.dynamics.base import ContinuousDynamics, as_state
from jaxplore.dynamics.integrators import RK4, Integrator
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import TINY, angle, length

BRAKING_SECONDS = 0.3
"""Time constant of the speed of a robot that brakes [s]."""


class Quadrotor(ContinuousDynamics):
    """Quadrotor with thrust and body-rate commands, as a flight controller takes them.

    The world frame is NED (x north, y east, z down), the body frame FRD (forward, right, down).
    Thrust acts along -z of the body. State (x, y, z, vx, vy, vz, qw, qx, qy, qz, wx, wy, wz):
    position p [m] and velocity v [m/s] in the world frame, unit quaternion q that rotates body
    vectors into the world frame, body rates w [rad/s]. Control (thrust, wx_command, wy_command,
    wz_command) [N, rad/s]:

        p' = v        v' = (0, 0, gravity) - thrust / mass R(q) e_z
        q' = q (0, w) / 2        w' = (w_command - w) / rate_time_constant

    The body-rate loop is a first-order lag; there is no drag. The quaternion is normalised after
    each step. The thrust is divided by |q|^2, so that a measured q need not be exactly normalised.
    RK4 is stable for steps below 2.78 rate time constants.

    Source: Kaufmann, Bauersfeld and Scaramuzza, "A benchmark comparison of learned control policies
    for agile quadrotor flight", ICRA 2022, collective thrust and body rates, with z up.

    Args:
        mass: mass of the vehicle [kg].
        gravity: gravitational acceleration [m/s^2].
        rate_time_constant: time constant of the body rates [s].
        max_thrust: upper bound of the thrust [N]; four times the weight by default.
        max_rate: bound of each |w_command|, one number or (3,) [rad/s].
        radius: radius of the disc that contains the robot [m].
        integrator: time integrator; `RK4()` by default.

    Raises:
        ValueError: an argument that is not positive.
    """

    state_names: ClassVar[tuple[str, ...]] = (
        *("x", "y", "z", "vx", "vy", "vz"),
        *("qw", "qx", "qy", "qz", "wx", "wy", "wz"),
    )
    control_names: ClassVar[tuple[str, ...]] = ("thrust", "wx_command", "wy_command", "wz_command")

    mass: Scalar
    gravity: Scalar
    rate_time_constant: Scalar
    control_min: ControlVector
    control_max: ControlVector
    radius: Scalar
    integrator: Integrator

    @_kinds.check_arguments
    def __init__(
        self,
        mass: ArrayLike = 1.0,
        gravity: ArrayLike = 9.81,
        rate_time_constant: ArrayLike = 0.05,
        max_thrust: ArrayLike | None = None,
        max_rate: Vector = 10.0,
        radius: ArrayLike = 0.3,
        integrator: Integrator | None = None,
    ) -> None:
        self.mass = _checks.scalar("mass", mass, above=0.0)
        self.gravity = _checks.scalar("gravity", gravity, above=0.0)
        self.rate_time_constant = _checks.scalar(
            "rate_time_constant", rate_time_constant, above=0.0
        )
        highest = (
            compute(lambda _, mass, gravity: 4.0 * mass * gravity, self.mass, self.gravity)
            if max_thrust is None
            else _checks.scalar("max_thrust", max_thrust, above=0.0)
        )
        rates = positive("max_rate", max_rate, 3)
        self.control_min = compute(
            lambda xp, most: xp.append(xp.zeros_like(most[:1]), -most), rates
        )
        self.control_max = compute(lambda xp, *each: xp.append(*each), highest, rates)
        self.radius = radius_of_robot(radius)
        self.integrator = RK4() if integrator is None else integrator

    @property
    def default_control(self) -> ControlVector:
        """Hover control (4,): thrust equal to the weight and zero rates, clipped to the bounds."""
        return compute(
            lambda xp, mass, gravity, low, high: xp.clip(
                xp.append(mass * gravity, xp.zeros_like(low[1:])), low, high
            ),
            self.mass,
            self.gravity,
            self.control_min,
            self.control_max,
        )

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (13,)."""
        _, _, _, vx, vy, vz, qw, qx, qy, qz, wx, wy, wz = state
        thrust, wx_command, wy_command, wz_command = control
        # The rotation below scales with |q|^2: dividing by it keeps the thrust's size.
        squared = qw * qw + qx * qx + qy * qy + qz * qz
        push = thrust / (self.mass * jnp.where(squared < TINY, 1.0, squared))
        return jnp.stack(
            [
                vx,
                vy,
                vz,
                -push * 2.0 * (qx * qz + qw * qy),
                -push * 2.0 * (qy * qz - qw * qx),
                self.gravity - push * (qw * qw - qx * qx - qy * qy + qz * qz),
                -0.5 * (qx * wx + qy * wy + qz * wz),
                0.5 * (qw * wx + qy * wz - qz * wy),
                0.5 * (qw * wy + qz * wx - qx * wz),
                0.5 * (qw * wz + qx * wy - qy * wx),
                (wx_command - wx) / self.rate_time_constant,
                (wy_command - wy) / self.rate_time_constant,
                (wz_command - wz) / self.rate_time_constant,
            ]
        )

    def project(self, state: StateVector) -> StateVector:
        """Return the state (13,) with a unit quaternion; a zero quaternion becomes level."""
        x, y, z, vx, vy, vz, qw, qx, qy, qz, wx, wy, wz = state
        squared = qw * qw + qx * qx + qy * qy + qz * qz
        is_zero = squared < TINY
        # If the square overflows, the division would give a zero quaternion and hide that the
        # rollout diverged: make it NaN.
        squared = jnp.where(jnp.isinf(squared), jnp.nan, squared)
        norm = jnp.sqrt(jnp.where(is_zero, 1.0, squared))
        return jnp.stack(
            [
                *(x, y, z, vx, vy, vz),
                jnp.where(is_zero, 1.0, qw / norm),
                *(jnp.where(is_zero, 0.0, part / norm) for part in (qx, qy, qz)),
                *(wx, wy, wz),
            ]
        )

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the quadrotor can be brought to rest [m/s^2].

        It is a quarter of gravity, with the time that it takes to tilt: below the 0.8 gravity of
        `stopping_control`.
        """
        return 0.25 * self.gravity

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (4,) that brakes hardest, and then hovers.

        The wanted acceleration is `-v / T` with T = 0.3 s, at most 0.8 gravity horizontally and
        0.4 gravity vertically. The body rates turn the thrust axis to it, and the thrust is its
        share along the present axis. It needs velocity, attitude and rates, and no position. A
        `turn` of 1 turns the horizontal acceleration by 45 degrees from x (north) towards y (east),
        so that the robot evades to a side while it brakes; below 1 m/s by less.
        """
        _, _, _, vx, vy, vz, qw, qx, qy, qz, _, _, _ = state
        # A step longer than the time constants must not overshoot.
        pace = 1.0 / jnp.maximum(BRAKING_SECONDS, 2.0 * dt)
        speed = jnp.sqrt(vx * vx + vy * vy + TINY)
        # Close to rest the robot brakes straight, or it would circle.
        sin, cos = sin_cos(turn * math.radians(45.0) * jnp.minimum(speed, 1.0))
        strength = jnp.minimum(pace, 0.8 * self.gravity / speed)
        north, east = -strength * (cos * vx - sin * vy), -strength * (sin * vx + cos * vy)
        down = jnp.clip(-pace * vz, -0.4 * self.gravity, 0.4 * self.gravity)
        # The thrust accelerates along -z of the body, so that axis must point along this vector.
        axis = jnp.stack([-north, -east, self.gravity - down])
        present = jnp.stack(
            [
                2.0 * (qx * qz + qw * qy),
                2.0 * (qy * qz - qw * qx),
                qw * qw - qx * qx - qy * qy + qz * qz,
            ]
        )
        thrust = self.mass * jnp.dot(axis, present)
        error = jnp.cross(present, axis / jnp.sqrt(jnp.dot(axis, axis)))
        # Turn the error into the frame of the body: the inverse rotation by the quaternion.
        vector = jnp.stack([qx, qy, qz])
        twice = 2.0 * jnp.cross(error, vector)
        body = error + qw * twice + jnp.cross(twice, vector)
        gain = 1.0 / jnp.maximum(2.5 * self.rate_time_constant, 2.0 * dt)
        rates = gain * body
        control = jnp.stack([thrust, rates[0], rates[1], jnp.zeros_like(thrust)])
        return jnp.clip(control, self.control_min, self.control_max)

    def heading(self, state: StateVector) -> Scalar:
        """Return the yaw of the quaternion [rad], from x (north) towards y (east).

        It is discontinuous where the nose points straight up or down, and 0 there.
        """
        _, _, _, _, _, _, qw, qx, qy, qz, _, _, _ = state
        return angle(1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qw * qz + qx * qy))

    def speed(self, state: StateVector) -> Scalar:
        """Return the horizontal speed [m/s]."""
        return length(self.component(state, "vx"), self.component(state, "vy"))

    def with_pose(
        self,
        state: StateVector,
        pose: Pose,
        velocity_error: Float[Array, "2"] | None = None,
    ) -> StateVector:
        """Return a state (13,) turned about the vertical to another pose, at the same altitude.

        Roll, pitch and body rates stay, and the velocity turns with the yaw. Where the yaw is not
        finite, nothing turns: a robot without a pose still measures what it brakes by.

        Args:
            state: state (13,) of the robot.
            pose: the other pose (x, y, yaw) [m, m, rad].
            velocity_error: error (2,) of the horizontal velocity, in the frame of the heading
                [m/s]; none when absent.
        """
        _, _, z, vx, vy, vz, qw, qx, qy, qz, wx, wy, wz = state
        x, y, yaw = jnp.unstack(pose)
        heading = self.heading(state)
        turn = jnp.where(jnp.isfinite(yaw), yaw - heading, 0.0)
        sin, cos = sin_cos(turn)
        vx, vy = cos * vx - sin * vy, sin * vx + cos * vy
        if velocity_error is not None:
            ahead, left = jnp.unstack(velocity_error)
            sin, cos = sin_cos(heading + turn)
            vx = vx + cos * ahead - sin * left
            vy = vy + sin * ahead + cos * left
        # The quaternion of the turn, times that of the attitude.
        sin, cos = sin_cos(0.5 * turn)
        attitude = (
            cos * qw - sin * qz,
            cos * qx - sin * qy,
            cos * qy + sin * qx,
            cos * qz + sin * qw,
        )
        return jnp.stack([x, y, z, vx, vy, vz, *attitude, wx, wy, wz])

    def at_pose(self, x: float, y: float, yaw: float, z: float = 0.0) -> StateVector:
        """Return the state of a level robot at rest at a pose (x, y, yaw, z) [m, m, rad, m]."""
        for name, value in {"x": x, "y": y, "yaw": yaw, "z": z}.items():
            _checks.of_shape(name, value, ())
        level = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
        return as_state(x, y, z, 0.0, 0.0, 0.0, *level, 0.0, 0.0, 0.0)


def position_upwards(state: StateVector) -> Float[Array, "3"]:
    """Return the position (x, y, z) of a quadrotor in a frame with z up [m]."""
    return state[:3] * jnp.asarray([1.0, 1.0, -1.0])


def attitude_upwards(state: StateVector) -> Float[Array, "3 3"]:
    """Return the rotation from the body, x ahead, y to the left, z up, to that frame.

    The model is NED and FRD: mirrored in z, both y axes keep their names, and a turn from x towards
    y remains one.
    """
    w, x, y, z = state[6], state[7], state[8], state[9]
    rotation = jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )
    mirror = jnp.asarray([1.0, 1.0, -1.0])
    return mirror[:, None] * rotation * mirror
