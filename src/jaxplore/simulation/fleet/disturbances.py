"""What the robots of a fleet differ by from their models, each by a draw of its own."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.control.fleet_controller import robot_keys
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.formation import Formation
from jaxplore.simulation.disturbances import Disturbances

type FleetDrawn = tuple[dict[str, Any], ...]
"""What is random of an episode, of each robot by name."""


class FleetDisturbances(NamedTuple):
    """The `Disturbances` of each robot of a fleet, behind the methods of one.

    Keys are derived by the `identity` (N,) of the robots. Scans fail for all when they do for the
    first one.
    """

    formation: Formation
    robots: Sequence[Disturbances]
    identity: Int[Array, " N"]

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands of any robot and episode [control periods]."""
        return max(each.longest_delay for each in self.robots)

    @property
    def is_varying(self) -> bool:
        """Whether any true robot differs from its model."""
        return any(each.is_varying for each in self.robots)

    def draw(self, key: Key | None, model: Dynamics) -> FleetDrawn:
        """Return what is random of each robot in the episode of a key."""
        keys = [None] * len(self.robots) if key is None else robot_keys(key, self.identity)
        given = zip(self.robots, keys, self.formation.robots, strict=True)
        return tuple(each.draw(own, robot) for each, own, robot in given)

    def observe(
        self,
        model: Dynamics,
        truth: StateVector,
        last: StateVector,
        drawn: FleetDrawn,
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> tuple[StateVector, Flag, Flag]:
        """Return the measured states (nx,); see `Disturbances.observe`."""
        states, before = (self.formation.split_state(each) for each in (truth, last))
        keys, robots = robot_keys(key, self.identity), self.formation.robots
        found = [
            each.observe(robot, state, ago, own, time, period, own_key)
            for each, robot, state, ago, own, own_key in zip(
                self.robots, robots, states, before, drawn, keys, strict=True
            )
        ]
        return jnp.concatenate([state for state, *_ in found]), *found[0][1:]

    def delay(
        self, pending: Float[Array, "D nu"], control: ControlVector, drawn: FleetDrawn
    ) -> tuple[Float[Array, "D nu"], ControlVector]:
        """Return the pending commands (D, nu), oldest first, and those that take effect."""
        queue = jnp.concatenate([pending, control[None]])
        effective = []
        for each, rows, own in zip(
            self.robots, self.formation.split_control(queue), drawn, strict=True
        ):
            # Of a shorter queue than the longest, the youngest commands.
            newest = rows[len(pending) - each.longest_delay :]
            effective.append(each.delay(newest[:-1], newest[-1], own)[1])
        return queue[1:], jnp.concatenate(effective)

    def true_robot(self, model: Dynamics, drawn: FleetDrawn, key: Key, step: Count) -> Dynamics:
        """Return the robots that move in a step of an episode; `key` is that of the run."""
        if not self.is_varying:
            return model
        keys = robot_keys(key, self.identity)
        robots = [
            each.true_robot(robot, own, own_key, step)
            for each, robot, own, own_key in zip(
                self.robots, self.formation.robots, drawn, keys, strict=True
            )
        ]
        return Formation(robots)
