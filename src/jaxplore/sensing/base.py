"""Define range sensors: simulated scans, and the update of an occupancy grid by a scan."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._types import GridMask, Key, Pose, Scalar
from jaxplore.geometry.rays import RayCells
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.maps.window import Window
from jaxplore.sensing.beams import ROUNDING, Beams, Scan
from jaxplore.sensing.fan import disc_distance, fan, first_entry
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

ONE_HIT_IN = 3
"""A cell is measured occupied if at least one of this many beams that hit or pass it hits it."""


class Sighting(NamedTuple):
    """Number of beams of a scan that hit and that passed each cell of a window, (h, w) each.

    The window holds all cells of the map that are within the range of the sensor.
    """

    hits: Int[Array, "h w"]
    passes: Int[Array, "h w"]
    window: Window

    @property
    def is_seen(self) -> GridMask:
        """Mask (H, W) of the cells of the map that some beam hit or passed."""
        return self.on_map((self.hits + self.passes) > 0)

    def on_map(self, cells: Array) -> Array:
        """Return an array (h, w) of the window as one of the map (H, W), 0 around the window."""
        return self.window.write(jnp.zeros(self.window.map_shape, cells.dtype), cells)


class Sensor(Beams):
    """Fan of beams from the robot's centre that measure ranges; abstract.

    A beam is a vertical slice of the view: a line for a lidar, a column of pixels for a camera. A
    subclass defines what stops its beams, which cells are visible, and which measurements are
    consistent with the known ground.

    A `Ground` must have the shape, resolution and origin of the map. The sensor is `height` above
    the ground of the robot's cell, and does not tilt with the ground.
    """

    range_noise: eqx.AbstractVar[Scalar]
    height: eqx.AbstractVar[Scalar]

    def __repr__(self) -> str:
        return describe_fields(self)

    @property
    def clear_range(self) -> float | Scalar:
        """Range from which on a beam without a return met nothing [m]. A shorter one ended at a
        moving obstacle."""
        return self.max_range - 1e-3

    @abc.abstractmethod
    def stops(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the masks of the cells that return a beam and of those that end it.

        A cell can end a beam without a return.

        Args:
            cells: cells of each beam.
            solid: mask of the solid cells.
            rise: height of each cell's ground above the sensor [m]; None without a ground.
            resolution: side of a cell [m].
        """

    @abc.abstractmethod
    def visible(
        self,
        cells: RayCells,
        solid: Bool[Array, "B N"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> Bool[Array, "B N"]:
        """Return the mask of the cells that are visible to each beam; arguments as in `stops`."""

    @abc.abstractmethod
    def consistent(
        self,
        cells: RayCells,
        is_hit: Bool[Array, "B N"],
        is_passed: Bool[Array, "B N"],
        reading: Float[Array, "B 1"],
        rise: Float[Array, "B N"] | None,
        resolution: float,
    ) -> tuple[Bool[Array, "B N"], Bool[Array, "B N"]]:
        """Return the hits and passes that are consistent with the known ground.

        Args:
            cells: cells of each beam.
            is_hit: mask of the cells in which a reading lies.
            is_passed: mask of the cells before a reading.
            reading: range of each beam [cells].
            rise: height of each cell's ground above the sensor [m]; None without a ground.
            resolution: side of a cell [m].
        """

    @_kinds.check_arguments
    def scan(
        self,
        world: OccupancyGrid,
        pose: Pose,
        *,
        key: Key,
        ground: Ground | None = None,
        movers: Float[Array, "M *D 3"] | None = None,
        is_told: bool = True,
        starts: Float[Array, "B 3"] | None = None,
    ) -> Scan:
        """Simulate a scan of a world.

        A beam ends where it enters the first cell that is not free, or leaves the map. Unknown
        cells of a world are solid, because nothing tells what is behind them. Cells are traversed
        exactly, and returned ranges have Gaussian noise.

        Args:
            world: true map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            key: random key of the noise.
            ground: ground of the world. By default it is level: at elevation 0 for a camera, and
                far below for a lidar.
            movers: moving obstacles, discs (M, 3) as (x, y, radius) [m], taller than the view. A
                beam that meets one before anything else ends there, at range 0 inside it. A disc of
                radius 0 is ignored. (M, B, 3) for discs that are elsewhere for each beam.
            is_told: whether such a beam has no return, which tells that it ended at a moving
                obstacle. No lidar tells; it is for truth that is handed to the robot.
            starts: (B, 3) pose of the sensor for each beam, where it is not that of the robot.

        Raises:
            ValueError: a ground of another shape or resolution than the world, an argument of
                another kind or shape.
        """
        _kinds.key("key", key)
        pose = _checks.pose("pose", pose)
        if movers is not None:
            movers = _checks.of_shape("movers", movers, ("M", 3), ("M", self.num_beams, 3))
        place, turn = pose[:2], pose[2]
        if starts is not None:
            starts = _checks.of_shape("starts", starts, (self.num_beams, 3))
            place, turn = starts[:, :2], starts[:, 2]
        cells = self._cells(world, place, turn)
        solid = cells.is_crossed & (world.at_cell(cells.cell) >= FREE_THRESHOLD)
        rise = self._rise(cells, pose, world, ground)
        stops, ends = self.stops(cells, solid, rise, world.resolution)
        first = first_entry(cells, stops, world.resolution)
        # Moving obstacles hide what is behind them, but are themselves hidden by whatever ends a
        # beam before, which for a camera includes ground that gives no return.
        is_mover = None
        if movers is not None:
            angles = turn + jnp.asarray(self.beam_angles)
            disc = disc_distance(place, angles, movers)
            is_mover = disc < first_entry(cells, ends, world.resolution)
            first = jnp.where(is_mover, disc, first)
        is_met = first < self.max_range
        noise = self.range_noise * jax.random.normal(key, first.shape)
        ranges = jnp.clip(first + noise, 0.0, self.max_range)
        is_return = is_met & ~is_mover if is_told and is_mover is not None else is_met
        return self.degrade(Scan(jnp.where(is_met, ranges, self.max_range), is_return), key)

    def degrade(self, scan: Scan, key: Key) -> Scan:
        """Return a simulated scan with the errors of the sensor, beside noise; by default none.

        Args:
            scan: the scan with noise.
            key: random key of the scan.
        """
        return scan

    @_kinds.check_arguments
    def sight(
        self, grid: OccupancyGrid, scan: Scan, pose: Pose, ground: Ground | None = None
    ) -> Sighting:
        """Count the beams of a scan that hit and that passed each cell within the range.

        A visible cell that the beam leaves before its reading was passed; without a return, the
        reading is the maximum range. The cell that contains the reading was hit. A reading lies on
        the face of an obstacle, so noise would put half of the readings into the cell in front.
        Therefore the hit cell is taken `min(2 sigma, resolution / 2)` behind the reading.

        A cell in which the beam is for less than `min(sigma, resolution / 2)` is ignored, because
        noise decides whether the beam ended there or behind. Otherwise beams that graze the corners
        of obstacles erode them: with noise of half a cell, 3 % of the cells of walls became free;
        with this rule it is one in 5000.

        Args:
            grid: grid whose frame and shape are used; its probabilities are not read.
            scan: measured scan.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            ground: ground that the robot knows, or None.

        Raises:
            ValueError: a ground of another shape or resolution than the grid, an argument of
                another kind or shape.
        """
        pose = _checks.pose("pose", pose)
        resolution = grid.resolution
        cells = self._cells(grid, pose[:2], pose[2])
        rise = self._rise(cells, pose, grid, ground)
        # The small constant keeps a noise-free reading from rounding into the cell in front.
        margin = jnp.minimum(2.0 * self.range_noise, 0.5 * resolution) / resolution + 1e-3
        reading = (scan.ranges / resolution)[:, None]
        is_return = scan.is_return[:, None]
        depth = reading + margin
        least = jnp.minimum(self.range_noise, 0.5 * resolution) / resolution
        is_long = cells.exit - cells.entry >= least
        is_hit = is_return & is_long & (cells.entry <= depth) & (depth < cells.exit)
        is_passed = is_long & (cells.exit <= reading + 1e-3)
        is_hit, is_passed = self.consistent(cells, is_hit, is_passed, reading, rise, resolution)
        window = Window.around(pose[:2], self.max_range, grid.frame, grid.shape)
        height, width = window.shape
        row, column = jnp.unstack(cells.cell - window.corner, axis=-1)
        is_in = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        seen = cells.is_crossed & (is_hit | is_passed) & is_in & grid.contains(cells.cell)
        index = jnp.where(seen, row * width + column, height * width)
        # One scatter counts both: passes in the low half of the word, hits in the high half. Cells
        # that do not count are scattered to an index out of bounds, which is dropped.
        count = (
            jnp.zeros(height * width, jnp.int32)
            .at[index.reshape(-1)]
            .add(jnp.where(is_hit, 1 << 16, 1).reshape(-1), mode="drop")
            .reshape(height, width)
        )
        return Sighting(count >> 16, count & 0xFFFF, window)

    @_kinds.check_arguments
    def update(
        self,
        belief: OccupancyGrid,
        scan: Scan,
        pose: Pose,
        model: InverseSensorModel,
        ground: Ground | None = None,
    ) -> OccupancyGrid:
        """Return the occupancy grid after a scan: `sight`, then `update_grid`.

        Args:
            belief: occupancy grid before the scan.
            scan: measured scan.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            model: inverse sensor model.
            ground: ground that the robot knows, or None.

        Raises:
            ValueError: a ground of another shape or resolution than the belief.
        """
        return update_grid(belief, self.sight(belief, scan, pose, ground), model)

    @_kinds.check_arguments
    def sees(
        self,
        world: OccupancyGrid,
        pose: Pose,
        points: Float[Array, "P 2"],
        ground: Ground | None = None,
    ) -> Bool[Array, " P"]:
        """Return whether the cell of each point is visible from a pose.

        The test casts one exact ray to each point instead of using the fan of beams. The point must
        be in the field of view, within the range and on the map, and no nearer cell on the ray may
        occlude its cell. The solid cell that stops the ray is visible. Noise and moving obstacles
        are ignored.

        Args:
            world: true map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            points: points (P, 2) as (x, y) [m].
            ground: ground of the world, as in `scan`.

        Raises:
            ValueError: a ground of another shape or resolution than the world, an argument of
                another kind or shape.
        """
        pose = _checks.pose("pose", pose)
        points = _checks.of_shape("points", points, ("P", 2))
        offset = points - pose[:2]
        distance = jnp.sqrt((offset**2).sum(axis=-1))
        is_here = distance < ROUNDING
        # At the sensor's own position neither atan2 nor the bearing is defined.
        x = jnp.where(is_here, 1.0, offset[:, 0])
        angle = jnp.arctan2(offset[:, 1], x)
        # Wrap the bearing to (-pi, pi].
        turn = angle - pose[2]
        bearing = jnp.arctan2(jnp.sin(turn), jnp.cos(turn))
        in_view = is_here | (jnp.abs(bearing) <= 0.5 * self.field_of_view + ROUNDING)
        cells = fan(world, pose[:2], angle - world.frame.origin[2], self.max_range)
        target = world.frame.to_cell(points)
        depth = (distance / world.resolution)[:, None]
        # A point on the line between two cells may be rounded into the one that its ray does not
        # enter. Then take the cell that the ray is in at the point's distance.
        is_target = (cells.cell == target[:, None]).all(axis=-1)
        holds = (cells.entry <= depth) & (depth < cells.exit)
        is_target = jnp.where(is_target.any(axis=-1, keepdims=True), is_target, holds)
        solid = cells.is_crossed & (world.at_cell(cells.cell) >= FREE_THRESHOLD)
        rise = self._rise(cells, pose, world, ground)
        shown = self.visible(cells, solid, rise, world.resolution)
        is_shown = (is_target & shown).any(axis=-1)
        return is_shown & in_view & (distance <= self.max_range) & world.contains(target)

    def _cells(
        self, grid: OccupancyGrid, place: Float[Array, "*S 2"], turn: Float[Array, "*S"]
    ) -> RayCells:
        angles = turn - grid.frame.origin[2] + jnp.asarray(self.beam_angles)
        return fan(grid, place, angles, self.max_range)

    def _rise(
        self, cells: RayCells, pose: Pose, grid: OccupancyGrid, ground: Ground | None
    ) -> Float[Array, "B N"] | None:
        """Return the height of each cell's ground above the sensor [m], or None without ground."""
        if ground is None:
            return None
        if ground.shape != grid.shape or ground.frame.resolution != grid.resolution:
            raise ValueError(
                f"ground has {ground.shape} cells of {ground.frame.resolution:g} m; accepted: "
                f"those of the map, {grid.shape} of {grid.resolution:g} m"
            )
        # The sensor moves with the ground under the robot, so heights are relative to its cell.
        own = ground.elevation_at_cell(grid.frame.to_cell(pose[:2]))
        return ground.elevation_at_cell(cells.cell) - (own + self.height)


def update_grid(
    belief: OccupancyGrid, sighting: Sighting, model: InverseSensorModel
) -> OccupancyGrid:
    """Apply the inverse sensor model to each cell that a scan hit or passed.

    Each cell is updated once per scan, however many beams cross it. It is updated as occupied if at
    least a third of these beams hit it, else as free. So a wall survives beams that graze it, and
    the one reading in fifty that noise cuts short does not close a passage beside the beam.
    """
    hits, passes, window = sighting
    is_occupied = (hits > 0) & (ONE_HIT_IN * hits >= hits + passes)
    change = jnp.where(is_occupied, model.occupied, jnp.where(passes > 0, model.free, 0.0))
    updated = model.update(window.read(belief.probability), change)
    return belief.with_probability(window.write(belief.probability, updated))
