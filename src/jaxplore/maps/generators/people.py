"""People who walk to and fro on a map, as moving obstacles."""

import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_PEOPLE
from jaxplore._xla import on_device
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.world import MovingObstacle

ROOM = 0.05
"""Distance that people keep from walls [m]."""
SHORTEST_WALK = 4.0
"""Shortest way of somebody [m], where the map has room for it."""
CORNERS = 40
"""Number of corners of each way and back: walks of any people have arrays of one shape."""
TRIES = 30
"""Number of destinations that are tried for each."""


@_kinds.check_arguments
def walking_people(
    world: OccupancyGrid,
    number: int,
    *,
    speed: float = 1.0,
    radius: float = 0.3,
    seed: int = 0,
) -> tuple[MovingObstacle, ...]:
    """Let people walk to and fro on shortest ways between random places of a map.

    They do not look out for anybody. All of them walk in the widest connected part of the free
    space in which they fit.

    Args:
        world: the map.
        number: number of people.
        speed: their speed [m/s].
        radius: their radius [m].
        seed: seed of the places.

    Raises:
        ValueError: a number that is not accepted, a map without room for them.
    """
    from scipy import ndimage

    count = _checks.whole_number("number", number, at_least=0, at_most=MOST_PEOPLE)
    pace = _checks.number("speed", speed, at_least=0.0)
    size = _checks.number("radius", radius, above=0.0)
    rng = np.random.default_rng(_checks.whole_number("seed", seed, at_least=0))
    if count == 0:
        return ()
    free = np.pad(np.asarray(world.is_free), 1)
    # To the faces of solid cells, not to their centres.
    room = (ndimage.distance_transform_edt(free) - 0.5)[1:-1, 1:-1] * world.resolution
    label, _ = ndimage.label(room >= size + ROOM, np.ones((3, 3)))
    counts = np.bincount(label.ravel())
    counts[0] = 0
    if not counts.any():
        raise ValueError(f"radius is {size:g}; accepted: people who fit between the map's walls")
    is_open = label == counts.argmax()
    ways = _Ways(is_open, room >= size)
    walks = []
    for _ in range(count):
        corners = ways.draw(rng, SHORTEST_WALK / world.resolution)
        there = [*corners, *corners[-2:0:-1]]
        there += [there[-1]] * (CORNERS - len(there))
        cells = np.array(there, np.float32) + 0.5
        places = np.asarray(world.frame.to_world(on_device(cells)), np.float64)
        path = tuple((float(x), float(y)) for x, y in places)
        walks.append(MovingObstacle(path, pace, size))
    return tuple(walks)


class _Ways:
    """Shortest ways through the cells of `is_open`, with straight parts across `is_clear` only."""

    def __init__(self, is_open: np.ndarray, is_clear: np.ndarray) -> None:
        from scipy import sparse

        self._clear, self._cells = is_clear, np.argwhere(is_open)
        number = np.full(is_open.shape, -1)
        number[is_open] = np.arange(len(self._cells))
        rows, columns, lengths = [], [], []
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = self._cells + np.array([down, right])
            is_on = ((there >= 0) & (there < is_open.shape)).all(axis=1)
            beside = number[tuple(there[is_on].T)]
            is_joined = beside >= 0
            rows.append(np.flatnonzero(is_on)[is_joined])
            columns.append(beside[is_joined])
            lengths.append(np.full(is_joined.sum(), np.hypot(down, right)))
        size = len(self._cells)
        entries = np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))
        self._graph = sparse.coo_matrix(entries, shape=(size, size)).tocsr()

    def draw(self, rng: np.random.Generator, shortest: float) -> list[np.ndarray]:
        """Return the corners (row, column) of a way between two random cells.

        The way should be at least `shortest` cells long.
        """
        from scipy.sparse.csgraph import dijkstra

        start = int(rng.integers(len(self._cells)))
        length, before = dijkstra(
            self._graph, directed=False, indices=start, return_predecessors=True
        )
        far = np.flatnonzero(length >= min(shortest, length.max()))
        for end in rng.permutation(far)[:TRIES]:
            way = [int(end)]
            while way[-1] != start:
                way.append(int(before[way[-1]]))
            corners = self._straighten(self._cells[way])
            if 2 * len(corners) - 2 <= CORNERS:
                return corners
        return [self._cells[start]]

    def _straighten(self, way: np.ndarray) -> list[np.ndarray]:
        """Return the corners that are left if all that can be is walked straight."""
        corners, at = [way[0]], 0
        while at < len(way) - 1:
            step = 1
            # Doubled and then halved: the farthest cell that is in reach, or one near it.
            while at + 2 * step < len(way) and self._is_straight(way[at], way[at + 2 * step]):
                step *= 2
            part = step
            while part > 0:
                if at + step + part < len(way) and self._is_straight(
                    way[at], way[at + step + part]
                ):
                    step += part
                part //= 2
            at += step
            corners.append(way[at])
        return corners

    def _is_straight(self, start: np.ndarray, end: np.ndarray) -> bool:
        number = 2 * int(np.abs(end - start).max()) + 1
        along = np.linspace(start, end, number).round().astype(int)
        return bool(self._clear[tuple(along.T)].all())
