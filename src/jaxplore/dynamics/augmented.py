"""Combine a robot's dynamics with a virtual state, such as the progress along a path."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._types import ArrayLike, ControlVector, Pose, Position, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.footprint import Footprint


class Augmented(Dynamics):
    """A physical and a virtual model side by side, each with its own state and controls:

        x = (x_p, x_v),  u = (u_p, u_v),  x' = (step_p(x_p, u_p, dt), step_v(x_v, u_v, dt))

    Names, bounds and default controls are concatenated, physical part first. Position, heading,
    speed and footprint are those of the physical part. So a cost that reads them works for the
    augmented model as well, and a cost can read any component of either part by its name.

    Args:
        physical: model of the robot.
        virtual: model of the state that is planned beside it, such as a `PathParameter`.

    Raises:
        ValueError: a state component or a control that has the same name in both models.
    """

    physical: Dynamics
    virtual: Dynamics

    @_kinds.check_arguments
    def __init__(self, physical: Dynamics, virtual: Dynamics) -> None:
        for kind in ("state_names", "control_names"):
            both = [name for name in getattr(physical, kind) if name in getattr(virtual, kind)]
            if both:
                raise ValueError(
                    f"{kind} of {type(virtual).__name__} has {both[0]!r}, which "
                    f"{type(physical).__name__} has; accepted: names that differ"
                )
        self.physical = physical
        self.virtual = virtual

    # Properties instead of class variables: the names depend on the two models.
    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's components."""
        return (*self.physical.state_names, *self.virtual.state_names)

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the controls."""
        return (*self.physical.control_names, *self.virtual.control_names)

    # Bounds are computed from the parts, so that a changed part cannot disagree with them.
    @property  # type: ignore[misc]
    def control_min(self) -> ControlVector:  # type: ignore[override]
        """Lower bounds of the controls (nu,)."""
        return jnp.concatenate([self.physical.control_min, self.virtual.control_min])

    @property  # type: ignore[misc]
    def control_max(self) -> ControlVector:  # type: ignore[override]
        """Upper bounds of the controls (nu,)."""
        return jnp.concatenate([self.physical.control_max, self.virtual.control_max])

    @property
    def default_control(self) -> ControlVector:
        """Default control (nu,) of both parts."""
        return jnp.concatenate([self.physical.default_control, self.virtual.default_control])

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs that cover the robot [m]."""
        return self.physical.radius

    @property
    def footprint(self) -> Footprint:
        """Footprint of the robot."""
        return self.physical.footprint

    def split_state(self, state: StateVector) -> tuple[Float[Array, " np"], Float[Array, " nv"]]:
        """Return the physical (np,) and the virtual (nv,) part of a state."""
        size = self.physical.state_size
        return state[:size], state[size:]

    def split_control(
        self, control: ControlVector
    ) -> tuple[Float[Array, " np"], Float[Array, " nv"]]:
        """Return the physical (np,) and the virtual (nv,) part of a control."""
        size = self.physical.control_size
        return control[:size], control[size:]

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""
        state, control, dt = self.check_step(state, control, dt)
        return self.step_at(state, control, jnp.zeros(()), dt)

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after a step of `dt` seconds that begins at time `t` [s]."""
        # The parts do not influence each other within a step; costs couple them.
        parts = (self.physical, self.virtual)
        states, controls = self.split_state(state), self.split_control(control)
        reached = [
            part.step_at(values, given, t, dt)
            for part, values, given in zip(parts, states, controls, strict=True)
        ]
        return jnp.concatenate(reached)

    def position(self, state: StateVector) -> Position:
        """Return the physical part's position (x, y) [m]."""
        return self.physical.position(self.split_state(state)[0])

    def heading(self, state: StateVector) -> Scalar:
        """Return the physical part's heading [rad]."""
        return self.physical.heading(self.split_state(state)[0])

    def speed(self, state: StateVector) -> Scalar:
        """Return the physical part's forward speed [m/s]."""
        return self.physical.speed(self.split_state(state)[0])

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle of the physical model [m]."""
        return self.physical.turning_radius

    @property
    def deceleration(self) -> Scalar:
        """Deceleration of the physical model [m/s^2]."""
        return self.physical.deceleration

    @property
    def can_reverse(self) -> bool:
        """Whether the physical model can drive backwards."""
        return self.physical.can_reverse

    def speed_under(self, state: StateVector, control: ControlVector) -> Scalar:
        """Return the physical part's forward speed [m/s] under its part of a control (nu,)."""
        return self.physical.speed_under(self.split_state(state)[0], self.split_control(control)[0])

    def with_pose(
        self,
        state: StateVector,
        pose: Pose,
        velocity_error: Float[Array, "2"] | None = None,
    ) -> StateVector:
        """Return a state (nx,) with the physical part at another pose; see `Dynamics.with_pose`."""
        physical, virtual = self.split_state(state)
        return jnp.concatenate([self.physical.with_pose(physical, pose, velocity_error), virtual])

    def at_pose(self, x: float, y: float, yaw: float) -> StateVector:
        """Return the state of a robot at rest at a pose, with the virtual state at zero."""
        return jnp.concatenate(
            [self.physical.at_pose(x, y, yaw), jnp.zeros(self.virtual.state_size)]
        )

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (nu,) that brakes the physical part hardest."""
        parts, states = (self.physical, self.virtual), self.split_state(state)
        return jnp.concatenate(
            [
                part.stopping_control(values, dt, turn)
                for part, values in zip(parts, states, strict=True)
            ]
        )

    def resolve_collision(self, before: StateVector, after: StateVector) -> StateVector:
        """Return the state after a collision stopped the robot; the virtual state moves on."""
        stopped = self.physical.resolve_collision(
            self.split_state(before)[0], self.split_state(after)[0]
        )
        return jnp.concatenate([stopped, self.split_state(after)[1]])
