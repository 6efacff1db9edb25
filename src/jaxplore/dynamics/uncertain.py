"""A robot together with the variance of its position, which rollouts propagate."""

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Pose, Position, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.footprint import Footprint
from jaxplore.maps.field import ScalarField

VARIANCE = "position_variance"
"""Name of the state component of the variance [m^2]."""


class UncertainRobot(Dynamics):
    """A robot with the variance of its position as a further component of the state:

        v' = (v + q s) / (1 + (v + q s) lambda(x, y) rate dt)

    s is the length of the step, q the variance that the odometry adds by metre, and lambda the
    information of a scan about the position [1/m^2], in the direction that it says least about. So
    v is a bound of the greatest eigenvalue of the covariance of a Kalman filter with such scans.

    Source: the Riccati equation of the Kalman filter; of planning with it: Prentice and Roy, "The
    belief roadmap", IJRR 2009.

    Args:
        physical: model of the robot.
        certainty: information of a scan by position; `UncertaintyAware` sets that of the belief.
        added: variance q of the position after a metre [m^2/m].
        rate: rate of scans [Hz].

    Raises:
        ValueError: a robot that has such a component, a number that is negative or not positive.
    """

    physical: Dynamics
    certainty: ScalarField
    added: Scalar
    rate: Scalar

    def __init__(
        self,
        physical: Dynamics,
        certainty: ScalarField,
        added: ArrayLike = 4e-4,
        rate: ArrayLike = 10.0,
    ) -> None:
        _kinds.instance("physical", physical, Dynamics)
        _kinds.instance("certainty", certainty, ScalarField)
        if VARIANCE in physical.state_names:
            raise ValueError(f"physical has a component {VARIANCE}; accepted: a robot without one")
        self.physical, self.certainty = physical, certainty
        self.added = _checks.scalar("added", added, at_least=0.0)
        self.rate = _checks.scalar("rate", rate, above=0.0)

    # Properties instead of class variables: they are those of the robot.
    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's components."""
        return (*self.physical.state_names, VARIANCE)

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the controls."""
        return self.physical.control_names

    @property  # type: ignore[misc]
    def control_min(self) -> ControlVector:  # type: ignore[override]
        """Lower bounds of the controls (nu,)."""
        return self.physical.control_min

    @property  # type: ignore[misc]
    def control_max(self) -> ControlVector:  # type: ignore[override]
        """Upper bounds of the controls (nu,)."""
        return self.physical.control_max

    @property
    def default_control(self) -> ControlVector:
        """Default control (nu,) of the robot."""
        return self.physical.default_control

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs that cover the robot [m]."""
        return self.physical.radius

    @property
    def footprint(self) -> Footprint:
        """Footprint of the robot."""
        return self.physical.footprint

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""
        return self.step_at(state, control, jnp.zeros(()), dt)

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after a step of `dt` seconds that begins at time `t` [s]."""
        before, variance = state[:-1], state[-1]
        after = self.physical.step_at(before, control, t, dt)
        moved = self.physical.position(after) - self.physical.position(before)
        grown = variance + self.added * jnp.sqrt((moved**2).sum())
        told = self.certainty(self.physical.position(after)) * self.rate * dt
        return jnp.append(after, grown / (1.0 + grown * told))

    def position(self, state: StateVector) -> Position:
        """Return the position (x, y) [m]."""
        return self.physical.position(state[:-1])

    def heading(self, state: StateVector) -> Scalar:
        """Return the heading [rad]."""
        return self.physical.heading(state[:-1])

    def pose(self, state: StateVector) -> Pose:
        """Return the pose (x, y, yaw) [m, m, rad]."""
        return self.physical.pose(state[:-1])

    def speed(self, state: StateVector) -> Scalar:
        """Return the forward speed [m/s]."""
        return self.physical.speed(state[:-1])

    def speed_under(self, state: StateVector, control: ControlVector) -> Scalar:
        """Return the forward speed [m/s] that a control leads to."""
        return self.physical.speed_under(state[:-1], control)

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle of the robot [m]."""
        return self.physical.turning_radius

    @property
    def can_reverse(self) -> bool:
        """Whether the robot can drive backwards."""
        return self.physical.can_reverse

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (nu,) that brakes the robot hardest."""
        return self.physical.stopping_control(state[:-1], dt, turn)

    def blocked(self, before: StateVector, after: StateVector) -> StateVector:
        """Return the state after a collision stopped the robot."""
        stopped = self.physical.blocked(before[:-1], after[:-1])
        return jnp.append(stopped, after[-1])
