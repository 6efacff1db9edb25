"""Metrics of a path-following run."""

import dataclasses
import math
from typing import Any

import numpy as np

from jaxplore.report._numbers import finite, finite_mean, text
from jaxplore.report.following.data import PathData, lap_times, speeds
from jaxplore.report.metrics import Column, Curve, Metrics, thin_series
from jaxplore.report.motion import command_jerk, episodes


@dataclasses.dataclass(frozen=True, kw_only=True)
class PathMetrics(Metrics):
    """Metrics of a path-following run.

    Errors are absolute values over all steps; they are None for a run without a step.

    Args:
        progress: arc length from the start to the nearest point of the path [m].
        to_go: arc length from there to the end [m].
        lap_times: times of the completed laps [s]; empty for an open path.
        mean_contouring: mean distance across the path at phi, by the controller's own cost [m].
        max_contouring: the greatest distance across the path at phi [m].
        mean_lag: mean distance along the path at phi [m].
        max_lag: the greatest distance along the path at phi [m].
        mean_deviation: mean distance from the nearest point of the path [m].
        max_deviation: the greatest distance from the path [m].
        corridor_violations: number of times that part of the robot left the corridor; successive
            steps count once.
        corridor_violation_steps: number of steps that ended outside the corridor.
        minimum_room: least distance from the robot's edge to the corridor's edge [m], negative
            beyond it; None without one.
        collisions: number of contacts with obstacles; successive steps count once.
        collision_steps: number of steps that ended in contact.
        minimum_gap: least distance from the robot's edge to the nearest obstacle [m]; None without
            any.
        mean_speed: mean speed of the robot over the steps [m/s].
        max_speed: the greatest speed [m/s].
        rms_lateral_acceleration: root mean square [m/s^2]; None for a model without a time
            derivative.
        max_lateral_acceleration: the greatest lateral acceleration [m/s^2].
        rms_longitudinal_acceleration: root mean square [m/s^2].
        rms_jerk: root mean square of the change of both accelerations from step to step, over the
            control period [m/s^3].
        command_jerk: root mean square of the commands' second differences, in halves of the range
            between their bounds [1/s^2].
        mean_effective_sample_size: mean effective sample size over the steps.
        minimum_effective_sample_size: least effective sample size of the steps.
        non_finite_steps: number of steps without a single finite rollout.
        fault_steps: number of steps during which a fault was active.
        curves: "time" [s], "progress", "contouring", "lag", "room" and "gap" [m] every half second,
            the end included.
    """

    progress: float
    to_go: float
    lap_times: list[float]
    mean_contouring: float | None
    max_contouring: float | None
    mean_lag: float | None
    max_lag: float | None
    mean_deviation: float | None
    max_deviation: float | None
    corridor_violations: int
    corridor_violation_steps: int
    minimum_room: float | None
    collisions: int
    collision_steps: int
    minimum_gap: float | None
    mean_speed: float | None
    max_speed: float | None
    rms_lateral_acceleration: float | None
    max_lateral_acceleration: float | None
    rms_longitudinal_acceleration: float | None
    rms_jerk: float | None
    command_jerk: float | None
    mean_effective_sample_size: float | None
    minimum_effective_sample_size: float | None
    non_finite_steps: int
    fault_steps: int
    curves: dict[str, list[float | None]] = dataclasses.field(repr=False)

    plotted = (
        Curve("progress", "progress along the path [m]"),
        Curve("contouring", "contouring error [m]"),
    )
    columns = (
        Column.num_finished(),
        Column.quartiles("finished_at", "after [s]"),
        Column.quartiles(
            "best_lap",
            "best lap [s]",
            number=lambda each: min(each.lap_times, default=None),
            applies=lambda spread: math.isfinite(spread[0]),
        ),
        Column.quartiles("progress", "progress [m]"),
        Column.quartiles("mean_deviation", "deviation [m]", digits=3),
        Column.quartiles("max_deviation", "largest [m]", digits=3),
        Column.total("corridor_violations", "off the corridor"),
        Column.total("collisions", "collisions"),
        Column.least("minimum_gap", "gap [m]", applies=math.isfinite),
        Column.quartiles("mean_speed", "speed [m/s]", digits=2),
        Column.quartiles("max_lateral_acceleration", "lateral [m/s²]", digits=2),
        Column.quartiles("command_jerk", "jerk [1/s²]", digits=0),
        Column.total("fault_steps", "faults [steps]", applies=lambda total: total > 0),
        Column.quartiles("step_ms", "step [ms]", number=lambda each: each.compute.step_ms_p50),
    )

    def series(self) -> dict[str, list[float | None]]:
        """Return `curves`."""
        return self.curves

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text), for tables."""
        end = (
            f"finished after {text(self.finished_at, 2)} s" if self.is_finished else "not finished"
        )
        rows = [
            ("progress", f"{self.progress:.2f} m, {max(self.to_go, 0.0):.2f} m to go, {end}"),
            ("duration", f"{self.duration:.2f} s, {self.num_steps} steps"),
        ]
        if self.is_interrupted:
            rows.append(("interrupted", "by the user"))
        if self.lap_times:
            best, mean = min(self.lap_times), float(np.mean(self.lap_times))
            rows.append(
                (
                    "laps",
                    f"{len(self.lap_times)}, the best in {best:.2f} s, {mean:.2f} s on average",
                )
            )
        for name in ("contouring", "lag", "deviation"):
            both = [text(getattr(self, f"{kind}_{name}"), 3) for kind in ("mean", "max")]
            rows.append((name, f"{both[0]} m on average, {both[1]} m at most"))
        if self.minimum_room is not None:
            times = f"{self.corridor_violations} violations ({self.corridor_violation_steps} steps)"
            rows.append(("corridor", f"{times}, {self.minimum_room:.3f} m of room at least"))
        if self.minimum_gap is not None:
            times = f"{self.collisions} contacts ({self.collision_steps} steps)"
            rows.append(("obstacles", f"{times}, {self.minimum_gap:.3f} m away at least"))
        lateral = [text(self.rms_lateral_acceleration, 2), text(self.max_lateral_acceleration, 2)]
        sizes = (self.mean_effective_sample_size, self.minimum_effective_sample_size)
        rows += [
            ("speed", f"{text(self.mean_speed, 2)} m/s, {text(self.max_speed, 2)} m/s at most"),
            ("lateral", f"{lateral[0]} m/s² RMS, {lateral[1]} m/s² at most"),
            ("longitudinal", f"{text(self.rms_longitudinal_acceleration, 2)} m/s² RMS"),
            ("jerk", f"{text(self.rms_jerk, 1)} m/s³ RMS"),
            ("command jerk", f"{text(self.command_jerk, 1)} ranges/s²"),
            ("sample size", f"{text(sizes[0], 1)} effective, {text(sizes[1], 1)} at least"),
            ("non-finite", f"{self.non_finite_steps} steps"),
            *([("faults", f"{self.fault_steps} steps")] if self.fault_steps else []),
            *self.last_rows(),
        ]
        return rows


def compute_path_metrics(recording: PathData, *, seed: int | None = None) -> PathMetrics:
    """Compute the metrics of a path-following run, finished or not, also without a step."""
    records, period, steps = recording.records, recording.control_period, recording.num_steps
    time, progress = recording.time, recording.progress
    way, speed = float(progress[-1] - progress[0]), speeds(recording)[1:]
    room, gap = (np.asarray(each, np.float64) for each in (records.room, records.gap))
    felt = np.asarray(records.acceleration, np.float64).reshape(-1, 2)
    jerk = np.diff(felt, axis=0) / period
    sizes = np.asarray(records.effective_sample_size, np.float64)
    measured = {
        "contouring": records.contouring,
        "lag": records.lag,
        "room": records.room,
        "gap": records.gap,
    }
    curves = {"time": time, "progress": progress} | {
        # Contouring, lag, room and gap are measured after each step: the start has no value.
        name: np.concatenate([[np.nan], values])
        for name, values in measured.items()
    }
    # The loop ends with the step that reaches the end.
    finished_at = steps * period if progress[-1] >= recording.end else None
    return PathMetrics(
        **recording.common_metrics(finished_at=finished_at, seed=seed),
        progress=way,
        to_go=float(recording.end - progress[-1]),
        lap_times=lap_times(recording),
        mean_contouring=finite_mean(np.abs(records.contouring)),
        max_contouring=_greatest(records.contouring),
        mean_lag=finite_mean(np.abs(records.lag)),
        max_lag=_greatest(records.lag),
        mean_deviation=finite_mean(np.abs(records.deviation)),
        max_deviation=_greatest(records.deviation),
        corridor_violations=episodes(room < 0.0),
        corridor_violation_steps=int((room < 0.0).sum()),
        minimum_room=finite(np.min(room, initial=np.inf)),
        collisions=episodes(gap < 0.0),
        collision_steps=int((gap < 0.0).sum()),
        minimum_gap=finite(np.min(gap, initial=np.inf)),
        mean_speed=finite_mean(speed),
        max_speed=_greatest(speed),
        rms_lateral_acceleration=_rms(felt[:, 1]),
        max_lateral_acceleration=_greatest(felt[:, 1]),
        rms_longitudinal_acceleration=_rms(felt[:, 0]),
        rms_jerk=_rms(np.hypot(jerk[:, 0], jerk[:, 1])),
        command_jerk=command_jerk(records.control, recording.control_half_range, period),
        mean_effective_sample_size=finite_mean(sizes),
        minimum_effective_sample_size=finite(np.min(sizes, initial=np.inf)),
        non_finite_steps=int((~np.asarray(records.is_finite, bool)).sum()),
        fault_steps=int(np.asarray(records.is_faulty, bool).sum()),
        curves=thin_series(curves, period),
    )


def _greatest(values: Any) -> float | None:
    """Return the greatest absolute value; None if nothing is finite."""
    numbers = np.abs(np.asarray(values, np.float64))
    numbers = numbers[np.isfinite(numbers)]
    return float(numbers.max()) if numbers.size else None


def _rms(values: np.ndarray) -> float | None:
    mean = finite_mean(values**2)
    return None if mean is None else float(np.sqrt(mean))
