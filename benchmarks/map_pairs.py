"""Maps of robots that explore a part of a real map, each in a frame of its own."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jax import Array
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from jaxplore.geometry.motion import motions_between
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar

SPACING = 0.2
"""Side of the lattice on which robots drive [m]."""
ROOM = 0.3
"""Least distance of a robot from walls [m]."""
CHUNK = 16
"""Scans that one call of the program maps."""
PER_SCAN, PIECE = 0.4, 2.0
"""Way between two scans, and before the robot looks again where to go [m]."""
SEEN = 0.3
"""Probability below which a place counts as seen."""
DRIFT, TURN_DRIFT, FORGETTING = 0.03, 0.003, 0.02
"""Standard deviations of the error of the poses that a robot maps by [m, rad], and the share of it
that changes at each scan: what scan matching and closed loops leave."""


class Seen(NamedTuple):
    """What a robot has mapped.

    Args:
        grid: its map, in a frame of its own.
        frame: pose (x, y, yaw) of its frame in the world [m, m, rad].
        way: length of its way [m].
    """

    grid: OccupancyGrid
    frame: np.ndarray
    way: float


class Site:
    """A world, the lattice on which robots drive in it, and a lidar.

    Args:
        world: true map.
        resolution: side of a cell of the robots' maps [m].
        max_range: range of the lidar [m].
        num_beams: number of its beams.
    """

    def __init__(
        self,
        world: OccupancyGrid,
        resolution: float = 0.05,
        max_range: float = 8.0,
        num_beams: int = 360,
    ) -> None:
        self.world, self.resolution = world, resolution
        self.lidar = Lidar(num_beams, max_range, range_noise=0.03)
        self.nodes, self.graph = _lattice(world)
        # Rotated by any angle and begun at any place, a map reaches no farther than the diagonal.
        self.reach = world.resolution * math.hypot(*world.shape) + 1.0

    def explore(self, ways: tuple[float, ...], rng: np.random.Generator) -> list[Seen]:
        """Return the maps of a robot after lengths of its way [m].

        It begins anywhere, and drives to the nearest place that its map does not have, again and
        again.
        """
        node = int(rng.integers(len(self.nodes)))
        # The robot counts its poses from any pose.
        own = np.array([*rng.uniform(-3.0, 3.0, 2), rng.uniform(-math.pi, math.pi)])
        start = np.array([*self.nodes[node], rng.uniform(-math.pi, math.pi)])
        frame = _compose(start, motions_between(own[None], np.zeros((1, 3)))[0])
        # A grid around all of the world.
        centre = np.asarray(
            self.world.frame.to_world(jnp.asarray(self.world.shape, jnp.float32) / 2.0)
        )
        middle = motions_between(frame[None], np.array([[*centre, 0.0]]))[0, :2]
        number = math.ceil(self.reach / self.resolution)
        corner = middle - 0.5 * number * self.resolution
        grid = OccupancyGrid.unknown(
            (number, number), GridFrame(self.resolution, [*corner.tolist(), 0.0])
        )
        inner = motions_between(
            np.repeat(frame[None], len(self.nodes), axis=0),
            np.column_stack([self.nodes, np.zeros(len(self.nodes))]),
        )[:, :2]
        places = tuple(np.floor((inner[:, ::-1] - corner[::-1]) / self.resolution).astype(int).T)
        error, driven, kept = np.zeros(3), 0.0, []
        poses = [start]
        for way in sorted(ways):
            while poses and (driven < way or driven == 0.0):
                believed = []
                for pose in poses:
                    error = (1.0 - FORGETTING) * error + math.sqrt(2.0 * FORGETTING) * rng.normal(
                        0.0, [DRIFT, DRIFT, TURN_DRIFT]
                    )
                    believed.append(motions_between(frame[None], pose[None])[0] + error)
                key = jax.random.key(int(rng.integers(2**31)))
                grid = _map_scans(
                    self.lidar,
                    self.world,
                    grid,
                    _filled(poses),
                    _filled(believed),
                    jnp.asarray(len(poses), jnp.int32),
                    key,
                )
                # A few metres to the nearest place that the map does not have: what the robot sees
                # on the way may do.
                is_new = np.asarray(grid.probability)[places] > SEEN
                steps = self._steps(node, is_new)
                node = steps[-1]
                ahead = np.diff(self.nodes[steps], axis=0)
                driven += float(np.hypot(*ahead.T).sum())
                poses = [
                    np.array([*self.nodes[at], math.atan2(by[1], by[0])])
                    for at, by in zip(steps[1:], ahead, strict=True)
                ][:: round(PER_SCAN / SPACING)]
            kept.append(Seen(crop(grid), frame, driven))
        return kept

    def _steps(self, node: int, is_new: np.ndarray) -> list[int]:
        """Return nodes on the way from a node to the nearest one of a mask; itself if none is."""
        length, before = dijkstra(self.graph, indices=node, return_predecessors=True)
        is_new &= np.isfinite(length)
        if not is_new.any():
            return [node]
        path = [int(np.where(is_new, length, np.inf).argmin())]
        while path[-1] != node:
            path.append(int(before[path[-1]]))
        return path[::-1][: 1 + round(PIECE / SPACING)]


def _filled(poses: list[np.ndarray]) -> Array:
    rows = np.zeros((CHUNK, 3), np.float32)
    rows[: len(poses)] = poses
    return jnp.asarray(rows)


def true_pose(one: Seen, other: Seen) -> np.ndarray:
    """Return the pose of the frame of another robot in that of one [m, m, rad]."""
    pose: np.ndarray = motions_between(one.frame[None], other.frame[None])[0]
    return pose


def crop(grid: OccupancyGrid, margin: int = 4) -> OccupancyGrid:
    """Return the part of a map that is known."""
    values = np.asarray(grid.probability)
    rows, columns = (np.flatnonzero((np.abs(values - 0.5) > 0.1).any(axis=a)) for a in (1, 0))
    first = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    part = values[first[0] : rows[-1] + margin, first[1] : columns[-1] + margin]
    x, y, _ = np.asarray(grid.frame.origin, float).tolist()
    side = grid.resolution
    return OccupancyGrid(part, side, (x + side * first[1], y + side * first[0], 0.0))


def shared_area(one: Seen, other: Seen) -> tuple[float, float]:
    """Return the free area that both know [m2], and its share of what the one with less knows."""
    pose = true_pose(one, other)
    free = np.argwhere(np.asarray(other.grid.is_free))
    points = np.asarray(other.grid.frame.cell_centre(jnp.asarray(free)), float)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    there = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    x, y, _ = np.asarray(one.grid.frame.origin, float).tolist()
    cells = np.floor((there[:, ::-1] - [y, x]) / one.grid.resolution).astype(int)
    is_in = ((cells >= 0) & (cells < one.grid.shape)).all(axis=1)
    own = np.asarray(one.grid.is_free)
    shared = int(own[tuple(cells[is_in].T)].sum())
    return shared * other.grid.resolution**2, shared / max(min(int(own.sum()), len(free)), 1)


def _compose(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cos * motion[0] - sin * motion[1]
    return np.array([x, pose[1] + sin * motion[0] + cos * motion[1], pose[2] + motion[2]])


def _lattice(world: OccupancyGrid) -> tuple[np.ndarray, csr_array]:
    """Return the nodes (N, 2) of the greatest connected part of a lattice, and their graph."""
    free = np.asarray(world.is_free)
    clear = scipy.ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1]
    step = max(1, round(SPACING / world.resolution))
    is_open = (clear * world.resolution > ROOM)[::step, ::step]
    labels, _ = scipy.ndimage.label(is_open)
    largest = np.bincount(labels.ravel())[1:].argmax() + 1
    is_open = labels == largest
    index = np.full(is_open.shape, -1)
    cells = np.argwhere(is_open)
    index[is_open] = np.arange(len(cells))
    pairs: Any = [
        (index[:-1], index[1:]),
        (index[:, :-1], index[:, 1:]),
        (index[:-1, :-1], index[1:, 1:]),
        (index[:-1, 1:], index[1:, :-1]),
    ]
    begins, ends, weights = [], [], []
    for (a, b), length in zip(pairs, (1.0, 1.0, math.sqrt(2.0), math.sqrt(2.0)), strict=True):
        is_edge = (a >= 0) & (b >= 0)
        begins += [a[is_edge], b[is_edge]]
        ends += [b[is_edge], a[is_edge]]
        weights.append(np.full(2 * int(is_edge.sum()), length * step * world.resolution))
    rows, columns = np.concatenate(begins), np.concatenate(ends)
    graph = csr_array(coo_array((np.concatenate(weights), (rows, columns)), (len(cells),) * 2))
    nodes = np.asarray(world.frame.cell_centre(jnp.asarray(cells * step)), float)
    return nodes, graph


@eqx.filter_jit
def _map_scans(
    lidar: Lidar,
    world: OccupancyGrid,
    grid: OccupancyGrid,
    true: Any,
    believed: Any,
    number: Any,
    key: Any,
) -> OccupancyGrid:
    """Map scans from true poses at the poses that the robot takes itself to be."""

    def one(index: Any, grid: OccupancyGrid) -> OccupancyGrid:
        scan = lidar.scan(world, true[index], key=jax.random.fold_in(key, index))
        return lidar.update(grid, scan, believed[index], InverseSensorModel())

    mapped: OccupancyGrid = jax.lax.fori_loop(0, number, one, grid)
    return mapped
