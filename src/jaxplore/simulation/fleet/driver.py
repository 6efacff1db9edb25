"""The commands of the robots of a fleet, each of which is watched over by its own guard."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore import _kinds
from jaxplore._equal_objects import Alike
from jaxplore._types import ControlVector, Key, Scalar, StateVector
from jaxplore.control.base import Controller
from jaxplore.control.fleet_controller import FleetBelief, FleetController, join_infos
from jaxplore.control.fleet_share import Share
from jaxplore.control.guard import GuardState, ScanPoints
from jaxplore.dynamics.formation import Formation
from jaxplore.robot.decision import Decided
from jaxplore.simulation.exploration.scenario import ExplorationScenario


class FleetGuardState(NamedTuple):
    """States of the guards of a fleet.

    `robots` are those of the robots that this process computes. `stop` (N,) says why each robot of
    the fleet is stopped, an index into `control.stops.REASONS`; 0 if it is not. `expected` (nx,)
    are the states in which all robots take themselves to be, also where their guards do not trust
    what they observe.
    """

    robots: tuple[GuardState, ...]
    stop: Int[Array, " N"]
    expected: StateVector


class FleetDriver(NamedTuple):
    """Decides for each robot of a fleet which command is sent, as its own `Driver` does.

    `explorations` and `share` are those of the fleet, `formation` the model of all robots.
    `controller` commands them all; None where the guards only judge.
    """

    explorations: Alike[ExplorationScenario]
    share: Share
    formation: Formation
    controller: Controller | None

    @property
    def has_guards(self) -> bool:
        """Whether the robots have guards: all of them, or none."""
        return self.explorations.kinds[0].guard is not None

    def init(self, start: StateVector) -> FleetGuardState | None:
        """Return the states of the guards of robots at rest (nx,); None without guards."""
        if not self.has_guards:
            return None
        states = self._own(self.formation.split_state(start))
        robots = self._here.each(lambda one, *given: one.driver().init(*given), states)
        return FleetGuardState(tuple(robots), jnp.zeros(self.share.number, jnp.int32), start)

    def judge(
        self,
        watch: FleetGuardState | None,
        observed: StateVector,
        last: StateVector,
        points: Sequence[ScanPoints],
        time: Scalar,
    ) -> tuple[StateVector, FleetGuardState | None]:
        """Return the observed states (nx,), NaN of robots whose guard does not trust them, and the
        states of the guards."""
        if watch is None:
            return observed, None

        def judge(
            one: ExplorationScenario, own: GuardState, seen: Array, before: Array, scan: ScanPoints
        ) -> Any:
            return one.driver().judge(own, seen, before, scan, time)

        states = (self._own(self.formation.split_state(each)) for each in (observed, last))
        found = self._here.each(judge, watch.robots, *states, points)
        robots = tuple(judged for _, judged in found)
        told = self.share.gather([(state, judged.stop, judged.expected) for state, judged in found])
        trusted, stops, expected = zip(*told, strict=True)
        judged = FleetGuardState(robots, jnp.stack(stops), jnp.concatenate(expected))
        return jnp.concatenate(trusted), judged

    def decide(
        self,
        memory: Any,
        watch: FleetGuardState | None,
        observed: StateVector,
        belief: FleetBelief,
        points: Sequence[ScanPoints],
        time: Scalar,
        key: Key,
    ) -> Decided:
        """Return the commands of a period; see `Driver.decide`.

        Raises:
            ValueError: guards beside a controller that does not command each robot by itself.
        """
        controller = self.controller
        assert controller is not None
        if watch is None:
            control, memory, info = controller.step(memory, observed, belief, key=key)
            return Decided(control, memory, None, info)
        # A guard stops one robot, and starts the controller of that one anew.
        _kinds.instance("controller of robots with guards", controller, FleetController)
        assert isinstance(controller, FleetController)

        def decide(both: tuple[ExplorationScenario, Controller], *given: Any) -> Decided:
            (one, own), (*known, own_key) = both, given
            kept, judged, seen, believed, scan = known
            return one.driver(own).decide(kept, judged, seen, believed, scan, time, own_key)

        pairs = self._here.beside(controller.own.at(self.share.mine))
        memories, states, beliefs, keys = controller.rows(memory, observed, belief, key)
        rows = memories, watch.robots, states, beliefs, points, keys
        # Beliefs are large, as in `FleetController.step`.
        found = pairs.each(decide, *rows, is_large=True)
        told = self.share.gather([(each.control, each.info) for each in found])
        controls, infos = zip(*told, strict=True)
        robots = tuple(each.guard for each in found)
        return Decided(
            jnp.concatenate(controls),
            tuple(each.memory for each in found),
            watch._replace(robots=robots),
            join_infos(infos),
        )

    def actuate(
        self,
        watch: FleetGuardState | None,
        control: ControlVector,
        measured: StateVector,
        points: Sequence[ScanPoints],
    ) -> tuple[ControlVector, FleetGuardState | None]:
        """Return what the bases of the robots do, and where the guards expect the robots; see
        `Driver.actuate`."""
        if watch is None:
            return control, None

        def actuate(one: ExplorationScenario, *given: Any) -> Any:
            return one.driver().actuate(*given)

        controls = self._own(self.formation.split_control(control))
        states = self._own(self.formation.split_state(measured))
        found = self._here.each(actuate, watch.robots, controls, states, points)
        robots = tuple(after for _, after in found)
        done = self.share.gather([own for own, _ in found])
        return jnp.concatenate(done), watch._replace(robots=robots)

    @property
    def _here(self) -> Alike[ExplorationScenario]:
        """Explorations of the robots that this process computes."""
        return self.explorations.at(self.share.mine)

    def _own(self, rows: Sequence[Any]) -> tuple[Any, ...]:
        """Return the rows of the robots that this process computes."""
        return self.share.select(rows)
