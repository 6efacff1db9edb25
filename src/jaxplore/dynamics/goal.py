"""When a goal is reached: the one definition of all tasks, in simulation and on a robot."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxplore import _checks
from jaxplore._describe import describe
from jaxplore._types import ArrayLike, Scalar, Vector
from jaxplore.dynamics.base import Dynamics

GOAL_RADIUS = 0.15
"""Distance from a goal within which it is reached [m]."""
GOAL_TOLERANCE = 0.1
"""Greatest error of the heading at a goal that has one [rad]."""
GOAL_SPEED = 0.05
"""Speed up to which a robot is at rest [m/s]."""
ARM = 0.5
"""Distance from the robot's centre that moves no faster than that, for turns [m]."""


class Motion(NamedTuple):
    """How fast a robot moves: its speed, in any direction [m/s], and its turn rate [rad/s]."""

    # Numbers of a robot, or arrays of a simulation.
    speed: Any
    turn_rate: Any

    @classmethod
    def between(cls, robot: Dynamics, before: Any, after: Any, dt: Scalar) -> "Motion":
        """Return the mean motion over a step of `dt` [s] between two states (nx,)."""
        moved = robot.position(after) - robot.position(before)
        squared = jnp.sum(moved * moved)
        if "z" in robot.state_names:
            climbed = robot.component(after, "z") - robot.component(before, "z")
            squared = squared + climbed * climbed
        names = set(robot.state_names)
        if {"vx", "vy"} <= names and not {"yaw", "qw"} & names:
            # The heading of a point mass is its direction of travel, and jumps where it stands.
            return cls(jnp.sqrt(squared) / dt, jnp.zeros(()))
        turn = robot.heading(after) - robot.heading(before)
        # The shortest turn: an attitude has no full turns.
        turned = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
        return cls(jnp.sqrt(squared) / dt, turned / dt)

    def is_within(self, speed: Any) -> Any:
        """Check whether the robot is no faster than a speed [m/s], nor what is 0.5 m away from its
        centre by its turn."""
        return (abs(self.speed) <= speed) & (ARM * abs(self.turn_rate) <= speed)


STANDING = Motion(0.0, 0.0)
"""Motion of a robot that stands."""


class Goal(NamedTuple):
    """A goal, and when a robot has reached it.

    It has if its position is within `radius`, its heading, where the goal has one, within
    `tolerance`, and if it is at rest: no faster than `speed`, and turning by no more than
    `speed / 0.5 m`, which is 0.1 rad/s by default.

    Args:
        position: position (x, y) of the goal, in a volume (x, y, z) with z up [m].
        radius: distance within which the goal is reached by a robot at rest [m].
        heading: heading at the goal [rad]; any when absent.
        tolerance: greatest error of the heading at the goal [rad].
        speed: speed up to which the robot is at rest at the goal [m/s].
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map is explored, so
            that the goal ends an exploration; when absent 0.05, or 1 for a goal apart, which then
            needs no explored map. Volumes have none.
    """

    # Numbers of a robot, or arrays of a simulation.
    position: Any
    radius: Any = GOAL_RADIUS
    heading: Any = None
    tolerance: Any = GOAL_TOLERANCE
    speed: Any = GOAL_SPEED
    max_unknown: Any = None

    @classmethod
    def of(
        cls,
        position: Vector,
        radius: ArrayLike = GOAL_RADIUS,
        heading: ArrayLike | None = None,
        tolerance: ArrayLike = GOAL_TOLERANCE,
        speed: ArrayLike = GOAL_SPEED,
        max_unknown: ArrayLike | None = None,
        dimensions: int = 2,
    ) -> "Goal":
        """Make a goal of finite numbers; radius, tolerance and speed are positive."""
        return cls(
            _checks.vector("goal", position, dimensions),
            _checks.scalar("goal_radius", radius, above=0.0),
            None if heading is None else _checks.scalar("goal_heading", heading),
            _checks.scalar("goal_tolerance", tolerance, above=0.0),
            _checks.scalar("goal_speed", speed, above=0.0),
            None
            if max_unknown is None
            else _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0),
        )

    @classmethod
    def check(cls, goal: "Vector | Goal", dimensions: int = 2) -> "Goal":
        """Return a goal of finite numbers, from a position with the defaults or from a goal."""
        given = goal._asdict() if isinstance(goal, cls) else {"position": goal}
        return cls.of(**given, dimensions=dimensions)

    def __repr__(self) -> str:
        given = {name: each for name, each in self._asdict().items() if each is not None}
        texts = [f"{name}={describe(each)}" for name, each in given.items()]
        return f"Goal({', '.join(texts)})"

    def is_at(self, position: Any) -> Any:
        """Check whether a position, with the goal's number of components, is within the radius."""
        offset = position[: len(self.position)] - self.position
        return (offset * offset).sum() < self.radius * self.radius

    def is_reached(self, pose: Any, motion: Motion) -> Any:
        """Check whether a robot has reached the goal.

        `pose` is the position [m] and the yaw [rad], or the position alone where any heading is
        right.
        """
        there = self.is_at(pose) & motion.is_within(self.speed)
        if self.heading is None:
            return there
        xp = np if isinstance(pose, np.ndarray) else jnp
        return there & (xp.cos(pose[len(self.position)] - self.heading) >= xp.cos(self.tolerance))
