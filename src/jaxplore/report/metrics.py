"""The numbers by which a run is judged."""

import dataclasses
import math
import os
import platform
import sys
from collections import deque
from importlib.metadata import version
from typing import Any, SupportsFloat

import equinox as eqx
import jax
import numpy as np

from jaxplore._version import __version__
from jaxplore.simulation.recording import Recording, Timing

LEVELS = (50, 90, 95, 99)
"""Coverages [%] at which time and path are compared."""
STALL_RADIUS = 0.25
"""A robot that stays this close to one place [m], along each axis, may be stalled."""
CURVE_PERIOD = 0.5
"""Time between the points of the coverage curve [s]."""


@dataclasses.dataclass(frozen=True)
class Compute:
    """Wall-clock cost; None where nothing was timed.

    Args:
        step_ms_p50: median of the steps timed one at a time [ms].
        step_ms_p99: their 99th percentile [ms].
        loop_step_ms: mean per step of the uninterrupted loop [ms].
        steps_per_second: of that loop.
        real_time_factor: control period over the mean step; above 1 is faster than real time.
        compile_seconds: of the loop [s].
    """

    step_ms_p50: float | None
    step_ms_p99: float | None
    loop_step_ms: float | None
    steps_per_second: float | None
    real_time_factor: float | None
    compile_seconds: float | None


