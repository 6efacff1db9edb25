"""Ways between places on a known map."""

import dataclasses
import itertools
import math
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from benchmarks.bound.problem import Problem
from jaxplore.geometry.rays import TOUCH

STRAIGHT = 2.5
"""Distance up to which places are joined by straight ways, in spacings of the lattice."""
DETOUR = 1.25
"""Factor by which a way over cells is shorter than that over straight ones, to be added."""
OCTILE = math.sqrt(4.0 - 2.0 * math.sqrt(2.0))
"""Greatest ratio of a way of steps to 8 neighbours to the straight line, 1.0824."""


def is_straight(mask: np.ndarray, free: np.ndarray, first: np.ndarray, last: np.ndarray) -> bool:
    """Return whether the straight line between two places stays in the cells of a mask.

    The cells are those that the line crosses, exactly. Where it passes from a cell to a diagonal
    neighbour, both cells beside that corner must be free, as in `cell_graph`.

    Args:
        mask: (H, W) cells that may be entered.
        free: (H, W) free cells.
        first: (2,) place [cells].
        last: (2,) place [cells].
    """
    crossings = [np.array([0.0, 1.0])]
    for low, high in zip(first, last, strict=True):
        lines = np.arange(math.ceil(min(low, high)), math.floor(max(low, high)) + 1)
        if low != high:
            crossings.append((lines - low) / (high - low))
    shares = np.sort(np.concatenate(crossings).clip(0.0, 1.0))
    is_crossed = np.diff(shares) * math.dist(first, last) > TOUCH
    middle = 0.5 * (shares[:-1] + shares[1:])[is_crossed]
    if len(middle) == 0:
        middle = np.array([0.5])
    cells = np.floor(first + middle[:, None] * (last - first)).astype(np.int64)
    if (cells < 0).any() or (cells >= mask.shape).any() or not mask[tuple(cells.T)].all():
        return False
    one, other = cells[:-1], cells[1:]
    corner = (one != other).all(axis=1)
    one, other = one[corner], other[corner]
    return bool((free[one[:, 0], other[:, 1]] & free[other[:, 0], one[:, 1]]).all())


