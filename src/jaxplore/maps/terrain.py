"""The terrain map: what is in the way and what the ground is like, on one grid."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from jaxplore import _checks
from jaxplore._types import GridMask, GridValues, Vector
from jaxplore.maps.files import _terrain_file
from jaxplore.maps.files._files import name_of, replace_files
from jaxplore.maps.files.images import read_greys
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import HIGHEST, Ground
from jaxplore.maps.occupancy_grid import OUTSIDE, OccupancyGrid

UNKNOWN = 0.5
"""Probability of a cell of which nothing is known; a robot drives only below it."""

# Overlaps below this, in old cells, come from rounding: 0.15 m is not 3 x 0.05 m in binary.
_SLIVER = 1e-6


class TerrainSample(NamedTuple):
    """What a terrain map holds at points, (*N) each: `occupancy` in [0, 1], its `entropy` [nat],
    `elevation` [m], `slope` [m/m], `roughness` [m], `traversability` in [0, 1], `is_drivable`."""

    occupancy: Float[Array, "*N"]
    entropy: Float[Array, "*N"]
    elevation: Float[Array, "*N"]
    slope: Float[Array, "*N"]
    roughness: Float[Array, "*N"]
    traversability: Float[Array, "*N"]
    is_drivable: Bool[Array, "*N"]


class TerrainMap(eqx.Module):
    """Occupancy, entropy, elevation, traversability and roughness on one grid.

    Scans change what is known of obstacles, and `with_grid` takes that in; the ground is known and
    stays. A cell is drivable if it is likelier free than occupied and the ground lets a vehicle in:
    `p < 0.5` and `traversability >= threshold`.

    Args:
        grid: probability of being occupied.
        ground: what there is to drive on.

    Raises:
        ValueError: grids that differ in shape, resolution or origin.
    """

    grid: OccupancyGrid
    ground: Ground

    def __init__(self, grid: OccupancyGrid, ground: Ground) -> None:
        _check_same("shape", ground.shape, grid.shape)
        _check_same("resolution", ground.resolution, grid.resolution)
        origins = (ground.frame.origin, grid.frame.origin)
        if not _checks.is_traced(*origins):
            _check_same("origin", *(tuple(np.asarray(origin).tolist()) for origin in origins))
        self.grid = grid
        self.ground = ground

    @classmethod
    def from_arrays(
        cls,
        occupancy: ArrayLike,
        elevation: ArrayLike,
        resolution: float,
        origin: Vector = (0.0, 0.0, 0.0),
        **ground_options: Any,
    ) -> "TerrainMap":
        """Make a map of arrays.

        Args:
            occupancy: (H, W) probability in [0, 1]; 0.5 is unknown.
            elevation: (H, W) [m].
            resolution: side of a cell [m].
            origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].
            ground_options: of `Ground`, by keyword.

        Raises:
            ValueError: what `OccupancyGrid` or `Ground` refuses, shapes that differ.
        """
        grid = OccupancyGrid(occupancy, resolution, origin)
        return cls(grid, Ground(elevation, resolution, origin, **ground_options))

    @classmethod
    def from_images(
        cls,
        occupancy_image: str | os.PathLike[str],
        height_image: str | os.PathLike[str],
        resolution: float = 0.1,
        origin: Vector = (0.0, 0.0, 0.0),
        *,
        elevation_scale: float = 5.0,
        **ground_options: Any,
    ) -> "TerrainMap":
        """Make a map of two grey images of one size: PGM, PNG or BMP, of 8 or 16 bits.

        Black is free and white is occupied, and in between the probability is linear; a
        transparent pixel is unknown. Black is at 0 m and white at `elevation_scale`. The bottom
        row of an image is row 0 of the map, as in ROS maps (where black is occupied).

        Args:
            occupancy_image: path of the image of the obstacles.
            height_image: path of the image of the elevation; it has no transparent pixels.
            resolution: side of a cell [m].
            origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].
            elevation_scale: elevation of white [m].
            ground_options: of `Ground`, by keyword.

        Raises:
            ValueError: an image that is missing or malformed, images of different sizes, an
                argument that is not accepted.
        """
        greys = read_greys(Path(occupancy_image))
        occupancy = greys.shade
        if greys.opaque is not None:
            occupancy[~greys.opaque] = UNKNOWN
        elevation = _heights(Path(height_image), elevation_scale, occupancy.shape)
        return cls.from_arrays(occupancy[::-1], elevation, resolution, origin, **ground_options)

    @classmethod
    def from_ros(
        cls,
        map_yaml: str | os.PathLike[str],
        height_image: str | os.PathLike[str],
        *,
        elevation_scale: float = 5.0,
        **ground_options: Any,
    ) -> "TerrainMap":
        """Make a map of a ROS `map_server` map and a grey image of the elevation of its size.

        See `OccupancyGrid.from_ros` and, for `height_image`, `from_images`.
        """
        grid = OccupancyGrid.from_ros(map_yaml)
        elevation = _heights(Path(height_image), elevation_scale, grid.shape)
        return cls(grid, Ground(elevation, grid.resolution, grid.frame.origin, **ground_options))

    @property
    def occupancy(self) -> GridValues:
        """Probability of being occupied."""
        return self.grid.probability

    @property
    def entropy(self) -> GridValues:
        """Entropy of the occupancy [nat]."""
        return self.grid.entropy

    @property
    def elevation(self) -> GridValues:
        """Elevation [m]."""
        return self.ground.elevation

    @property
    def slope(self) -> GridValues:
        """Slope [m/m]."""
        return self.ground.slope

    @property
    def roughness(self) -> GridValues:
        """Roughness [m]."""
        return self.ground.roughness

    @property
    def traversability(self) -> GridValues:
        """Traversability in [0, 1]."""
        return self.ground.traversability

    @property
    def frame(self) -> GridFrame:
        """Where the cells are."""
        return self.grid.frame

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.grid.resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    @property
    def is_drivable(self) -> GridMask:
        """Cells that are likelier free than occupied and may be entered."""
        return (self.grid.probability < UNKNOWN) & self.ground.is_traversable

    def at(self, points: Float[Array, "*N 2"]) -> TerrainSample:
        """Return what the cell that holds each world point (x, y) [m] is like.

        Off the map it is occupied, with no entropy, and everything else is 0.
        """
        cell = self.ground.to_cell(points)
        p = jnp.where(self.ground.contains(cell), self.grid.at_cell(cell), OUTSIDE)
        ground = self.ground.at(points)
        return TerrainSample(
            occupancy=p,
            entropy=jax.scipy.special.entr(p) + jax.scipy.special.entr(1.0 - p),
            elevation=ground.elevation,
            slope=ground.slope,
            roughness=ground.roughness,
            traversability=ground.traversability,
            is_drivable=(p < UNKNOWN) & (ground.traversability >= self.ground.threshold),
        )

    def with_grid(self, grid: OccupancyGrid) -> "TerrainMap":
        """Return the map with what is known of obstacles now: occupancy and entropy change, the
        ground stays.

        Raises:
            ValueError: a grid of another shape, resolution or origin.
        """
        return TerrainMap(grid, self.ground)

    def resample(self, resolution: float) -> "TerrainMap":
        """Return the same map at another resolution [m].

        The occupancy is as cautious as `OccupancyGrid.resample`. The elevation of a new cell is
        the mean of m x m samples spread evenly over the part of it that is on the old map, each
        interpolated linearly between the old cells' centres, with m the old cells along its side,
        rounded up: the mean of the old cells if it covers whole ones, and the value at its centre
        if it is smaller. A plane stays one, but for a last row or column that reaches beyond the
        old map. Slope and roughness are those of the new elevation, and so is the traversability;
        one that was given becomes the least of the old cells that the new one overlaps.

        Raises:
            ValueError: see `OccupancyGrid.resample`.
        """
        grid = self.grid.resample(resolution)
        ratio = resolution / self.resolution
        elevation, given = np.asarray(self.elevation, np.float64), None
        for axis, size in enumerate(grid.shape):
            elevation = _mean(elevation, size, ratio, axis)
        if self.ground.is_given:
            given = np.asarray(self.traversability)
            for axis, size in enumerate(grid.shape):
                given = _least(given, size, ratio, axis)
        ground = Ground(
            elevation,
            resolution,
            self.frame.origin,
            max_slope=self.ground.max_slope,
            max_roughness=self.ground.max_roughness,
            threshold=self.ground.threshold,
            traversability=given,
        )
        return TerrainMap(grid, ground)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map as one file, whole or not at all; `load` returns it to the bit.

        It holds plain arrays, no pickles, and is read back before it takes its name.

        Args:
            path: ends in .npz.

        Raises:
            ValueError: another ending, or a map that could not be read back.
            OSError: the file cannot be written.
        """
        path = Path(path)
        data = _terrain_file.pack(path, _arrays_of(self))
        _terrain_file.unpack(path, data, _terrain_of)
        replace_files([(path, data)])

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "TerrainMap":
        """Read a map that `save` wrote.

        Raises:
            ValueError: a file that is missing, unreadable, malformed or too large, or that holds a
                value that is not accepted; one line that names it.
        """
        path = Path(path)
        return _terrain_file.unpack(path, _terrain_file.read(path), _terrain_of)


