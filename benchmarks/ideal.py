"""Explorers without dynamics: a point that moves down its guidance at full speed.

They are the ideal of what a rule can drive. The difference to a robot with dynamics is what the
tracker costs. They run like any robot and explorer of one's own:

    jaxplore compare --maps MAPS --robot benchmarks.ideal:Point --set rates.control=10 \\
        --explorers benchmarks.ideal:explorer,benchmarks.ideal:nearest_cluster
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxplore._types import ArrayLike, ControlVector, Key, Pose, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.control.base import Info, ModelBasedController, SampledPlan
from jaxplore.control.trajectory import Trajectory
from jaxplore.dynamics.base import Dynamics
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.strategy.references import ReferenceStart, descend
from jaxplore.planning.strategy.target_explorer import TargetExplorer
from jaxplore.planning.strategy.target_rules import (
    DistanceAdvantage,
    GainPerCost,
    NearestCluster,
    NearestFrontier,
    NextBestView,
    TargetRule,
)
from jaxplore.simulation.exploration.scenario import ExplorationScenario


class Point(Dynamics):
    """A point that goes anywhere at once.

    State (x, y) [m], control (vx, vy) [m/s], `p' = v`. It has no heading: its yaw is 0.

    Args:
        max_speed: greatest speed, by which the descent moves it [m/s].
        radius: radius of the disc around it that fits where it goes [m].
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y")
    control_names: ClassVar[tuple[str, ...]] = ("vx", "vy")

    max_speed: Scalar
    radius: Scalar
    control_min: ControlVector
    control_max: ControlVector

    def __init__(self, max_speed: ArrayLike = 1.0, radius: ArrayLike = 0.2) -> None:
        self.max_speed = jnp.asarray(max_speed, jnp.float32)
        self.radius = jnp.asarray(radius, jnp.float32)
        self.control_max = jnp.full(2, self.max_speed)
        self.control_min = -self.control_max

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (2,) after `dt` seconds."""
        return state + dt * control

    def heading(self, state: StateVector) -> Scalar:
        """Return 0."""
        return jnp.zeros(())

    def speed(self, state: StateVector) -> Scalar:
        """Return 0: the speed is a control."""
        return jnp.zeros(())

    def pose(self, state: StateVector) -> Pose:
        """Return the pose (x, y, 0)."""
        return jnp.append(state, 0.0)


class Descent(ModelBasedController):
    """Moves a point down `belief.guidance` at full speed, around what is known to be occupied.

    Args:
        dynamics: the point.
        control_period: time between commands [s].
    """

    dynamics: Point
    control_period: Scalar

    def init(self) -> tuple[()]:
        """Return no state."""
        return ()

    def at_period(self, control_period: ArrayLike) -> "Descent":
        """Return a copy that is called every `control_period` seconds."""
        return Descent(self.dynamics, jnp.asarray(control_period, jnp.float32))

    def step(
        self, state: tuple[()], observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, tuple[()], Info]:
        """Return the velocity (2,) to the next place."""
        control = self._velocity(observation, belief)
        return control, (), Info.of_law(control)

    def inspect(
        self,
        state: tuple[()],
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the next step."""
        control = self._velocity(observation, belief)
        after = self.dynamics.step(observation, control, self.control_period)
        one = Trajectory(jnp.stack([observation, after]), control[None], {"cost": jnp.zeros(())})
        return SampledPlan(one, one, one.states[None], jnp.ones(1))

    def _velocity(self, observation: StateVector, belief: Belief) -> ControlVector:
        pace = GradientReference(self.dynamics.max_speed, 1, self.control_period)
        start = ReferenceStart(jnp.append(observation, 0.0), jnp.zeros(()), jnp.zeros(()))
        (after,) = descend(pace, belief.guidance, belief, start)
        return (after[:2] - observation) / self.control_period


def explorer(scenario: ExplorationScenario) -> Descent:
    """Return the point that goes where `explorer` goes."""
    assert isinstance(scenario.robot, Point)
    return Descent(scenario.robot, jnp.asarray(scenario.period, jnp.float32))


def nearest_frontier(scenario: ExplorationScenario) -> TargetExplorer:
    """Return the point that goes to the nearest frontier."""
    return by_rule(scenario, NearestFrontier())


def nearest_cluster(scenario: ExplorationScenario) -> TargetExplorer:
    """Return the point that goes to the nearest cluster of frontier cells."""
    return by_rule(scenario, NearestCluster())


def gain_per_cost(scenario: ExplorationScenario) -> TargetExplorer:
    """Return the point that goes to the frontier with the most information per metre."""
    return by_rule(scenario, GainPerCost())


def next_best_view(scenario: ExplorationScenario) -> TargetExplorer:
    """Return the point that goes to the place with the most information."""
    return by_rule(scenario, NextBestView())


def distance_advantage(scenario: ExplorationScenario) -> TargetExplorer:
    """Return the point that goes to the frontier near to it and far from the others."""
    return by_rule(scenario, DistanceAdvantage())


def by_rule(scenario: ExplorationScenario, rule: TargetRule) -> TargetExplorer:
    """Return the point that goes to the targets of a rule, chosen whenever the fields are new."""
    perception = scenario.perception
    return TargetExplorer(
        explorer(scenario),
        rule,
        scenario.map_arrays.world.frame,
        scenario.map_arrays.world.shape,
        perception.field_sensor.stride,
        required_clearance=perception.required_clearance,
        min_information=perception.min_information,
        every=int(scenario.steps_per_field),
        locomotion=perception.locomotion,
    )
