"""A robot that is carried to another place without its knowing."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore._types import Flag, GridMask, Key, Pose, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.datum import Datum
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.faults import Faults

_CARRYING = 2**31 + 5
"""What is folded into the key of a run for the place; no step has such a number."""


def check_carrying(
    faults: Faults | None, world: OccupancyGrid, reachable: GridMask, datum: Datum
) -> None:
    """Raise a `ValueError` if the robot is carried off the map or to a cell out of its reach."""
    if faults is None or faults.carried_to is None:
        return
    row, column = np.asarray(world.frame.to_cell(faults.carried_to[:2])).tolist()
    rows, columns = reachable.shape
    if not (0 <= row < rows and 0 <= column < columns and bool(reachable[row, column])):
        raise ValueError(
            f"carried_to is {datum.round_to_map(faults.carried_to).tolist()}; accepted: a pose at "
            "which the robot fits and to which it could drive"
        )


def landing(
    faults: Faults | None, reachable: GridMask, frame: GridFrame, key: Key | None
) -> Pose | None:
    """Return the pose (x, y, yaw) at which the robot will be put down; None if it is not carried.

    Without a given pose it is uniform over the centres of the reachable cells and all yaws, by the
    random key of the run.
    """
    if faults is None or faults.carried_at is None:
        return None
    if faults.carried_to is not None:
        return faults.carried_to
    key = jax.random.fold_in(jax.random.key(0) if key is None else key, _CARRYING)
    place, turn = jax.random.split(key)
    before = jnp.cumsum(reachable.reshape(-1).astype(jnp.int32))
    rank = jax.random.randint(place, (), 0, jnp.maximum(before[-1], 1))
    # The first cell before which, itself included, there are more reachable cells than the rank.
    flat = jnp.minimum(jnp.searchsorted(before, rank, side="right"), before.size - 1)
    cell = jnp.stack(jnp.divmod(flat, reachable.shape[1])).astype(jnp.float32)
    yaw = jax.random.uniform(turn, (), minval=-math.pi, maxval=math.pi)
    return jnp.append(frame.to_world(cell + 0.5), yaw)


def carry(
    record: ExplorationRecord, robot: Dynamics, rest: StateVector, pose: Pose, is_carried: Flag
) -> ExplorationRecord:
    """Return the record of a step, with the robot at rest at `pose` if it is carried at its end.

    `rest` (nx,) is a state of the robot at rest at any pose.
    """
    there = robot.with_pose(rest, pose)
    return record._replace(state=jnp.where(is_carried, there, record.state), is_carried=is_carried)
