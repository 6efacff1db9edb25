"""What a pilot drives for: a task says when the robot waits and when it is done."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxplore._types import Position
from jaxplore._xla import on_device
from jaxplore.belief.exploration_field import leads_to_information
from jaxplore.belief.perception import Perception
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal import GOAL_RADIUS, STANDING, Goal, Motion

LOST_SECONDS = 10.0
"""Time without a way back after which a robot gives it up [s]."""
NOTHING_LEFT = "no place that is worth a visit is reachable"


class TaskControl(NamedTuple):
    """The controller, the model, and the state (nx,) to which the last command leads."""

    controller: Controller
    robot: Dynamics
    expected: np.ndarray


class DriveTask:
    """What a pilot drives for; by default a drive that nothing ends.

    Args:
        perception: perception of the pilot.
    """

    has_fields = True
    """Whether the controller reads the information and guidance fields."""

    def __init__(self, perception: Perception) -> None:
        self.perception = perception
        self.is_done = False

    def prepare(self, driver: TaskControl) -> None:
        """Compile what `update_control` calls."""

    def update_control(
        self, driver: TaskControl, offset: np.ndarray, place: np.ndarray
    ) -> TaskControl:
        """Return what drives the robot from now on; the same if nothing has changed.

        Args:
            driver: what has driven it so far.
            offset: (2,) position of the origin of the belief in the frame of the odometry [m].
            place: (2,) position relative to that origin [m].
        """
        return driver

    def waits_for(self, pose: np.ndarray, motion: Motion = STANDING) -> str:
        """Return why the robot stands; empty if it drives.

        Args:
            pose: (3,) pose relative to the origin of the belief [m, m, rad].
            motion: how fast it moves.
        """
        return ""

    @property
    def reference(self) -> np.ndarray:
        """Points (N, 2) that pictures show as the reference [m]; none by default."""
        return np.zeros((0, 2), np.float32)

    def set_home(self, place: np.ndarray) -> None:
        """Set where the robot drives back to.

        Args:
            place: (2,) position relative to the origin of the belief [m].
        """

    def check_return(self) -> None:
        """Check that the robot can be told to drive back to its start.

        Raises:
            ValueError: it cannot.
        """
        raise ValueError(
            "the robot cannot drive back to its start; accepted: in the mode control with the "
            "architecture explorer, which follows the guidance field"
        )

    def go_to(self, now: float, place: np.ndarray) -> None:
        """Drive to a place from now on, and stand there until another order.

        Args:
            now: present time [s].
            place: (2,) position relative to the origin of the belief [m].

        Raises:
            ValueError: as of `check_return`.
        """
        self.check_return()

    def turn_back(self, now: float, reason: str) -> None:
        """Drive back to the start from now on.

        Args:
            now: present time [s].
            reason: why, in a few words.

        Raises:
            ValueError: as of `check_return`.
        """
        self.check_return()

    def go_on(self) -> None:
        """Go on with the task, also after the robot was told to turn back."""

    def update(
        self,
        now: float,
        cost: float,
        place: np.ndarray,
        *,
        is_started: bool,
        motion: Motion = STANDING,
    ) -> str:
        """Take note of new fields; return why the drive is done, empty if it goes on.

        Args:
            now: present time [s].
            cost: cost-to-go of the guidance field at the robot [m].
            place: (2,) position relative to the origin of the belief [m].
            is_started: whether the robot may explore.
            motion: how fast it moves.
        """
        return ""


class Exploring(DriveTask):
    """Exploration until no place is worth a visit, and then the way back if it is wanted.

    With a part for which places must be seen again, such as on a patrol, it does not end by itself.

    The way back is that of the guidance field, whose only source is the start once the map counts
    as explored. That needs a perception whose goal is the start.

    Args:
        perception: perception of the pilot.
        done_after: time without a place that is worth a visit after which the robot is done [s].
        returns: whether it then drives back to its start.

    Raises:
        ValueError: `returns` with a perception without a goal.
    """

    def __init__(self, perception: Perception, done_after: float, *, returns: bool = False) -> None:
        super().__init__(perception)
        self._done_after, self._returns = done_after, returns
        self._worth_at = -math.inf
        self._way_at: float | None = None
        self._reason = self._waits = ""
        self._home = perception.goal
        self._is_visiting = False
        self._is_endless = any(part.is_patrol for part in perception.parts)
        if perception.goal is not None:
            # The share of unknown cells below which only the goal counts, so that both ways of
            # driving share a program: never, and always.
            self.perception = _with_max_unknown(perception, 0.0)
        if returns:
            self.check_return()

    def set_home(self, place: np.ndarray) -> None:
        """Set where the robot drives back to."""
        if self._home is not None:
            self._home = on_device(np.asarray(place, np.float32))
            self.perception = _with_goal(self.perception, self._home)

    @property
    def is_returning(self) -> bool:
        """Whether the robot drives back to its start."""
        return self._way_at is not None

    def check_return(self) -> None:
        """Check that the robot can be told to drive back to its start."""
        if self.perception.goal is None:
            super().check_return()

    def go_to(self, now: float, place: np.ndarray) -> None:
        """Drive to a place from now on, and stand there until another order."""
        self.check_return()
        self._way_at, self._is_visiting, self._waits = now, True, ""
        goal = on_device(np.asarray(place, np.float32))
        self.perception = _with_max_unknown(_with_goal(self.perception, goal), 1.0)

    def waits_for(self, place: np.ndarray, motion: Motion = STANDING) -> str:
        """Return why the robot stands; empty if it drives."""
        return self._waits

    def turn_back(self, now: float, reason: str) -> None:
        """Drive back to the start from now on."""
        self.check_return()
        if not self.is_returning or self._is_visiting:
            self._way_at, self._reason, self._is_visiting, self._waits = now, reason, False, ""
            assert self._home is not None
            self.perception = _with_max_unknown(_with_goal(self.perception, self._home), 1.0)

    def go_on(self) -> None:
        """Explore, also after the robot was told to turn back."""
        if self.is_returning:
            self._way_at, self._worth_at = None, -math.inf
            self._is_visiting, self._waits = False, ""
            assert self._home is not None
            self.perception = _with_max_unknown(_with_goal(self.perception, self._home), 0.0)

    def update(
        self,
        now: float,
        cost: float,
        place: np.ndarray,
        *,
        is_started: bool,
        motion: Motion = STANDING,
    ) -> str:
        """Take note of new fields; return why the drive is done, empty if it goes on."""
        if self.is_returning:
            return self._update_return(now, cost, place, motion)
        has_worth = leads_to_information(cost)
        # Before the first scans nothing is known, and a map that does not grow is not a reason.
        is_waiting = self._is_endless or not math.isfinite(self._worth_at)
        if has_worth or not is_started or is_waiting:
            self._worth_at = now
        elif now - self._worth_at > self._done_after:
            self.is_done = True
            if not self._returns:
                return NOTHING_LEFT
            self.turn_back(now, NOTHING_LEFT)
        return ""

    def _update_return(self, now: float, cost: float, place: np.ndarray, motion: Motion) -> str:
        end = Goal(np.asarray(self.perception.goal), GOAL_RADIUS)
        if end.is_reached(place, motion):
            if not self._is_visiting:
                return f"{self._reason}; the robot is back at its start"
            self._waits = "at the goal"
        assert self._way_at is not None
        if math.isfinite(cost):
            self._way_at = now
        elif now - self._way_at > LOST_SECONDS:
            if not self._is_visiting:
                return f"{self._reason}; no way back to the start is known"
            self._waits = "no way to the goal is known"
        return ""


def _with_goal(perception: Perception, goal: Position) -> Perception:
    changed: Perception = eqx.tree_at(lambda each: each.goal, perception, goal)
    return changed


def _with_max_unknown(perception: Perception, share: float) -> Perception:
    changed: Perception = eqx.tree_at(
        lambda each: each.max_unknown, perception, jnp.asarray(share, jnp.float32)
    )
    return changed
