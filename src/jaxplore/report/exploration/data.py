"""Data of an exploration by one robot or several: the record of each step, frames, the world."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import ControlVector, Flag, Scalar, StateVector
from jaxplore.control.base import Members
from jaxplore.maps.datum import move_points
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.recording import LiveCurves, move_records, move_states, robot_columns

TEAM = "team"
"""Name under which the records of parts have what several robots share."""


class MapProgress(NamedTuple):
    """Statistics of the known map: see `ExplorationRecord`."""

    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    unknown_map: Scalar


class ExplorationRecord(NamedTuple):
    """The record of a step; in a recording every field has a leading axis of steps.

    Of N robots the fields with the shape (*N,) have an axis of robots, () of one. The states and
    the controls stand one after the other. The rest says what the robots know together: of each
    cell it counts that some robot knows it. A map of all does not exist on any robot, so `entropy`,
    `unknown` and `unknown_map` are None.

    Args:
        state: (nx,) state after the step.
        control: (nu,) control that took effect during the step.
        coverage: share of the reachable cells known to be free.
        entropy: entropy of the belief over the reachable cells [nat].
        unknown: share of the reachable cells with `4 p (1 - p) > 1/2`.
        unknown_map: the same share of all cells of the map, below which a mission with a goal
            counts the map as explored: the robot does not know which cells it can reach.
        clearance: (*N,) distance from the robot's edge to the nearest solid cell or other robot
            [m], up to half a metre.
        is_collision: (*N,) whether the step would have led to a collision; the robot stopped
            instead.
        is_untraversable: (*N,) whether part of the robot is on untraversable ground.
        effective_sample_size: effective sample size of the controller's rollouts, mean over robots.
        is_finite: whether any rollout of each robot had a finite cost.
        is_faulty: whether a fault of scans or odometry was active.
        parts: record of each part of the robot that has one, by its name.
        members: diagnostics of the members of a controller that holds several.
        stop: (*N,) why the guard stopped the robot in the step, an index into
            `control.guard.REASONS`; 0 if it did not, None without a guard.
        pose_error: (*N,) distance of the estimated position from the true one [m]; None for a robot
            that knows its pose, as is the one below.
        uncertainty: (*N,) standard deviation of the position, as the robot estimates it [m].
        is_carried: (*N,) whether a fault carried the robot away at the end of the step; None
            without such a fault.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    entropy: Scalar | None
    unknown: Scalar | None
    unknown_map: Scalar | None
    clearance: Float[Array, "*N"]
    is_collision: Bool[Array, "*N"]
    is_untraversable: Bool[Array, "*N"]
    effective_sample_size: Scalar
    is_finite: Flag
    is_faulty: Flag
    parts: dict[str, Any]
    members: Members | None
    stop: Int[Array, "*N"] | None = None
    pose_error: Float[Array, "*N"] | None = None
    uncertainty: Float[Array, "*N"] | None = None
    is_carried: Bool[Array, "*N"] | None = None


class LocalisationData(NamedTuple):
    """Where a robot was and took itself to be, and the map of the same scans at the true poses.

    Args:
        true_poses: (N, 3) true poses at the stored scans [m, m, rad].
        poses: (N, 3) poses that the robot estimated for them at the end of the run.
        reckoned: (N, 3) poses by the odometry alone.
        way: (N,) length of its way by its odometry [m].
        reference: (H, W) map that the same scans give at the true poses.
        num_loops: number of loops that were closed; None on a known map, in whose frame the
            estimated poses are, so that none is aligned.
    """

    true_poses: np.ndarray
    poses: np.ndarray
    reckoned: np.ndarray
    way: np.ndarray
    reference: np.ndarray
    num_loops: int | None

    def move(self, offset: np.ndarray) -> "LocalisationData":
        """Return the data with an offset (2,) [m] added to positions."""
        return self._replace(
            true_poses=move_points(self.true_poses, offset),
            poses=move_points(self.poses, offset),
            reckoned=move_points(self.reckoned, offset),
        )


