"""Combine occupancy and ground layers on one grid: the terrain map."""

import io
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import read_bytes, replace_files
from jaxplore._text import error_reason, printable_path
from jaxplore._types import ArrayLike, GridMask, GridValues, Vector
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.images import read_greys
from jaxplore.maps.files.npz import MALFORMED_NPZ, array_names, read_arrays
from jaxplore.maps.files.ros import MapRules
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import HIGHEST, Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.resample import CELL_LIMIT, SLIVER

LAYERS = ("probability", "elevation", "slope", "roughness", "traversability")
"""Names of the arrays (H, W); all other arrays are small."""
BYTE_LIMIT = 5 * 4 * CELL_LIMIT + 2**20
"""Largest file that is read [bytes]: the five uncompressed layers of the largest map."""

_SUFFIX = ".npz"
_TYPES = {
    **dict.fromkeys(LAYERS, ("<f4", 2)),
    "origin": ("<f4", 1),
    "resolution": ("<f8", 0),
    "threshold": ("<f4", 0),
    "max_slope": ("<f4", 0),
    "max_roughness": ("<f4", 0),
    "is_given": ("|b1", 0),
}
_OPTIONAL = frozenset({"max_roughness"})
UNKNOWN = 0.5
"""Probability of a cell that was never measured; a robot drives only where it is lower."""