@dataclasses.dataclass(frozen=True)
class Metrics:
    """What a run achieved, and at what cost. `print` shows it as a table.

    Args:
        duration: simulated [s].
        num_steps: control periods done.
        coverage: share of the reachable cells known to be free, at the end.
        target_coverage: at which exploration is finished.
        is_finished: the target was reached, or with a goal its end: at the goal, the map known.
        finished_at: when that was [s]; None if it was not.
        is_interrupted: the user stopped the run.
        time_to: for each level of coverage ("50", "90", "95", "99" percent) when it was first
            reached [s]; None if never. The record of step k holds the coverage measured at the
            beginning of that step, so the time is k control periods.
        path_to: the distance travelled until then [m].
        path_length: in all [m].
        initial_entropy: of the belief over the reachable cells before the first step [nat].
        final_entropy: the same at the end [nat].
        initial_unknown: share of the map's cells with `4 p (1 - p) > 1/2` before the first step.
        final_unknown: the same at the end.
        information_per_metre: entropy lost over the reachable cells for each metre travelled
            [nat/m]; None if the robot did not move.
        goal_distance: from the goal at the end [m]; None if there is no goal.
        command_jerk: root mean square over steps and controls of the second difference of the
            commands, `(u_{t+1} - 2 u_t + u_{t-1}) / period^2`, in halves of the range between
            their bounds [1/s^2].
        fault_steps: steps during which a fault of the scenario was active.
        collisions: contacts; successive steps in contact are one.
        collision_steps: steps that would have led into something.
        minimum_clearance: from the robot's edge to the nearest solid cell [m], as far as the
            record looks.
        mean_effective_sample_size: over the steps.
        minimum_effective_sample_size: over the steps.
        non_finite_steps: steps without a single finite rollout.
        reachable_area: [m^2].
        longest_stall: longest time in which the positions fit into a square of side
            `2 * STALL_RADIUS` along the world's axes while the best coverage so far did not rise
            [s].
        compute: wall-clock cost.
        seed: of the run, if known.
        versions: of the software, and the machine.
        coverage_curve: "time" [s], "coverage", "entropy" [nat], "path" [m] and "unknown" every
            half second, the end included.
    """

    duration: float
    num_steps: int
    coverage: float
    target_coverage: float
    is_finished: bool
    finished_at: float | None
    is_interrupted: bool
    time_to: dict[str, float | None]
    path_to: dict[str, float | None]
    path_length: float
    initial_entropy: float | None
    final_entropy: float | None
    initial_unknown: float
    final_unknown: float
    information_per_metre: float | None
    goal_distance: float | None
    command_jerk: float | None
    fault_steps: int
    collisions: int
    collision_steps: int
    minimum_clearance: float | None
    mean_effective_sample_size: float | None
    minimum_effective_sample_size: float | None
    non_finite_steps: int
    reachable_area: float
    longest_stall: float
    compute: Compute
    seed: int | None
    versions: dict[str, str | int | None]
    coverage_curve: dict[str, list[float | None]] = dataclasses.field(repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain Python values that JSON can hold."""
        return dataclasses.asdict(self)

    def rows(self) -> list[tuple[str, str]]:
        """Return what matters as (name, text), for tables."""
        end = "finished" if self.is_finished else "not finished"
        rows = [
            ("coverage", f"{_percent(self.coverage)} of {self.reachable_area:.1f} m², {end}"),
            ("duration", f"{self.duration:.2f} s, {self.num_steps} steps"),
            ("path", f"{self.path_length:.2f} m"),
        ]
        if self.finished_at is not None and self.goal_distance is not None:
            rows.append(("finished", f"after {self.finished_at:.2f} s"))
        if self.goal_distance is not None:
            rows.append(("goal", f"{self.goal_distance:.2f} m away"))
        if self.is_interrupted:
            rows.append(("interrupted", "by the user"))
        for level, seconds in self.time_to.items():
            path = self.path_to[level]
            reached = seconds is not None and path is not None
            rows.append((f"  to {level} %", f"{seconds:.2f} s, {path:.2f} m" if reached else "-"))
        compute, versions = self.compute, self.versions
        sizes = (self.mean_effective_sample_size, self.minimum_effective_sample_size)
        rows += [
            ("entropy", f"{_text(self.initial_entropy, 0)} -> {_text(self.final_entropy, 0)} nat"),
            (
                "unknown",
                f"{_percent(self.initial_unknown)} -> {_percent(self.final_unknown)} of all cells",
            ),
            ("information", f"{_text(self.information_per_metre, 1)} nat/m"),
            ("command jerk", f"{_text(self.command_jerk, 1)} ranges/s²"),
            ("collisions", f"{self.collisions} ({self.collision_steps} steps)"),
            ("clearance", f"{_text(self.minimum_clearance, 3)} m at least"),
            ("longest stall", f"{self.longest_stall:.2f} s"),
            ("sample size", f"{_text(sizes[0], 1)} effective, {_text(sizes[1], 1)} at least"),
            ("non-finite", f"{self.non_finite_steps} steps"),
            *([("faults", f"{self.fault_steps} steps")] if self.fault_steps else []),
            (
                "step",
                f"{_text(compute.step_ms_p50, 2)} ms p50, {_text(compute.step_ms_p99, 2)} ms p99",
            ),
            ("loop", f"{_text(compute.loop_step_ms, 2)} ms a step"),
            ("real time", f"{_text(compute.real_time_factor, 1)} times as fast"),
            ("compilation", f"{_text(compute.compile_seconds, 1)} s"),
            ("seed", "-" if self.seed is None else str(self.seed)),
            ("software", f"jaxplore {versions['jaxplore']}, jax {versions['jax']}"),
            ("device", str(versions["device"])),
        ]
        return rows

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in rows)


def compute_metrics(recording: Recording, *, seed: int | None = None) -> Metrics:
    """Return the metrics of a run.

    Args:
        recording: of a run, finished or not; one without a step counts what is known at its start.
        seed: to note down.
    """
    records, period, steps = recording.records, recording.control_period, recording.num_steps
    time, coverage, entropy, path = progress(recording)
    reached = {str(level): _first(coverage >= np.float32(level / 100)) for level in LEVELS}
    in_contact = np.asarray(records.is_collision, bool)
    begins = in_contact & ~np.concatenate([[False], in_contact[:-1]])
    sample_size = np.asarray(records.effective_sample_size, np.float64)
    sample_size = sample_size[np.isfinite(sample_size)]
    stride = max(1, round(CURVE_PERIOD / period))
    kept = np.unique(np.append(np.arange(0, steps + 1, stride), steps))
    unknown = np.append(
        np.asarray(records.unknown), records.unknown[-1:] if steps else [recording.initial_unknown]
    )
    curve = {
        "time": time,
        "coverage": coverage,
        "entropy": entropy,
        "path": path,
        "unknown": unknown,
    }
    finished_at = _finished_at(recording, float(coverage[-1]))
    return Metrics(
        duration=steps * period,
        num_steps=steps,
        coverage=float(coverage[-1]),
        target_coverage=recording.target_coverage,
        is_finished=finished_at is not None,
        finished_at=finished_at,
        is_interrupted=recording.is_interrupted,
        time_to={name: None if k is None else k * period for name, k in reached.items()},
        path_to={name: None if k is None else float(path[k]) for name, k in reached.items()},
        path_length=float(path[-1]),
        initial_entropy=_finite(recording.initial_entropy),
        final_entropy=_finite(entropy[-1]),
        initial_unknown=recording.initial_unknown,
        final_unknown=float(records.unknown[-1]) if steps else recording.initial_unknown,
        information_per_metre=(
            _finite((recording.initial_entropy - entropy[-1]) / path[-1]) if path[-1] > 0 else None
        ),
        goal_distance=_goal_distance(recording),
        command_jerk=_command_jerk(recording),
        fault_steps=int(np.asarray(records.is_faulty, bool).sum()),
        collisions=int(begins.sum()),
        collision_steps=int(in_contact.sum()),
        minimum_clearance=_finite(np.min(records.clearance, initial=np.inf)),
        mean_effective_sample_size=_finite(sample_size.mean()) if sample_size.size else None,
        minimum_effective_sample_size=_finite(np.min(sample_size, initial=np.inf)),
        non_finite_steps=int((~np.asarray(records.is_finite, bool)).sum()),
        reachable_area=float(recording.reachable.sum()) * recording.resolution**2,
        longest_stall=_longest_stall(recording.positions, coverage) * period,
        compute=_compute(recording.timing, period),
        seed=seed,
        versions=_versions(),
        coverage_curve={
            name: [_finite(value, digits=5) for value in values[kept]]
            for name, values in curve.items()
        },
    )


def progress(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return time [s], coverage, entropy [nat] and path length [m] at the N + 1 instants of a run.

    Instant k is the beginning of step k, the last one the end of the run: nothing is sensed after
    the last step, so coverage and entropy keep their last values there. In a run without a step
    they are those at the start.
    """
    records, steps = recording.records, recording.num_steps
    coverage, entropy = (
        np.append(values, values[-1:] if steps else [initial]).astype(np.float32)
        for values, initial in (
            (records.coverage, recording.initial_coverage),
            (records.entropy, recording.initial_entropy),
        )
    )
    moves = np.diff(recording.positions.astype(np.float64), axis=0)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(moves[:, 0], moves[:, 1]))])
    return np.arange(steps + 1) * recording.control_period, coverage, entropy, path