class RobotRun(NamedTuple):
    """What a run has of one of its robots.

    Args:
        number: its number, from 0.
        states: (steps + 1, n) its states, the start included.
        columns: columns of its states by the names of their components.
        is_carried: (steps,) whether a fault carried it to another place at the end of a step.
        radius: its radius [m].
        footprint: (4, 2) its corners [m]; (0, 2) of a disc.
        pose_error: (steps,) distance of the estimated position from the true one [m]; None if it
            knows its pose, as is the one below.
        localisation: where it took itself to be.
    """

    number: int
    states: np.ndarray
    columns: dict[str, int]
    is_carried: np.ndarray
    radius: float
    footprint: np.ndarray
    pose_error: np.ndarray | None
    localisation: LocalisationData | None

    @property
    def positions(self) -> np.ndarray:
        """Positions (steps + 1, 2) [m]."""
        return self.states[:, [self.columns["x"], self.columns["y"]]]

    @property
    def lengths(self) -> np.ndarray:
        """Distance (steps + 1,) that it had driven at each instant [m]."""
        moves = np.diff(self.positions.astype(np.float64), axis=0)
        moves[self.is_carried] = 0.0
        return np.concatenate([[0.0], np.cumsum(np.hypot(moves[:, 0], moves[:, 1]))])

    def ways(self, step: int) -> list[np.ndarray]:
        """Return the positions (n, 2) up to a step, in the pieces that it has driven [m]."""
        cuts = np.flatnonzero(self.is_carried[:step]) + 1
        return np.split(self.positions[: step + 1], cuts)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExplorationFrame(MissionFrame):
    """A snapshot of an exploration run.

    Of several robots `plan` and `heading` have a leading axis of robots (N, ...), and the belief is
    what they know together: of each cell the probability that is the farthest from 1/2. Scans,
    rollouts, references, tracks and the information field are those of one robot, and empty then.

    Args:
        state: (nx,) state of the robot; of several one after the other.
        probability: (H, W) belief in 256 levels, from 0, free, to 255, occupied.
        information: (rows, columns) information of a scan at the nodes of the field [nat].
        scan: (B, 2) end points of the beams in the world [m].
        samples: (N, T + 1, 2) positions of some rollouts [m].
        weights: (N,) weights of these rollouts.
        plan: (T + 1, 2) positions of the nominal trajectory [m].
        heading: heading of the robot [rad].
        reference: (R, 2) reference positions of the plan [m]; empty without a reference.
        movers: (M, 2) positions of the moving obstacles [m].
        terms: value of each cost term for the nominal trajectory.
        sample_terms: cost of each term of the rollouts (N,), by name; empty if they are not known.
        tracks: (N, 2, 2) places of what the robot tracks, now and in a second [m]; NaN for unused
            tracks, (0, 2, 2) without a tracker.
    """

    state: np.ndarray
    probability: np.ndarray
    information: np.ndarray
    scan: np.ndarray
    samples: np.ndarray
    weights: np.ndarray
    plan: np.ndarray
    heading: float | np.ndarray
    reference: np.ndarray
    movers: np.ndarray
    terms: dict[str, float]
    sample_terms: dict[str, np.ndarray]
    tracks: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2, 2)))

    places = ("scan", "samples", "plan", "reference", "movers", "tracks")

    @property
    def plans(self) -> np.ndarray:
        """Positions (N, T, 2) of the nominal trajectory of each robot [m]."""
        return self.plan.reshape(np.size(self.heading), -1, 2)

    @property
    def headings(self) -> np.ndarray:
        """Heading (N,) of each robot [rad]."""
        return np.atleast_1d(np.asarray(self.heading))


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class ExplorationData(MissionData):
    """Data of an exploration run: every step, frames, and the true world.

    Of several robots `robot_radius`, `footprint` and `localisation` have one entry for each. Their
    states stand one after the other, and names end with the number of the robot.

    Args:
        field_origin: pose of the lattice of the information field [m, m, rad].
        field_resolution: distance between its nodes [m].
        start: (nx,) state at the start.
        initial_entropy: entropy of the belief over the reachable cells before the first step [nat].
        goal: (2,) goal position [m]; None if there is no goal.
        control_half_range: (nu,) half the range between the bounds of each control.
        state_names: names of the components of the robot's state.
        robot_radius: radius of the robot [m].
        target: what the exploration ends by: coverage, information, walls or never.
        footprint: (4, 2) corners of a robot that is a rectangle, in its own frame [m]; (0, 2) of a
            disc.
        mover_radii: (M,) radii of the moving obstacles [m].
        member_names: names of the members of a controller that holds several.
        localisation: where the robot took itself to be; None if it knew its pose.
    """

    records: ExplorationRecord
    frames: tuple[ExplorationFrame, ...]
    field_origin: np.ndarray
    field_resolution: float
    start: np.ndarray
    initial_entropy: float
    goal: np.ndarray | None
    control_half_range: np.ndarray
    state_names: tuple[str, ...]
    robot_radius: float | np.ndarray
    footprint: np.ndarray | tuple[np.ndarray, ...]
    mover_radii: np.ndarray
    member_names: tuple[str, ...]
    localisation: LocalisationData | tuple[LocalisationData, ...] | None = None
    target: str = "coverage"

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that are or have positions, with an offset (2,) [m] added."""
        place: Any = self.localisation
        if isinstance(place, LocalisationData):
            place = place.move(offset)
        elif place is not None:
            place = tuple(each.move(offset) for each in place)
        return {
            "records": move_records(self.records, offset, self.state_names),
            "start": move_states(self.start, offset, self.state_names),
            "goal": None if self.goal is None else move_points(self.goal, offset),
            **self.move_mission(offset),
            "localisation": place,
            "field_origin": move_points(self.field_origin, offset),
        }

    @property
    def num_robots(self) -> int:
        """Number of robots, N."""
        return len(robot_columns(self.state_names))

    def by_robot(self, values: Any) -> np.ndarray:
        """Return a field of the records as (steps, N), also that of one robot."""
        return np.asarray(values).reshape(self.num_steps, self.num_robots)

    @property
    def robots(self) -> tuple[RobotRun, ...]:
        """What the run has of each robot."""
        states = np.concatenate([self.start[None], self.records.state])
        carried, errors, place = self.records.is_carried, self.records.pose_error, self.localisation
        is_one = place is None or isinstance(place, LocalisationData)
        places: Any = [place] * self.num_robots if is_one else place
        prints = self.footprint if isinstance(self.footprint, tuple) else (self.footprint,)
        return tuple(
            RobotRun(
                number,
                states[:, list(columns.values())],
                {name: index for index, name in enumerate(columns)},
                np.zeros(self.num_steps, bool)
                if carried is None
                else self.by_robot(carried)[:, number].astype(bool),
                float(self.radii[number]),
                prints[number],
                None if errors is None else self.by_robot(errors)[:, number],
                places[number],
            )
            for number, columns in enumerate(robot_columns(self.state_names).values())
        )

    @property
    def radii(self) -> np.ndarray:
        """Radius (N,) of each robot [m]."""
        return np.atleast_1d(np.asarray(self.robot_radius))

    @property
    def trails(self) -> np.ndarray:
        """Positions (N, steps + 1, 2) of each robot, the start included [m]."""
        return np.stack([each.positions for each in self.robots])

    @property
    def positions(self) -> np.ndarray:
        """Positions (steps + 1, 2) of the first robot, the start included [m]."""
        return self.robots[0].positions

    @property
    def last_positions(self) -> np.ndarray:
        """Positions (N, 2) of the robots at the end [m]."""
        return np.stack([each.positions[-1] for each in self.robots])

    def places(self, frame: ExplorationFrame) -> np.ndarray:
        """Return the position (N, 2) of each robot in a frame [m]."""
        columns = robot_columns(self.state_names).values()
        return np.stack([frame.state[[own["x"], own["y"]]] for own in columns])

    @property
    def live_curves(self) -> LiveCurves:
        """The coverage, of several robots also that by the map of each, and the share of what
        the task is about that was found."""
        names, rows = ["coverage"], [np.asarray(self.records.coverage)]
        team = self.records.parts.get(TEAM)
        if team is not None:
            # The robots come first, so that their curves have the colours of the picture.
            names = [*(f"robot {number + 1}" for number in range(self.num_robots)), "together"]
            rows = [*self.by_robot(team.coverages).T, *rows]
        title = "coverage"
        for tally in self.tallies():
            title, names = f"{title} and {tally.label} found", [*names, f"{tally.label} found"]
            rows.append(tally.values[:-1] / tally.number)
        return LiveCurves(title, tuple(names), np.stack(rows))
