"""Fault injection: sensor dropouts, lost odometry, delayed commands, walls that appear, a robot
that is carried away."""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DELAY
from jaxplore._types import ArrayLike, Flag, GridMask, Key, Pose, Scalar, StateVector, Vector
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.simulation.disturbances import Disturbance, Place

NEVER = (0.0, 0.0)
"""Interval of length 0: the fault never happens."""
_CARRYING = 2**31 + 5
"""What is folded into the key of a run for the place; no step has such a number."""


class Faults(Disturbance):
    """Faults to inject into a run; each lasts from a start to an end time [s].

    Args:
        scan_dropout: interval without scans [s].
        lost_odometry: interval in which the observed state is NaN [s].
        frozen_odometry: interval in which the observed state stays as at its start [s].
        control_delay: number of control periods between a command and its effect; static.
        walls: (H, W) cells that become solid, in a volume (D, H, W) voxels.
        walls_from: time at which they do [s].
        carried_at: time at which the robot is carried to another place, where it stands [s]; never
            when absent. Its odometry does not notice. For explorations in the plane; a robot of a
            fleet is carried to a place of its own, unless it would touch another one there. The
            time may change without a new compilation, but not from absent to present.
        carried_to: pose (x, y, yaw) at which it is put down [m, m, rad]; when absent a pose in a
            cell that it can reach, drawn by the key of the run. `carried_at` says when.

    Raises:
        ValueError: a time that is negative or not finite, an end before its start, a delay that
                is not a whole number >= 0, walls that are no array of booleans of a map's or a
                volume's dimensions, a pose to be carried to without a time. In a scenario walls of
                another shape than its world, a pose that the robot cannot reach.
    """

    name: ClassVar[str] = "faults"
    is_blinding: ClassVar[bool] = True

    scan_dropout: Float[Array, "2"]
    lost_odometry: Float[Array, "2"]
    frozen_odometry: Float[Array, "2"]
    walls: Bool[Array, "*shape"] | None
    walls_from: Scalar
    carried_at: Scalar | None
    carried_to: Pose | None
    control_delay: int = eqx.field(static=True)

    def __init__(
        self,
        *,
        scan_dropout: Vector = NEVER,
        lost_odometry: Vector = NEVER,
        frozen_odometry: Vector = NEVER,
        control_delay: int = 0,
        walls: ArrayLike | None = None,
        walls_from: ArrayLike = 0.0,
        carried_at: ArrayLike | None = None,
        carried_to: Vector | None = None,
    ) -> None:
        self.scan_dropout = _interval("scan_dropout", scan_dropout)
        self.lost_odometry = _interval("lost_odometry", lost_odometry)
        self.frozen_odometry = _interval("frozen_odometry", frozen_odometry)
        self.control_delay = _checks.whole_number(
            "control_delay", control_delay, at_least=0, at_most=MOST_DELAY
        )
        self.walls_from = _checks.scalar("walls_from", walls_from, at_least=0.0)
        self.carried_at = self.carried_to = None
        if carried_at is not None:
            self.carried_at = _checks.scalar("carried_at", carried_at, at_least=0.0)
        if carried_to is not None:
            self.carried_to = _checks.vector("carried_to", carried_to, 3)
            if carried_at is None:
                raise ValueError("carried_to is given without carried_at; accepted: with a time")
        self.walls = None
        if walls is not None:
            mask = np.asarray(walls)
            if mask.dtype != bool or mask.ndim not in (2, 3):
                raise ValueError(
                    f"walls has type {mask.dtype} and shape {mask.shape}; accepted: (H, W) bool, "
                    "or (D, H, W) in a volume"
                )
            self.walls = jnp.asarray(mask)

    @property
    def is_carrying(self) -> bool:
        """Whether the robot is carried away."""
        return self.carried_at is not None

    def check(self, place: Place) -> None:
        """Check the shape of the walls, and the pose to which the robot is carried."""
        world, walls = place.world, self.walls
        if walls is not None:
            if world is None:
                raise ValueError("faults has walls without a map; accepted: faults without walls")
            own: tuple[int, ...] = world.shape
            if isinstance(world, OccupancyGrid):
                own = world.crop(world.probability).shape
            # A world that is padded already may come with walls that are.
            if walls.shape not in (own, world.shape):
                raise ValueError(f"walls has shape {walls.shape}; accepted: the world's, {own}")
        if self.carried_at is None:
            return
        if place.reachable is None or not isinstance(world, OccupancyGrid):
            where = "without a map" if world is None else "in a volume"
            raise ValueError(f"faults has carried_at {where}; accepted: faults without it")
        if self.carried_to is None:
            return
        row, column = np.asarray(world.frame.to_cell(self.carried_to[:2])).tolist()
        rows, columns = place.reachable.shape
        is_on = 0 <= row < rows and 0 <= column < columns
        if not (is_on and bool(place.reachable[row, column])):
            raise ValueError(
                f"carried_to is {place.datum.round_to_map(self.carried_to).tolist()}; accepted: a "
                "pose at which the robot fits and to which it could drive"
            )

    def check_team(self, number: int) -> None:
        """Check that each robot is put down at a place of its own."""
        if self.carried_to is not None:
            raise ValueError(
                f"faults.carried_to is {np.asarray(self.carried_to).tolist()} for {number} robots; "
                "accepted: without it, each is put down at a place of its own"
            )

    @property
    def longest_delay(self) -> int:
        """Delay of commands [control periods]."""
        return self.control_delay

    def delay(self, drawn: Any) -> int:
        """Return the delay of commands [control periods]."""
        return self.control_delay

    def world[World: (OccupancyGrid, VoxelGrid)](self, world: World, time: Scalar) -> World:
        """Return the world at a time since the start, with the walls that have appeared."""
        if self.walls is None:
            return world
        # The world's arrays may be larger than its map, see `OccupancyGrid.pad`.
        more = [size - own for size, own in zip(world.shape, self.walls.shape, strict=True)]
        walls = jnp.pad(self.walls, [(0, max(0, each)) for each in more])
        return world.with_solid(walls & (time >= self.walls_from))

    def is_blind(self, time: Scalar) -> Flag:
        """Check whether a dropout of scans is active."""
        return _during(self.scan_dropout, time)

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
        """Return the measured state (nx,), lost or frozen."""
        frozen = self.frozen_odometry
        # The first observation of the fault is still the true state, and later ones repeat it.
        is_stuck = _during(frozen, time) & _during(frozen, time - period)
        observed = jnp.where(is_stuck, last, state)
        return jnp.where(_during(self.lost_odometry, time), jnp.nan, observed)

    def is_active(self, time: Scalar) -> Flag:
        """Check whether a fault of scans or odometry is active."""
        intervals = (self.scan_dropout, self.lost_odometry, self.frozen_odometry)
        return jnp.stack([_during(interval, time) for interval in intervals]).any()

    def landing(self, reachable: GridMask, frame: GridFrame, key: Key | None) -> Pose | None:
        """Return the pose (x, y, yaw) at which the robot is put down; None if it is not carried.

        Without a given pose it is uniform over the centres of the reachable cells and all yaws.
        """
        if self.carried_at is None or self.carried_to is not None:
            return self.carried_to
        key = jax.random.fold_in(jax.random.key(0) if key is None else key, _CARRYING)
        place, turn = jax.random.split(key)
        before = jnp.cumsum(reachable.reshape(-1).astype(jnp.int32))
        rank = jax.random.randint(place, (), 0, jnp.maximum(before[-1], 1))
        # The first cell before which, itself included, there are more reachable cells than the
        # rank.
        flat = jnp.minimum(jnp.searchsorted(before, rank, side="right"), before.size - 1)
        cell = jnp.stack(jnp.divmod(flat, reachable.shape[1])).astype(jnp.float32)
        yaw = jax.random.uniform(turn, (), minval=-math.pi, maxval=math.pi)
        return jnp.append(frame.to_world(cell + 0.5), yaw)

    def is_carried(self, time: Scalar, period: Scalar) -> Flag | None:
        """Return whether the robot is carried away at the end of a control period."""
        if self.carried_at is None:
            return None
        # In one period alone, in that which the time lies in or begins with.
        return _during(jnp.stack([self.carried_at, self.carried_at + period]), time)


def _interval(name: str, value: Vector) -> Array:
    given = _checks.vector(name, value, 2)
    # The value of a traced array is not known yet.
    if not _kinds.is_traced(given) and not 0.0 <= float(given[0]) <= float(given[1]):
        raise ValueError(
            f"{name} is {given.tolist()}; accepted: beginning and end [s], 0 <= beginning <= end"
        )
    return given


def _during(interval: Array, time: Scalar) -> Flag:
    # A tolerance of a millisecond: times are multiples of a rounded period.
    return (time >= interval[0] - 1e-3) & (time < interval[1] - 1e-3)
