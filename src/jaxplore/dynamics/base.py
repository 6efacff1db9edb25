"""Define the interface of dynamics models, and how costs read a state."""

import abc
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._types import ArrayLike, ControlVector, Pose, Position, Scalar, StateVector, Twist
from jaxplore._xla import compute
from jaxplore.dynamics.integrators import Derivative, Integrator
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.footprint import Disc, Footprint

BRAKED_SPEED, BRAKED_TIME = 0.1, 1e-3
"""Speed [m/s] and time [s] at which the deceleration of a model is measured."""
LEAST_DECELERATION = 1e-3
"""Deceleration below which a model does not brake [m/s^2]."""


class Dynamics(eqx.Module):
    """Discrete-time model of a robot, `state' = step(state, control, dt)`; abstract.

    Write it for one robot and one step; the controller maps it over samples and time. A subclass
    provides `state_names`, `control_names`, the control bounds, `step`, and the `radius` of a disc
    around the position that contains the robot. Position, heading and speed are the components
    named `x`, `y`, `yaw` and `v`; a model without these names overrides the accessors. A robot with
    another shape than a disc overrides `footprint`; `radius` is then the radius of the discs that
    cover the footprint. A model given by its time derivative is a `ContinuousDynamics`.
    """

    state_names: ClassVar[tuple[str, ...]]
    control_names: ClassVar[tuple[str, ...]]

    control_min: eqx.AbstractVar[ControlVector]
    control_max: eqx.AbstractVar[ControlVector]
    radius: eqx.AbstractVar[Scalar]

    def __check_init__(self) -> None:
        for name in ("state_names", "control_names"):
            kind, hint = type(self).__name__, "such as ('x', 'y')"
            _kinds.instance(f"{name} of {kind}", getattr(self, name, None), tuple, list, hint=hint)

    @abc.abstractmethod
    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""

    def step_at(
        self, state: StateVector, control: ControlVector, t: Scalar, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after a step of `dt` seconds that begins at time `t` [s].

        Rollouts call this method, with t = 0 at the start of the horizon. The default calls `step`;
        only models that depend on time override it.
        """
        return self.step(state, control, dt)

    @property
    def default_control(self) -> ControlVector:
        """Control (nu,) with which a control sequence is initialised and extended.

        It is zero, clipped to the bounds. A model for which zero is a bad idle control overrides
        it: a quadrotor hovers.
        """
        return jnp.clip(jnp.zeros(self.control_size), self.control_min, self.control_max)

    @property
    def control_half_range(self) -> ControlVector:
        """Half the width of the control range (nu,), a natural scale for sampling noise."""
        return compute(lambda _, low, high: 0.5 * (high - low), self.control_min, self.control_max)

    @property
    def footprint(self) -> Footprint:
        """Footprint of the robot on the ground; by default a disc of its radius."""
        return Disc(self.radius)

    def __repr__(self) -> str:
        return describe_fields(self)

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

    def pose(self, state: StateVector) -> Pose:
        """Return the pose (x, y, yaw) [m, m, rad]."""
        return jnp.concatenate([self.position(state), self.heading(state)[None]])

    def speed(self, state: StateVector) -> Scalar:
        """Return the forward speed [m/s]."""
        return self.component(state, "v")

    def speed_under(self, state: StateVector, control: ControlVector) -> Scalar:
        """Return the forward speed [m/s] at a state (nx,) that a control (nu,) leads to.

        Costs read it. The default is `speed` of the state. A model whose speed is a control
        overrides it.
        """
        return self.speed(state)

    def twist(self, state: StateVector, control: ControlVector) -> Twist:
        """Return the velocity (vx, vy, omega) in the body frame [m/s, m/s, rad/s].

        It is the time derivative of the pose under a control (nu,), turned into the frame of the
        heading: vx is forwards and vy is to the left of the heading, or to the right if z points
        down.

        Args:
            state: state (nx,) of the robot.
            control: control (nu,), which matters to a model whose controls are velocities.
        """
        pose, (x_rate, y_rate, turn_rate) = jax.jvp(
            lambda dt: self.pose(self.step(state, control, dt)),
            (jnp.zeros((), state.dtype),),
            (jnp.ones((), state.dtype),),
        )
        sin, cos = sin_cos(pose[2])
        return jnp.stack([cos * x_rate + sin * y_rate, cos * y_rate - sin * x_rate, turn_rate])

    def acceleration(self, state: StateVector, control: ControlVector) -> tuple[Scalar, Scalar]:
        """Return the acceleration in the body frame, along the heading and to the left [m/s^2].

        With the twist (vx, vy, omega) of `twist` it is `(vx' - omega vy, vy' + omega vx)`, with the
        rates of change under a constant control.

        Args:
            state: state (nx,) of the robot.
            control: control (nu,).
        """
        zero, one = jnp.zeros((), state.dtype), jnp.ones((), state.dtype)
        _, rate = jax.jvp(lambda dt: self.step(state, control, dt), (zero,), (one,))
        twist, twist_rate = jax.jvp(lambda here: self.twist(here, control), (state,), (rate,))
        ahead, left, turn_rate = twist
        return twist_rate[0] - turn_rate * left, twist_rate[1] + turn_rate * ahead

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle that its position can drive [m]; 0 by default, for a robot
        that turns on the spot."""
        return jnp.zeros(())

    @property
    def can_reverse(self) -> bool:
        """Whether it can drive backwards; true by default."""
        return True

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (nu,) that brakes hardest over the next `dt` seconds.

        Applied again and again it brings the robot to rest and keeps it there. The default is
        `default_control`, which stops a robot whose controls are velocities.

        Args:
            state: state (nx,) of the robot.
            dt: time for which the control is applied [s].
            turn: share of the turning bound, in [-1, 1], that the robot turns with while it moves;
                positive turns counter-clockwise. 0 brings the turn rate to zero.
        """
        return self.default_control

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the robot can be brought to rest along its heading [m/s^2].

        From a speed v it needs v^2 / (2 deceleration) [m]. It is infinite for a robot whose speed
        is a control, and for one that `stopping_control` does not brake. By default it is what
        `stopping_control` brings about at a low speed v.
        """
        if "v" not in self.state_names:
            return jnp.full((), jnp.inf)
        speed, dt = jnp.asarray(BRAKED_SPEED, jnp.float32), jnp.asarray(BRAKED_TIME, jnp.float32)
        state = self.with_component(self.at_pose(0.0, 0.0, 0.0), "v", speed)
        slower = self.step(state, self.stopping_control(state, dt), dt)
        found = (speed - self.component(slower, "v")) / dt
        return jnp.where(found > LEAST_DECELERATION, found, jnp.inf)

    def component(self, state: StateVector, name: str) -> Scalar:
        """Return the state component with a name.

        Raises:
            ValueError: a name that is not among `state_names`.
        """
        if name not in self.state_names:
            raise ValueError(
                f"{type(self).__name__} has no state component {name!r}; "
                f"accepted: {', '.join(self.state_names)}"
            )
        return state[self.state_names.index(name)]

    def with_component(self, state: StateVector, name: str, value: ArrayLike) -> StateVector:
        """Return a state (nx,) with another value of the state component with a name."""
        is_it = np.array([each == name for each in self.state_names])
        return compute(
            lambda xp, state, value: xp.where(is_it, xp.asarray(value, state.dtype), state),
            state,
            value,
        )

    def with_pose(
        self,
        state: StateVector,
        pose: Pose,
        velocity_error: Float[Array, "2"] | None = None,
    ) -> StateVector:
        """Return a state (nx,) at another pose, with the velocity turned with the yaw.

        The default sets the components named `x`, `y` and `yaw`, for a model whose speeds are in
        its own frame. A model with a velocity in the world, or with another attitude, overrides it.

        Args:
            state: state (nx,) of the robot.
            pose: the other pose (x, y, yaw) [m, m, rad].
            velocity_error: error (2,) that is added to a velocity which the robot does not measure,
                in the frame of its heading [m/s]; the default takes speeds as measured.
        """
        for name, value in zip(("x", "y", "yaw"), jnp.unstack(pose), strict=True):
            if name in self.state_names:
                state = self.with_component(state, name, value)
        return state

    def at_pose(self, x: float, y: float, yaw: float) -> StateVector:
        """Return the state of a robot at rest at a pose (x, y, yaw) [m, m, rad].

        Raises:
            ValueError: a component that is not one number.
        """
        pose = {"x": x, "y": y, "yaw": yaw}
        for name, value in pose.items():
            _checks.of_shape(name, value, ())
        return as_state(*(pose.get(name, 0.0) for name in self.state_names))

    def check_step(
        self, state: StateVector, control: ControlVector, dt: Scalar
    ) -> tuple[StateVector, ControlVector, Scalar]:
        """Return the arguments of `step`, lists as arrays, if their shapes are right.

        The models of the library call it. Only shapes are checked, so that it costs nothing in a
        compiled program.

        Raises:
            ValueError: a state or a control of another size, a `dt` that is not one number.
        """
        vectors = []
        for name, value, names in (
            ("state", state, self.state_names),
            ("control", control, self.control_names),
        ):
            accepted = f"{len(names)} numbers: {', '.join(names)}"
            vectors.append(_checks.of_shape(name, value, (len(names),), accepted=accepted))
        return vectors[0], vectors[1], _checks.of_shape("dt", dt, ())

    def resolve_collision(self, before: StateVector, after: StateVector) -> StateVector:
        """Return the state after a collision stopped the robot.

        The robot keeps its position and loses its speed. A disc may still turn; any other footprint
        keeps its yaw as well, because turning would move its outline.

        Args:
            before: state (nx,) before the step.
            after: state (nx,) after the step, which collides.
        """
        # Select by masks instead of branches: the method is traced.
        kept = ("x", "y") if isinstance(self.footprint, Disc) else ("x", "y", "yaw")
        stays = jnp.asarray([name in kept for name in self.state_names])
        stops = jnp.asarray([name in ("v", "vx", "vy", "vz") for name in self.state_names])
        return jnp.where(stays, before, jnp.where(stops, 0.0, after))

    if not TYPE_CHECKING:  # for type checkers any attribute could be set

        def __setattr__(self, name: str, value: Any) -> None:
            _kinds.check_annotation(self, name)
            super().__setattr__(name, value)


class ContinuousDynamics(Dynamics):
    """Model given by its time derivative, `dx/dt = derivative(x, u)`, and an integrator; abstract.

    `step` integrates with a constant control, then projects the state onto the admissible states.
    """

    integrator: eqx.AbstractVar[Integrator]

    @abc.abstractmethod
    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return the time derivative of the state, dx/dt (nx,)."""

    def project(self, state: StateVector) -> StateVector:
        """Return the nearest admissible state (nx,); by default every state is admissible."""
        return state

    def derivative_under(self, control: ControlVector) -> Derivative:
        """Return the derivative function for a control that is constant during the step.

        The default returns `derivative`. A model overrides it to compute what depends on the
        control alone once, instead of once per stage of the integrator.
        """
        return self.derivative

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,).

        Raises:
            ValueError: a state or a control of another size, a `dt` that is not one number.
        """
        state, control, dt = self.check_step(state, control, dt)
        rate = self.derivative_under(control)
        return self.project(self.integrator(rate, state, control, dt))


class State(eqx.Module):
    """State vector together with the model that names its components.

    Costs receive it and read `state.position`, `state.heading`, `state.speed` or `state["omega"]`
    instead of an index, so that one cost works for every model.

    Args:
        values: state (nx,).
        dynamics: model of the robot.
        control: control (nu,) that led to the state, where one is known. `speed` reads it for a
            model whose speed is a control, such as `Unicycle`.
    """

    values: StateVector
    dynamics: Dynamics
    control: ControlVector | None = None

    @property
    def position(self) -> Position:
        """Position (x, y) [m]."""
        return self.dynamics.position(self.values)

    def place(self, dimensions: int) -> Float[Array, " D"]:
        """Return the position as a field of so many dimensions has it: (x, y), or (x, y, z) [m].

        Fields have z up, models with `z` have it down.
        """
        if dimensions == 2:
            return self.position
        return jnp.stack([self["x"], self["y"], -self["z"]])

    @property
    def heading(self) -> Scalar:
        """Heading [rad]."""
        return self.dynamics.heading(self.values)

    @property
    def speed(self) -> Scalar:
        """Forward speed [m/s]."""
        if self.control is None:
            return self.dynamics.speed(self.values)
        return self.dynamics.speed_under(self.values, self.control)

    @property
    def squared_speed(self) -> Scalar:
        """Square of the speed in any direction on the ground [m^2/s^2]."""
        if {"vx", "vy"} <= set(self.dynamics.state_names):
            vx, vy = self["vx"], self["vy"]
            return vx * vx + vy * vy
        return self.speed * self.speed

    @property
    def stopping_distance(self) -> Scalar:
        """Distance in which the robot comes to rest [m]: v^2 / (2 `deceleration`)."""
        return self.squared_speed / (2.0 * self.dynamics.deceleration)

    def __getitem__(self, name: str) -> Scalar:
        return self.dynamics.component(self.values, name)


def as_state(*components: float) -> StateVector:
    """Return numbers as a state (nx,)."""
    return compute(lambda xp, *each: xp.stack(each).astype(xp.float32), *components)