def pack(path: Path, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the content of a terrain file that holds arrays by name; nothing is written.

    A path that does not end in .npz raises a `ValueError`.
    """
    if path.suffix.lower() != _SUFFIX:
        raise ValueError(f"path is {printable_path(path)}; accepted: a name that ends in {_SUFFIX}")
    plain = {name: np.asarray(value, _TYPES[name][0], order="C") for name, value in arrays.items()}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **plain)
    return stream.getvalue()


def unpack[T](path: Path, data: bytes, build: Callable[[dict[str, NDArray[Any]]], T]) -> T:
    """Check the content of a terrain file and build an object from its arrays.

    Types, numbers of axes and sizes are checked against those that `pack` writes, and the layers
    must have one shape. `build` gets the arrays by name and has to check their values. The path is
    for messages.
    """
    try:
        return build(_arrays(data))
    except MALFORMED_NPZ as error:
        raise ValueError(
            f"{printable_path(path)} is not a terrain map ({error_reason(error)}); "
            "accepted: what TerrainMap.save writes"
        ) from None


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    names = array_names(data)
    missing = sorted(_TYPES.keys() - _OPTIONAL - set(names))
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    if len(set(names)) < len(names) or not set(names) <= _TYPES.keys():
        raise ValueError(f"it holds more than {', '.join(_TYPES)}")
    arrays = read_arrays(data, _check_header)
    shapes = {arrays[name].shape for name in LAYERS}
    if len(shapes) > 1:
        raise ValueError(f"its layers have the shapes {sorted(shapes)}")
    return arrays


def _check_header(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    kind, ndim = _TYPES[name]
    if dtype != np.dtype(kind) or len(shape) != ndim:
        raise ValueError(f"{name} has shape {shape} and type {dtype}")
    if not 0 < math.prod(shape) <= CELL_LIMIT:
        raise ValueError(f"{name} has shape {shape}, not 1 to {CELL_LIMIT} cells")


class TerrainSample(NamedTuple):
    """Layers of a terrain map at points, (*N) each: `occupancy` in [0, 1], its `entropy` [nat],
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

    Scans change the occupancy, which `with_grid` replaces; the ground stays as it is. A cell is
    drivable if it is more likely free than occupied and the ground is traversable: `p < 0.5` and
    `traversability >= threshold`.

    Args:
        grid: occupancy grid.
        ground: elevation and traversability of the same cells.

    Raises:
        ValueError: grids that differ in shape, resolution or origin.
    """

    grid: OccupancyGrid
    ground: Ground

    def __init__(self, grid: OccupancyGrid, ground: Ground) -> None:
        _check_same("shape", ground.shape, grid.shape)
        _check_same("resolution", ground.resolution, grid.resolution)
        # Shapes and resolutions are static, but origins may be traced and cannot be compared then.
        origins = (ground.frame.origin, grid.frame.origin)
        if not _kinds.is_traced(*origins):
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
        """Build a terrain map from arrays.

        Args:
            occupancy: probability of occupancy (H, W) in [0, 1]; 0.5 is unknown.
            elevation: elevation (H, W) [m].
            resolution: side of a cell [m].
            origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].
            ground_options: keyword arguments of `Ground`.

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
        """Build a terrain map from two grey images of one size: PGM, PNG, BMP, JPEG or WebP.

        In the occupancy image black is free, white is occupied, the probability is linear in
        between, and a transparent pixel is unknown. In the height image black is 0 m and white is
        `elevation_scale`. The bottom row of an image is row 0 of the map, as in ROS maps (in which,
        however, black is occupied).

        Args:
            occupancy_image: path of the image of the obstacles.
            height_image: path of the image of the elevation; it must not have transparent pixels.
            resolution: side of a cell [m].
            origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].
            elevation_scale: elevation of white [m].
            ground_options: keyword arguments of `Ground`.

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
        datum: Datum = ORIGIN,
        rules: MapRules = "nav2",
        unknown: int | None = None,
        **ground_options: Any,
    ) -> "TerrainMap":
        """Build a terrain map from a ROS `map_server` map and a grey elevation image of its size.

        See `OccupancyGrid.from_ros` for the map, `datum`, `rules` and `unknown`, and `from_images`
        for `height_image`.
        """
        grid = OccupancyGrid.from_ros(map_yaml, datum=datum, rules=rules, unknown=unknown)
        elevation = _heights(Path(height_image), elevation_scale, grid.shape)
        return cls(grid, Ground(elevation, grid.resolution, grid.frame.origin, **ground_options))

    @property
    def occupancy(self) -> GridValues:
        """Probability of occupancy (H, W)."""
        return self.grid.probability

    @property
    def entropy(self) -> GridValues:
        """Entropy of the occupancy (H, W) [nat]."""
        return self.grid.entropy

    @property
    def elevation(self) -> GridValues:
        """Elevation (H, W) [m]."""
        return self.ground.elevation

    @property
    def slope(self) -> GridValues:
        """Slope (H, W) [m/m]."""
        return self.ground.slope

    @property
    def roughness(self) -> GridValues:
        """Roughness (H, W) [m]."""
        return self.ground.roughness

    @property
    def traversability(self) -> GridValues:
        """Traversability (H, W) in [0, 1]."""
        return self.ground.traversability

    @property
    def frame(self) -> GridFrame:
        """Pose and cell size of the map."""
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
        """Mask (H, W) of the cells that are more likely free than occupied and traversable."""
        return (self.grid.probability < UNKNOWN) & self.ground.is_traversable

    def at(self, points: Float[Array, "*N 2"]) -> TerrainSample:
        """Return the layers at the cell that contains each world point (x, y) [m].

        Off the map the occupancy is 1 and everything else is 0.
        """
        cell = self.frame.to_cell(points)
        p = self.grid.at_cell(cell)
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
        """Return the map with another occupancy grid and the same ground.

        Raises:
            ValueError: a grid of another shape, resolution or origin.
        """
        return TerrainMap(grid, self.ground)

    def resample(self, resolution: float) -> "TerrainMap":
        """Return the same map at another resolution [m].

        The occupancy is resampled by `OccupancyGrid.resample`. The elevation of a new cell is the
        mean of m x m samples, spread evenly over the part of the cell that is on the old map and
        interpolated linearly between the old cell centres. m is the number of old cells along the
        side of a new one, rounded up. So a new cell that covers whole old cells gets their mean,
        and a smaller one the value at its centre. A plane stays a plane, except in a last row or
        column that reaches beyond the old map.

        Slope, roughness and traversability are computed from the new elevation. A traversability
        that was given is resampled instead: a new cell gets the minimum of the old cells that it
        overlaps.

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
        """Write the map to one file, completely or not at all; `load` restores every bit.

        The file holds plain arrays and no pickles. It is read back before it gets its name.

        Args:
            path: path of the file; it must end in .npz.

        Raises:
            ValueError: another ending, or a map that could not be read back.
            OSError: the file cannot be written.
        """
        path = Path(path)
        data = pack(path, _arrays_by_name(self))
        unpack(path, data, _build_terrain)
        replace_files([(path, data)])

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "TerrainMap":
        """Read a map that `save` wrote.

        Raises:
            ValueError: a file that is missing, unreadable, malformed or too large, or that holds a
                value that is not accepted; one line that names it.
        """
        path = Path(path)
        return unpack(path, read_bytes(path, "a terrain map's npz", BYTE_LIMIT), _build_terrain)


