"""What the robots of a fleet differ by from their models, each by a draw of its own."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.control.fleet_controller import robot_keys
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.formation import Formation
from jaxplore.simulation.disturbances import Disturbances
from jaxplore.simulation.faults import Faults
from jaxplore.simulation.variation import Drawn


class FleetDisturbances(NamedTuple):
    """The `Disturbances` of a fleet: of each robot what it varies by, and faults of all together.

    `robots` are those of each robot, without faults. Keys are derived by the `identity` (N,) of
    the robots. Draws are None if no robot varies.
    """

    formation: Formation
    robots: Sequence[Disturbances]
    faults: Faults | None
    identity: Int[Array, " N"]

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands of any robot and episode [control periods]."""
        return self._together.longest_delay + max(each.longest_delay for each in self.robots)

    @property
    def _together(self) -> Disturbances:
        return Disturbances(self.faults, None)

    def draw(self, key: Key | None, model: Dynamics) -> tuple[Drawn | None, ...] | None:
        """Return the variation of each robot in the episode of a key; see `Disturbances.draw`."""
        keys = [None] * len(self.robots) if key is None else robot_keys(key, self.identity)
        drawn = tuple(
            each.draw(own, robot)
            for each, own, robot in zip(self.robots, keys, self.formation.robots, strict=True)
        )
        return None if all(each is None for each in drawn) else drawn

    def observe(
        self,
        model: Dynamics,
        truth: StateVector,
        last: StateVector,
        drawn: tuple[Drawn | None, ...] | None,
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> tuple[StateVector, Flag, Flag]:
        """Return the measured states (nx,); see `Disturbances.observe`."""
        if drawn is not None:
            states = self.formation.split_state(truth)
            given = zip(
                *(self.robots, self.formation.robots, states, drawn),
                robot_keys(key, self.identity),
                strict=True,
            )
            measured = [
                each.observe(robot, state, state, own, time, period, own_key)[0]
                for each, robot, state, own, own_key in given
            ]
            truth = jnp.concatenate(measured)
        return self._together.observe(model, truth, last, None, time, period, key)

    def delay(
        self,
        pending: Float[Array, "D nu"],
        control: ControlVector,
        drawn: tuple[Drawn | None, ...] | None,
    ) -> tuple[Float[Array, "D nu"], ControlVector]:
        """Return the pending commands (D, nu), oldest first, and those that take effect."""
        if drawn is None:
            return self._together.delay(pending, control, None)
        queue = jnp.concatenate([pending, control[None]])
        # The faults delay all commands by as much, before those that vary.
        fixed, effective = self._together.longest_delay, []
        for each, rows, own in zip(
            self.robots, self.formation.split_control(queue), drawn, strict=True
        ):
            # Of a shorter queue than the longest, the youngest commands.
            newest = rows[rows.shape[0] - 1 - fixed - each.longest_delay :]
            late = newest[0] if own is None else each.delay(newest[:-1], newest[-1], own)[1]
            effective.append(late)
        return queue[1:], jnp.concatenate(effective)

    def true_robot(
        self, model: Dynamics, drawn: tuple[Drawn | None, ...] | None, key: Key, step: Count
    ) -> Dynamics:
        """Return the robots that move in a step of an episode; `key` is that of the run."""
        if drawn is None:
            return model
        keys = robot_keys(key, self.identity)
        robots = [
            each.true_robot(robot, own, own_key, step)
            for each, robot, own, own_key in zip(
                self.robots, self.formation.robots, drawn, keys, strict=True
            )
        ]
        return Formation(robots)
