"""The true robot of an episode: a model with other actuators and with slip."""

import jax.numpy as jnp

from jaxplore._types import ArrayLike, ControlVector, Pose, Position, Scalar, StateVector
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import ContinuousDynamics, Dynamics
from jaxplore.dynamics.integrators import Integrator
from jaxplore.geometry.footprint import Footprint


class Plant(Dynamics):
    """A robot whose controls and motion differ from those of its model:

        u' = gain clip(u + noise, control_min, control_max)
        x' = x + (1 - loss) (step(x, u', dt) - x)

    The loss is `slip` for the components x and y, `turn_slip` for the component yaw, and 0 for
    all others. So the wheels have their speed, and the robot moves by less.

    Args:
        model: model of the robot.
        gain: (nu,) factor on each control.
        noise: (nu,) what is added to the command.
        slip: share of the displacement that is lost.
        turn_slip: share of the change of yaw that is lost.
    """

    model: Dynamics
    gain: ControlVector
    noise: ControlVector
    slip: Scalar
    turn_slip: Scalar

    def __init__(
        self,
        model: Dynamics,
        gain: ControlVector,
        noise: ControlVector,
        slip: Scalar,
        turn_slip: Scalar,
    ) -> None:
        self.model, self.gain, self.noise = model, gain, noise
        self.slip, self.turn_slip = slip, turn_slip

    # Properties instead of class variables: the names are those of the model.
    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's components."""
        return self.model.state_names

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the controls."""
        return self.model.control_names

    @property  # type: ignore[misc]
    def control_min(self) -> ControlVector:  # type: ignore[override]
        """Lower bounds of the controls (nu,)."""
        return self.model.control_min

    @property  # type: ignore[misc]
    def control_max(self) -> ControlVector:  # type: ignore[override]
        """Upper bounds of the controls (nu,)."""
        return self.model.control_max

    @property
    def default_control(self) -> ControlVector:
        """Default control (nu,) of the model."""
        return self.model.default_control

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs that cover the robot [m]."""
        return self.model.radius

    @property
    def footprint(self) -> Footprint:
        """Footprint of the robot."""
        return self.model.footprint

    def effective(self, control: ControlVector) -> ControlVector:
        """Return the control (nu,) that acts on the model."""
        within = jnp.clip(control + self.noise, self.control_min, self.control_max)
        return self.gain * within

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""
        return self.step_at(state, control, jnp.zeros(()), dt)

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after a step of `dt` seconds that begins at time `t` [s]."""
        after = self.model.step_at(state, self.effective(control), t, dt)
        lost = {"x": self.slip, "y": self.slip, "yaw": self.turn_slip}
        share = jnp.stack([lost.get(name, jnp.zeros(())) for name in self.state_names])
        # Without slip the state is that of the model to the bit.
        return jnp.where(share == 0.0, after, state + (1.0 - share) * (after - state))

    def position(self, state: StateVector) -> Position:
        """Return the position (x, y) [m]."""
        return self.model.position(state)

    def heading(self, state: StateVector) -> Scalar:
        """Return the heading [rad]."""
        return self.model.heading(state)

    def pose(self, state: StateVector) -> Pose:
        """Return the pose (x, y, yaw) [m, m, rad]."""
        return self.model.pose(state)

    def speed(self, state: StateVector) -> Scalar:
        """Return the forward speed [m/s], without slip."""
        return self.model.speed(state)

    def speed_under(self, state: StateVector, control: ControlVector) -> Scalar:
        """Return the forward speed [m/s] of the model under the control that acts on it."""
        return self.model.speed_under(state, self.effective(control))

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle of the model [m]."""
        return self.model.turning_radius

    @property
    def can_reverse(self) -> bool:
        """Whether the model can drive backwards."""
        return self.model.can_reverse

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (nu,) that brakes the model hardest."""
        return self.model.stopping_control(state, dt, turn)

    def resolve_collision(self, before: StateVector, after: StateVector) -> StateVector:
        """Return the state after a collision stopped the robot."""
        return self.model.resolve_collision(before, after)


class ContinuousPlant(Plant, ContinuousDynamics):
    """The plant of a model that is given by its time derivative, which recordings read."""

    @property  # type: ignore[misc]
    def integrator(self) -> Integrator:  # type: ignore[override]
        """Integrator of the model."""
        assert isinstance(self.model, ContinuousDynamics)
        return self.model.integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return the time derivative of the state (nx,), without slip."""
        assert isinstance(self.model, ContinuousDynamics)
        return self.model.derivative(state, self.effective(control))

    def project(self, state: StateVector) -> StateVector:
        """Return the nearest admissible state (nx,)."""
        assert isinstance(self.model, ContinuousDynamics)
        return self.model.project(state)


def physical_part(robot: Dynamics) -> Dynamics:
    """Return a model without its virtual states, which no plant can vary."""
    return robot.physical if isinstance(robot, Augmented) else robot


def as_plant(
    robot: Dynamics,
    gain: ControlVector,
    noise: ControlVector,
    slip: Scalar,
    turn_slip: Scalar,
) -> Dynamics:
    """Return the plant of a model; of an `Augmented` one the physical part is varied."""
    if isinstance(robot, Augmented):
        return Augmented(as_plant(robot.physical, gain, noise, slip, turn_slip), robot.virtual)
    kind: type[Plant] = ContinuousPlant if isinstance(robot, ContinuousDynamics) else Plant
    return kind(robot, gain, noise, slip, turn_slip)