def _check_same(name: str, ground: object, grid: object) -> None:
    if ground != grid:
        raise ValueError(f"ground has {name} {ground}; accepted: the grid's, {grid}")


def _heights(path: Path, scale: float, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the elevation in an image [m], row 0 at the bottom."""
    scale = _checks.number("elevation_scale", scale, above=0.0, at_most=HIGHEST)
    where = f"image {name_of(path)}"
    greys = read_greys(path)
    if greys.level.shape != shape:
        found, wanted = (f"{width} x {height}" for height, width in (greys.level.shape, shape))
        raise ValueError(f"{where} has {found} pixels; accepted: the map's size, {wanted}")
    if greys.opaque is not None and not greys.opaque.all():
        raise ValueError(f"{where} has transparent pixels; accepted: an elevation everywhere")
    return np.float32(scale) * greys.shade[::-1]


def _edges(size: int, new_size: int, ratio: float) -> tuple[NDArray[np.float64], ...]:
    """Return where each new cell begins and ends on an axis of old cells [old cells]."""
    # A new cell beyond the whole axis covers all of it; this also keeps inf out of the products.
    edges = np.minimum(np.arange(new_size + 1) * min(ratio, float(size)), float(size))
    return edges[:-1], edges[1:]


def _mean(
    values: NDArray[np.float64], new_size: int, ratio: float, axis: int
) -> NDArray[np.float64]:
    size = values.shape[axis]
    if size == 1:
        return np.repeat(values, new_size, axis)
    number = min(size, max(1, int(np.ceil(min(ratio, float(size)) - _SLIVER))))
    begin, end = _edges(size, new_size, ratio)
    share = (np.arange(number) + 0.5) / number
    # Centres of old cells are at whole numbers; half a cell beyond the outermost is the edge.
    at = (begin[:, None] + (end - begin)[:, None] * share).ravel() - 0.5
    first = np.clip(np.floor(at).astype(np.intp), 0, size - 2)
    along = np.moveaxis(values, axis, 0)
    part = (at - first)[:, None]
    samples = along[first] * (1.0 - part) + along[first + 1] * part
    mean = samples.reshape(new_size, number, -1).mean(axis=1)
    return np.moveaxis(mean, 0, axis)


def _least(
    values: NDArray[np.floating], new_size: int, ratio: float, axis: int
) -> NDArray[np.floating]:
    size = values.shape[axis]
    begin, end = _edges(size, new_size, ratio)
    first = np.clip(np.floor(begin + _SLIVER).astype(np.intp), 0, size - 1)
    stop = np.clip(np.ceil(end - _SLIVER).astype(np.intp), first + 1, size)
    # `reduceat` wants its bounds inside: one more cell makes `size` one of them.
    padding = [(0, 1) if axis == other else (0, 0) for other in range(values.ndim)]
    padded = np.pad(values, padding, constant_values=1.0)
    bounds = np.stack([first, stop], axis=-1).ravel()
    both = np.minimum.reduceat(padded, bounds, axis=axis)
    return np.take(both, np.arange(0, 2 * new_size, 2), axis=axis)


def _arrays_of(terrain: TerrainMap) -> dict[str, NDArray[Any]]:
    ground = terrain.ground
    found = {
        "probability": terrain.occupancy,
        "elevation": ground.elevation,
        "slope": ground.slope,
        "roughness": ground.roughness,
        "traversability": ground.traversability,
        "origin": terrain.frame.origin,
        "resolution": terrain.resolution,
        "threshold": ground.threshold,
        "max_slope": ground.max_slope,
        "max_roughness": ground.max_roughness,
        "is_given": ground.is_given,
    }
    return {name: np.asarray(value) for name, value in found.items() if value is not None}


def _terrain_of(arrays: dict[str, NDArray[Any]]) -> TerrainMap:
    for name in ("slope", "roughness"):
        if not ((arrays[name] >= 0.0) & np.isfinite(arrays[name])).all():
            raise ValueError(f"{name} has values that are negative or not finite")
    traversability = _checks.probabilities("traversability", arrays["traversability"], 2)
    resolution, origin = float(arrays["resolution"]), arrays["origin"]
    ground = Ground(
        arrays["elevation"],
        resolution,
        origin,
        max_slope=arrays["max_slope"],
        max_roughness=arrays.get("max_roughness"),
        threshold=arrays["threshold"],
        traversability=traversability if arrays["is_given"] else None,
    )
    # What follows from the elevation may differ in its last bit where it was compiled by another
    # program or for another machine: what was saved holds.
    ground = eqx.tree_at(
        lambda layers: (layers.slope, layers.roughness, layers.traversability),
        ground,
        (jnp.asarray(arrays["slope"]), jnp.asarray(arrays["roughness"]), traversability),
    )
    return TerrainMap(OccupancyGrid(arrays["probability"], resolution, origin), ground)
