"""What scans are worth by the definition: rays walked cell by cell and FSMI's double sum over hits
and readings, in double precision, sharing nothing with the package."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import expit, ndtr, rel_entr

from jaxplore import Lidar, OccupancyGrid
from jaxplore.information.gain import CellSensor, IdealSensor
from jaxplore.information.noise import GaussianNoise, RangeNoise, UniformNoise

TOUCH = 1e-4
"""Cells that a ray crosses over less than this are touched at a corner: they do not count."""


def walk(start: np.ndarray, angle: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells (n, 2) that a ray leaves within `length`, and its entries and exits (n, 2).

    Amanatides and Woo, in units of cells, from (row, column).
    """
    direction = (math.sin(angle), math.cos(angle))
    cell = [math.floor(start[0]), math.floor(start[1])]
    upcoming, apart = [math.inf, math.inf], [math.inf, math.inf]
    for axis in (0, 1):
        if abs(direction[axis]) > 1e-9:
            ahead = cell[axis] + (direction[axis] > 0) - start[axis]
            upcoming[axis], apart[axis] = ahead / direction[axis], 1.0 / abs(direction[axis])
    cells, spans, entry = [], [], 0.0
    while min(upcoming) <= length:
        axis = int(upcoming[1] < upcoming[0])
        leave = upcoming[axis]
        if leave - entry > TOUCH:
            cells.append(tuple(cell))
            spans.append((entry, leave))
        entry = leave
        cell[axis] += 1 if direction[axis] > 0 else -1
        upcoming[axis] += apart[axis]
    return np.array(cells, int).reshape(-1, 2), np.array(spans, float).reshape(-1, 2)


def gains(p: np.ndarray, sensor: CellSensor) -> tuple[np.ndarray, np.ndarray]:
    """Return KL(posterior || prior) of cells measured occupied and of cells passed."""
    if isinstance(sensor, IdealSensor):
        some, other = np.where(p > 0, p, 1.0), np.where(p < 1, 1.0 - p, 1.0)
        return -np.log(some), -np.log(other)
    low, high = float(sensor.minimum), float(sensor.maximum)
    with np.errstate(divide="ignore"):
        before = np.clip(np.log(p) - np.log1p(-p), low, high)

    def divergence(change: float) -> np.ndarray:
        after = np.clip(before + change, low, high)
        return rel_entr(expit(after), expit(before)) + rel_entr(expit(-after), expit(-before))

    return divergence(float(sensor.occupied)), divergence(float(sensor.free))


def readings(noise: RangeNoise | None, edges: np.ndarray) -> np.ndarray:
    """Return G[k, j] = P(reading in cell k | first hit in cell j)."""
    n = len(edges) - 1
    if noise is None:
        return np.eye(n)
    if isinstance(noise, UniformNoise):
        apart = np.abs(np.arange(n)[:, None] - np.arange(n))
        return (apart <= noise.half_width) / (2.0 * noise.half_width + 1.0)
    assert isinstance(noise, GaussianNoise)
    away = edges[:, None] - 0.5 * (edges[1:] + edges[:-1])
    share = np.diff(ndtr(away / float(noise.std)), axis=0)
    if noise.reach is None:
        return share
    nearest = np.maximum(0.0, np.maximum(away[:-1], -away[1:]))
    return np.where(nearest <= noise.reach, share, 0.0)


def beam_value(
    p: np.ndarray,
    resolution: float,
    start: np.ndarray,
    angle: float,
    max_range: float,
    spacing: float | None,
    sensor: CellSensor,
    noise: RangeNoise | None = None,
    no_return: bool = True,
) -> float:
    """Return what a beam is worth, in the map's frame and cells; off the map cells absorb.

    Near cells count `min(1, r spacing)` where there is a spacing.
    """
    cells, spans = walk(start, angle, max_range / resolution)
    if len(cells) == 0:
        return 0.0
    on_map = ((cells >= 0) & (cells < p.shape)).all(axis=1)
    inside = np.where(on_map[:, None], cells, 0)
    o = np.where(on_map, p[inside[:, 0], inside[:, 1]], 1.0)
    weight = on_map.astype(float)
    if spacing is not None:
        weight *= np.minimum(1.0, spans.mean(axis=1) * spacing)
    occupied, free = (weight * gain for gain in gains(o, sensor))
    reach = np.concatenate([[1.0], np.cumprod(1.0 - o)])
    potential = occupied + np.cumsum(free) - free
    edges = np.append(0.0, spans[:, 1]) * resolution
    value = potential @ readings(noise, edges) @ (o * reach[:-1])
    return float(value + no_return * reach[-1] * free.sum())


def pose_value(
    grid: OccupancyGrid,
    position: np.ndarray,
    heading: float,
    lidar: Lidar,
    sensor: CellSensor,
    noise: RangeNoise | None = None,
    no_return: bool = True,
    near_weight: bool = True,
) -> float:
    """Return what a scan from a pose in the world is worth."""
    p, origin = np.asarray(grid.probability, float), np.asarray(grid.frame.origin, float)
    cos, sin = math.cos(origin[2]), math.sin(origin[2])
    x, y = np.asarray(position, float) - origin[:2]
    start = np.array([cos * y - sin * x, cos * x + sin * y]) / grid.resolution
    here = np.floor(start).astype(int)
    if not ((here >= 0) & (here < p.shape)).all() or p[tuple(here)] > np.float32(0.65):
        return 0.0
    is_full, count = lidar.field_of_view > 6.283, lidar.num_beams
    half = lidar.field_of_view / 2
    beams = np.linspace(-half, half, count, endpoint=not is_full) if count > 1 else np.zeros(1)
    # One beam has no cell to share.
    spacing = beams[1] - beams[0] if near_weight and count > 1 else None
    rules = (lidar.max_range, spacing, sensor, noise, no_return)
    angles = heading - origin[2] + beams
    return sum(beam_value(p, grid.resolution, start, angle, *rules) for angle in angles)


@pytest.fixture(scope="session")
def beam_by_definition() -> Callable[..., float]:
    """Return `beam_value`."""
    return beam_value


@pytest.fixture(scope="session")
def scan_by_definition() -> Callable[..., float]:
    """Return `pose_value`."""
    return pose_value


@pytest.fixture(scope="session")
def cells_of_a_ray() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Return `walk`."""
    return walk
