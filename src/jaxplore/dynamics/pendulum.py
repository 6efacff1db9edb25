"""Model a pendulum that is swung up by a torque."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Integrator
from jaxplore.geometry.angles import sin_cos


class Pendulum(ContinuousDynamics):
    """Uniform rod that swings about one end, driven by a torque: Gymnasium's Pendulum-v1.

    State (angle, rate) [rad, rad/s], control (torque,) [N m]. The angle is 0 upright and pi
    hanging, and is not wrapped:

        angle' = rate,  rate' = 3 gravity / (2 length) sin(angle) + 3 / (mass length^2) torque

    The rate is clipped to its bound. A pendulum is no vehicle: position, heading, speed and
    `at_pose` raise a `ValueError`.

    Source: Gymnasium, `envs/classic_control/pendulum.py`, which steps it by 0.05 s with the
    semi-implicit Euler method.

    Args:
        mass: mass of the rod [kg].
        length: length of the rod [m]; also the radius of the disc about the pivot that contains it.
        gravity: gravitational acceleration [m/s^2].
        max_torque: bound of |torque| [N m].
        max_rate: bound of |rate| [rad/s].
        integrator: time integrator; `RK4()` by default.

    Raises:
        ValueError: an argument that is not positive.
    """

    state_names: ClassVar[tuple[str, ...]] = ("angle", "rate")
    control_names: ClassVar[tuple[str, ...]] = ("torque",)

    mass: Scalar
    length: Scalar
    gravity: Scalar
    max_rate: Scalar
    control_min: ControlVector
    control_max: ControlVector
    radius: Scalar
    integrator: Integrator

    @_kinds.check_arguments
    def __init__(
        self,
        mass: ArrayLike = 1.0,
        length: ArrayLike = 1.0,
        gravity: ArrayLike = 10.0,
        max_torque: ArrayLike = 2.0,
        max_rate: ArrayLike = 8.0,
        integrator: Integrator | None = None,
    ) -> None:
        self.mass = _checks.scalar("mass", mass, above=0.0)
        self.length = _checks.scalar("length", length, above=0.0)
        self.gravity = _checks.scalar("gravity", gravity, above=0.0)
        self.max_rate = _checks.scalar("max_rate", max_rate, above=0.0)
        self.control_max = _checks.scalar("max_torque", max_torque, above=0.0)[None]
        self.control_min = compute(lambda xp, high: -high, self.control_max)
        self.radius = self.length
        self.integrator = RK4() if integrator is None else integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (2,)."""
        # The inner stages of an integrator may leave the bound that the rate itself never leaves.
        angle, rate = self.project(state)
        (torque,) = control
        fall = 1.5 * self.gravity / self.length * sin_cos(angle)[0]
        return jnp.stack([rate, fall + 3.0 / (self.mass * self.length * self.length) * torque])

    def project(self, state: StateVector) -> StateVector:
        """Return the state (2,) with the rate within its bound."""
        angle, rate = state
        return jnp.stack([angle, jnp.clip(rate, -self.max_rate, self.max_rate)])

    def at_pose(self, x: float, y: float, yaw: float) -> StateVector:
        """Raise a `ValueError`: a pendulum has no pose.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            f"pose is {(x, y, yaw)}, but a Pendulum has none; accepted: a state (angle, rate)"
        )