def _check_same(name: str, ground: object, grid: object) -> None:
    if ground != grid:
        raise ValueError(f"ground has {name} {ground}; accepted: the grid's, {grid}")


def _heights(path: Path, scale: float, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Read the elevation (H, W) from an image [m], row 0 at the bottom."""
    scale = _checks.number("elevation_scale", scale, above=0.0, at_most=HIGHEST)
    where = f"image {printable_path(path)}"
    greys = read_greys(path)
    if greys.level.shape != shape:
        found, wanted = (f"{width} x {height}" for height, width in (greys.level.shape, shape))
        raise ValueError(f"{where} has {found} pixels; accepted: the map's size, {wanted}")
    if greys.opaque is not None and not greys.opaque.all():
        raise ValueError(f"{where} has transparent pixels; accepted: an elevation everywhere")
    return np.float32(scale) * greys.shade[::-1]


def _edges(size: int, new_size: int, ratio: float) -> tuple[NDArray[np.float64], ...]:
    """Return the coordinates at which each new cell begins and ends [old cells]."""
    # A new cell larger than the whole axis covers all of it. The bound also avoids infinity here.
    edges = np.minimum(np.arange(new_size + 1) * min(ratio, float(size)), float(size))
    return edges[:-1], edges[1:]


def _mean(
    values: NDArray[np.float64], new_size: int, ratio: float, axis: int
) -> NDArray[np.float64]:
    """Average the linearly interpolated values over each new cell along an axis."""
    size = values.shape[axis]
    if size == 1:
        return np.repeat(values, new_size, axis)
    number = min(size, max(1, int(np.ceil(min(ratio, float(size)) - SLIVER))))
    begin, end = _edges(size, new_size, ratio)
    share = (np.arange(number) + 0.5) / number
    # Shift by half a cell, so that the centres of old cells are at whole numbers. Samples beyond
    # the outermost centres are extrapolated.
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
    """Return the minimum of the old cells that each new cell overlaps along an axis."""
    size = values.shape[axis]
    begin, end = _edges(size, new_size, ratio)
    first = np.clip(np.floor(begin + SLIVER).astype(np.intp), 0, size - 1)
    stop = np.clip(np.ceil(end - SLIVER).astype(np.intp), first + 1, size)
    # `reduceat` accepts only indices below the size: pad by one cell, so that `size` is one.
    padding = [(0, 1) if axis == other else (0, 0) for other in range(values.ndim)]
    padded = np.pad(values, padding, constant_values=1.0)
    bounds = np.stack([first, stop], axis=-1).ravel()
    both = np.minimum.reduceat(padded, bounds, axis=axis)
    # Every second result is the minimum between one new cell's end and the next one's start.
    return np.take(both, np.arange(0, 2 * new_size, 2), axis=axis)


def _arrays_by_name(terrain: TerrainMap) -> dict[str, NDArray[Any]]:
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


def _build_terrain(arrays: dict[str, NDArray[Any]]) -> TerrainMap:
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
    # Recomputed layers may differ in the last bit on another machine or in another program: restore
    # the saved ones.
    ground = eqx.tree_at(
        lambda layers: (layers.slope, layers.roughness, layers.traversability),
        ground,
        (jnp.asarray(arrays["slope"]), jnp.asarray(arrays["roughness"]), traversability),
    )
    return TerrainMap(OccupancyGrid(arrays["probability"], resolution, origin), ground)
