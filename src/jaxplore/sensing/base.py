"""What a sensor is: scans of a world, what a scan says of each cell, and the belief after it."""

import abc
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import GridMask, Key, Pose, Scalar
from jaxplore.geometry.rays import RayCells
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.sensing.fan import disc_distance, fan, first_entry
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

ONE_HIT_IN = 3
"""So many of the beams that hit or pass a cell may be for one hit to find it occupied."""
ROUNDING = 1e-6
"""Directions this close to the edge of the field of view are in it [rad]."""


class Scan(NamedTuple):
    """One scan: `ranges` (B,) [m], and which beams came back (B,).

    A beam that met nothing within the sensor's range has `is_return` False and the maximum range.
    One that ended at something that moves has its range and `is_return` False: what is before it is
    free, and where it ended there is nothing for the map.
    """

    ranges: Float[Array, " B"]
    is_return: Bool[Array, " B"]


class Sighting(NamedTuple):
    """What a scan says of each cell: how many beams hit it and how many passed it, (H, W) each."""

    hits: Int[Array, "H W"]
    passes: Int[Array, "H W"]

    @property
    def is_seen(self) -> GridMask:
        """Cells of which the scan says anything."""
        return (self.hits + self.passes) > 0


class Sensor(eqx.Module):
    """A fan of beams from the robot's centre that measure ranges; abstract.

    A beam is a vertical slice of the view: a line for a lidar, a column of pixels for a camera. A
    sensor says what stops its beams, which cells they show, and what of a reading may be believed
    where the ground is known; everything else is here.

    Where a `Ground` is given, its layers are those of the map's cells: same shape, resolution and
    origin. The sensor is `height` above the ground of the robot's cell, and does not tilt with it.
    """

    num_beams: eqx.AbstractVar[int]
    max_range: eqx.AbstractVar[float]
    field_of_view: eqx.AbstractVar[float]
    range_noise: eqx.AbstractVar[Scalar]
    height: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def _stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Say which cells send a beam back, and which end it, back or not.

        Args:
            cells: the cells of each beam.
            solid: which of them are solid.
            rise: their ground's height above the sensor [m]; None where no ground is given.
            resolution: side of a cell [m].
        """

    @abc.abstractmethod
    def _shown(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        """Say which cells each beam shows, by the same arguments."""

    @abc.abstractmethod
    def _believed(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the hits and passes that the known ground allows; `reading` is in cells."""

    @property
    def is_full_circle(self) -> bool:
        """Whether the field of view is 2 pi."""
        return self.field_of_view >= 2.0 * math.pi - 1e-6

    @property
    def beam_spacing(self) -> float:
        """Angle between neighbouring beams [rad]."""
        gaps = self.num_beams if self.is_full_circle else max(1, self.num_beams - 1)
        return self.field_of_view / gaps

    @property
    def beam_angles(self) -> np.ndarray:
        """Direction of each beam (B,) relative to the heading [rad]."""
        if self.num_beams == 1:
            return np.zeros(1, np.float32)
        first = -math.pi if self.is_full_circle else -self.field_of_view / 2.0
        return (first + self.beam_spacing * np.arange(self.num_beams)).astype(np.float32)

    def scan(
        self,
        world: OccupancyGrid,
        pose: Pose,
        *,
        key: Key,
        ground: Ground | None = None,
        movers: Float[Array, "M 3"] | None = None,
    ) -> Scan:
        """Measure a world from a pose (x, y, yaw) [m, m, rad].

        A beam ends where it enters the first cell that is not known to be free, off the map
        included: a world's unknown cells are as solid as its walls, since nothing says what would
        be behind. Exact cell traversal; Gaussian noise on what comes back.

        Args:
            world: the truth.
            pose: of the robot.
            key: for the noise.
            ground: the ground of the world; level and far below when absent, for a lidar, and at
                elevation 0 for a camera.
            movers: discs that stand in the world now, as high as it takes: x, y, radius (M, 3) [m].
                A beam ends at the nearest if it is nearer than everything else, at 0 inside one,
                and is no return: what moves is for a tracker, not for the map. A radius of 0 is no
                disc.

        Raises:
            ValueError: a ground of another shape or resolution than the world.
        """
        cells = self._cells(world, pose)
        solid = cells.is_crossed & (world.at_cell(cells.cell) >= FREE_THRESHOLD)
        rise = self._rise(cells, pose, world, ground)
        stops, ends = self._stops(cells, solid, rise, world.resolution)
        first = first_entry(cells, stops, world.resolution)
        is_mover = None
        if movers is not None:
            angles = pose[2] + jnp.asarray(self.beam_angles)
            disc = disc_distance(pose[:2], angles, movers)
            is_mover = disc < first_entry(cells, ends, world.resolution)
            first = jnp.where(is_mover, disc, first)
        is_met = first < self.max_range
        noise = self.range_noise * jax.random.normal(key, first.shape)
        ranges = jnp.clip(first + noise, 0.0, self.max_range)
        is_return = is_met if is_mover is None else is_met & ~is_mover
        return Scan(jnp.where(is_met, ranges, self.max_range), is_return)

    def sight(
        self, grid: OccupancyGrid, scan: Scan, pose: Pose, ground: Ground | None = None
    ) -> Sighting:
        """Return how many beams of a scan hit and passed each cell of a grid.

        A cell that a beam shows and leaves before its reading (or before the maximum range, where
        nothing came back) was passed; the cell that holds the reading was hit. A reading lies on
        the face of its cell, and noise would put half of them into the cell in front, so the cell
        is taken `min(2 sigma, resolution / 2)` behind the reading. Of a cell that the beam is in
        for less than `min(sigma, resolution / 2)` it says nothing: noise decides whether it ended
        there or behind. Without this the corners of obstacles, which beams only graze, wear away:
        with noise of half a cell 3 % of the cells of walls were taken for free, now one in 5000.

        Only the grid's frame and shape are read. The robot knows the ground, as far as it is given.

        Raises:
            ValueError: a ground of another shape or resolution than the grid.
        """
        resolution = grid.resolution
        cells = self._cells(grid, pose)
        rise = self._rise(cells, pose, grid, ground)
        margin = jnp.minimum(2.0 * self.range_noise, 0.5 * resolution) / resolution + 1e-3
        reading = (scan.ranges / resolution)[:, None]
        is_return = scan.is_return[:, None]
        depth = reading + margin
        least = jnp.minimum(self.range_noise, 0.5 * resolution) / resolution
        is_long = cells.exit - cells.entry >= least
        is_hit = is_return & is_long & (cells.entry <= depth) & (depth < cells.exit)
        is_passed = is_long & (cells.exit <= reading + 1e-3)
        is_hit, is_passed = self._believed(cells, is_hit, is_passed, reading, rise, resolution)
        height, width = grid.shape
        seen = cells.is_crossed & (is_hit | is_passed)
        index = cells.cell[..., 0] * width + cells.cell[..., 1]
        index = jnp.where(seen & grid.contains(cells.cell), index, height * width)
        # One scatter counts both: passes in the low half of the word, hits in the high half.
        count = (
            jnp.zeros(height * width, jnp.int32)
            .at[index.reshape(-1)]
            .add(jnp.where(is_hit, 1 << 16, 1).reshape(-1), mode="drop")
            .reshape(height, width)
        )
        return Sighting(hits=count >> 16, passes=count & 0xFFFF)

    def update(
        self,
        belief: OccupancyGrid,
        scan: Scan,
        pose: Pose,
        model: InverseSensorModel,
        ground: Ground | None = None,
    ) -> OccupancyGrid:
        """Return the belief after a scan from a pose: `updated` with what `sight` says.

        Raises:
            ValueError: a ground of another shape or resolution than the belief.
        """
        return updated(belief, self.sight(belief, scan, pose, ground), model)

    def sees(
        self,
        world: OccupancyGrid,
        pose: Pose,
        points: Float[Array, "P 2"],
        ground: Ground | None = None,
    ) -> Bool[Array, " P"]:
        """Say whether the cell of each point (x, y) [m] can be seen from a pose in a world.

        Exact: along the ray to the point itself, not through the fan of beams. The point must lie
        in the field of view, within the range and on the map, and nothing nearer on that ray may
        hide its cell. A solid cell that stops the ray is seen. No noise, and nothing that moves.

        Raises:
            ValueError: a ground of another shape or resolution than the world.
        """
        offset = points - pose[:2]
        distance = jnp.sqrt((offset**2).sum(axis=-1))
        is_here = distance < ROUNDING
        # atan2 has no value where the sensor stands, nor has the bearing.
        x = jnp.where(is_here, 1.0, offset[:, 0])
        angle = jnp.arctan2(offset[:, 1], x)
        turn = angle - pose[2]
        bearing = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
        in_view = is_here | (jnp.abs(bearing) <= 0.5 * self.field_of_view + ROUNDING)
        cells = fan(world, pose[:2], angle - world.frame.origin[2], self.max_range)
        target = world.frame.to_cell(points)
        depth = (distance / world.resolution)[:, None]
        # A point on a line between two cells may round into the one that its ray does not enter.
        is_target = (cells.cell == target[:, None]).all(axis=-1)
        holds = (cells.entry <= depth) & (depth < cells.exit)
        is_target = jnp.where(is_target.any(axis=-1, keepdims=True), is_target, holds)
        solid = cells.is_crossed & (world.at_cell(cells.cell) >= FREE_THRESHOLD)
        rise = self._rise(cells, pose, world, ground)
        shown = self._shown(cells, solid, rise, world.resolution)
        is_shown = (is_target & shown).any(axis=-1)
        return is_shown & in_view & (distance <= self.max_range) & world.contains(target)

    def _cells(self, grid: OccupancyGrid, pose: Pose) -> RayCells:
        turn = pose[2] - grid.frame.origin[2]
        return fan(grid, pose[:2], turn + jnp.asarray(self.beam_angles), self.max_range)

    def _rise(
        self, cells: RayCells, pose: Pose, grid: OccupancyGrid, ground: Ground | None
    ) -> Float[Array, "B N"] | None:
        """Height of each cell's ground above the sensor [m]."""
        if ground is None:
            return None
        if ground.shape != grid.shape or ground.frame.resolution != grid.resolution:
            raise ValueError(
                f"ground has {ground.shape} cells of {ground.frame.resolution:g} m; accepted: "
                f"those of the map, {grid.shape} of {grid.resolution:g} m"
            )
        own = ground.elevation_at_cell(grid.frame.to_cell(pose[:2]))
        return ground.elevation_at_cell(cells.cell) - (own + self.height)


def updated(belief: OccupancyGrid, sighting: Sighting, model: InverseSensorModel) -> OccupancyGrid:
    """Return the belief after a sighting: the inverse sensor model, cell by cell.

    Each cell is updated once per scan however many beams cross it: as occupied if at least a third
    of those that hit or passed it hit it. A wall keeps its cells though some beams graze them, and
    one reading in fifty that noise cuts short does not close a passage beside it.
    """
    hits, passes = sighting
    is_occupied = (hits > 0) & (ONE_HIT_IN * hits >= hits + passes)
    change = jnp.where(is_occupied, model.occupied, jnp.where(passes > 0, model.free, 0.0))
    probability = model.update(belief.probability, change)
    return OccupancyGrid(probability, belief.resolution, belief.frame.origin)
