"""Sensors of a volume: depth cameras and lidars of several rings, which tilt with the body."""

import abc
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._describe import describe_fields
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.geometry.rays import VoxelStep, walk
from jaxplore.maps.voxel_grid import OCCUPIED_ABOVE, VoxelGrid, contains, flat_index
from jaxplore.maps.window import Window
from jaxplore.sensing.beams import fan_angles
from jaxplore.sensing.fan import check_range, check_view
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

Rotation = Float[Array, "3 3"]
"""Rotation from the body, x ahead, y to the left, z up, to the world."""
HIT, PASSED = 2, 1
AT_SENSOR = 1e-6
"""Distance below which a point is where the sensor is [m]."""


class VolumeScan(NamedTuple):
    """One scan of R rays.

    Args:
        ranges: (R,) [m]; the greatest range where nothing was met.
        is_return: (R,) whether the ray met something.
    """

    ranges: Float[Array, " R"]
    is_return: Bool[Array, " R"]


class VolumeSensor(eqx.Module):
    """Rays from one point that measure ranges; abstract.

    Args:
        max_range: greatest range [m]; static.
        field_of_view: angle of the view around the vertical axis, centred on the heading [rad];
            static.
        range_noise: standard deviation of a range r is `range_noise + quadratic_noise r^2` [m].
        quadratic_noise: see `range_noise` [1/m].
    """

    max_range: eqx.AbstractVar[float]
    field_of_view: eqx.AbstractVar[float]
    range_noise: eqx.AbstractVar[Scalar]
    quadratic_noise: eqx.AbstractVar[Scalar]

    def __repr__(self) -> str:
        return describe_fields(self)

    @property
    @abc.abstractmethod
    def directions(self) -> np.ndarray:
        """Unit vectors (3, R) of the rays in the frame of the body."""

    @property
    @abc.abstractmethod
    def elevations(self) -> tuple[float, float]:
        """Elevations of the lower and the upper edge of the view of a level body [rad]."""

    @property
    @abc.abstractmethod
    def lattice(self) -> tuple[int, int]:
        """Number of rows and columns of the rays, which are in order, row by row."""

    @property
    @abc.abstractmethod
    def spacing(self) -> tuple[float, float]:
        """Greatest angle between rays of neighbouring rows, and of neighbouring columns [rad]."""

    @property
    def is_full_circle(self) -> bool:
        """Whether the first column and the last one are neighbours."""
        return self.field_of_view > 2.0 * math.pi - 1e-6

    @abc.abstractmethod
    def is_in_view(self, points: Float[Array, "3 M"]) -> Bool[Array, " M"]:
        """Return whether points in the frame of the body [m] are within the angles of the view.

        Args:
            points: (3, M) points (x ahead, y to the left, z up) [m].
        """

    def sees(
        self,
        world: VoxelGrid,
        position: Float[Array, "3"],
        rotation: Rotation,
        points: Float[Array, "M 3"],
    ) -> Bool[Array, " M"]:
        """Return which points are in sight: in view, in range, and with no occupied voxel before.

        Args:
            world: the true world.
            position: position (x, y, z) of the sensor [m].
            rotation: rotation from the body to the world.
            points: (M, 3) points (x, y, z) [m].
        """
        away = points - position
        distance = jnp.linalg.norm(away, axis=-1)
        is_near = distance <= self.max_range
        # A point at the sensor itself is seen, whatever its direction.
        ways = away / jnp.maximum(distance, AT_SENSOR)[:, None]
        is_shown = self.is_in_view(rotation.T @ away.T) | (distance < AT_SENSOR)
        start = jnp.broadcast_to(world.to_grid(position)[:, None], (3, points.shape[0]))
        length = jnp.where(is_near, distance, 0.0) / world.resolution
        log_odds = world.log_odds.reshape(-1)

        def visit(
            is_clear: Bool[Array, " M"], step: VoxelStep
        ) -> tuple[Bool[Array, " M"], Bool[Array, " M"]]:
            is_here = world.contains(step.voxel) & step.is_crossed & (step.entry < length)
            index = flat_index(step.voxel, world.shape)
            found = log_odds.at[index].get(mode="fill", fill_value=0.0)
            is_clear = is_clear & ~(is_here & (found > OCCUPIED_ABOVE))
            return is_clear, is_clear

        is_clear = walk(start, jnp.flip(ways.T, axis=0), length, visit, is_near)
        seen: Bool[Array, " M"] = is_near & is_shown & is_clear
        return seen

    def noise_std(self, ranges: Float[Array, " R"]) -> Float[Array, " R"]:
        """Return the standard deviation of ranges [m]."""
        return self.range_noise + self.quadratic_noise * ranges * ranges

    def scan(
        self, world: VoxelGrid, position: Float[Array, "3"], rotation: Rotation, *, key: Key
    ) -> VolumeScan:
        """Simulate a scan.

        A ray returns from where it enters the first occupied voxel. What is unknown to the true
        world, and all beyond its box, lets rays through.

        Args:
            world: the true world.
            position: position (x, y, z) of the sensor [m].
            rotation: rotation from the body to the world.
            key: random key of the noise.
        """
        start, direction = _rays(world, position, rotation, self.directions)
        limit = self.max_range / world.resolution
        length = jnp.full(direction.shape[1], limit, jnp.float32)
        log_odds = world.log_odds.reshape(-1)

        def visit(
            met: Float[Array, " R"], step: VoxelStep
        ) -> tuple[Float[Array, " R"], Bool[Array, " R"]]:
            is_here = world.contains(step.voxel) & step.is_crossed
            index = flat_index(step.voxel, world.shape)
            found = log_odds.at[index].get(mode="fill", fill_value=0.0)
            is_hit = is_here & (found > OCCUPIED_ABOVE)
            met = jnp.where(is_hit & jnp.isinf(met), step.entry, met)
            return met, jnp.isinf(met)

        met = walk(start, direction, length, visit, jnp.full_like(length, jnp.inf))
        exact = jnp.minimum(met, limit) * world.resolution
        is_return = met <= limit
        noisy = exact + self.noise_std(exact) * jax.random.normal(key, exact.shape, exact.dtype)
        ranges = jnp.where(is_return, jnp.clip(noisy, 0.0, self.max_range), self.max_range)
        return VolumeScan(ranges, is_return)

    def update(
        self,
        grid: VoxelGrid,
        position: Float[Array, "3"],
        rotation: Rotation,
        scan: VolumeScan,
        model: InverseSensorModel,
        window: Window | None = None,
    ) -> VoxelGrid:
        """Return the grid after a scan.

        A voxel that a return lies in was measured occupied, and another one whose middle, along the
        ray, lies farther before the return than twice its standard deviation was measured free:
        each voxel once per scan, as in OctoMap. A ray without a return
        passes through all voxels within the greatest range. Ranges that are not finite, or not
        positive, are no measurements.

        Source: Hornung et al., "OctoMap", Autonomous Robots 2013, section 5.1.

        Args:
            grid: log-odds of the voxels.
            position: position (x, y, z) of the sensor [m].
            rotation: rotation from the body to the world.
            scan: the scan.
            model: inverse sensor model.
            window: box of voxels in which the rays end, beyond which nothing is updated; all
                voxels when absent.
        """
        if window is None:
            window = Window.at(jnp.zeros(3, jnp.int32), grid.shape, grid.shape)
        start, direction = _rays(grid, position, rotation, self.directions)
        is_measured = jnp.isfinite(scan.ranges) & (scan.ranges > 0.0)
        reading = jnp.where(is_measured, scan.ranges, -1.0) / grid.resolution
        # Half of the noisy readings of a face end before it. So what was met is taken to lie two
        # standard deviations behind its reading, though at most half a voxel, and what was passed
        # to end two before it: scans neither put a layer before a wall nor carve into it.
        measured = jnp.where(is_measured, scan.ranges, 0.0)
        doubtful = 2.0 * self.noise_std(measured) / grid.resolution
        behind = jnp.clip(doubtful, INSIDE, 0.5)
        met = reading + jnp.where(scan.is_return & is_measured, behind, 0.0)
        passed = reading + jnp.where(scan.is_return, INSIDE - doubtful, 1.0)
        before = window.read(grid.log_odds)
        corner = window.corner[:, None]

        def visit(seen: Array, step: VoxelStep) -> tuple[Array, Bool[Array, " R"]]:
            voxel = step.voxel - corner
            is_in = step.is_crossed & contains(voxel, window.shape)
            is_end = scan.is_return & (step.entry <= met) & (met < step.exit)
            is_passed = 0.5 * (step.entry + step.exit) <= passed
            what = jnp.where(is_end, HIT, jnp.where(is_passed, PASSED, 0)).astype(jnp.int8)
            index = jnp.where(is_in, flat_index(voxel, window.shape), before.size)
            return seen.at[index].max(what, mode="drop"), ~is_end

        seen = walk(start, direction, met, visit, jnp.zeros(before.size, jnp.int8))
        seen = seen.reshape(window.shape)
        change = jnp.where(seen == HIT, model.occupied, jnp.where(seen == PASSED, model.free, 0.0))
        bounded = jnp.clip(before + change, model.minimum, model.maximum)
        values = window.write(grid.log_odds, jnp.where(seen > 0, bounded, before))
        known: VoxelGrid = eqx.tree_at(lambda each: each.log_odds, grid, values)
        return known


