"""A mass that is pushed about freely, in one to three dimensions."""

import equinox as eqx
import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Position, Scalar, StateVector, Vector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import acceleration_to, positive, radius_of_robot, shrink
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Integrator
from jaxplore.geometry.vectors import angle, length


class PointMass(ContinuousDynamics):
    """Point mass, or double integrator, with linear drag.

    State (x, y, z, vx, vy, vz) [m, m/s] and control (ax, ay, az) [m/s^2] in three dimensions;
    without z in two, and without y and z in one:

        p' = v,  v' = a - c v

    A velocity above `max_speed` is scaled down to it. The heading is the direction of travel, and 0
    at rest; the yaw of a start pose is ignored.

    Args:
        dimensions: number of dimensions, 1, 2 or 3; static.
        max_speed: upper bound of the speed [m/s]; unbounded by default.
        max_acceleration: bound of each |a|, one number or one per dimension [m/s^2].
        drag: drag coefficient c, fraction of the velocity lost per second [1/s].
        radius: radius of the disc that contains the robot [m].
        integrator: time integrator; `RK4()` by default.

    Raises:
        ValueError: other dimensions, a bound or radius that is not positive, a negative drag.
    """

    max_speed: Scalar | None
    control_min: ControlVector
    control_max: ControlVector
    drag: Scalar
    radius: Scalar
    integrator: Integrator
    dimensions: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        dimensions: int = 2,
        max_speed: ArrayLike | None = None,
        max_acceleration: Vector = 1.0,
        drag: ArrayLike = 0.0,
        radius: ArrayLike = 0.2,
        integrator: Integrator | None = None,
    ) -> None:
        if isinstance(dimensions, bool) or dimensions not in (1, 2, 3):
            raise ValueError(f"dimensions is {dimensions!r}; accepted: 1, 2 or 3")
        self.dimensions = int(dimensions)
        self.max_speed = (
            None if max_speed is None else _checks.scalar("max_speed", max_speed, above=0.0)
        )
        self.control_max = positive("max_acceleration", max_acceleration, self.dimensions)
        self.control_min = compute(lambda xp, high: -high, self.control_max)
        self.drag = _checks.scalar("drag", drag, at_least=0.0)
        self.radius = radius_of_robot(radius)
        self.integrator = RK4() if integrator is None else integrator

    # Properties instead of class variables: the names depend on the number of dimensions.
    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's components."""
        return ("x", "y", "z")[: self.dimensions] + ("vx", "vy", "vz")[: self.dimensions]

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the controls."""
        return ("ax", "ay", "az")[: self.dimensions]

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (2 n,) in n dimensions."""
        # The inner stages of an integrator may leave the bound that the mass itself never leaves.
        velocity = tuple(self.project(state))[self.dimensions :]
        pushed = [a - self.drag * v for a, v in zip(control, velocity, strict=True)]
        return jnp.stack([*velocity, *pushed])

    def project(self, state: StateVector) -> StateVector:
        """Return the state (2 n,) with the velocity scaled down to at most `max_speed`."""
        if self.max_speed is None:
            return state
        components = tuple(state)
        position, velocity = components[: self.dimensions], components[self.dimensions :]
        # Scale the vector instead of clipping components, which would change its direction. The
        # division is guarded for gradients at rest.
        speed = length(*velocity)
        is_fast = speed > self.max_speed
        scale = jnp.where(is_fast, self.max_speed / jnp.where(is_fast, speed, 1.0), 1.0)
        return jnp.stack([*position, *(scale * v for v in velocity)])

    def position(self, state: StateVector) -> Position:
        """Return the position (x, y) [m]; in one dimension y is 0."""
        y = jnp.zeros(()) if self.dimensions == 1 else self.component(state, "y")
        return jnp.stack([self.component(state, "x"), y])

    def heading(self, state: StateVector) -> Scalar:
        """Return the direction of travel in the plane [rad], 0 at rest."""
        vy = jnp.zeros(()) if self.dimensions == 1 else self.component(state, "vy")
        return angle(self.component(state, "vx"), vy)

    def speed(self, state: StateVector) -> Scalar:
        """Return the norm of the velocity in all dimensions [m/s]."""
        return length(*tuple(state)[self.dimensions :])

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the mass can be brought to rest in any direction [m/s^2]."""
        return jnp.min(self.control_max)

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (n,) in n dimensions that brakes hardest along a straight line.

        A point mass has no turning bound, so `turn` has no effect.
        """
        needed = [
            acceleration_to(0.0, v, self.drag, self.integrator, dt)
            for v in tuple(state)[self.dimensions :]
        ]
        return shrink(jnp.stack(needed), self.control_max)
