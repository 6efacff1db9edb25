"""What a robot's model is, and how costs read its state."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxplore._types import ControlVector, Position, Scalar, StateVector


class Dynamics(eqx.Module):
    """A robot's discrete-time model, `state' = step(state, control, dt)`.

    Written for one robot and one step; the engine maps it over samples and time. A model says its
    `state_names` and `control_names`, its control bounds, the radius of the disc that holds it and
    `step`. Position, heading and speed are found among the state's names (`x`, `y`, `yaw`, `v`);
    a model that names or computes them otherwise gives its own accessors.
    """

    state_names: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]

    control_min: eqx.AbstractVar[ControlVector]
    control_max: eqx.AbstractVar[ControlVector]
    radius: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""

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

        It stays at the position it had, without speed; it may still turn.
        """
        stays = jnp.asarray([name in ("x", "y") for name in self.state_names])
        stops = jnp.asarray([name == "v" for name in self.state_names])
        return jnp.where(stays, before, jnp.where(stops, 0.0, after))


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
