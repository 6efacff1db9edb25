"""What a simulated robot differs by from its model, and what fails, around each task."""

import functools
import operator
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Count, Flag, GridMask, Key, Pose, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.datum import Datum
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid


class Place(NamedTuple):
    """Where a robot is disturbed.

    Args:
        robot: model of the robot.
        datum: point to which positions are relative.
        world: the true map or volume; None where a task has neither.
        reachable: (H, W) cells that the robot's centre can reach; None where it does not drive.
    """

    robot: Dynamics
    datum: Datum
    world: OccupancyGrid | VoxelGrid | None = None
    reachable: GridMask | None = None


class Disturbance(eqx.Module):
    """What makes a simulated robot and its world differ from their model.

    All methods have a default that disturbs nothing. What is traced returns the same shapes at
    every step.
    """

    name: ClassVar[str]
    """Name, by which a run keeps what was drawn; a scenario has one disturbance of a name."""
    is_varying: ClassVar[bool] = False
    """Whether the true robot or its measured pose differs from the model all the time."""
    is_blinding: ClassVar[bool] = False
    """Whether measurements may be absent, so that what is known of obstacles grows old."""

    @property
    def is_carrying(self) -> bool:
        """Whether the robot is carried to another place at some time."""
        return False

    def check(self, place: Place) -> None:
        """Check that it can happen at a place.

        Args:
            place: where the robot is disturbed.

        Raises:
            ValueError: it cannot.
        """

    def check_team(self, number: int) -> None:
        """Check that it can happen to each robot of a fleet.

        Args:
            number: number of robots, 2 or more.

        Raises:
            ValueError: it cannot.
        """

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands in any episode [control periods]."""
        return 0

    def draw(self, key: Key | None, model: Dynamics) -> Any:
        """Return what is random of an episode; None if nothing is.

        Args:
            key: random key of the run; the middle of all when absent.
            model: model of the robot.
        """
        return None

    def observe(
        self,
        model: Dynamics,
        state: StateVector,
        last: StateVector,
        drawn: Any,
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> StateVector:
        """Return the measured state (nx,).

        Args:
            model: model of the robot.
            state: what the base would measure without this disturbance.
            last: what was measured before.
            drawn: what was drawn of the episode.
            time: time since the start [s].
            period: time since the last measurement [s].
            key: random key of the step.
        """
        return state

    def is_blind(self, time: Scalar) -> Flag | None:
        """Return whether there is no scan; None if there always is."""
        return None

    def is_active(self, time: Scalar) -> Flag | None:
        """Return whether measurements fail; None if they never do."""
        return None

    def delay(self, drawn: Any) -> int | Count:
        """Return the delay of commands in an episode [control periods]."""
        return 0

    def true_robot(self, model: Dynamics, drawn: Any, key: Key) -> Dynamics:
        """Return the robot that moves in a step, whose key is given."""
        return model

    def world[World: (OccupancyGrid, VoxelGrid)](self, world: World, time: Scalar) -> World:
        """Return the true world at a time since the start [s]."""
        return world

    def landing(self, reachable: GridMask, frame: GridFrame, key: Key | None) -> Pose | None:
        """Return the pose (x, y, yaw) at which the robot is put down; None if it is not carried.

        Args:
            reachable: (H, W) cells that the robot can reach.
            frame: frame of the cells.
            key: random key of the run, of a robot of a fleet its own.
        """
        return None

    def is_carried(self, time: Scalar, period: Scalar) -> Flag | None:
        """Return whether the robot is carried away at the end of a control period, to its landing.

        Args:
            time: beginning of the period, since the start [s].
            period: control period [s].
        """
        return None


class Disturbances(NamedTuple):
    """The disturbances of a robot, one after the other: measurements pass through all of them."""

    each: tuple[Disturbance, ...]

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands of any episode [control periods]."""
        return sum(each.longest_delay for each in self.each)

    @property
    def is_varying(self) -> bool:
        """Whether the true robot or its measured pose differs from the model all the time."""
        return any(each.is_varying for each in self.each)

    @property
    def is_blinding(self) -> bool:
        """Whether measurements may be absent."""
        return any(each.is_blinding for each in self.each)

    @property
    def is_carrying(self) -> bool:
        """Whether the robot is carried to another place at some time."""
        return any(each.is_carrying for each in self.each)

    def draw(self, key: Key | None, model: Dynamics) -> dict[str, Any]:
        """Return what is random of the episode of a key, by name."""
        drawn = {each.name: each.draw(key, model) for each in self.each}
        return {name: own for name, own in drawn.items() if own is not None}

    def observe(
        self,
        model: Dynamics,
        truth: StateVector,
        last: StateVector,
        drawn: dict[str, Any],
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> tuple[StateVector, Flag, Flag]:
        """Return the measured state (nx,), whether there is no scan, and whether a fault is active.

        `truth` (nx,) is what the base would measure without errors at a time since the start [s].
        `last` (nx,) is what was measured before. `key` is that of the step.
        """
        for each in self.each:
            own = drawn.get(each.name)
            truth = each.observe(model, truth, last, own, time, period, key)
        is_blind = _any(each.is_blind(time) for each in self.each)
        return truth, is_blind, _any(each.is_active(time) for each in self.each)

    def delay(
        self, pending: Float[Array, "D nu"], control: ControlVector, drawn: dict[str, Any]
    ) -> tuple[Float[Array, "D nu"], ControlVector]:
        """Return the pending commands (D, nu), oldest first, and the one that takes effect.

        There is room for the longest delay. A shorter one takes a younger command.
        """
        queue = jnp.concatenate([pending, control[None]])
        late = sum(each.delay(drawn.get(each.name)) for each in self.each)
        return queue[1:], queue[len(pending) - late]

    def true_robot(self, model: Dynamics, drawn: dict[str, Any], key: Key, step: Count) -> Dynamics:
        """Return the robot that moves in a step of an episode; `key` is that of the run."""
        for each in self.each:
            model = each.true_robot(model, drawn.get(each.name), jax.random.fold_in(key, step))
        return model

    def world[World: (OccupancyGrid, VoxelGrid)](self, world: World, time: Scalar) -> World:
        """Return the true world at a time since the start [s]."""
        for each in self.each:
            world = each.world(world, time)
        return world

    def landing(self, reachable: GridMask, frame: GridFrame, key: Key | None) -> Pose | None:
        """Return the pose at which the robot is put down; None if it is not carried."""
        found = (each.landing(reachable, frame, key) for each in self.each)
        return next((pose for pose in found if pose is not None), None)

    def is_carried(self, time: Scalar, period: Scalar) -> Flag:
        """Return whether the robot is carried to its landing at the end of a control period."""
        return _any(each.is_carried(time, period) for each in self.each)


def _any(flags: Iterable[Flag | None]) -> Flag:
    known = [each for each in flags if each is not None]
    return functools.reduce(operator.or_, known) if known else jnp.array(False)
