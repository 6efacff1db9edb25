"""Data of an exploration of a volume."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxplore._types import ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.geometry.level_motion import LevelPose
from jaxplore.maps.datum import move_points
from jaxplore.report._numbers import finite, numbers, percent, text
from jaxplore.report.coverage_levels import (
    LEVELS,
    at_instants,
    describe_levels,
    find_first,
    reach_levels,
)
from jaxplore.report.drawing.palette import Colour
from jaxplore.report.exploration.guard import GUARD_COLUMN, GuardMetrics, guard_metrics
from jaxplore.report.metrics import Column, Curve, thin_series
from jaxplore.report.motion import episodes
from jaxplore.report.of_parts import PartsData, PartsMetrics
from jaxplore.report.recording import Frame, LiveCurves, move_records, move_states
from jaxplore.report.volume.localisation import ERRORS, flight_errors


class VolumeRecord(NamedTuple):
    """The record of a step; in a recording every field has a leading axis of steps.

    Args:
        state: (nx,) state after the step.
        control: (nu,) control that took effect during the step.
        coverage: share of the observable volume that is known to be free.
        clearance: distance from the robot's edge to the nearest solid voxel [m], up to the reach of
            the examined box.
        is_collision: whether the step would have led to a collision; the robot stopped instead.
        effective_sample_size: effective sample size of the controller's rollouts.
        is_finite: whether any rollout had a finite cost.
        is_untraversable: whether part of the robot is in a keep-out box; None without any.
        stop: why the guard stopped the robot, an index into `control.stops.REASONS`; 0 if it did
            not, None without a guard.
        parts: record of each part of the robot that has one, by its name; None in older files.
        estimate: pose (x, y, z, yaw) at which the robot takes itself to be after the step, with z
            up [m, m, m, rad]; None if it knows its pose, as is the one below.
        reckoned: the same by the odometry alone.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    clearance: Scalar
    is_collision: Flag
    effective_sample_size: Scalar
    is_finite: Flag
    is_untraversable: Flag | None = None
    stop: Count | None = None
    parts: dict[str, Any] | None = None
    estimate: LevelPose | None = None
    reckoned: LevelPose | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class VolumeFrame(Frame):
    """A snapshot of an exploration of a volume.

    Args:
        state: (nx,) state of the robot.
        level: (H, W) level slice of the map at the height of the robot: `UNKNOWN`, `FREE` or
            `OCCUPIED`.
        upright: (D, W) vertical slice of the map along x, through the robot.
        voxels: (ceil(D H W / 8),) bits of the voxels that the robot knows to be occupied.
        plan: (T + 1, 3) positions of the nominal trajectory, with z up [m].
        movers: (P, 3) true moving obstacles, (x, y, radius) [m].
        parts: arrays of each part that has any, by its name.
    """

    state: np.ndarray
    level: np.ndarray
    upright: np.ndarray
    voxels: np.ndarray
    plan: np.ndarray
    movers: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    parts: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    places = ("plan", "movers")

    def find_occupied(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the voxels (D, H, W) that the robot knows to be occupied."""
        bits = np.unpackbits(self.voxels, count=math.prod(shape))
        return bits.reshape(shape).astype(bool)


UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""States of a voxel in a slice."""


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class VolumeData(PartsData):
    """Data of an exploration of a volume: every step, frames, and the true world.

    Args:
        world: (D, H, W) voxels that are truly occupied.
        belief: (D, H, W) states of the voxels of the robot's map at the end.
        observable: (D, H, W) voxels that count for the coverage.
        resolution: side of a voxel [m].
        origin: corner (x, y, z) of the first voxel [m].
        start: (nx,) state at the start.
        state_names: names of the components of the state.
        initial_coverage: coverage before the first step.
        target_coverage: coverage at which the exploration is finished.
        robot_radius: radius of the robot [m].
        given_up_step: number of steps until it was given up; None if it was not.
        goal: (3,) position (x, y, z) of the goal [m]; None without one.
        is_at_goal: whether the robot was at rest at its goal at the end.
        boxes: (B, 6) keep-out boxes (x_min, y_min, z_min, x_max, y_max, z_max) [m].
    """

    records: VolumeRecord
    frames: tuple[VolumeFrame, ...]
    world: np.ndarray
    belief: np.ndarray
    observable: np.ndarray
    resolution: float
    origin: np.ndarray
    start: np.ndarray
    state_names: tuple[str, ...]
    initial_coverage: float
    target_coverage: float
    robot_radius: float
    given_up_step: int | None = None
    goal: np.ndarray | None = None
    is_at_goal: bool = False
    boxes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 6)))

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that have positions, with an offset (2,) [m] added."""
        return {
            "records": self._move_records(offset),
            "start": move_states(self.start, offset, self.state_names),
            "origin": move_points(self.origin, offset),
            "goal": None if self.goal is None else move_points(self.goal, offset),
            "parts": self.move_parts(offset),
            "boxes": move_points(move_points(self.boxes, offset), offset, (3, 4)),
        }

    def marks(self, frame: VolumeFrame) -> list[tuple[np.ndarray, Colour]]:
        """Return the place (3,) [m] and the colour of what parts mark in a frame."""
        return [mark for each in self.parts.values() for mark in each.marks(frame)]

    def _move_records(self, offset: np.ndarray) -> VolumeRecord:
        records: VolumeRecord = move_records(self.records, offset, self.state_names)
        moved: dict[str, Any] = {
            name: move_points(getattr(records, name), offset)
            for name in ("estimate", "reckoned")
            if getattr(records, name) is not None
        }
        return records._replace(**moved)

    @property
    def live_curves(self) -> LiveCurves:
        """The coverage, and the share that was found of what the task is about."""
        rows, names = [np.asarray(self.records.coverage)], ["coverage"]
        for tally in self.tallies():
            rows.append(tally.values[:-1] / tally.number)
            names.append(f"{tally.label} found")
        return LiveCurves(" and ".join(names), tuple(names), np.stack(rows))

    @property
    def coverage(self) -> np.ndarray:
        """Coverage (N + 1,) at each instant."""
        return at_instants(self.records.coverage, self.initial_coverage)

    @property
    def positions(self) -> np.ndarray:
        """Positions (N + 1, 3) of the robot with z up, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        x, y, z = (self.state_names.index(name) for name in "xyz")
        return np.asarray(states[:, [x, y, z]] * np.array([1.0, 1.0, -1.0]))

    @property
    def estimates(self) -> list[tuple[np.ndarray, str, str]]:
        """Poses (N, 4) at which a robot that found its pose took itself to be, and those of its
        odometry, each with the style of its line and what it is; empty if it knew its pose."""
        named = (
            (self.records.reckoned, ":", "by odometry alone"),
            (self.records.estimate, "--", "estimated way"),
        )
        return [
            (np.asarray(each), style, label) for each, style, label in named if each is not None
        ]

    @property
    def headings(self) -> np.ndarray:
        """Yaws (N + 1,) of the robot, the start included [rad]."""
        states = np.concatenate([self.start[None], self.records.state]).astype(np.float64)
        w, x, y, z = (states[:, self.state_names.index(name)] for name in ("qw", "qx", "qy", "qz"))
        yaws: np.ndarray = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return yaws


