"""Lengths that no way can be shorter than: lower bounds of the optimum."""

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import dijkstra

from benchmarks.bound.problem import Problem
from benchmarks.bound.roads import cell_graph

MARGIN = 4.0
"""Rounding of places to cells, of a way's two ends and of a beam's [cells]."""
WIDE = 1.5
"""Radius from which all cells around a robot's centre are free [cells]."""


class Floor(NamedTuple):
    """Two lower bounds of the length of a way that sees a share of the reachable cells.

    Args:
        reach: by the distance of the cells that must be seen [m].
        sweep: by the area that must be seen [m].
    """

    reach: float
    sweep: float

    @property
    def metres(self) -> float:
        """The greater one [m]."""
        return max(self.reach, self.sweep)


def lower_bound(problem: Problem, share: float) -> Floor:
    """Compute the lower bounds.

    **Reach.** A way of length L sees a cell only if the cell's distance D from the start is at most
    L + R, with the range R. Of the cells that are not known in advance, at least n must be seen, so
    L is at least the n-th smallest of the distances, less R. D is the straight line, or the length
    of steps over free cells divided by sqrt(2) if that is more: a path of length L changes the
    bilinear interpolation of the latter by at most sqrt(2) L, whatever its bends. `MARGIN` covers
    the rounding to cells.

    **Sweep.** All that is seen lies within R of the way. The points within R of a way of length L
    that are not within R of its start have an area of at most 2 R L. So

        L >= (area that must be seen - area of the cells within R of the start) / (2 R)

    Args:
        problem: map, start, robot and sensors.
        share: share of the reachable cells that must be seen.
    """
    cells = problem.cells + 0.5
    known = np.zeros(len(cells), bool)
    if problem.known is not None:
        known = problem.known[tuple(problem.cells.T)]
    missing = problem.needed(share) - int(known.sum())
    if missing <= 0:
        return Floor(0.0, 0.0)
    straight = np.hypot(*(cells - problem.start).T)
    distance = straight
    if problem.radius >= WIDE * problem.resolution:
        distance = np.maximum(straight, _steps(problem) / math.sqrt(2.0))
    ordered = np.sort(distance[~known])
    reach = (ordered[missing - 1] - MARGIN) * problem.resolution - problem.max_range
    # A cell is seen by its nearest point, which is up to half a diagonal nearer than its centre.
    within = problem.max_range / problem.resolution + math.sqrt(0.5)
    near = int((straight[~known] <= within).sum())
    sweep = (missing - near) / (2.0 * within) * problem.resolution
    return Floor(max(0.0, float(reach)), max(0.0, sweep))


def _steps(problem: Problem) -> np.ndarray:
    """Return the lengths (R,) of steps over free cells from the start's cell [cells]."""
    # Steps past a corner are allowed everywhere, which makes ways shorter at most.
    index, graph = cell_graph(problem.free, np.ones_like(problem.free))
    row, column = np.floor(problem.start).astype(np.int64)
    lengths = np.asarray(dijkstra(graph, indices=int(index[row, column])))
    return np.asarray(lengths[index[tuple(problem.cells.T)]])
