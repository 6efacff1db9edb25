"""State of a fleet."""

from typing import NamedTuple

from jaxtyping import Array, Float

from jaxplore._types import Count, Scalar, StateVector
from jaxplore.belief.gain import Gain
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.radio import Heard


class Team(NamedTuple):
    """What the robots of a fleet of several have told one another.

    Args:
        heard: what each has heard of each.
        merged: (H, W) map of each robot that this process computes after the last exchange.
        plans: (N, S, 2) positions that each robot plans to pass [m].
        velocities: (N, 2) velocities during the last step [m/s].
        sent: size of the messages of the present step [bytes].
        links: number of pairs of robots that heard each other last.
        coverages: (N,) share of the reachable cells that each knew to be free at the last scan.
    """

    heard: Heard
    merged: tuple[Float[Array, "H W"], ...]
    plans: Float[Array, "N S 2"]
    velocities: Float[Array, "N 2"]
    sent: Scalar
    links: Count
    coverages: Float[Array, " N"]


class FleetState(NamedTuple):
    """State of the exploration by a fleet.

    Args:
        robot: (nx,) true states of all robots, one after the other.
        members: state of each robot as an explorer, of those that this process computes.
        coverage: share of the reachable cells that some robot knows to be free.
        gain: the last rise of the coverage.
        finished: number of steps since the task was finished; 0 before.
        team: what the robots have told one another; None for a robot alone.
    """

    robot: StateVector
    members: tuple[ExplorationState, ...]
    coverage: Scalar
    gain: Gain
    finished: Count
    team: Team | None
