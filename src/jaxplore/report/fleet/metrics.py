"""Metrics of an exploration by a fleet."""

import dataclasses
import math
from typing import Any

import numpy as np

from jaxplore.report._numbers import finite, numbers, percent, text
from jaxplore.report.coverage_levels import LEVELS, describe_levels, reach_levels
from jaxplore.report.exploration.guard import GUARD_COLUMN, GuardMetrics, guard_metrics
from jaxplore.report.exploration.localisation import trajectory_errors
from jaxplore.report.exploration.mission_metrics import (
    TARGET_COLUMNS,
    TARGET_CURVE,
    MissionMetrics,
    mission_curves,
    mission_metrics,
)
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.fleet.data import FleetData
from jaxplore.report.metrics import Column, Curve, thin_series
from jaxplore.report.motion import episodes


@dataclasses.dataclass(frozen=True, kw_only=True)
class FleetMetrics(MissionMetrics, GuardMetrics):
    """Metrics of an exploration by a fleet.

    Args:
        num_robots: number of robots, N.
        coordination: how the robots divided the places among themselves.
        coverage: share of the reachable cells that some robot knows to be free at the end.
        target_coverage: coverage at which the exploration is finished; None if it never is.
        time_to: time at which each level of coverage ("50", "90", "95", "99" percent) was first
            reached [s]; None if never.
        path_to: distance that all robots together had driven by then [m].
        path_lengths: distance that each robot drove (N,) [m].
        path_length: distance that all robots drove together [m].
        collisions: collisions with something solid, of all robots; successive steps are one.
        contacts: contacts between robots: successive steps in which some robot was stopped because
            it would have touched another one are one.
        untraversable_steps: number of steps of a robot that ended with part of it where it may not
            be, of all robots.
        minimum_clearance: least distance from a robot's edge to a solid cell or another robot [m].
        exchanged: size of all messages with maps and ways [bytes].
        linked: share of the pairs of robots that heard each other, mean over the steps.
        goal_distance: distance of the nearest robot from the goal at the end [m]; None if there is
            no goal.
        ates: absolute trajectory error of each robot (N,), as `ExplorationMetrics.ate` [m]; empty
            if the robots knew their poses, as is the one below.
        odometry_ates: the same error of its odometry alone (N,) [m].
        position_errors: root mean square over the steps of the distance of each robot from where it
            takes itself to be (N,) [m]. The frame is that of all robots: nothing is aligned.
        ate: the greatest of the `ates` [m]; None if the robots knew their poses.
        num_loops: number of loops that all robots closed; None on a known map.
        is_map_known: whether the map was known in advance, so that coverage says nothing.
        least_coverage: coverage of the map of the robot that knows the least at the end.
        mean_effective_sample_size: mean effective sample size.
        coverage_curve: "time" [s], "coverage", "path" [m] of all robots, and the coverage of each
            robot's map, "robot 1" and so on, every half second.
    """

    num_robots: int
    coordination: str
    coverage: float
    target_coverage: float | None
    time_to: dict[str, float | None]
    path_to: dict[str, float | None]
    path_lengths: tuple[float, ...]
    path_length: float
    collisions: int
    contacts: int
    untraversable_steps: int
    minimum_clearance: float | None
    exchanged: float
    linked: float | None
    is_map_known: bool
    least_coverage: float
    mean_effective_sample_size: float | None
    coverage_curve: dict[str, list[float | None]]
    goal_distance: float | None = None
    ates: tuple[float | None, ...] = ()
    odometry_ates: tuple[float | None, ...] = ()
    position_errors: tuple[float, ...] = ()
    ate: float | None = None
    num_loops: int | None = None

    columns = (
        Column.num_finished(),
        Column.quartiles("to_90", "90 % [s]", number=lambda each: each.time_to["90"]),
        Column.quartiles("to_95", "95 % [s]", number=lambda each: each.time_to["95"]),
        Column.quartiles(
            "last_target_at", "last target [s]", applies=lambda spread: spread[0] < math.inf
        ),
        Column.quartiles("path_length", "path [m]"),
        *TARGET_COLUMNS,
        Column.total("collisions", "collisions"),
        Column.total("contacts", "contacts"),
        Column.total(
            "untraversable_steps", "untraversable [steps]", applies=lambda total: total > 0
        ),
        GUARD_COLUMN,
        Column.quartiles(
            "ate",
            "trajectory error [m]",
            digits=3,
            missing=math.nan,
            applies=lambda spread: math.isfinite(spread[1]),
        ),
        Column.least("minimum_clearance", "clearance [m]"),
        Column.quartiles("exchanged", "exchanged [MB]", digits=2, scale=1e-6),
        Column.quartiles("step_ms", "step [ms]", number=lambda each: each.compute.step_ms_p50),
    )
    plotted = (
        Curve("coverage", "coverage [%]", 100.0, 100.0, applies=lambda each: not each.is_map_known),
        Curve("path", "path of all [m]"),
        TARGET_CURVE,
    )
    levels = LEVELS

    def series(self) -> dict[str, list[float | None]]:
        """Return `coverage_curve`."""
        return self.coverage_curve

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text)."""
        each = ", ".join(f"{metres:.1f}" for metres in self.path_lengths)
        return [
            self.duration_row(
                has_end=self.target_coverage is not None
                or self.num_targets > 0
                or self.goal_distance is not None
            ),
            ("robots", f"{self.num_robots}, coordination: {self.coordination}"),
            *self._coverage_rows(),
            *numbers("goal", "{:.2f} m away", self.goal_distance),
            *self.mission_rows(),
            ("path", f"{self.path_length:.1f} m: {each}"),
            ("contacts", f"{self.contacts} between robots, {self.collisions} with walls"),
            *(
                [("untraversable", f"{self.untraversable_steps} steps")]
                if self.untraversable_steps
                else []
            ),
            *self.guard_rows(),
            *self._localisation_rows(),
            ("clearance", f"{text(self.minimum_clearance, 3)} m at least"),
            ("exchanged", f"{1e-6 * self.exchanged:.2f} MB"),
            *self.last_rows(),
        ]

    def _localisation_rows(self) -> list[tuple[str, str]]:
        if not self.ates:
            return []
        rows = [
            ("position error", f"{', '.join(text(each, 3) for each in self.position_errors)} m"),
            ("trajectory error", f"{', '.join(text(each, 3) for each in self.ates)} m"),
            ("  of odometry", f"{', '.join(text(each, 2) for each in self.odometry_ates)} m"),
        ]
        if self.num_loops is not None:
            rows.append(("loops", f"{self.num_loops} closed"))
        return rows

    def _coverage_rows(self) -> list[tuple[str, str]]:
        if self.is_map_known:
            return [("map", "known in advance")]
        return [
            ("coverage", f"{percent(self.coverage)}, {describe_levels(self.time_to)}"),
            ("least known", f"{percent(self.least_coverage)} by one robot"),
        ]


def compute_metrics(data: FleetData, *, seed: int | None = None) -> FleetMetrics:
    """Compute the metrics of a run; without a step those of its start."""
    records, period = data.records, data.control_period
    coverage, path = data.coverage, data.lengths.sum(axis=0)
    pairs = data.num_robots * (data.num_robots - 1) // 2
    sizes = np.asarray(records.effective_sample_size, np.float64)
    collisions = np.asarray(records.is_collision, bool).reshape(-1, data.num_robots)
    ended = {"finished": data.finished_step, "given_up": data.given_up_step}
    at = {name: None if step is None else step * period for name, step in ended.items()}
    curve = {"time": data.time, "coverage": coverage, "path": path}
    robots = {f"robot {i}": rows for i, rows in enumerate(data.coverages, start=1)}
    return FleetMetrics(
        **data.common_metrics(finished_at=at["finished"], seed=seed),
        num_robots=data.num_robots,
        coordination=data.coordination,
        coverage=float(coverage[-1]),
        target_coverage=data.target_coverage,
        given_up_at=at["given_up"],
        **reach_levels(coverage, path, period),
        path_lengths=tuple(float(each) for each in data.lengths[:, -1]),
        path_length=float(path[-1]),
        collisions=sum(episodes(each) for each in collisions.T),
        contacts=episodes(np.asarray(records.is_contact, bool).any(axis=-1)),
        minimum_clearance=finite(np.min(records.clearance, initial=np.inf)),
        exchanged=float(np.sum(records.sent, dtype=np.float64)),
        linked=float(np.mean(records.links) / pairs) if pairs and data.num_steps else None,
        untraversable_steps=int(np.asarray(records.is_untraversable, bool).sum()),
        **mission_metrics(data),
        **guard_metrics(records.stop),
        goal_distance=(
            None
            if data.goal is None
            else float(np.hypot(*(data.last_positions - data.goal).T).min())
        ),
        **_localisation_metrics(data),
        is_map_known=is_known_map(data),
        least_coverage=float(data.coverages[:, -1].min()),
        mean_effective_sample_size=finite(sizes.mean()) if sizes.size else None,
        coverage_curve=thin_series({**curve, **mission_curves(data), **robots}, period),
    )


def _localisation_metrics(data: FleetData) -> dict[str, Any]:
    """Return the metrics of the localisation of all robots; nothing if they knew their poses."""
    if data.localisation is None:
        return {}
    errors = [trajectory_errors(each) for each in data.localisation if len(each.poses)]
    if not errors or data.records.pose_error is None or not data.num_steps:
        return {}
    squares = np.square(np.asarray(data.records.pose_error, np.float64))
    ates = tuple(each["ate"] for each in errors)
    loops = [each.num_loops for each in data.localisation if each.num_loops is not None]
    return {
        "ates": ates,
        "odometry_ates": tuple(each["odometry_ate"] for each in errors),
        "position_errors": tuple(
            float(each) for each in np.sqrt(np.nanmean(squares, axis=0)).reshape(-1)
        ),
        "ate": max(each for each in ates if each is not None),
        "num_loops": sum(loops) if loops else None,
    }