def _longest_stall(positions: np.ndarray, coverage: np.ndarray) -> int:
    """Return the most steps between two instants of one stall.

    One pass with two ends: the later end advances, the earlier one follows as far as it must.
    Four queues keep the window's extremes, so the whole pass is O(N).
    """
    best = np.maximum.accumulate(coverage).tolist()
    axes = [signed.tolist() for axis in positions.T for signed in (axis, -axis)]
    queues: list[deque[int]] = [deque() for _ in axes]
    first = longest = 0
    for last in range(len(positions)):
        for values, queue in zip(axes, queues, strict=True):
            while queue and values[queue[-1]] <= values[last]:
                queue.pop()
            queue.append(last)
        while best[first] != best[last] or any(
            axes[i][queues[i][0]] + axes[i + 1][queues[i + 1][0]] > 2.0 * STALL_RADIUS
            for i in (0, 2)
        ):
            first += 1
            for queue in queues:
                if queue[0] < first:
                    queue.popleft()
        longest = max(longest, last - first)
    return longest


def _finished_at(recording: Recording, coverage: float) -> float | None:
    if recording.finished_step is not None:
        return recording.finished_step * recording.control_period
    is_covered = recording.goal is None and coverage >= np.float32(recording.target_coverage)
    return 0.0 if is_covered and recording.num_steps == 0 else None


def _goal_distance(recording: Recording) -> float | None:
    if recording.goal is None:
        return None
    return float(np.hypot(*(recording.positions[-1] - recording.goal)))


def _command_jerk(recording: Recording) -> float | None:
    controls = np.asarray(recording.records.control, np.float64)
    if len(controls) < 3:
        return None
    jerk = np.diff(controls, 2, axis=0) / (
        recording.control_half_range * recording.control_period**2
    )
    return _finite(np.sqrt(np.mean(jerk**2)))


def _compute(timing: Timing, period: float) -> Compute:
    measured = timing.loop_steps > 0 and timing.loop_seconds > 0.0
    mean = timing.loop_seconds / timing.loop_steps if measured else None
    single = 1e3 * np.asarray(timing.step_seconds, np.float64)
    return Compute(
        step_ms_p50=float(np.percentile(single, 50)) if single.size else None,
        step_ms_p99=float(np.percentile(single, 99)) if single.size else None,
        loop_step_ms=None if mean is None else 1e3 * mean,
        steps_per_second=None if mean is None else 1.0 / mean,
        real_time_factor=None if mean is None else period / mean,
        compile_seconds=_finite(timing.compile_seconds),
    )


def _versions() -> dict[str, str | int | None]:
    return {
        "jaxplore": __version__,
        "jax": jax.__version__,
        "jaxlib": version("jaxlib"),
        "numpy": np.__version__,
        "equinox": eqx.__version__,
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "device": jax.devices()[0].device_kind,
        "cpu_count": os.cpu_count(),
    }


def _first(mask: np.ndarray) -> int | None:
    return int(mask.argmax()) if mask.any() else None


def _finite(value: SupportsFloat, *, digits: int | None = None) -> float | None:
    number = float(value)
    if not math.isfinite(number):
        return None
    return number if digits is None else round(number, digits)


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
