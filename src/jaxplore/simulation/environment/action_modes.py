"""Meanings of an environment's action: a control, or a waypoint."""

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Key, Position, Scalar, StateVector
from jaxplore.belief.guidance import GuidanceField
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.trajectory import Trajectory
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.angles import sin_cos
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.state import Moment

ActionVector = Float[Array, "A"]


class ActionMode(eqx.Module):
    """The meaning of an action (A,): a conversion to a controller that carries it out.

    All controllers of a mode have states of the same structure, so that one can continue from the
    state of another.
    """

    @property
    @abc.abstractmethod
    def low(self) -> ActionVector:
        """Lower bounds (A,) of an action."""

    @property
    @abc.abstractmethod
    def high(self) -> ActionVector:
        """Upper bounds (A,) of an action."""

    @property
    @abc.abstractmethod
    def initial_controller(self) -> Controller:
        """Controller that gives the initial controller state."""

    @abc.abstractmethod
    def controller(
        self, action: ActionVector, moment: Moment, belief: Any, scenario: Scenario
    ) -> Controller:
        """Make the controller that carries out an action.

        Args:
            action: (A,) action, clipped to its bounds.
            moment: time at which the action begins, and the observed state.
            belief: the robot's belief.
            scenario: scenario in which the robot acts.
        """

    @abc.abstractmethod
    def at_period(self, control_period: ArrayLike) -> "ActionMode":
        """Return this mode for commands that are `control_period` seconds apart."""


class ControlMode(ActionMode):
    """An action is a control of the robot, held until the next action.

    Args:
        robot: model of the robot.
    """

    robot: Dynamics

    def __check_init__(self) -> None:
        _kinds.instance("robot", self.robot, Dynamics)

    @property
    def low(self) -> ActionVector:
        """Lower bounds (nu,) of the robot's controls."""
        return self.robot.control_min

    @property
    def high(self) -> ActionVector:
        """Upper bounds (nu,) of the robot's controls."""
        return self.robot.control_max

    @property
    def initial_controller(self) -> Controller:
        """Controller that holds the default control."""
        return Hold(self.robot.default_control)

    def controller(
        self, action: ActionVector, moment: Moment, belief: Any, scenario: Scenario
    ) -> Controller:
        """Make the controller that holds this control."""
        return Hold(jnp.clip(action, self.low, self.high))

    def at_period(self, control_period: ArrayLike) -> "ControlMode":
        """Return this mode unchanged: it does not depend on the period."""
        return self


class WaypointMode(ActionMode):
    """An action is a waypoint (x, y) in the robot's frame, ahead and to the left [m].

    A controller drives there along the shortest path through cells that are not known to be
    occupied, by the map at the time of the action: see `goal_field`. If the waypoint is in a wall,
    the robot drives as near to it as possible.

    Args:
        drive: controller that drives; its costs read `Belief.to_goal`, see `waypoint_mppi`.
        reach: greatest x and y of an action [m].

    Raises:
        ValueError: a reach that is not positive.
    """

    drive: Controller
    reach: Scalar

    @_kinds.check_arguments
    def __init__(self, drive: Controller, reach: ArrayLike = 3.0) -> None:
        self.drive = drive
        self.reach = _checks.scalar("reach", reach, above=0.0)

    @property
    def low(self) -> ActionVector:
        """Lower bounds (2,): minus the reach."""
        return jnp.stack([-self.reach, -self.reach])

    @property
    def high(self) -> ActionVector:
        """Upper bounds (2,): the reach."""
        return jnp.stack([self.reach, self.reach])

    @property
    def initial_controller(self) -> Controller:
        """Controller that drives."""
        return self.drive

    def controller(
        self, action: ActionVector, moment: Moment, belief: Any, scenario: Scenario
    ) -> Controller:
        """Make the controller that drives to this waypoint."""
        if not isinstance(scenario, ExplorationScenario):
            raise ValueError(
                f"mode is a WaypointMode in a {type(scenario).__name__}; accepted: ControlMode, or "
                "an ExplorationScenario, whose map leads to waypoints"
            )
        pose, perception = scenario.robot.pose(moment.observed), scenario.perception
        ahead, left = jnp.clip(action, self.low, self.high)
        sin, cos = sin_cos(pose[2])
        offset = jnp.stack([cos * ahead - sin * left, sin * ahead + cos * left])
        # The field has the parameters of the belief's guidance, so costs read both alike.
        waypoint = pose[:2] + offset
        closed = perception.find_forbidden(belief)
        way = perception.way_to(waypoint, belief.grid, pose, closed=closed)
        return WaypointController(self.drive, way, waypoint)

    def at_period(self, control_period: ArrayLike) -> "WaypointMode":
        """Return this mode for commands that are `control_period` seconds apart."""
        return WaypointMode(self.drive.at_period(control_period), self.reach)


class Hold(Controller):
    """Controller that holds one control (nu,)."""

    control: ControlVector

    def init(self) -> tuple[()]:
        """Return an empty state."""
        return ()

    def step(
        self, state: tuple[()], observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, tuple[()], Info]:
        """Return the held control."""
        return self.control, state, Info.of_law(self.control)

    def inspect(
        self,
        state: tuple[()],
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return a plan that stays at the observed state, because the controller has no model."""
        still = jnp.stack([observation, observation])
        alone = Trajectory(still, self.control[None], {})
        return SampledPlan(alone, alone, still[None], jnp.ones(1))

    def at_period(self, control_period: ArrayLike) -> "Hold":
        """Return this controller unchanged: it does not depend on the period."""
        return self


class WaypointController(Controller):
    """Wrapper of a controller that adds a cost to go to the belief.

    `way` is the cost to go to the waypoint [m], which replaces `Belief.to_goal`. `waypoint` is its
    position (x, y) [m], which replaces `Belief.goal`.
    """

    drive: Controller
    way: GuidanceField
    waypoint: Position

    def init(self) -> Any:
        """Return the state of the controller before the first step."""
        return self.drive.init()

    def step(
        self, state: Any, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, Any, Info]:
        """Return the control, the controller's new state and its diagnostics."""
        guided = self._guide(belief)
        return self.drive.step(state, observation, guided, key=key)

    def inspect(
        self,
        state: Any,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the sampled plan of `step` with the same arguments."""
        guided = self._guide(belief)
        return self.drive.inspect(
            state, observation, guided, key=key, num_trajectories=num_trajectories
        )

    def at_period(self, control_period: ArrayLike) -> "WaypointController":
        """Return this controller for commands that are `control_period` seconds apart."""
        return WaypointController(self.drive.at_period(control_period), self.way, self.waypoint)

    def _guide(self, belief: Any) -> Any:
        return dataclasses.replace(belief, to_goal=self.way, goal=self.waypoint, goal_heading=None)
