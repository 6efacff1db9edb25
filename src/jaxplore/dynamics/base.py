"""What a robot's model is, and how costs read its state."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxplore._types import ControlVector, Position, Scalar, StateVector
from jaxplore.dynamics.integrators import Derivative, Integrator
from jaxplore.geometry.footprint import Disc, Footprint


class Dynamics(eqx.Module):
    """A robot's discrete-time model, `state' = step(state, control, dt)`.

    Written for one robot and one step; the engine maps it over samples and time. A model says its
    `state_names` and `control_names`, its control bounds, the `radius` of the disc that holds it
    and `step`. Position, heading and speed are found among the state's names (`x`, `y`, `yaw`,
    `v`); a model that names or computes them otherwise gives its own accessors. A robot that is no
    disc around its position gives its `footprint`; its `radius` is then that of the discs that
    cover it together. A model that is given by its time derivative is a `ContinuousDynamics`.
    """

    state_names: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]

    control_min: eqx.AbstractVar[ControlVector]
    control_max: eqx.AbstractVar[ControlVector]
    radius: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after the step that begins `t` seconds from now.

        The engine calls this. A model that does not depend on time leaves it as it is: `step`.
        """
        return self.step(state, control, dt)

    @property
    def default_control(self) -> ControlVector:
        """The control (nu,) of a robot that is left alone: no control, within the bounds.

        A plan starts with it and is continued with it. A model that zeros would let fall says
        better.
        """
        return jnp.clip(jnp.zeros(self.control_size), self.control_min, self.control_max)

    @property
    def control_half_range(self) -> ControlVector:
        """Half the range between the bounds of each control, `(control_max - control_min) / 2`
        (nu,)."""
        return 0.5 * (self.control_max - self.control_min)

    @property
    def footprint(self) -> Footprint:
        """What the robot covers of the ground: the disc of its radius, unless a model says
        otherwise."""
        return Disc(self.radius)

    @property
    def state_size(self) -> int:
        """Number of state components, nx."""
        return len(self.state_names)

    @property
    def control_size(self) -> int:
        """Number of controls, nu."""
        return len(self.control_names)

    def position(self, state: StateVector) -> Position:
        """Return the position (x, y) [m]."""
        return jnp.stack([self.component(state, "x"), self.component(state, "y")])

    def heading(self, state: StateVector) -> Scalar:
        """Return the heading [rad], counter-clockwise from the x axis."""
        return self.component(state, "yaw")

    def speed(self, state: StateVector) -> Scalar:
        """Return the forward speed [m/s]."""
        return self.component(state, "v")

    def component(self, state: StateVector, name: str) -> Scalar:
        """Return the state component called `name`.

        Raises:
            ValueError: the model has no such component.
        """
        if name not in self.state_names:
            raise ValueError(
                f"{type(self).__name__} has no state component {name!r}; "
                f"accepted: {', '.join(self.state_names)}"
            )
        return state[self.state_names.index(name)]

    def at_pose(self, x: float, y: float, yaw: float) -> StateVector:
        """Return the state of a robot that stands still at a pose [m, m, rad]."""
        pose = {"x": x, "y": y, "yaw": yaw}
        return jnp.asarray([pose.get(name, 0.0) for name in self.state_names], jnp.float32)

    def blocked(self, before: StateVector, after: StateVector) -> StateVector:
        """Return the state of a robot that something kept from moving.

        It stays at the position it had, without speed. A disc may still turn.
        """
        kept = ("x", "y") if isinstance(self.footprint, Disc) else ("x", "y", "yaw")
        stays = jnp.asarray([name in kept for name in self.state_names])
        stops = jnp.asarray([name in ("v", "vx", "vy", "vz") for name in self.state_names])
        return jnp.where(stays, before, jnp.where(stops, 0.0, after))


class ContinuousDynamics(Dynamics):
    """A model given by its time derivative, `dx/dt = derivative(x, u)`, and an integrator.

    `step` integrates with the control held constant, then projects onto the states that there are.
    """

    integrator: eqx.AbstractVar[Integrator]

    @abc.abstractmethod
    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (nx,)."""

    def project(self, state: StateVector) -> StateVector:
        """Return the nearest admissible state (nx,): all are, unless a model says otherwise."""
        return state

    def derivative_under(self, control: ControlVector) -> Derivative:
        """Return the derivative for a control that is held, `derivative` unless a model says
        otherwise: one that computes much from its control alone does it here, once for all stages
        of an integrator."""
        return self.derivative

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""
        rate = self.derivative_under(control)
        return self.project(self.integrator(rate, state, control, dt))


class State(eqx.Module):
    """A state with the model that knows what its components mean.

    Costs get this and read `state.position`, `state.heading`, `state.speed` or `state["omega"]`,
    never an index, so that one cost serves every model.
    """

    values: StateVector
    dynamics: Dynamics

    @property
    def position(self) -> Position:
        """Position (x, y) [m]."""
        return self.dynamics.position(self.values)

    @property
    def heading(self) -> Scalar:
        """Heading [rad]."""
        return self.dynamics.heading(self.values)

    @property
    def speed(self) -> Scalar:
        """Forward speed [m/s]."""
        return self.dynamics.speed(self.values)

    def __getitem__(self, name: str) -> Scalar:
        return self.dynamics.component(self.values, name)
