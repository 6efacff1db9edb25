"""A robot together with the variance of its position, which rollouts propagate."""

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Position, Scalar, StateVector
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.field import ScalarField

VARIANCE = "position_variance"
"""Name of the state component of the variance [m^2]."""


class PositionVariance(Dynamics):
    """The variance of a robot's position as a state without controls; see `UncertainRobot`.

    Args:
        certainty: information of a scan by position [1/m^2].
        added: variance of the position after a metre [m^2/m].
        rate: rate of scans [Hz].
    """

    state_names = (VARIANCE,)
    control_names = ()

    certainty: ScalarField
    added: Scalar
    rate: Scalar
    control_min: ControlVector
    control_max: ControlVector
    radius: Scalar

    @_kinds.check_arguments
    def __init__(self, certainty: ScalarField, added: ArrayLike, rate: ArrayLike) -> None:
        self.certainty = certainty
        self.added = _checks.scalar("added", added, at_least=0.0)
        self.rate = _checks.scalar("rate", rate, above=0.0)
        self.control_min = self.control_max = jnp.zeros(0)
        self.radius = jnp.zeros(())

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the variance (1,) of a robot that stands still and scans nothing: the same."""
        return state

    def propagate(self, variance: Scalar, before: Position, here: Position, dt: Scalar) -> Scalar:
        """Return the variance [m^2] after a step of `dt` [s] from `before` to `here` [m]."""
        moved = here - before
        grown = variance + self.added * jnp.sqrt((moved**2).sum())
        return grown / (1.0 + grown * self.certainty(here) * self.rate * dt)


class UncertainRobot(Augmented):
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

    virtual: PositionVariance

    def __init__(
        self,
        physical: Dynamics,
        certainty: ScalarField,
        added: ArrayLike = 4e-4,
        rate: ArrayLike = 10.0,
    ) -> None:
        super().__init__(physical, PositionVariance(certainty, added, rate))

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after a step of `dt` seconds that begins at time `t` [s]."""
        before, variance = state[:-1], state[-1]
        robot = self.physical
        after = robot.step_at(before, control, t, dt)
        places = robot.position(before), robot.position(after)
        return jnp.append(after, self.virtual.propagate(variance, *places, dt))
