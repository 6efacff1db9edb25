"""What the sensors see from a pose: the cells that a scan makes free."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from benchmarks.bound.problem import Problem
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import ONE_HIT_IN, Sensor

MOST_AT_ONCE = 2**24
"""Greatest number of cells of the maps that are computed side by side."""


class Sight:
    """Cells that a scan from a pose makes free, as the judge of coverage counts them.

    The scan is that of the simulation, `Sensor.scan`, without noise. The cells are those that
    `Sensor.sight` counts as passed and `update_grid` takes for free. With `num_yaws` above 1 a view
    is that of a robot that turns on the spot: of scans at headings that divide the angle between
    two beams.

    A view is a row of bits, one for each reachable cell, packed into 64-bit words.

    Args:
        problem: map and sensors.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._words = -(-problem.num_cells // 64)
        self._batch = int(np.clip(MOST_AT_ONCE // problem.reachable.size, 1, 32))
        self._silent = tuple(
            eqx.tree_at(lambda at: at.range_noise, sensor, jnp.zeros(()))
            for sensor in problem.sensors
        )

    def blank(self) -> np.ndarray:
        """Return a view (words,) of what is known in advance."""
        known = self.problem.known
        if known is None:
            return np.zeros(self._words, np.uint64)
        (view,) = self.packed(known[tuple(self.problem.cells.T)][None])
        return np.asarray(view)

    def views(self, places: np.ndarray, yaws: np.ndarray) -> np.ndarray:
        """Return the views (P, words) of scans.

        Args:
            places: (P, 2) places [cells].
            yaws: (P,) headings in the world [rad].
        """
        poses = np.column_stack([self.problem.to_world(places), yaws]).astype(np.float32)
        found = np.zeros((len(poses), self._words), np.uint64)
        for begin in range(0, len(poses), self._batch):
            part = poses[begin : begin + self._batch]
            # Batches of one size share a program.
            full = np.concatenate([part, np.repeat(part[-1:], self._batch - len(part), axis=0)])
            seen = np.asarray(
                _free_by_scans(
                    jnp.asarray(full),
                    self.problem.world,
                    self.problem.sensors,
                    self._silent,
                    self.problem.ground,
                )
            )
            row, column = self.problem.cells.T
            found[begin : begin + len(part)] = self.packed(seen[: len(part), row, column])
        return found

    def turning_views(self, places: np.ndarray, num_yaws: int) -> np.ndarray:
        """Return the views (P, words) of a robot that turns on the spot.

        Args:
            places: (P, 2) places [cells].
            num_yaws: number of headings.
        """
        spacing = max(sensor.beam_spacing for sensor in self.problem.sensors)
        seen = np.zeros((len(places), self._words), np.uint64)
        for turn in range(num_yaws):
            seen |= self.views(places, np.full(len(places), turn * spacing / num_yaws))
        return seen

    def packed(self, seen: np.ndarray) -> np.ndarray:
        """Return masks (P, R) of the reachable cells as rows of bits (P, words)."""
        rows = np.zeros((len(seen), 8 * self._words), np.uint8)
        packed = np.packbits(seen, axis=1)
        rows[:, : packed.shape[1]] = packed
        return rows.view(np.uint64)

    def unpacked(self, views: np.ndarray) -> np.ndarray:
        """Return the masks (P, R) of views (P, words)."""
        bits = np.unpackbits(np.ascontiguousarray(views).view(np.uint8), axis=1)
        return bits[:, : self.problem.num_cells].astype(bool)


@eqx.filter_jit
def _free_by_scans(
    poses: Array,
    world: OccupancyGrid,
    sensors: tuple[Sensor, ...],
    silent: tuple[Sensor, ...],
    ground: Ground | None,
) -> Array:
    """Return the masks (P, H, W) of the cells that scans from poses (P, 3) make free.

    `silent` are the sensors without noise, which scan. Those with noise take the readings in.
    """

    def free(pose: Array) -> Array:
        seen = jnp.zeros(world.shape, bool)
        for sensor, source in zip(sensors, silent, strict=True):
            scan = source.scan(world, pose, key=jax.random.key(0), ground=ground)
            sighting = sensor.sight(world, scan, pose, ground)
            hits, passes, _ = sighting
            is_occupied = (hits > 0) & (ONE_HIT_IN * hits >= hits + passes)
            seen = seen | sighting.on_map((passes > 0) & ~is_occupied)
        return seen

    return jax.vmap(free)(poses)


def union(views: Sequence[np.ndarray] | np.ndarray, initial: np.ndarray) -> np.ndarray:
    """Return what is seen in any of some views, and in an initial one (words,)."""
    rows = np.asarray(views, np.uint64).reshape(-1, len(initial))
    found: np.ndarray = np.bitwise_or.reduce(rows, axis=0, initial=0) | initial
    return found


def count(views: np.ndarray) -> np.ndarray:
    """Return the number of cells in each of some views (..., words)."""
    return np.bitwise_count(views).sum(axis=-1, dtype=np.int64)
