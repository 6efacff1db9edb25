"""What is kept of each step of the closed loop."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxplore._types import ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.control.base import Controller, Members
from jaxplore.dynamics.base import Dynamics


class Progress(NamedTuple):
    """How much of the map is known, and how long ago it was seen: see `Record`."""

    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    mean_idleness: Scalar
    worst_idleness: Scalar


class Record(NamedTuple):
    """What is kept of each step; in a run every field has a leading axis of steps.

    Args:
        state: (nx,) after the step.
        control: (nu,) that took effect during it.
        coverage: share of the reachable cells known to be free.
        entropy: of the belief over the reachable cells [nat].
        unknown: share of the map's cells with `4 p (1 - p) > 1/2`.
        clearance: from the robot's edge to the nearest solid cell [m], up to half a metre.
        is_collision: the step would have led into something; the robot stopped instead.
        is_untraversable: some of the robot is on ground that may not be entered.
        effective_sample_size: of the controller's rollouts.
        is_finite: whether any of them was finite.
        is_faulty: whether scans or odometry failed, by the scenario's faults.
        targets_seen: how many targets have been seen.
        mean_idleness: of the reachable cells, the time since each was seen, or since the start [s];
            0 if nobody keeps watch.
        worst_idleness: the longest of them [s].
        members: of a controller that holds several.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    clearance: Scalar
    is_collision: Flag
    is_untraversable: Flag
    effective_sample_size: Scalar
    is_finite: Flag
    is_faulty: Flag
    targets_seen: Count
    mean_idleness: Scalar
    worst_idleness: Scalar
    members: Members | None


def blank_records(controller: Controller, robot: Dynamics, capacity: int) -> Record:
    """Return records to be filled; to trace a step for their shapes would take a second.

    Args:
        controller: whose members are recorded, if it holds several.
        robot: the plant.
        capacity: how many steps there is room for; static.
    """
    number, flag = jnp.zeros(capacity), jnp.zeros(capacity, bool)
    members = None
    if controller.member_names:
        one = Members.blank(len(controller.member_names), robot.control_size)
        members = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), one)
    return Record(
        state=jnp.zeros((capacity, robot.state_size)),
        control=jnp.zeros((capacity, robot.control_size)),
        coverage=number,
        entropy=number,
        unknown=number,
        clearance=number,
        is_collision=flag,
        is_untraversable=flag,
        effective_sample_size=number,
        is_finite=flag,
        is_faulty=flag,
        members=members,
        targets_seen=jnp.zeros(capacity, jnp.int32),
        mean_idleness=number,
        worst_idleness=number,
    )
