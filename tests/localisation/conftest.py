"""Rooms of straight walls, whose ranges are known exactly."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.sensing import Lidar, Scan


def wall_distances(walls: np.ndarray, pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the exact distance (B,) to the nearest of the walls (S, 2, 2); infinite without."""
    directions = np.stack([np.cos(pose[2] + angles), np.sin(pose[2] + angles)], axis=1)
    start, along = walls[:, 0] - pose[:2], walls[:, 1] - walls[:, 0]
    cross = directions[:, None, 0] * along[:, 1] - directions[:, None, 1] * along[:, 0]
    away = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    share = start[:, 0] * directions[:, None, 1] - start[:, 1] * directions[:, None, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        away, share = away / cross, share / cross
    is_met = (away > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.where(is_met, away, np.inf).min(axis=1)


@pytest.fixture(scope="session")
def scan_of() -> Callable[..., Scan]:
    """Return what makes the scan of walls from a pose, exact but for noise of the ranges."""

    def make(
        walls: np.ndarray, pose: Any, sensor: Lidar, noise: float = 0.0, seed: int = 0
    ) -> Scan:
        ranges = wall_distances(walls, np.asarray(pose, float), sensor.beam_angles.astype(float))
        ranges += noise * np.random.default_rng(seed).standard_normal(len(ranges))
        is_return = ranges <= sensor.max_range
        ranges = np.where(is_return, ranges, sensor.max_range)
        return Scan(jnp.asarray(ranges, jnp.float32), jnp.asarray(is_return))

    return make


def polygon(*corners: tuple[float, float]) -> np.ndarray:
    """Return the walls (S, 2, 2) of a closed polygon."""
    points = np.array(corners, float)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


@pytest.fixture(scope="session")
def room() -> np.ndarray:
    """Return the walls of a room of 6 m x 4 m with a slanted corner and a box inside."""
    outer = polygon((-3.0, -2.0), (3.0, -2.0), (3.0, 1.0), (2.0, 2.0), (-3.0, 2.0))
    return np.concatenate([outer, polygon((1.0, -1.0), (1.8, -1.0), (1.8, -0.4), (1.0, -0.4))])


@pytest.fixture(scope="session")
def traced() -> Callable[..., int]:
    """Return what counts how often a function is traced for calls with other arguments."""

    def count(function: Callable[..., Any], calls: Any) -> int:
        traces = []

        @eqx.filter_jit
        def counted(*arguments: Any) -> Any:
            traces.append(arguments)
            return function(*arguments)

        for each in calls:
            counted(*each)
        return len(traces)

    return count
