"""State of a fleet."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from jaxplore._types import Count, Scalar, StateVector
from jaxplore.belief.gain import Gain
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.frames import Frames
from jaxplore.simulation.fleet.radio import Heard


class Team(NamedTuple):
    """What the robots of a fleet of several have told one another.

    `heard` is what each has heard of each. `merged` are the maps (H, W) after the last exchange, of
    the robots that this process computes. `plans` (N, S, 2) are positions that each plans to pass
    [m], `velocities` (N, 2) those during the last step [m/s]. `sent` is the size of the messages of
    the present step [bytes], `links` the number of pairs of robots that heard each other last.
    `coverages` (N,) are the shares of the reachable cells that each knew to be free at the last
    scan. `frames` says which robots know each other's frames; None if all do from the start.
    """

    heard: Heard
    merged: tuple[Float[Array, "H W"], ...]
    plans: Float[Array, "N S 2"]
    velocities: Float[Array, "N 2"]
    sent: Scalar
    links: Count
    coverages: Float[Array, " N"]
    frames: Frames | None = None


class FleetState(NamedTuple):
    """State of the exploration by a fleet.

    `robot` (nx,) are the true states of all robots, one after the other. `members` are the states
    of those that this process computes, each as an explorer. `coverage` is the share of the
    reachable cells that some robot knows to be free, and `gain` its last rise. `finished` is the
    number of steps since the task was finished; 0 before. `team` is None for a robot alone.
    `judged` are the states of truths of parts that judge all robots together, by name.
    """

    robot: StateVector
    members: tuple[ExplorationState, ...]
    coverage: Scalar
    gain: Gain
    finished: Count
    team: Team | None
    judged: dict[str, Any]
