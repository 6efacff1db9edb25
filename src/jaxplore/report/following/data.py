"""Data of a path-following run: the record of each step, frames, course, laps and speeds."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Flag, Scalar, StateVector
from jaxplore.maps.datum import move_points
from jaxplore.report.recording import Frame, RunData, move_records, move_states


class PathRecord(NamedTuple):
    """The record of a step; in a recording every field has a leading axis of steps.

    Args:
        state: (nx,) state after the step, with its path parameter phi.
        control: (nu,) control that took effect during the step.
        contouring: contouring error at phi, computed by the controller's own cost [m].
        lag: lag error at phi, computed likewise [m].
        progress: arc length of the point of the path nearest to the robot [m]; it keeps growing
            from lap to lap.
        deviation: distance from that point across the path, positive to its right [m].
        room: distance from the robot's edge to the edge of the corridor there [m], negative beyond
            it; infinite without one.
        gap: distance from the robot's edge to the nearest obstacle [m]; infinite without any.
        acceleration: (2,) acceleration along the heading and to the left [m/s^2]; NaN for a model
            without a time derivative.
        effective_sample_size: effective sample size of the controller's rollouts.
        is_finite: whether any rollout had a finite cost.
        is_faulty: whether a fault of tracking or odometry was active.
    """

    state: StateVector
    control: ControlVector
    contouring: Scalar
    lag: Scalar
    progress: Scalar
    deviation: Scalar
    room: Scalar
    gap: Scalar
    acceleration: Float[Array, "2"]
    effective_sample_size: Scalar
    is_finite: Flag
    is_faulty: Flag


@dataclasses.dataclass(frozen=True, kw_only=True)
class PathFrame(Frame):
    """A snapshot of a path-following run.

    Args:
        position: (2,) position of the robot [m].
        heading: heading of the robot [rad].
        corners: (N, V, 2) of the obstacles' polygons [m].
        samples: (S, T + 1, 2) positions of some rollouts [m].
        weights: (S,) weights of these rollouts.
        plan: (T + 1, 2) positions of the nominal trajectory [m].
        sample_terms: cost of each term of the rollouts (S,), by name; empty if they are not known.
    """

    position: np.ndarray
    heading: float
    corners: np.ndarray
    samples: np.ndarray
    weights: np.ndarray
    plan: np.ndarray
    sample_terms: dict[str, np.ndarray]

    places = ("position", "corners", "samples", "plan")


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PathData(RunData):
    """Data of a path-following run: every step, frames, and the course.

    Args:
        start: (nx,) state at the start.
        start_progress: arc length at the start [m].
        centre: (P, 2) points of the path [m].
        edges: (2, P, 2) the corridor's left and right edge [m]; (0, P, 2) without one.
        length: length of the path, or of a lap [m].
        end: arc length at which the run is finished [m].
        is_closed: whether the path is a lap.
        state_names: names of the components of the robot's state.
        control_half_range: (nu,) half the range between the bounds of each control.
        robot_radius: radius of the discs that cover the robot [m].
        footprint: (4, 2) corners of a rectangular robot in its own frame [m]; (0, 2) of a disc.
        obstacle_radii: (N,) radii by which the obstacles' polygons are inflated [m].
    """

    records: PathRecord
    frames: tuple[PathFrame, ...]
    start: np.ndarray
    start_progress: float
    centre: np.ndarray
    edges: np.ndarray
    length: float
    end: float
    is_closed: bool
    state_names: tuple[str, ...]
    control_half_range: np.ndarray
    robot_radius: float
    footprint: np.ndarray
    obstacle_radii: np.ndarray

    def move_fields(self, offset: np.ndarray) -> dict[str, Any]:
        """Return the fields that are or have positions, with an offset (2,) [m] added."""
        return {
            "records": move_records(self.records, offset, self.state_names),
            "start": move_states(self.start, offset, self.state_names),
            "centre": move_points(self.centre, offset),
            "edges": move_points(self.edges, offset),
        }

    @property
    def progress(self) -> np.ndarray:
        """Arc length (N + 1,) at the start and after each step [m]."""
        return np.concatenate([[self.start_progress], self.records.progress])

    @property
    def positions(self) -> np.ndarray:
        """Positions (N + 1, 2) of the robot, the start included [m]."""
        states = np.concatenate([self.start[None], self.records.state])
        return states[:, [self.state_names.index("x"), self.state_names.index("y")]]


def num_laps(recording: PathData) -> int:
    """Return the number of laps to drive; 0 for an open path."""
    return round(recording.end / recording.length) if recording.is_closed else 0


def lap_starts(recording: PathData) -> np.ndarray:
    """Return the times at which laps begin (L + 1,) [s]: the start, and the end of each completed
    lap, where the progress first reaches its number of lengths; between two steps it grows
    linearly. An open path has only the start."""
    time, progress = recording.time, np.asarray(recording.progress, np.float64)
    starts, laps = [0.0], num_laps(recording)
    for number in range(1, laps + 1):
        # As shares of the end: rounding must not lose the last lap of a finished run.
        line = recording.end * (number / laps)
        has_passed = progress >= line
        if not has_passed.any():
            break
        after = int(has_passed.argmax())
        # A robot that starts beyond the line has no step before it to interpolate from.
        if after == 0:
            starts.append(0.0)
            continue
        before = after - 1
        share = (line - progress[before]) / (progress[after] - progress[before])
        starts.append(float(time[before] + share * recording.control_period))
    return np.asarray(starts)


def lap_times(recording: PathData) -> list[float]:
    """Return the times of the completed laps [s], the first from the start of the run.

    Empty for an open path.
    """
    return [float(seconds) for seconds in np.diff(lap_starts(recording))]


def speeds(recording: PathData) -> np.ndarray:
    """Return the speed (N + 1,) at the start and after each step [m/s], never negative.

    It is read from the state, v or (vx, vy). If the state has no speed, it is the distance per
    control period, and 0 at the start.
    """
    names = recording.state_names
    states = np.concatenate([recording.start[None], recording.records.state]).astype(np.float64)
    for own in (("v",), ("vx", "vy")):
        if set(own) <= set(names):
            columns = [names.index(name) for name in own]
            return np.asarray(np.linalg.norm(states[:, columns], axis=1))
    moves = np.diff(recording.positions.astype(np.float64), axis=0)
    return np.concatenate([[0.0], np.hypot(moves[:, 0], moves[:, 1]) / recording.control_period])
