"""A short tour that sees a share of the reachable cells: an upper bound of the optimum.

1. Places of the lattice are inserted one by one, each time the one with the most new cells for a
   metre of detour, until enough is seen (greedy set cover with the price of the way).
2. Large neighbourhood search: some stops are taken out, the tour is repaired in the same way, stops
   without which enough is seen are dropped, and the shorter tour is kept. What is seen from the
   places on the way counts. Improved tours are put in order by PyVRP (`order`).
3. The line is tightened: its points are dropped or moved towards the line between their neighbours,
   as long as it stays in reachable cells and enough is seen. Here what is seen is that of the
   scans of a robot that drives the line: one at each point and one every `scan_step`.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.bound.order import open_tour
from benchmarks.bound.problem import Problem
from benchmarks.bound.roads import Roads, is_straight
from benchmarks.bound.sight import Sight, count, union

SPACING = 0.4
"""Spacing of the lattice [m]."""
ROUNDS = 200
"""Rounds of the large neighbourhood search."""
LEAST_DETOUR = 0.1
"""Detours count as at least this long, so that free ones do not win by a cell [cells]."""
WARM = 0.02
"""Share by which a tour may be longer than the present one and still replace it at first."""
MOST_KEPT = 2**28
"""Bytes of views of ways that are kept; then they are computed again."""
_TIGHTENINGS = 6
_CORRECTIONS = 6
_HALVINGS = 7
_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of the way to the line between its neighbours that a point is moved."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tour:
    """A line that sees enough.

    Args:
        line: (N, 2) points of the line, from the start [cells].
        metres: its length [m].
        coverage: share of the reachable cells that its scans make free.
        wanted: share that it had to see.
    """

    line: np.ndarray
    metres: float
    coverage: float
    wanted: float


class Planner:
    """Search for tours on one map.

    Args:
        problem: map, start, robot and sensors.
        spacing: spacing of the lattice [m].
        rounds: rounds of the large neighbourhood search.
        seed: seed of the search; the same seed gives the same tours.
    """

    def __init__(
        self, problem: Problem, *, spacing: float = SPACING, rounds: int = ROUNDS, seed: int = 0
    ) -> None:
        self.problem, self.rounds, self.seed = problem, rounds, seed
        self.sight = Sight(problem)
        self.roads = Roads(problem, max(1, round(spacing / problem.resolution)))
        gap = max(each.beam_spacing * each.max_range for each in problem.sensors)
        # Two beams are at most half a cell apart where they end.
        turns = math.ceil(gap / (0.5 * problem.resolution))
        self.views = self.sight.turning_views(self.roads.places, turns)
        self._blank = self.sight.blank()
        self._between: dict[tuple[int, int], np.ndarray] = {}
        self._segments: dict[tuple[float, float, float, float], np.ndarray] = {}

    def tour(self, share: float) -> Tour:
        """Return a short tour from the start that sees a share of the reachable cells.

        Raises:
            ValueError: the places of the lattice do not see as much; a smaller spacing is needed.
        """
        needed = self.problem.needed(share)
        wanted = needed
        best: np.ndarray | None = None
        for _ in range(_CORRECTIONS):
            stops = self._search(wanted)
            line = self._shortened(self.roads.line(self._all_places(stops)), needed)
            if line is not None:
                best = line
                break
            # The scans on the way see less than a robot that turns at each place.
            missing = needed - self._count(self.roads.line(self._all_places(stops)))
            wanted += max(1, missing)
        if best is None:
            raise ValueError(
                f"no tour was found that sees {share:.3%}; accepted: a smaller spacing of the "
                "places"
            )
        return Tour(
            best,
            line_length(best) * self.problem.resolution,
            self._count(best) / self.problem.num_cells,
            share,
        )

    # Search on the lattice.

    def _search(self, needed: int) -> list[int]:
        rng = np.random.default_rng(self.seed)
        stops = self._ordered(self._pruned(self._repaired([0], needed, rng, 0.0), needed, rng))
        best, present = stops, stops
        for index in range(self.rounds):
            kept = self._removed(present, rng)
            trial = self._pruned(self._repaired(kept, needed, rng, 0.3), needed, rng)
            length, least = self._length(trial), self._length(best)
            if length < least - 1e-9:
                trial = self._shifted(self._ordered(trial), needed)
                trial = self._pruned(trial, needed, rng)
                best = trial
            warmth = 1.0 + WARM * (1.0 - index / self.rounds)
            if self._length(trial) <= warmth * self._length(best):
                present = trial
        return best

    def _length(self, stops: Sequence[int]) -> float:
        return float(sum(self.roads.lengths[a, b] for a, b in itertools.pairwise(stops)))

    def _seen(self, stops: Sequence[int]) -> np.ndarray:
        """Return what is seen at stops and on the ways between them."""
        pairs = [self._pair(a, b) for a, b in itertools.pairwise(stops)]
        return union(np.stack([self.views[stops[0]], *pairs]), self._blank)

    def _pair(self, first: int, last: int) -> np.ndarray:
        key = min(first, last), max(first, last)
        if key not in self._between:
            self._forget(self._between)
            self._between[key] = union(self.views[self.roads.stops(*key)], self._blank)
        return self._between[key]

    def _forget(self, kept: dict[Any, np.ndarray]) -> None:
        """Forget views of ways when there are many: large maps have large views."""
        if len(kept) * self._blank.nbytes > MOST_KEPT:
            kept.clear()

    def _is_enough(self, stops: Sequence[int], needed: int) -> bool:
        return int(count(self._seen(stops))) >= needed

    def _repaired(
        self, stops: Sequence[int], needed: int, rng: np.random.Generator, noise: float
    ) -> list[int]:
        """Insert places until enough is seen."""
        stops, lengths = list(stops), self.roads.lengths
        while True:
            seen = self._seen(stops)
            missing = needed - int(count(seen))
            if missing <= 0:
                return stops
            gain = count(self.views & ~seen)
            if not gain.any():
                raise ValueError(
                    f"places of the lattice see {int(count(seen))} of {needed} cells; accepted: a "
                    "smaller spacing of the places"
                )
            ways = lengths[stops]
            detours = np.concatenate([ways[:-1] + ways[1:], ways[-1:]])
            detours[:-1] -= lengths[stops[:-1], stops[1:]][:, None]
            behind = detours.argmin(axis=0)
            detour = np.maximum(detours.min(axis=0), LEAST_DETOUR)
            # Cells beyond those that are missing are worth little.
            worth = np.minimum(gain, missing) + 0.01 * gain
            score = worth / detour * np.exp(noise * rng.standard_normal(len(gain)))
            place = int(np.where(gain > 0, score, -1.0).argmax())
            stops.insert(int(behind[place]) + 1, place)

    def _pruned(self, stops: Sequence[int], needed: int, rng: np.random.Generator) -> list[int]:
        """Drop the stops without which enough is seen, in random order."""
        kept = list(stops)
        for place in rng.permutation(kept[1:]).tolist():
            trial = [each for each in kept if each != place]
            if self._length(trial) <= self._length(kept) + 1e-9 and self._is_enough(trial, needed):
                kept = trial
        return kept

    def _removed(self, stops: Sequence[int], rng: np.random.Generator) -> list[int]:
        """Take out some stops: a part of the tour, or those around one of them."""
        others = np.asarray(stops[1:])
        if len(others) == 0:
            return list(stops)
        size = int(rng.integers(1, 2 + max(1, min(7, len(others) // 2))))
        at = int(rng.integers(len(others)))
        if rng.random() < 0.5:
            out = others[at : at + size]
        else:
            out = others[np.argsort(self.roads.lengths[others[at], others])[:size]]
        return [each for each in stops if each == 0 or each not in out]

    def _shifted(self, stops: Sequence[int], needed: int) -> list[int]:
        """Move stops to neighbouring places where that makes the tour shorter."""
        stops, lengths = list(stops), self.roads.lengths
        for at in range(1, len(stops)):
            near = np.argsort(lengths[stops[at]])[1:13]
            before = lengths[stops[at - 1], near]
            after = lengths[near, stops[at + 1]] if at + 1 < len(stops) else 0.0
            trials = near[np.argsort(before + after)]
            for place in trials.tolist():
                trial = [*stops[:at], place, *stops[at + 1 :]]
                if self._length(trial) >= self._length(stops) - 1e-9:
                    break
                if self._is_enough(trial, needed):
                    stops = trial
                    break
        return stops

    def _ordered(self, stops: Sequence[int]) -> list[int]:
        """Return the stops in the order of a shorter tour, if there is one that sees as much."""
        kept = list(dict.fromkeys(stops))
        order = open_tour(self.roads.lengths[np.ix_(kept, kept)], seed=self.seed)
        found = [kept[each] for each in order]
        is_shorter = self._length(found) < self._length(stops)
        seen = int(count(self._seen(stops)))
        return found if is_shorter and self._is_enough(found, seen) else list(stops)

    def _all_places(self, stops: Sequence[int]) -> list[int]:
        """Return the places on the way along stops."""
        places = [stops[0]]
        for first, last in itertools.pairwise(stops):
            places += self.roads.stops(first, last)[1:]
        return places

    # The line itself.

    def _segment(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return what the scans on a straight line make free: one at each end and every step."""
        key = (*first.tolist(), *last.tolist())
        if key not in self._segments:
            number = max(1, math.ceil(math.dist(first, last) / self.problem.scan_step - 1e-3))
            along = np.arange(number) * self.problem.scan_step / max(math.dist(first, last), 1e-9)
            places = first + np.minimum(np.append(along, 1.0), 1.0)[:, None] * (last - first)
            yaws = np.full(len(places), self.problem.heading(first, last))
            self._forget(self._segments)
            self._segments[key] = union(self.sight.views(places, yaws), self._blank)
        return self._segments[key]

    def _segment_views(self, line: np.ndarray) -> list[np.ndarray]:
        if len(line) == 1:
            return [self.sight.views(line, np.zeros(1))[0]]
        return [self._segment(a, b) for a, b in itertools.pairwise(line)]

    def _count(self, line: np.ndarray) -> int:
        return int(count(union(np.stack(self._segment_views(line)), self._blank)))

    def _shortened(self, line: np.ndarray, needed: int) -> np.ndarray | None:
        """Tighten a line that sees enough; None for one that does not."""
        # The start and the place of its block may be the same.
        line = line[np.append(True, np.hypot(*np.diff(line, axis=0).T) > 1e-9)]
        if self._count(line) < needed:
            return None
        line = self._ended(line, needed)
        for _ in range(_TIGHTENINGS):
            before = line_length(line)
            at = 1
            while at < len(line):
                line, is_dropped = self._tightened(line, at, needed)
                at += 0 if is_dropped else 1
            if line_length(line) > before - 0.1:
                break
        return self._cut(line, needed)

    def _tightened(self, line: np.ndarray, at: int, needed: int) -> tuple[np.ndarray, bool]:
        """Drop or move one point of a line, if it still sees enough; say whether it was dropped."""
        mask, free, is_last = self.problem.reachable, self.problem.free, at + 1 == len(line)
        before, point = line[at - 1], line[at]
        # The last point is moved back towards the one before it.
        target = before if is_last else _nearest(point, before, line[at + 1])
        others = [
            view
            for index, view in enumerate(self._segment_views(line))
            if index not in (at - 1, at)
        ]
        seen = union(others, self._blank)
        trials: list[np.ndarray | None] = [None]
        trials += [point + share * (target - point) for share in _SHARES[0 if not is_last else 1 :]]
        for moved in trials:
            ends = [before] if moved is None else [before, moved]
            ends += [] if is_last else [line[at + 1]]
            pairs = list(itertools.pairwise(ends))
            gain = math.dist(before, point) + (0.0 if is_last else math.dist(point, line[at + 1]))
            if sum(math.dist(*pair) for pair in pairs) >= gain - 1e-6:
                continue
            if not all(is_straight(mask, free, *pair) for pair in pairs):
                continue
            views = [self._segment(*pair) for pair in pairs]
            if len(line) == 2 and moved is None:
                views = [self.sight.views(before[None], np.zeros(1))[0]]
            if int(count(union([seen, *views], self._blank))) >= needed:
                middle = [] if moved is None else [moved[None]]
                return np.concatenate([line[:at], *middle, line[at + 1 :]]), moved is None
        return line, False

    def _ended(self, line: np.ndarray, needed: int) -> np.ndarray:
        """Cut a line off at the first point by which enough is seen."""
        seen = self._blank
        for index, view in enumerate(self._segment_views(line)):
            seen = seen | view
            if int(count(seen)) >= needed:
                return line[: index + 2]
        return line

    def _cut(self, line: np.ndarray, needed: int) -> np.ndarray:
        """Cut the last straight line of a line where enough is seen, by bisection."""
        if len(line) == 1:
            return line
        seen = union(self._segment_views(line)[:-1], self._blank)
        before, end, best = line[-2], line[-1], line[-1]
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            trial = before + middle * (end - before)
            if int(count(seen | self._segment(before, trial))) >= needed:
                high, best = middle, trial
            else:
                low = middle
        return np.concatenate([line[:-1], best[None]])


def line_length(line: np.ndarray) -> float:
    """Return the length of a line (N, 2), in its own unit."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _nearest(point: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the place on a straight line that is nearest to a point."""
    along = last - first
    square = float(along @ along)
    share = 0.0 if square == 0.0 else float(np.clip((point - first) @ along / square, 0.0, 1.0))
    return np.asarray(first + share * along)