def ray_ends(sensors: Sequence[VolumeSensor]) -> np.ndarray:
    """Return the farthest ends (3, R) of the rays of sensors on one body, in its frame [m]."""
    return np.concatenate([each.max_range * each.directions for each in sensors], axis=1)


def greatest_extent(sensors: Sequence[VolumeSensor]) -> float:
    """Return a bound of the extent along any axis of what sensors on one body see [m].

    It holds whichever way the body is turned. All rays lie in a cone around their mean. With the
    length L and the half-angle a < 90 degrees, its extent along an axis at the angle b from its own
    is at most

        L max(1, cos(b - a) - cos(b + a)) = L max(1, 2 sin a sin b)

    and 2 L for wider ones.
    """
    ways = np.concatenate([each.directions for each in sensors], axis=1).astype(np.float64)
    length = max(each.max_range for each in sensors)
    mean = ways.mean(axis=1)
    cosine = (mean @ ways / max(np.linalg.norm(mean), 1e-9)).min()
    if cosine <= 0.0:
        return 2.0 * length
    return float(length * max(1.0, 2.0 * math.sqrt(max(0.0, 1.0 - cosine**2))))


INSIDE = 0.01
"""Share of a voxel by which a return without noise lies behind the face that it came from."""


def _rays(
    grid: VoxelGrid, position: Float[Array, "3"], rotation: Rotation, directions: np.ndarray
) -> tuple[Float[Array, "3 R"], Float[Array, "3 R"]]:
    """Return starts and directions of rays along the axes (z, y, x) of a grid [voxels]."""
    ways = jnp.flip(rotation @ jnp.asarray(directions), axis=0)
    return jnp.broadcast_to(grid.to_grid(position)[:, None], ways.shape), ways


