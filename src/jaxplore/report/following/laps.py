"""Laps and speeds of a path-following run."""

import numpy as np

from jaxplore.report.following.data import PathData


def num_laps(recording: PathData) -> int:
    """Return the number of laps to drive; 0 for an open path."""
    return round(recording.end / recording.length) if recording.is_closed else 0


def lap_starts(recording: PathData) -> np.ndarray:
    """Return the times at which laps begin (L + 1,) [s]: the start, and the end of each lap.

    Lap k, from 0 on, lasts from entry k to entry k + 1, where the progress first reaches k + 1
    lengths of the path; between two steps it grows linearly. A robot that starts behind or beyond
    the line has a longer or a shorter first lap. The last entry is the end of the last completed
    lap. An open path has only the start.
    """
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
