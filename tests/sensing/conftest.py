"""Hilly worlds, and what a ray crosses in them, in double precision."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np
import pytest

from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid

SHAPE, RESOLUTION, ORIGIN = (30, 36), 0.2, (-1.0, 2.0, 0.4)
SLIVER = 1e-3
"""Of a stretch shorter than this [cells] rounding decides whether the ray is in the cell."""


class Place(NamedTuple):
    """A world, its elevation, and a pose in it."""

    world: np.ndarray
    elevation: np.ndarray
    pose: np.ndarray


class Stretch(NamedTuple):
    """A ray's stay in a cell: where [row, column] and from how far to how far [m]."""

    cell: tuple[int, int]
    entry: float
    exit: float

    @property
    def is_sliver(self) -> bool:
        return self.exit - self.entry < SLIVER * RESOLUTION


def cross(start: np.ndarray, angle: float, reach: float) -> Iterator[Stretch]:
    """Cut a ray at every line of the grid; the middle of a piece says which cell it lies in."""
    offset = np.asarray(start[:2], float) - ORIGIN[:2]
    cos, sin = math.cos(ORIGIN[2]), math.sin(ORIGIN[2])
    begin = np.array([cos * offset[0] + sin * offset[1], cos * offset[1] - sin * offset[0]])
    direction = np.array([math.cos(angle - ORIGIN[2]), math.sin(angle - ORIGIN[2])])
    lines = np.arange(-100, 140) * RESOLUTION
    cuts = ((lines[:, None] - begin) / direction).ravel()
    cuts = np.concatenate([[0.0], np.sort(cuts[(cuts > 0.0) & (cuts < reach + 1.0)])])
    middles = begin + 0.5 * (cuts[1:] + cuts[:-1])[:, None] * direction
    for (x, y), entry, leave in zip(middles, cuts, cuts[1:], strict=False):
        if entry > reach:
            return
        yield Stretch((math.floor(y / RESOLUTION), math.floor(x / RESOLUTION)), entry, leave)


def own_cell(start: np.ndarray) -> tuple[int, int]:
    return next(cross(start, 0.123, 1.0)).cell


def hilly(seed: int, heights: float) -> Place:
    """Make some hills and pits, a few posts, and a pose well on the map."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    elevation = 0.03 * rng.standard_normal(SHAPE)
    for _ in range(6):
        row, column, width = rng.uniform(0, 30), rng.uniform(0, 36), rng.uniform(2, 7)
        square = (rows - row) ** 2 + (columns - column) ** 2
        elevation += rng.uniform(-heights, heights) * np.exp(-square / (2 * width**2))
    world = rng.choice([0.0, 0.1, 0.5, 1.0], SHAPE, p=[0.85, 0.12, 0.015, 0.015])
    x, y = rng.uniform(8, 28) * RESOLUTION, rng.uniform(8, 22) * RESOLUTION
    cos, sin = math.cos(ORIGIN[2]), math.sin(ORIGIN[2])
    world[int(y / RESOLUTION), int(x / RESOLUTION)] = 0.0
    pose = [ORIGIN[0] + cos * x - sin * y, ORIGIN[1] + sin * x + cos * y, rng.uniform(-4, 4)]
    return Place(*(np.asarray(part, np.float32) for part in (world, elevation, pose)))


def at(values: np.ndarray, cell: tuple[int, int], outside: float) -> float:
    row, column = cell
    inside = 0 <= row < values.shape[0] and 0 <= column < values.shape[1]
    return float(values[row, column]) if inside else outside


def observe_from(sensor, places: list[Place], number: int, seed: int, turn: float, near: float):
    """Return places, points that a sensor may see from each, and what it observes there."""
    rng = np.random.default_rng(seed)
    poses, size = np.stack([place.pose for place in places]), (len(places), number)
    angle = poses[:, None, 2] + rng.uniform(-turn, turn, size)
    far = rng.uniform(near, 4.5, size)
    points = poses[:, None, :2] + far[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    points = points.astype(np.float32)

    @jax.jit
    @jax.vmap
    def observe(world, elevation, pose, points):
        frame = RESOLUTION, ORIGIN
        grid, ground = OccupancyGrid(world, *frame), Ground(elevation, *frame)
        scan = sensor.scan(grid, pose, key=jax.random.key(0), ground=ground)
        sighting = sensor.sight(grid, scan, pose, ground)
        return scan, sighting, sensor.sees(grid, pose, points, ground)

    arguments = [np.stack(part) for part in zip(*places, strict=True)]
    return places, points, jax.device_get(observe(*arguments, points))


@pytest.fixture(scope="session")
def observed_from() -> Callable[..., tuple]:
    return observe_from


@pytest.fixture(scope="session")
def place() -> Callable[[int, float], Place]:
    return hilly


@pytest.fixture(scope="session")
def crossed() -> Callable[[np.ndarray, float, float], Iterator[Stretch]]:
    return cross


@pytest.fixture(scope="session")
def standing() -> Callable[[np.ndarray], tuple[int, int]]:
    return own_cell


@pytest.fixture(scope="session")
def value_at() -> Callable[[np.ndarray, tuple[int, int], float], float]:
    return at


@pytest.fixture(scope="session")
def frame() -> tuple[float, tuple[float, float, float]]:
    """Resolution and origin of the hilly worlds."""
    return RESOLUTION, ORIGIN
