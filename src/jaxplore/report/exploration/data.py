"""Data of an exploration run: the record of each step, the frames, the world."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxplore._types import ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.control.base import Members
from jaxplore.maps.datum import move_points
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.recording import LiveCurves, move_records, move_states


class MapProgress(NamedTuple):
    """Statistics of the known map: see `ExplorationRecord`."""

    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    unknown_map: Scalar


class ExplorationRecord(NamedTuple):
    """The record of a step; in a recording every field has a leading axis of steps.

    Args:
        state: (nx,) state after the step.
        control: (nu,) control that took effect during the step.
        coverage: share of the reachable cells known to be free.
        entropy: entropy of the belief over the reachable cells [nat].
        unknown: share of the reachable cells with `4 p (1 - p) > 1/2`.
        unknown_map: the same share of all cells of the map, below which a mission with a goal
            counts the map as explored: the robot does not know which cells it can reach.
        clearance: distance from the robot's edge to the nearest solid cell [m], up to half a metre.
        is_collision: whether the step would have led to a collision; the robot stopped instead.
        is_untraversable: whether part of the robot is on untraversable ground.
        effective_sample_size: effective sample size of the controller's rollouts.
        is_finite: whether any rollout had a finite cost.
        is_faulty: whether a fault of scans or odometry was active.
        targets_seen: number of targets found so far: seen, or with a detector reported.
        parts: record of each part of the robot that has one, by its name.
        members: diagnostics of the members of a controller that holds several.
        stop: why the guard stopped the robot in the step, an index into `control.guard.REASONS`; 0
            if it did not, None without a guard.
        pose_error: distance of the estimated position from the true one [m]; None for a robot that
            knows its pose, as is the one below.
        uncertainty: standard deviation of the position, as the robot estimates it [m].
        is_carried: whether a fault carried the robot away at the end of the step; None without such
            a fault.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    unknown_map: Scalar
    clearance: Scalar
    is_collision: Flag
    is_untraversable: Flag
    effective_sample_size: Scalar
    is_finite: Flag
    is_faulty: Flag
    targets_seen: Count
    parts: dict[str, Any]
    members: Members | None
    stop: Count | None = None
    pose_error: Scalar | None = None
    uncertainty: Scalar | None = None
    is_carried: Flag | None = None


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


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExplorationFrame(MissionFrame):
    """A snapshot of an exploration run.

    Args:
        state: (nx,) state of the robot.
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
    heading: float
    reference: np.ndarray
    movers: np.ndarray
    terms: dict[str, float]
    sample_terms: dict[str, np.ndarray]
    tracks: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2, 2)))

    places = ("scan", "samples", "plan", "reference", "movers", "tracks")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class ExplorationData(MissionData):
    """Data of an exploration run: every step, frames, and the true world.

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
    robot_radius: float
    footprint: np.ndarray
    mover_radii: np.ndarray
    member_names: tuple[str, ...]
    localisation: LocalisationData | None = None
    target: str = "coverage"

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that are or have positions, with an offset (2,) [m] added."""
        place = self.localisation
        return {
            "records": move_records(self.records, offset, self.state_names),
            "start": move_states(self.start, offset, self.state_names),
            "goal": None if self.goal is None else move_points(self.goal, offset),
            **self.move_mission(offset),
            "localisation": None if place is None else place.move(offset),
            "field_origin": move_points(self.field_origin, offset),
        }

    @property
    def live_curves(self) -> LiveCurves:
        """The coverage, and the share of the targets that were found."""
        rows = [np.asarray(self.records.coverage)]
        if not len(self.targets):
            return LiveCurves("coverage", ("coverage",), np.stack(rows))
        rows.append(np.asarray(self.records.targets_seen) / len(self.targets))
        return LiveCurves(
            "coverage and targets found", ("coverage", "targets found"), np.stack(rows)
        )

    @property
    def positions(self) -> np.ndarray:
        """Positions (N + 1, 2) of the robot, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        return states[:, [self.state_names.index("x"), self.state_names.index("y")]]

    @property
    def last_positions(self) -> np.ndarray:
        """Position (1, 2) of the robot at the end [m]."""
        return self.positions[-1:]
