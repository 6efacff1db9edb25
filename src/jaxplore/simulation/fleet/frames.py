"""Robots that do not know where the others have begun, and find it by their maps; host code.

The maps of all robots are in the axes of the world, because one program updates them all. Before
maps are matched, each is turned into a frame of its robot's own, so that the search has to find
what nobody knows.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore.geometry.motion import motions_between
from jaxplore.localisation.map_matching import match_maps
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.union import unite_maps

SEARCH_PERIOD = 5.0
"""Least time between two searches for the frame of the same robot [s]: one takes about a second."""
FARTHEST = 10.0
"""Greatest coordinate of the origin of the world in a robot's frame [m]."""


class Frames(NamedTuple):
    """Which robots know how their frames lie to each other.

    Args:
        known: (N, N) whether two robots know it; each knows its own.
        found_at: (N, N) time at which they found it [s]; infinite before.
        errors: (N, N) distance by which a point in the middle of what a robot knew was off [m].
    """

    known: Bool[Array, "N N"]
    found_at: Float[Array, "N N"]
    errors: Float[Array, "N N"]

    @classmethod
    def nothing(cls, number: int) -> "Frames":
        """Return what robots know before they have met."""
        own = jnp.eye(number, dtype=bool)
        return cls(own, jnp.where(own, 0.0, jnp.inf), jnp.zeros((number, number)))


def find_frames(
    frames: Frames,
    maps: Sequence[OccupancyGrid],
    links: np.ndarray,
    identity: np.ndarray,
    time: float,
) -> Frames:
    """Return what the robots know of their frames after those that hear each other have matched
    their maps.

    Robots whose frames are known are a group, and have one map of what they have told one another.
    When two robots of two groups are certain how they lie, all of both groups are. A pose that is
    not certain changes nothing.

    Args:
        frames: what they knew before.
        maps: map of each robot.
        links: (N, N) which robots hear each other.
        identity: (N,) number of each robot, from which its own frame follows.
        time: time since the start [s].
    """
    known, found_at, errors = (np.array(each) for each in frames)
    own: dict[int, tuple[OccupancyGrid, np.ndarray]] = {}
    for one, other in itertools.combinations(range(len(maps)), 2):
        if known[one, other] or not links[one, other]:
            continue
        for robot in (one, other):
            if robot not in own:
                own[robot] = _in_own_frame(maps[robot], int(identity[robot]))
        (first, from_first), (second, from_second) = own[one], own[other]
        match = match_maps(first, second)
        if not match.is_certain:
            continue
        # Where the world's origin is seen from a robot is known to the simulation alone.
        origin = motions_between(from_second[None], np.zeros((1, 3)))[0]
        middle = _middle(second)
        true = _moved(_moved(middle, origin), from_first)
        error = math.dist(_moved(middle, match.pose), true)
        joined = np.ix_(np.flatnonzero(known[one]), np.flatnonzero(known[other]))
        for rows in (joined, (joined[1].T, joined[0].T)):
            known[rows], found_at[rows], errors[rows] = True, time, error
    return Frames(*(jnp.array(each) for each in (known, found_at, errors)))


def _in_own_frame(grid: OccupancyGrid, identity: int) -> tuple[OccupancyGrid, np.ndarray]:
    """Return a map in the frame of a robot, and the pose of the world in that frame."""
    rng = np.random.default_rng(identity)
    pose = np.append(rng.uniform(-FARTHEST, FARTHEST, 2), rng.uniform(-math.pi, math.pi))
    nothing = OccupancyGrid(np.full((1, 1), 0.5, np.float32), grid.resolution)
    return unite_maps(nothing, grid, pose), pose


def _middle(grid: OccupancyGrid) -> np.ndarray:
    """Return the mean of the free cells of a map (2,) [m]."""
    cells = np.argwhere(np.asarray(grid.is_free)).mean(axis=0) + 0.5
    return np.asarray(grid.frame.to_world(jnp.asarray(cells, jnp.float32)), np.float64)


def _moved(point: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a point (2,) of the frame of a pose in the frame of that pose [m]."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(np.array([[cos, -sin], [sin, cos]]) @ point + pose[:2])
