"""Combine the dynamics of several robots into one model of all of them."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._types import ControlVector, Position, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.footprint import Footprint, Rectangle


class Formation(Dynamics):
    """Several robots side by side, each with its own state and controls:

        x = (x_1, ..., x_N),  u = (u_1, ..., u_N),  x_i' = step_i(x_i, u_i, dt)

    Names get the number of their robot: `x_1` is the x of the first. Position, heading, speed and
    footprint are those of the first robot.

    Args:
        robots: models of the robots, at least one.

    Raises:
        ValueError: no robots, something else than a model.
    """

    robots: tuple[Dynamics, ...]

    @_kinds.check_arguments
    def __init__(self, robots: Sequence[Dynamics]) -> None:
        if not len(robots):
            raise ValueError("robots is empty; accepted: at least one")
        self.robots = tuple(robots)

    # Properties instead of class variables: the names depend on the robots.
    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the state's components."""
        return _number_names([robot.state_names for robot in self.robots])

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the controls."""
        return _number_names([robot.control_names for robot in self.robots])

    @property  # type: ignore[misc]
    def control_min(self) -> ControlVector:  # type: ignore[override]
        """Lower bounds of the controls (nu,)."""
        return jnp.concatenate([robot.control_min for robot in self.robots])

    @property  # type: ignore[misc]
    def control_max(self) -> ControlVector:  # type: ignore[override]
        """Upper bounds of the controls (nu,)."""
        return jnp.concatenate([robot.control_max for robot in self.robots])

    @property
    def default_control(self) -> ControlVector:
        """Default controls (nu,) of all robots."""
        return jnp.concatenate([robot.default_control for robot in self.robots])

    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs that cover the first robot [m]."""
        return self.robots[0].radius

    @property
    def footprint(self) -> Footprint:
        """Footprint of the first robot."""
        return self.robots[0].footprint

    def split_state(self, state: Float[Array, "*A nx"]) -> tuple[Float[Array, "*A n"], ...]:
        """Return the state of each robot, of states along the last axis."""
        return _split(state, [robot.state_size for robot in self.robots])

    def split_control(self, control: Float[Array, "*A nu"]) -> tuple[Float[Array, "*A n"], ...]:
        """Return the control of each robot, of controls along the last axis."""
        return _split(control, [robot.control_size for robot in self.robots])

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (nx,) after `dt` seconds under a control (nu,)."""
        state, control, dt = self.check_step(state, control, dt)
        parts = zip(self.robots, self.split_state(state), self.split_control(control), strict=True)
        return jnp.concatenate([robot.step(x, u, dt) for robot, x, u in parts])

    def position(self, state: StateVector) -> Position:
        """Return the position (x, y) of the first robot [m]."""
        return self.robots[0].position(self.split_state(state)[0])

    def heading(self, state: StateVector) -> Scalar:
        """Return the heading of the first robot [rad]."""
        return self.robots[0].heading(self.split_state(state)[0])

    def speed(self, state: StateVector) -> Scalar:
        """Return the forward speed of the first robot [m/s]."""
        return self.robots[0].speed(self.split_state(state)[0])

    def positions(self, state: StateVector) -> Float[Array, "N 2"]:
        """Return the positions (x, y) of all robots (N, 2) [m]."""
        states = zip(self.robots, self.split_state(state), strict=True)
        return jnp.stack([robot.position(each) for robot, each in states])


def extent(footprint: Footprint) -> float:
    """Return the radius of the circle around a robot's position that holds its footprint [m]."""
    if isinstance(footprint, Rectangle):
        ahead = max(float(footprint.front), float(footprint.rear))
        return math.hypot(ahead, 0.5 * float(footprint.width))
    return float(np.max(np.abs(footprint.offsets))) + float(footprint.radius)


def _number_names(names: Sequence[Sequence[str]]) -> tuple[str, ...]:
    return tuple(f"{name}_{number}" for number, each in enumerate(names, 1) for name in each)


def _split(values: Array, sizes: Sequence[int]) -> tuple[Array, ...]:
    return tuple(jnp.split(values, np.cumsum(sizes)[:-1].tolist(), axis=-1))