@dataclasses.dataclass(frozen=True, kw_only=True)
class VolumeMetrics(PartsMetrics, GuardMetrics):
    """Metrics of an exploration of a volume.

    Args:
        coverage: share of the observable volume that is known to be free at the end.
        time_to: time at which each level of coverage ("50", "90", "95", "99" percent) was first
            reached [s]; None if never.
        path_to: distance flown until then [m].
        path_length: distance flown in the whole run [m].
        volume: observable volume [m^3].
        collisions: contacts; successive steps in contact are one.
        minimum_clearance: least distance from the robot's edge to a solid voxel [m].
        mean_speed: mean speed [m/s].
        mean_effective_sample_size: mean effective sample size.
        goal_distance: distance from the goal at the end [m]; None without a goal.
        untraversable_steps: number of steps that ended with part of the robot in a keep-out box.
        ate: absolute trajectory error of a robot that localised itself, root mean square after the
            alignment [m]; None if it knew its pose, as are the ones below.
        odometry_ate: the same error of the odometry alone [m].
        rpe: relative pose error over 5 m, root mean square of the position [m].
        greatest_error: greatest distance of the estimated position from the true one, not aligned
            [m].
        curve: time, coverage and path, and the curves of parts, for plots.
    """

    coverage: float
    time_to: dict[str, float | None]
    path_to: dict[str, float | None]
    path_length: float
    volume: float
    collisions: int
    minimum_clearance: float | None
    mean_speed: float
    mean_effective_sample_size: float | None
    goal_distance: float | None
    untraversable_steps: int
    ate: float | None
    odometry_ate: float | None
    rpe: float | None
    greatest_error: float | None
    curve: dict[str, list[float | None]]
    columns = (
        Column.num_finished(),
        Column.quartiles("to_90", "90 % [s]", number=lambda each: each.time_to["90"]),
        Column.quartiles("to_95", "95 % [s]", number=lambda each: each.time_to["95"]),
        Column.quartiles(
            "goal_distance",
            "goal [m]",
            applies=lambda spread: spread[0] < math.inf,
        ),
        Column.quartiles("path_length", "path [m]"),
        Column.total("collisions", "collisions"),
        GUARD_COLUMN,
        Column.least("minimum_clearance", "clearance [m]"),
        *(
            Column.quartiles(name, title, applies=lambda spread: spread[0] < math.inf)
            for name, title in (("ate", "ATE [m]"), ("odometry_ate", "of odometry [m]"))
        ),
        Column.quartiles("step_ms", "step [ms]", number=lambda each: each.compute.step_ms_p50),
    )
    plotted = (Curve("coverage", "coverage [%]", 100.0, 100.0), Curve("path", "path [m]"))
    levels = LEVELS

    def series(self) -> dict[str, list[float | None]]:
        """Return `curve`."""
        return self.curve

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text)."""
        levels = describe_levels(self.time_to)
        return [
            self.duration_row(),
            ("coverage", f"{percent(self.coverage)} of {self.volume:.1f} m³, {levels}"),
            *self.part_rows(),
            *numbers("goal", "{:.2f} m away", self.goal_distance),
            ("path", f"{self.path_length:.1f} m, {self.mean_speed:.2f} m/s in the mean"),
            ("collisions", str(self.collisions)),
            *self._localisation_rows(),
            *self.guard_rows(),
            *(
                [("untraversable", f"{self.untraversable_steps} steps")]
                if self.untraversable_steps
                else []
            ),
            *numbers("clearance", "{:.3f} m at least", self.minimum_clearance),
            *numbers("sample size", "{:.1f} effective", self.mean_effective_sample_size),
            *self.last_rows(),
        ]

    def _localisation_rows(self) -> list[tuple[str, str]]:
        if self.ate is None:
            return []
        error = f"{self.ate:.3f} m, {text(self.rpe, 3)} m over 5 m"
        return [("trajectory error", error), ("  of odometry", f"{text(self.odometry_ate, 2)} m")]


def _pose_errors(data: VolumeData) -> dict[str, Any]:
    found, alone = data.records.estimate, data.records.reckoned
    if found is None or alone is None or not data.num_steps:
        return dict.fromkeys(ERRORS)
    poses = np.asarray(found), np.asarray(alone)
    return flight_errors(data.positions[1:], data.headings[1:], *poses)


def compute_volume_metrics(data: VolumeData, *, seed: int | None = None) -> VolumeMetrics:
    """Compute the metrics of a run; without a step those of its start."""
    records, period = data.records, data.control_period
    coverage, given_up = data.coverage, data.given_up_step
    steps = np.linalg.norm(np.diff(data.positions, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    tallies = data.tallies()
    if data.goal is not None:
        done = data.num_steps if data.is_at_goal else None
    elif tallies:
        found = [find_first(each.values[:-1].astype(float), float(each.number)) for each in tallies]
        all_found = [each for each in found if each is not None]
        done = max(all_found) if len(all_found) == len(tallies) else None
    else:
        done = find_first(coverage, data.target_coverage)
    # A run ends with the step in which its target is reached, or takes none.
    finished_at = None if done is None else min(done + 1, data.num_steps) * period
    sizes = np.asarray(records.effective_sample_size, np.float64)
    curve = {"time": data.time, "coverage": coverage, "path": path, **data.part_curves()}
    return VolumeMetrics(
        **data.common_metrics(finished_at=finished_at, seed=seed),
        coverage=float(coverage[-1]),
        given_up_at=None if given_up is None else given_up * period,
        **reach_levels(coverage, path, period),
        path_length=float(path[-1]),
        volume=float(data.observable.sum()) * data.resolution**3,
        collisions=episodes(np.asarray(records.is_collision, bool)),
        **guard_metrics(records.stop),
        parts=data.part_metrics(),
        minimum_clearance=finite(np.min(records.clearance, initial=np.inf)),
        mean_speed=float(path[-1] / max(period, data.num_steps * period)),
        mean_effective_sample_size=finite(sizes.mean()) if sizes.size else None,
        goal_distance=None
        if data.goal is None
        else float(np.linalg.norm(data.positions[-1] - data.goal)),
        untraversable_steps=0
        if records.is_untraversable is None
        else int(np.asarray(records.is_untraversable, bool).sum()),
        **_pose_errors(data),
        curve=thin_series(curve, period),
    )