def cell_graph(mask: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Return the graph of steps between the cells of a mask.

    Steps lead to 8 neighbours, a diagonal one only past a corner all four cells of which are free,
    as on the project's own lattices. A step costs its length in cells.

    Args:
        mask: (H, W) cells that may be entered.
        free: (H, W) free cells.

    Returns:
        The numbers (H, W) of the cells in the graph, -1 outside the mask, and the graph.
    """
    index = np.full(mask.shape, -1, np.int64)
    index[mask] = np.arange(int(mask.sum()))
    clear = free[:-1, :-1] & free[:-1, 1:] & free[1:, :-1] & free[1:, 1:]
    edges = []
    for one, other, is_clear, length in (
        (np.s_[:, :-1], np.s_[:, 1:], np.True_, 1.0),
        (np.s_[:-1, :], np.s_[1:, :], np.True_, 1.0),
        (np.s_[:-1, :-1], np.s_[1:, 1:], clear, math.sqrt(2.0)),
        (np.s_[:-1, 1:], np.s_[1:, :-1], clear, math.sqrt(2.0)),
    ):
        joined = mask[one] & mask[other] & is_clear
        begin, end = index[one][joined], index[other][joined]
        edges.append(np.stack([begin, end, np.full(len(begin), length)]))
    begin, end, lengths = np.concatenate(edges, axis=1)
    shape = (int(mask.sum()),) * 2
    graph = coo_array((lengths, (begin.astype(np.int64), end.astype(np.int64))), shape=shape)
    return index, csr_array(graph + graph.T)


def step_lengths(
    mask: np.ndarray, free: np.ndarray, sources: np.ndarray, limit: float = math.inf
) -> np.ndarray:
    """Return the lengths (H, W) of the ways of steps from the nearest source [cells].

    They are infinite outside the mask, where no way leads, and beyond the limit.

    Args:
        mask: (H, W) cells that may be entered.
        free: (H, W) free cells, see `cell_graph`.
        sources: (S, 2) cells from which ways begin; those outside the mask are left out.
        limit: greatest length [cells].
    """
    index, graph = cell_graph(mask, free)
    numbers = index[tuple(np.asarray(sources).T)]
    lengths = np.full(mask.shape, np.inf)
    if (numbers >= 0).any():
        numbers = np.unique(numbers[numbers >= 0])
        lengths[mask] = dijkstra(graph, indices=numbers, min_only=True, limit=limit)
    return lengths


@dataclasses.dataclass(frozen=True, eq=False)
class Roads:
    """Lattice of places on the reachable cells, and the shortest ways on it.

    Place 0 is the start. Places that see each other within `STRAIGHT` spacings are joined by the
    straight line. Ways over cells join the rest, so that every place is reached.

    Args:
        problem: map and start.
        spacing: spacing of the places [cells].
    """

    problem: Problem
    spacing: int

    @cached_property
    def places(self) -> np.ndarray:
        """Places (C, 2) [cells]: the start, and in each block of cells the reachable cell that is
        nearest to its centre."""
        cells = self.problem.cells
        centre = (cells // self.spacing + 0.5) * self.spacing
        away = np.hypot(*(cells + 0.5 - centre).T)
        columns = self.problem.reachable.shape[1] // self.spacing + 1
        block = (cells // self.spacing) @ np.array([columns, 1])
        order = np.lexsort([away, block])
        _, first = np.unique(block[order], return_index=True)
        return np.concatenate([self.problem.start[None], cells[order[first]] + 0.5])

    @cached_property
    def _ways(self) -> tuple[csr_array, dict[tuple[int, int], np.ndarray]]:
        """The graph of joined places, with lengths in cells, and the ways over cells."""
        lengths = self._straight_ways()
        between = dijkstra(self._graph(lengths))
        over_cells = {}
        for (one, other), (length, way) in self._cell_ways().items():
            if length * DETOUR < between[one, other]:
                lengths[one, other] = length
                over_cells[one, other] = way
        return self._graph(lengths), over_cells

    def _graph(self, lengths: dict[tuple[int, int], float]) -> csr_array:
        shape = (len(self.places),) * 2
        if not lengths:
            return csr_array(shape)
        begin, end = np.array(list(lengths)).T
        graph = coo_array((list(lengths.values()), (begin, end)), shape=shape)
        return csr_array(graph + graph.T)

    def _straight_ways(self) -> dict[tuple[int, int], float]:
        from scipy.spatial import cKDTree

        pairs = cKDTree(self.places).query_pairs(STRAIGHT * self.spacing, output_type="ndarray")
        mask, free = self.problem.reachable, self.problem.free
        # Places that coincide, such as the start on a cell's centre, are a way of almost no length.
        return {
            (int(one), int(other)): max(1e-6, math.dist(self.places[one], self.places[other]))
            for one, other in np.sort(pairs, axis=1)
            if is_straight(mask, free, self.places[one], self.places[other])
        }

    def _cell_ways(self) -> dict[tuple[int, int], tuple[float, np.ndarray]]:
        """Return the shortest way over cells between the neighbours of a Voronoi diagram."""
        mask = self.problem.reachable
        index, graph = cell_graph(mask, self.problem.free)
        nearest = np.floor(self.places).astype(np.int64)
        numbers = index[tuple(nearest.T)]
        if numbers[0] < 0:
            # The start is between cell centres, and its own cell need not be a reachable one.
            away = np.hypot(*(self.problem.cells + 0.5 - self.places[0]).T)
            numbers[0] = int(away.argmin())
        owner_of = {}
        for place in reversed(range(len(numbers))):
            owner_of[int(numbers[place])] = place
        length, before, source = dijkstra(
            graph, indices=np.array(list(owner_of)), min_only=True, return_predecessors=True
        )
        owner = np.array([owner_of.get(int(each), -1) for each in source])
        edges = graph.tocoo()
        is_border = (edges.row < edges.col) & (owner[edges.row] != owner[edges.col])
        rows, columns = edges.row[is_border], edges.col[is_border]
        total = length[rows] + edges.data[is_border] + length[columns]
        found: dict[tuple[int, int], tuple[float, np.ndarray]] = {}
        for each in np.argsort(total, kind="stable"):
            row, column = int(rows[each]), int(columns[each])
            if owner[row] > owner[column]:
                row, column = column, row
            pair = int(owner[row]), int(owner[column])
            if pair not in found:
                chain = [*reversed(_chain(before, row)), *_chain(before, column)]
                ends = self.places[pair[0]][None], self.places[pair[1]][None]
                way = np.concatenate([ends[0], self.problem.cells[chain] + 0.5, ends[1]])
                found[pair] = float(total[each]), way
        # A second place in the cell of another has no region of its own.
        for place, number in enumerate(numbers):
            other = owner_of[int(number)]
            if other != place:
                away = math.dist(self.places[place], self.places[other])
                found[other, place] = max(away, 1e-6), self.places[[other, place]]
        return found

    @cached_property
    def _shortest(self) -> tuple[np.ndarray, np.ndarray]:
        lengths, before = dijkstra(self._ways[0], return_predecessors=True)
        return lengths, before

    @property
    def lengths(self) -> np.ndarray:
        """Lengths (C, C) of the shortest ways on the lattice [cells]."""
        return self._shortest[0]

    def stops(self, first: int, last: int) -> list[int]:
        """Return the places on the shortest way between two, both included."""
        before, way = self._shortest[1], [last]
        while way[-1] != first:
            way.append(int(before[first, way[-1]]))
        return way[::-1]

    def line(self, places: list[int]) -> np.ndarray:
        """Return the line (N, 2) through joined places [cells]."""
        points = [self.places[places[0]][None]]
        for one, other in itertools.pairwise(places):
            way = self._ways[1].get((min(one, other), max(one, other)))
            if way is None:
                way = self.places[[one, other]]
            elif one > other:
                way = way[::-1]
            points.append(way[1:])
        return np.concatenate(points)


def _chain(before: np.ndarray, number: int) -> list[int]:
    """Return the numbers from one back to its source."""
    chain = [number]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return chain
