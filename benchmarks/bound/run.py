"""A run folder beside the bounds of its map."""

import dataclasses
import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bound import metres
from benchmarks.bound.floor import Floor, lower_bound
from benchmarks.bound.metres import Split, Steps
from benchmarks.bound.problem import Problem
from benchmarks.bound.roads import is_straight, step_lengths
from benchmarks.bound.sight import Sight
from benchmarks.bound.tour import Planner, Tour
from jaxplore._text import printable_path
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.settings.sections import read_settings
from jaxplore.simulation.run import Run
from jaxplore.tasks.exploration.settings import Settings
from jaxplore.tasks.registry import make_settings

LEVELS = (90, 99)
"""Coverages for which bounds are computed [%]."""
STARTS = 3
"""Number of searches for a tour with other seeds, the shortest of which is taken."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bound:
    """Bounds of a map, start, robot and sensors.

    Args:
        tours: the shortest tour that was found, by level [%].
        floors: lower bounds, by level [%].
    """

    tours: dict[int, Tour]
    floors: dict[int, Floor]


def find_bound(problem: Problem, *, starts: int = STARTS, **options: Any) -> Bound:
    """Compute the bounds of a problem.

    Args:
        problem: map, start, robot and sensors.
        starts: number of searches.
        **options: spacing and rounds of the search, see `Planner`.
    """
    planner = Planner(problem, **options)
    tours = {}
    for level in LEVELS:
        found = []
        for seed in range(starts):
            planner.seed = seed
            found.append(planner.tour(level / 100.0))
        tours[level] = min(found, key=lambda tour: tour.metres)
    # A tour for a higher level is one for a lower level as well.
    for low, high in zip(LEVELS[-2::-1], LEVELS[:0:-1], strict=True):
        tours[low] = min(tours[low], tours[high], key=lambda tour: tour.metres)
    return Bound(tours, {level: lower_bound(problem, level / 100.0) for level in LEVELS})


@dataclasses.dataclass(frozen=True, eq=False)
class Driven:
    """A run folder of an exploration.

    Args:
        folder: the folder.
        settings: its settings.
        recording: its recording.
        metrics: its metrics.
        problem: the problem that the run had.
    """

    folder: Path
    settings: Settings
    recording: ExplorationRecording
    metrics: ExplorationMetrics
    problem: Problem

    @classmethod
    def load(cls, folder: Path) -> "Driven":
        """Read a run folder.

        Raises:
            ValueError: a folder that holds no run of an exploration with its settings, or one for
                which bounds are not defined, see `Problem.from_settings`; a map that has changed.
        """
        settings = make_settings(read_settings(folder / "settings.yaml"))
        if not isinstance(settings, Settings):
            raise ValueError(
                f"{printable_path(folder)} is a run along a path; accepted: runs of an exploration"
            )
        problem = Problem.from_settings(settings)
        run = Run.load(folder)
        recording = run.recording
        assert isinstance(recording, ExplorationRecording)
        assert isinstance(run.metrics, ExplorationMetrics)
        if not np.array_equal(recording.reachable, problem.reachable):
            raise ValueError(
                f"{printable_path(folder)} was run on another map than {settings.map!r} is now; "
                "accepted: a run on the same map"
            )
        return cls(folder, settings, recording, run.metrics, problem)

    @property
    def key(self) -> tuple[object, ...]:
        """What runs share that have the same bounds."""
        problem = self.problem
        return (
            np.asarray(problem.world.probability).tobytes(),
            problem.reachable.tobytes(),
            np.asarray(problem.world.frame.origin).tobytes(),
            problem.resolution,
            problem.start.tobytes(),
            repr(problem.sensors),
            problem.speed,
            problem.acceleration,
            problem.scan_period,
            problem.radius,
            None if problem.known is None else problem.known.tobytes(),
        )

    @property
    def map_name(self) -> str:
        """Name of the map: that of its folder for a file."""
        path = Path(self.settings.map)
        return path.parent.name if path.suffix and path.parent.name else self.settings.map

    @cached_property
    def positions(self) -> np.ndarray:
        """Positions (N + 1, 2) of the robot in grid coordinates [cells]."""
        return self.problem.to_grid(self.recording.positions - self.offset)

    @cached_property
    def offset(self) -> np.ndarray:
        """Offset (2,) of the recording's coordinates from those of the problem [m]."""
        origin = np.asarray(self.problem.world.frame.origin, np.float64)
        return np.asarray(self.recording.origin, np.float64)[:2] - origin[:2]

    @cached_property
    def instants(self) -> np.ndarray:
        """Instants (K + 1,) of the scans, the last of which is the end of the run."""
        every = round(self.problem.scan_period / self.recording.control_period)
        return metres.scan_steps(self.recording.num_steps, every)

    @cached_property
    def first_seen(self) -> np.ndarray:
        """Number (R,) of the scan by which each reachable cell was first made free; -1 for none."""
        sight = Sight(self.problem)
        recording = self.recording
        states = np.concatenate([recording.start[None], recording.records.state])
        names = recording.state_names
        yaw = states[:, names.index("yaw")] if "yaw" in names else np.zeros(len(states))
        # Nothing is sensed at the end.
        instants = self.instants[:-1] if recording.num_steps else self.instants
        views = sight.views(self.positions[instants], yaw[instants])
        views[0] |= sight.blank()
        found = np.full(self.problem.num_cells, -1, np.int64)
        seen = np.zeros_like(views[0])
        for index, view in enumerate(views):
            new = sight.unpacked((view & ~seen)[None])[0]
            found[new] = index
            seen = seen | view
        return found

    @cached_property
    def coverage(self) -> np.ndarray:
        """Coverage (K + 1,) at the scans, recomputed without noise."""
        seen = np.bincount(self.first_seen[self.first_seen >= 0], minlength=len(self.instants))
        return np.cumsum(seen) / self.problem.num_cells

    @cached_property
    def steps(self) -> Steps:
        """The run from scan to scan."""
        side, instants = self.problem.resolution, self.instants
        driven = np.concatenate([[0.0], np.cumsum(metres.driven_lengths(self.positions * side))])
        gain = np.diff(self.coverage, prepend=0.0) * self.problem.num_cells * side**2
        period = self.problem.scan_period
        return Steps(self.positions[instants] * side, gain, np.diff(driven[instants]), period)

    @cached_property
    def split(self) -> Split:
        """Kinds of its metres."""
        return metres.split_metres(self.steps, self._shortest, self._detour)

    def _shortest(self, first: int, last: int) -> float:
        """Return the shortest way between the places of two scans [m]."""
        side, mask = self.problem.resolution, self.problem.reachable
        one, other = (self.positions[self.instants[each]] for each in (first, last))
        straight = math.dist(one, other)
        # The robot may be a little outside of the cells whose centres it can reach.
        cells = mask.copy()
        for place in (one, other):
            row, column = np.floor(place).astype(np.int64)
            cells[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] = True
        if is_straight(cells, self.problem.free, one, other):
            return straight * side
        sources = np.floor(one).astype(np.int64)[None]
        lengths = step_lengths(cells, self.problem.free, sources, self._reach)
        row, column = np.floor(other).astype(np.int64)
        return max(straight, float(lengths[row, column])) * side

    @property
    def _reach(self) -> float:
        """Greatest length of a way within a window [cells]."""
        return float(1.5 * metres.WINDOW * (self.problem.speed or 10.0) / self.problem.resolution)

    def _detour(self, last: int, scan: int) -> float:
        """Return the shortest way from the path up to a scan to the place of another one [m]."""
        path = np.floor(self.positions[self.instants[: last + 1]]).astype(np.int64)
        row, column = np.floor(self.positions[self.instants[scan]]).astype(np.int64)
        lengths = step_lengths(self.problem.free, self.problem.free, path)
        return float(lengths[row, column]) * self.problem.resolution

    def step_at(self, level: int) -> int | None:
        """Return the number of steps from scan to scan until a level was reached; None if it was
        not."""
        reached = np.flatnonzero(self.coverage.astype(np.float32) >= np.float32(level / 100.0))
        return int(reached[0]) if len(reached) else None

    def report(self, bound: Bound) -> dict[str, Any]:
        """Return the numbers of the run beside the bounds, for a table and for JSON."""
        problem, side = self.problem, self.problem.resolution
        recorded = np.asarray(self.recording.records.coverage, np.float64)
        difference = 0.0
        if len(recorded):
            difference = float(np.abs(recorded[self.instants[:-1]] - self.coverage[:-1]).max())
        levels = {}
        for level in LEVELS:
            tour, floor = bound.tours[level], bound.floors[level]
            path, time = (each[str(level)] for each in (self.metrics.path_to, self.metrics.time_to))
            least = problem.seconds(tour.metres)
            levels[str(level)] = {
                "metres": path,
                "seconds": time,
                "tour_metres": tour.metres,
                "tour_seconds": least,
                "tour_coverage": tour.coverage,
                "floor_metres": floor.metres,
                "floor_reach": floor.reach,
                "floor_sweep": floor.sweep,
                "ratio": None if path is None else path / tour.metres,
                "ratio_seconds": None if time is None or least is None else time / least,
                "ratio_to_floor": (
                    None if path is None or floor.metres == 0.0 else path / floor.metres
                ),
            }
        phases, begin = {}, 0
        for level in LEVELS:
            end = self.step_at(level)
            if end is None:
                phases[f"to the end, below {level}"] = self._phase(begin, len(self.steps.metres))
                break
            phases[f"to {level}"] = self._phase(begin, end)
            begin = end
        return {
            "folder": str(self.folder),
            "map": self.map_name,
            "explorer": self.settings.architecture,
            "seed": self.settings.seed,
            "area": problem.num_cells * side**2,
            "coverage": self.metrics.coverage,
            "recomputed_difference": difference,
            "levels": levels,
            "phases": phases,
        }

    def _phase(self, first: int, last: int) -> dict[str, float]:
        """Return the metres of each kind, and the slow seconds, between two scans."""
        found = self.split.lengths(first, last)
        found["price_of_returns"] = float(self.split.price[first:last].sum())
        if self.problem.speed is not None:
            begin, end = self.instants[first], self.instants[last]
            moves = metres.driven_lengths(self.positions * self.problem.resolution)
            speeds = moves[begin:end] / self.recording.control_period
            period = self.recording.control_period
            slow, lost = metres.slow_seconds(speeds, period, self.problem.speed)
            found |= {"slow_seconds": slow, "lost_seconds": lost}
        return found