class DepthCamera(VolumeSensor):
    """Depth camera: a pinhole whose pixels are evenly spaced in the image.

    Ranges are along the rays. The noise of a stereo camera grows with the square of the depth.

    Args:
        columns: number of pixels across; static.
        rows: number of pixels from top to bottom; static.
        max_range: greatest range [m]; static.
        field_of_view: angle between the left and the right edge of the image [rad]; static.
        vertical_view: angle between its upper and its lower edge [rad]; static.
        tilt: pitch of the middle of the view, negative downwards [rad]; static.
        range_noise: standard deviation at range 0 [m].
        quadratic_noise: its growth with the square of the range [1/m].

    Raises:
        ValueError: no pixels, a range that is not positive, a view outside (0, pi), a negative
            noise.
    """

    columns: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    vertical_view: float = eqx.field(static=True)
    tilt: float = eqx.field(static=True)
    range_noise: Scalar
    quadratic_noise: Scalar

    def __init__(
        self,
        columns: int = 64,
        rows: int = 48,
        max_range: float = 5.0,
        field_of_view: float = math.radians(80.0),
        vertical_view: float = math.radians(60.0),
        tilt: float = 0.0,
        range_noise: ArrayLike = 0.0,
        quadratic_noise: ArrayLike = 0.002,
    ) -> None:
        self.columns = _checks.positive_int("columns", columns, at_most=MOST_PIXELS)
        self.rows = _checks.positive_int("rows", rows, at_most=MOST_PIXELS)
        self.max_range = check_range("max_range", max_range)
        self.field_of_view = _checks.number("field_of_view", field_of_view, above=0.0, below=WIDE)
        self.vertical_view = _checks.number("vertical_view", vertical_view, above=0.0, below=WIDE)
        self.tilt = _checks.number("tilt", tilt, at_least=-0.5 * math.pi, at_most=0.5 * math.pi)
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)
        self.quadratic_noise = _checks.scalar("quadratic_noise", quadratic_noise, at_least=0.0)

    @property
    def elevations(self) -> tuple[float, float]:
        """Elevations of the lower and the upper edge in the middle of the image [rad]."""
        half, quarter = 0.5 * self.vertical_view, 0.5 * math.pi
        return max(self.tilt - half, -quarter + 1e-3), min(self.tilt + half, quarter)

    @property
    def lattice(self) -> tuple[int, int]:
        """Number of rows and columns of the rays."""
        return self.rows, self.columns

    @property
    def spacing(self) -> tuple[float, float]:
        """Angles between neighbouring pixels in the middle of the image [rad]."""
        across, along = math.tan(0.5 * self.vertical_view), math.tan(0.5 * self.field_of_view)
        return 2.0 * across / self.rows, 2.0 * along / self.columns

    def is_in_view(self, points: Float[Array, "3 M"]) -> Bool[Array, " M"]:
        """Return whether points in the frame of the body [m] are in the image."""
        x, left, z = points
        cos, sin = math.cos(self.tilt), math.sin(self.tilt)
        ahead, up = cos * x + sin * z, cos * z - sin * x
        across = jnp.abs(left) <= ahead * math.tan(0.5 * self.field_of_view)
        return across & (jnp.abs(up) <= ahead * math.tan(0.5 * self.vertical_view))

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors (3, R) of the pixels, row by row from the top, each from left to right."""
        left = _centres(self.columns) * math.tan(0.5 * self.field_of_view)
        up = _centres(self.rows) * math.tan(0.5 * self.vertical_view)
        up, left = np.meshgrid(up, left, indexing="ij")
        ahead = np.ones_like(left)
        cos, sin = math.cos(self.tilt), math.sin(self.tilt)
        ways = np.stack([cos * ahead - sin * up, left, sin * ahead + cos * up]).reshape(3, -1)
        return (ways / np.linalg.norm(ways, axis=0)).astype(np.float32)


class RingLidar(VolumeSensor):
    """Lidar of several rings, which turns around its vertical axis.

    Args:
        rings: number of rings; static.
        columns: number of rays of each ring; static.
        max_range: greatest range [m]; static.
        field_of_view: angle around the vertical axis, in (0, 2 pi], centred on the heading [rad];
            static.
        lowest: elevation of the lowest ring [rad]; static.
        highest: elevation of the highest ring [rad]; static.
        range_noise: standard deviation at range 0 [m].
        quadratic_noise: its growth with the square of the range [1/m].

    Raises:
        ValueError: no rays, a range that is not positive, a view outside (0, 2 pi], elevations that
            are not in order within a right angle, a negative noise.
    """

    rings: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    field_of_view: float = eqx.field(static=True)
    lowest: float = eqx.field(static=True)
    highest: float = eqx.field(static=True)
    range_noise: Scalar
    quadratic_noise: Scalar

    def __init__(
        self,
        rings: int = 16,
        columns: int = 360,
        max_range: float = 10.0,
        field_of_view: float = 2.0 * math.pi,
        lowest: float = math.radians(-15.0),
        highest: float = math.radians(15.0),
        range_noise: ArrayLike = 0.02,
        quadratic_noise: ArrayLike = 0.0,
    ) -> None:
        self.rings = _checks.positive_int("rings", rings, at_most=MOST_PIXELS)
        self.columns = _checks.positive_int("columns", columns, at_most=MOST_PIXELS)
        self.max_range = check_range("max_range", max_range)
        self.field_of_view = check_view("field_of_view", field_of_view)
        quarter = 0.5 * math.pi
        self.lowest = _checks.number("lowest", lowest, at_least=-quarter, at_most=quarter)
        self.highest = _checks.number("highest", highest, at_least=self.lowest, at_most=quarter)
        self.range_noise = _checks.scalar("range_noise", range_noise, at_least=0.0)
        self.quadratic_noise = _checks.scalar("quadratic_noise", quadratic_noise, at_least=0.0)

    @property
    def elevations(self) -> tuple[float, float]:
        """Elevations of the lowest and the highest ring, half a ring beyond them [rad]."""
        half = 0.5 * (self.highest - self.lowest) / max(1, self.rings - 1)
        quarter = 0.5 * math.pi
        half = max(half, 0.01)
        return max(self.lowest - half, -quarter + 1e-3), min(self.highest + half, quarter)

    @property
    def lattice(self) -> tuple[int, int]:
        """Number of rings and of rays of each."""
        return self.rings, self.columns

    @property
    def spacing(self) -> tuple[float, float]:
        """Angles between neighbouring rings, and between rays of one ring [rad]."""
        across = (self.highest - self.lowest) / max(1, self.rings - 1)
        return max(across, 1e-3), self.field_of_view / self.columns

    def is_in_view(self, points: Float[Array, "3 M"]) -> Bool[Array, " M"]:
        """Return whether points in the frame of the body [m] are between the outermost rays."""
        x, y, z = points
        elevation = jnp.arctan2(z, jnp.hypot(x, y))
        low, high = self.elevations
        is_level = (elevation >= low) & (elevation <= high)
        return is_level & (jnp.abs(jnp.arctan2(y, x)) <= 0.5 * self.field_of_view + 1e-6)

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors (3, R) of the rays, ring by ring from the lowest."""
        elevation = np.linspace(self.lowest, self.highest, self.rings)
        around = fan_angles(self.columns, self.field_of_view)
        elevation, around = np.meshgrid(elevation, around, indexing="ij")
        level = np.cos(elevation)
        ways = np.stack([level * np.cos(around), level * np.sin(around), np.sin(elevation)])
        return ways.reshape(3, -1).astype(np.float32)


MOST_PIXELS = 4096
"""Greatest number of rows or columns of rays."""
WIDE = math.pi - 0.01
"""Greatest view of a pinhole [rad]: the tangent of its half is finite."""


def _centres(number: int) -> np.ndarray:
    """Return the centres of pixels from 1 to -1."""
    return 1.0 - (2.0 * np.arange(number) + 1.0) / number
