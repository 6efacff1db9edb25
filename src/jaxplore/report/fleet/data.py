"""Data of an exploration by a fleet: the record of each step, the frames, the world."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.maps.datum import move_points
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.exploration.data import LocalisationData
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.recording import LiveCurves


class FleetRecord(NamedTuple):
    """The record of a step; in a recording every field has a leading axis of steps.

    Args:
        state: (nx,) states of all N robots after the step, one after the other.
        control: (nu,) controls that took effect during the step.
        coverage: share of the reachable cells that some robot knew to be free.
        coverages: (N,) share of them that each robot knew to be free.
        clearance: (N,) distance from each robot's edge to the nearest solid cell or other robot
            [m], up to half a metre.
        is_collision: (N,) whether each robot would have collided with something solid; it stopped
            instead.
        is_untraversable: (N,) whether part of each robot is where it may not be.
        is_contact: (N,) whether each robot would have touched another one; it stopped instead.
        effective_sample_size: mean over the robots of the effective sample size.
        is_finite: whether every robot had a rollout of finite cost.
        sent: size of all messages with maps and ways in the step [bytes].
        links: number of pairs of robots that heard each other.
        targets_seen: number of targets that some robot had found; None without targets.
        parts: record of each part of the robots that has one, by its name: of each robot (N,), or
            of what all know together.
        stop: (N,) why the guard of each robot stopped it in the step, an index into
            `control.stops.REASONS`; 0 if it did not, None without guards.
        pose_error: (N,) distance of each robot from where it takes itself to be [m]; None if the
            robots know their poses, as is the one below.
        uncertainty: (N,) standard deviation of its position by its own estimate [m].
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    coverages: Float[Array, " N"]
    clearance: Float[Array, " N"]
    is_collision: Bool[Array, " N"]
    is_untraversable: Bool[Array, " N"]
    is_contact: Bool[Array, " N"]
    effective_sample_size: Scalar
    is_finite: Flag
    sent: Scalar
    links: Count
    parts: dict[str, Any]
    targets_seen: Count | None = None
    stop: Int[Array, " N"] | None = None
    pose_error: Float[Array, " N"] | None = None
    uncertainty: Float[Array, " N"] | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class FleetFrame(MissionFrame):
    """A snapshot of an exploration by a fleet.

    Args:
        positions: (N, 2) positions of the robots [m].
        headings: (N,) headings [rad].
        probability: (H, W) what the robots know together, in 256 levels: of each cell the
            probability that is the farthest from 1/2.
        plans: (N, T, 2) positions of the nominal trajectories [m]; T = 0 without a plan.
        links: (N, N) which robots hear each other.
    """

    positions: np.ndarray
    headings: np.ndarray
    probability: np.ndarray
    plans: np.ndarray
    links: np.ndarray

    places = ("positions", "plans")


def axes_of_robots(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Return the places of x and y of each robot among the names of a formation's state."""
    x = [index for index, name in enumerate(names) if name.startswith("x_")]
    y = [index for index, name in enumerate(names) if name.startswith("y_")]
    return tuple(zip(x, y, strict=True))


def move_states(states: np.ndarray, offset: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Return states (..., nx) of a fleet with an offset (2,) [m] added to all positions."""
    for columns in axes_of_robots(names):
        states = move_points(states, offset, columns)
    return states


def move_records(records: Any, offset: np.ndarray, names: Sequence[str]) -> Any:
    """Return records of steps with an offset (2,) [m] added to the positions of all robots."""
    return records._replace(state=move_states(records.state, offset, names))


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class FleetData(MissionData):
    """Data of an exploration by a fleet: every step, frames, and the true world.

    Args:
        beliefs: (N, H, W) map of each robot at the end, in 256 levels.
        start: (nx,) states at the start.
        state_names: names of the components of the state.
        radii: (N,) radii of the robots [m].
        coordination: how the robots divided the places among themselves.
        localisation: where each robot took itself to be; None if they knew their poses.
        goal: (2,) goal position of all robots [m]; None if there is no goal.
    """

    records: FleetRecord
    frames: tuple[FleetFrame, ...]
    beliefs: np.ndarray
    start: np.ndarray
    state_names: tuple[str, ...]
    radii: np.ndarray
    coordination: str
    localisation: tuple[LocalisationData, ...] | None = None
    goal: np.ndarray | None = None

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that have positions, with an offset (2,) [m] added."""
        return {
            "records": move_records(self.records, offset, self.state_names),
            "start": move_states(self.start, offset, self.state_names),
            "goal": None if self.goal is None else move_points(self.goal, offset),
            "localisation": (
                None
                if self.localisation is None
                else tuple(each.move(offset) for each in self.localisation)
            ),
            **self.move_mission(offset),
        }

    @property
    def num_robots(self) -> int:
        """Number of robots, N."""
        return len(self.radii)

    @property
    def trails(self) -> np.ndarray:
        """Positions (N, steps + 1, 2) of each robot, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        return np.stack([states[:, list(each)] for each in axes_of_robots(self.state_names)])

    @property
    def positions(self) -> np.ndarray:
        """Positions (steps + 1, 2) of the first robot, the start included [m]."""
        return np.asarray(self.trails[0])

    @property
    def last_positions(self) -> np.ndarray:
        """Positions (N, 2) of the robots at the end [m]."""
        return np.asarray(self.trails[:, -1])

    @property
    def lengths(self) -> np.ndarray:
        """Distance that each robot has driven (N, steps + 1) [m]."""
        steps = np.linalg.norm(np.diff(self.trails, axis=1), axis=-1)
        return np.concatenate([np.zeros((self.num_robots, 1)), np.cumsum(steps, axis=1)], axis=1)

    @property
    def live_curves(self) -> LiveCurves:
        """The coverage by the map of each robot and by all together, and the share of the targets
        that were found."""
        # The robots come first, so that their curves have the colours of the picture.
        names = [*(f"robot {number + 1}" for number in range(self.num_robots)), "together"]
        rows = [*np.asarray(self.records.coverages).reshape(-1, self.num_robots).T]
        rows.append(np.asarray(self.records.coverage))
        if len(self.targets):
            names.append("targets found")
            rows.append(np.asarray(self.records.targets_seen) / len(self.targets))
        title = "coverage and targets found" if len(self.targets) else "coverage"
        return LiveCurves(title, tuple(names), np.stack(rows))

    @property
    def coverage(self) -> np.ndarray:
        """Coverage (steps + 1,) at each instant."""
        return at_instants(self.records.coverage, self.initial_coverage)

    @property
    def coverages(self) -> np.ndarray:
        """Coverage (N, steps + 1) of each robot's own map, likewise."""
        start = np.full(self.num_robots, self.initial_coverage)
        return at_instants(self.records.coverages, start).T
