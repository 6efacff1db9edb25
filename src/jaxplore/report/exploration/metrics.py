"""Metrics of an exploration run, and how tables and figures show them."""

import dataclasses

from jaxplore.report._numbers import numbers, percent, text
from jaxplore.report.coverage_levels import LEVELS
from jaxplore.report.exploration.data import TEAM
from jaxplore.report.exploration.guard import GUARD_COLUMN, GuardMetrics
from jaxplore.report.metrics import Column, Curve
from jaxplore.report.of_parts import PartsMetrics


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExplorationMetrics(PartsMetrics, GuardMetrics):
    """Metrics of an exploration run.

    Args:
        coverage: share of the reachable cells that are known to be free at the end.
        target_coverage: coverage at which exploration is finished; None if it never is.
        target: what the exploration ends by: the coverage, the information that the robot can
            still get, the walls of its map, or never.
        walls_seen: share of the true wall cells around the free space of the start that the robot's
            map shows at the end; None where the robot takes itself to be elsewhere.
        time_to: time at which each level of coverage ("50", "90", "95", "99" percent) was first
            reached [s]; None if never. The record of step k holds the coverage measured at the
            beginning of that step, so the time is k control periods.
        path_to: distance travelled until each level was reached [m].
        path_length: distance travelled in the whole run [m].
        initial_entropy: entropy of the belief over the reachable cells before the first step [nat].
        final_entropy: entropy at the end [nat].
        initial_unknown: share of the reachable cells with `4 p (1 - p) > 1/2` before the first
            step.
        final_unknown: share of unknown cells at the end.
        information_per_metre: entropy lost over the reachable cells for each metre travelled
            [nat/m]; None if the robot did not move.
        goal_distance: distance from the goal at the end [m]; None if there is no goal.
        command_jerk: root mean square over steps and controls of the second difference of the
            commands, `(u_{t+1} - 2 u_t + u_{t-1}) / period^2`, in halves of the range between
            their bounds [1/s^2].
        fault_steps: steps during which a fault of the scenario was active.
        collisions: contacts; successive steps in contact are one.
        collision_steps: number of steps that would have led to a collision.
        minimum_clearance: least distance from the robot's edge to the nearest solid cell [m], up to
            the reach of the record.
        mean_effective_sample_size: mean effective sample size over the steps.
        minimum_effective_sample_size: least effective sample size of the steps.
        non_finite_steps: number of steps without a single finite rollout.
        untraversable_steps: number of steps that ended with part of the robot on untraversable
            ground.
        members: statistics of the members of a controller, by name: mean `share` in the control,
            and means of its `uncertainty` [half ranges], `effective_sample_size` and `cost` where
            they were finite. None of any other controller.
        diversity: mean distance between two members' controls [half ranges].
        replaced: share of the steps in which a member's plan took the place of the mixture.
        carried_at: time at which a fault carried the robot away [s]; None if it did not.
        recovered_after: time from then until the error of the position stays below 0.5 m for a
            second [s]; None if it does not.
        ate: absolute trajectory error of a robot that localised itself, root mean square after the
            alignment, or on a known map without one [m]; None if it knew its pose, as are the ones
            below.
        odometry_ate: the same error of the odometry alone [m].
        rpe: relative pose error over 5 m, root mean square of the position [m].
        map_iou: intersection over union of the occupied cells of the aligned map and of the map of
            the same scans at the true poses, to within a cell.
        double_walls: share of the occupied cells that draw a wall a second time.
        aligned_coverage: coverage of the aligned map; None on a known map.
        num_loops: number of loops that were closed; None on a known map.
        reachable_area: area of the reachable cells [m^2].
        longest_stall: longest time without a rise of the coverage in which the positions fit into a
            square of side `2 * STALL_RADIUS` along the world's axes [s].
        coverage_curve: "time" [s], "coverage", "entropy" [nat], "path" [m] and "unknown" every
            half second, the end included; also the curves of parts.
    """

    coverage: float
    target_coverage: float | None
    target: str
    walls_seen: float | None
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
    untraversable_steps: int
    members: dict[str, dict[str, float | None]] | None
    diversity: float | None
    replaced: float | None
    carried_at: float | None = None
    recovered_after: float | None = None
    ate: float | None = None
    odometry_ate: float | None = None
    rpe: float | None = None
    map_iou: float | None = None
    double_walls: float | None = None
    aligned_coverage: float | None = None
    num_loops: int | None = None
    reachable_area: float
    longest_stall: float
    coverage_curve: dict[str, list[float | None]] = dataclasses.field(repr=False)

    levels = LEVELS
    plotted = (
        Curve(
            "coverage",
            "coverage of reachable cells [%]",
            100.0,
            104.0,
            applies=lambda each: not each.is_map_known,
        ),
        Curve(
            "unknown",
            "unknown reachable cells [%]",
            100.0,
            104.0,
            applies=lambda each: not each.is_map_known,
        ),
    )
    columns = (
        Column.num_finished(),
        Column.quartiles("finished_at", "after [s]"),
        Column.quartiles("time_to_90", "90 % after [s]", number=lambda each: each.time_to["90"]),
        Column.quartiles("coverage", "coverage [%]", scale=100.0),
        Column.quartiles("path_length", "path [m]"),
        # Without a path there is no information per metre, and it counts as 0.
        Column.quartiles("information_per_metre", "nat/m", missing=0.0),
        Column.quartiles("final_unknown", "unknown [%]", scale=100.0),
        Column.total("collisions", "collisions"),
        Column.total(
            "untraversable_steps", "untraversable [steps]", applies=lambda total: total > 0
        ),
        Column.total("fault_steps", "faults [steps]", applies=lambda total: total > 0),
        GUARD_COLUMN,
        Column.least("minimum_clearance", "clearance [m]"),
        Column.quartiles("command_jerk", "jerk [1/s²]", digits=0),
        Column.quartiles("step_ms", "step [ms]", number=lambda each: each.compute.step_ms_p50),
    )

    def series(self) -> dict[str, list[float | None]]:
        """Return `coverage_curve`."""
        return self.coverage_curve

    def rows(self) -> list[tuple[str, str]]:
        """Return the main metrics as (name, text), for tables."""
        # A patrol has no end, so it can be neither finished nor unfinished.
        ends = (
            self.target_coverage is not None
            or self.target in ("information", "walls")
            or any(each.is_end for each in self.parts.values())
            or self.goal_distance is not None
        )
        end = ", finished" if self.is_finished else ", not finished" if ends else ""
        if self.given_up_at is not None:
            end = ", given up"
        rows = [
            *self._coverage_rows(end),
            ("duration", f"{self.duration:.2f} s, {self.num_steps} steps"),
            ("path", f"{self.path_length:.2f} m"),
        ]
        if self.finished_at is not None and self.goal_distance is not None:
            rows.append(("finished", f"after {self.finished_at:.2f} s"))
        if self.goal_distance is not None:
            rows.append(("goal", f"{self.goal_distance:.2f} m away"))
        if self.given_up_at is not None:
            left = percent(1.0 - self.coverage)
            rows.append(("given up", f"nothing new to see; {left} unreachable or hidden"))
        if self.is_interrupted:
            rows.append(("interrupted", "by the user"))
        rows += [*self._level_rows(), *self.part_rows(), *self._map_rows()]
        sizes = (self.mean_effective_sample_size, self.minimum_effective_sample_size)
        rows += [
            *numbers("command jerk", "{:.1f} ranges/s²", self.command_jerk),
            ("collisions", f"{self.collisions} ({self.collision_steps} steps)"),
            *(
                [("untraversable", f"{self.untraversable_steps} steps")]
                if self.untraversable_steps
                else []
            ),
            *self._localisation_rows(),
            *numbers("clearance", "{:.3f} m at least", self.minimum_clearance),
            ("longest stall", f"{self.longest_stall:.2f} s"),
            *numbers("sample size", "{:.1f} effective, {:.1f} at least", *sizes),
            ("non-finite", f"{self.non_finite_steps} steps"),
            *([("faults", f"{self.fault_steps} steps")] if self.fault_steps else []),
            *self.guard_rows(),
            *self._member_rows(),
            *self.last_rows(),
        ]
        return rows

    @property
    def contacts(self) -> int:
        """Contacts between robots; 0 of one robot."""
        return int(getattr(self.parts.get(TEAM), "contacts", 0))

    @property
    def is_map_known(self) -> bool:
        """Whether the map was known in advance, so that coverage does not judge the run."""
        return self.initial_unknown <= 1.0 - LEVELS[-1] / 100

    def _coverage_rows(self, end: str) -> list[tuple[str, str]]:
        if self.is_map_known:
            return [("map", f"{self.reachable_area:.1f} m², known in advance{end}")]
        rows = [("coverage", f"{percent(self.coverage)} of {self.reachable_area:.1f} m²{end}")]
        if self.walls_seen is not None:
            rows.append(("walls", f"{percent(self.walls_seen)} of the cells seen"))
        return rows

    def _level_rows(self) -> list[tuple[str, str]]:
        if self.is_map_known:
            return []
        rows = []
        for level, seconds in self.time_to.items():
            path = self.path_to[level]
            is_reached = seconds is not None and path is not None
            when = f"{seconds:.2f} s, {path:.2f} m" if is_reached else "not reached"
            rows.append((f"  to {level} %", when))
        return rows

    def _map_rows(self) -> list[tuple[str, str]]:
        if self.is_map_known:
            return []
        shares = percent(self.initial_unknown), percent(self.final_unknown)
        return [
            *numbers("entropy", "{:.0f} -> {:.0f} nat", self.initial_entropy, self.final_entropy),
            ("unknown", f"{shares[0]} -> {shares[1]} of the reachable cells"),
            *numbers("information", "{:.1f} nat/m", self.information_per_metre),
        ]

    def _localisation_rows(self) -> list[tuple[str, str]]:
        rows = []
        if self.carried_at is not None:
            later = self.recovered_after
            end = "not found again" if later is None else f"found again after {later:.2f} s"
            known = "" if self.ate is None else f", {end}"
            rows.append(("carried away", f"after {self.carried_at:.2f} s{known}"))
        if self.ate is None:
            return rows
        shares = percent(self.map_iou), percent(self.double_walls)
        rows += [
            ("trajectory error", f"{self.ate:.3f} m, {text(self.rpe, 3)} m over 5 m"),
            ("  of odometry", f"{text(self.odometry_ate, 2)} m"),
            ("walls", f"{shares[0]} in place, {shares[1]} double"),
        ]
        if self.num_loops is not None:
            rows.append(("aligned coverage", f"{percent(self.aligned_coverage)}"))
            rows.append(("loops", f"{self.num_loops} closed"))
        return rows

    def _member_rows(self) -> list[tuple[str, str]]:
        if self.members is None:
            return []
        replaced = f"replaced in {percent(self.replaced)} of the steps"
        rows = [("members", f"{text(self.diversity, 3)} apart, {replaced}")]
        for name, mean in self.members.items():
            size, spread = text(mean["effective_sample_size"], 1), text(mean["uncertainty"], 3)
            share = percent(mean["share"])
            rows.append((f"  {name}", f"{share}, {size} effective, uncertainty {spread}"))
        return rows
