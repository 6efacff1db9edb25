"""Represent an occupancy grid: a probability for each cell, and the pose of the grid."""

from os import PathLike
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._describe import describe
from jaxplore._types import ArrayLike, Count, GridMask, GridValues, Position, Scalar, Vector
from jaxplore.maps import resample
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.field import bilinear
from jaxplore.maps.files import ros
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure
from jaxplore.maps.padding import choose_padded_shape, pad_cells

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FREE_THRESHOLD = 0.25
"""A cell with a lower probability is free (nav2's default `free_thresh`)."""
OCCUPIED_THRESHOLD = 0.65
"""A cell with a higher probability is occupied (ROS's default `occupied_thresh`)."""
OUTSIDE = 1.0
"""Probability off the map: nothing can drive there, and there is nothing to learn."""


class OccupancyGrid(eqx.Module):
    """Probability of occupancy for each cell of a regular grid.

    Row 0, column 0 is the cell at the origin. Columns run along the grid's x axis and rows along
    its y axis. Off the map the probability is 1. A cell is free below 0.25, occupied above 0.65 and
    unknown in between.

    A compiled program is for one shape of arrays. `pad` adds rows and columns that are off the
    map, so that maps of similar size share a program. Then `map_shape` is the number of rows and
    columns that are on the map.

    Args:
        probability: probability of occupancy (H, W) in [0, 1]; 0.5 for a cell that was never
            measured.
        resolution: side of a cell [m].
        origin: pose (x, y, yaw) of the outer corner of cell (0, 0) in the world [m, m, rad].

    Raises:
        ValueError: a probability outside [0, 1] or NaN, an array that is empty or not
            two-dimensional, a resolution that is not positive, an origin that is not three finite
            numbers or too far away for single precision (see `GridFrame`).
    """

    probability: GridValues
    frame: GridFrame

    def __init__(
        self,
        probability: ArrayLike,
        resolution: float,
        origin: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        self.probability = _checks.probabilities("probability", probability, 2)
        self.frame = GridFrame(resolution, origin)

    def __repr__(self) -> str:
        is_known = not _kinds.is_traced(self.probability)
        values = self.crop(self.probability) if is_known else self.probability
        height, width = (self.resolution * size for size in values.shape)
        text = f"{type(self).__name__}({width:g} m x {height:g} m, cells of {self.resolution:g} m"
        if is_known:
            shares = (values < FREE_THRESHOLD).mean(), (values > OCCUPIED_THRESHOLD).mean()
            text += f", {100 * shares[0]:.0f} % free, {100 * shares[1]:.0f} % occupied"
        return f"{text}, origin {describe(self.frame.origin)})"

    @classmethod
    @_kinds.check_arguments
    def unknown(cls, shape: tuple[int, int], frame: GridFrame) -> "OccupancyGrid":
        """Return a grid in which every cell is unknown: 0.5 everywhere."""
        rows, columns = _checks.rows_and_columns("shape", shape)
        filled = np.full((rows, columns), 0.5, np.float32)
        return cls(filled, frame.resolution, frame.origin)

    @classmethod
    @_kinds.check_arguments
    def from_ros(
        cls,
        path: str | PathLike[str],
        *,
        datum: Datum = ORIGIN,
        rules: ros.MapRules = "nav2",
        unknown: int | None = None,
    ) -> "OccupancyGrid":
        """Read a ROS `map_server` map (see `jaxplore.maps.files.ros.read_map`).

        Args:
            path: path of the YAML file.
            datum: point of the map's coordinates to which the grid is relative, which a map far
                from the origin needs: `jaxplore.maps.map_datum` chooses it.
            rules: rules of nav2's map server by which the image is read: `nav2`, those until 2025,
                or `nav2_2025`, where both thresholds are inclusive and what is not opaque is
                unknown.
            unknown: grey from 0 to 255 that is read as unknown, whatever the thresholds say, such
                as 205, which map savers write; none when absent.
        """
        probability, resolution, origin = ros.read_map(path, rules=rules, unknown=unknown)
        return cls(probability, resolution, datum.to_local(origin))

    @_kinds.check_arguments
    def to_ros(
        self, path: str | PathLike[str], *, mode: str = "trinary", datum: Datum = ORIGIN
    ) -> None:
        """Write a ROS `map_server` map (see `jaxplore.maps.files.ros.write_map`).

        Args:
            path: path of the YAML file.
            mode: "trinary", "scale" or "raw".
            datum: point of the map's coordinates to which the grid is relative.
        """
        ros.write_map(
            path,
            self.crop(self.probability),
            self.resolution,
            datum.to_map(np.asarray(self.frame.origin, np.float64)).tolist(),
            mode=mode,
        )

    def resample(self, resolution: float) -> "OccupancyGrid":
        """Return the same map at another resolution [m]; no wall gets lost.

        See `jaxplore.maps.resample.resample`.
        """
        values = resample.resample(self.crop(self.probability), self.resolution, resolution)
        return type(self)(values, resolution, self.frame.origin)

    def pad(self, shape: tuple[int, int] | None = None) -> "OccupancyGrid":
        """Return the map in larger arrays, whose further rows and columns are off the map.

        Args:
            shape: rows and columns of the arrays; those of `choose_padded_shape` when absent,
                where a map that is padded already is returned as it is.

        Raises:
            ValueError: fewer rows or columns than the map has.
        """
        if shape is None:
            if self.map_shape is not None:
                return self
            shape = choose_padded_shape(self.shape)
        values = self.crop(self.probability)
        filled = pad_cells("shape", values, shape, OUTSIDE)
        same = OccupancyGrid(filled, self.resolution, self.frame.origin)
        rows, columns = values.shape
        result: OccupancyGrid = eqx.tree_at(
            lambda grid: grid.frame, same, same.frame.pad((rows, columns))
        )
        return result

    def unpad(self) -> "OccupancyGrid":
        """Return the map in arrays of its own shape: without the rows and columns off the map."""
        if self.map_shape is None:
            return self
        return OccupancyGrid(self.crop(self.probability), self.resolution, self.frame.origin)

    def crop(self, values: ArrayLike) -> np.ndarray:
        """Return the rows and columns of an array (H, W, ...) that are on the map, in NumPy."""
        return self.frame.crop(values)

    def with_probability(self, probability: GridValues) -> "OccupancyGrid":
        """Return the grid with other probabilities (H, W); they must be 1 off the map."""
        probability = _checks.of_shape("probability", probability, self.shape)
        same: OccupancyGrid = eqx.tree_at(lambda grid: grid.probability, self, probability)
        return same

    def with_solid(self, mask: GridMask) -> "OccupancyGrid":
        """Return a true world in which these cells (H, W) are certainly occupied as well."""
        return self.with_probability(jnp.where(mask, 1.0, self.probability))

    @property
    def map_shape(self) -> Int[Array | np.ndarray, "2"] | None:
        """Number of rows and columns that are on the map, of a padded map; None if all are."""
        return self.frame.map_shape

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.frame.resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the arrays."""
        height, width = self.probability.shape
        return height, width

    @property
    def is_on_map(self) -> GridMask | None:
        """Mask (H, W) of the cells that are on the map; None if all are."""
        if self.map_shape is None:
            return None
        rows, columns = (jnp.arange(size) for size in self.shape)
        return (rows < self.map_shape[0])[:, None] & (columns < self.map_shape[1])[None, :]

    @property
    def sides(self) -> tuple[Count | int, Count | int]:
        """Rows and columns that are on the map: traced numbers for a map that is padded."""
        if self.map_shape is None:
            return self.shape
        return self.map_shape[0], self.map_shape[1]

    @property
    def is_free(self) -> GridMask:
        """Mask (H, W) of the free cells."""
        return self.probability < FREE_THRESHOLD

    @property
    def is_occupied(self) -> GridMask:
        """Mask (H, W) of the occupied cells."""
        return self.probability > OCCUPIED_THRESHOLD

    def with_prior(self, prior: Scalar) -> "OccupancyGrid":
        """Return the grid with the probability `prior` in cells that were never measured.

        These are the cells whose probability is 0.5 to within 1e-3.
        """
        _checks.of_shape("prior", prior, ())
        return self.with_probability(with_prior(self.probability, prior))

    def settle(self) -> "OccupancyGrid":
        """Return the grid with the probability 0 in free cells and 1 in occupied ones.

        It is for maps of other programs. Their probabilities are on a scale of their own: a known
        cell at 0.1 would count as information that is left, and in a known hall such cells add up.
        """
        known = jnp.where(self.is_occupied, 1.0, self.probability)
        return self.with_probability(jnp.where(self.is_free, 0.0, known))

    def contains(self, cell: Int[Array, "*N 2"]) -> Bool[Array, "*N"]:
        """Return whether each cell (row, column) is on the map."""
        cell = _checks.pairs("cell", cell, jnp.int32)
        height, width = self.sides
        row, column = cell[..., 0], cell[..., 1]
        return (row >= 0) & (row < height) & (column >= 0) & (column < width)

    def at_cell(self, cell: Int[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Return the probability of each cell (row, column), 1 off the map."""
        cell = _checks.pairs("cell", cell, jnp.int32)
        height, width = self.shape
        row = jnp.clip(cell[..., 0], 0, height - 1)
        column = jnp.clip(cell[..., 1], 0, width - 1)
        return jnp.where(self.contains(cell), self.probability[row, column], OUTSIDE)

    def at(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N"]:
        """Return the probability of the cell that contains each world point (x, y) [m]."""
        points = _checks.pairs("points", points, jnp.float32)
        return self.at_cell(self.frame.to_cell(points))

    def interpolate(self, position: Position) -> Scalar:
        """Return the bilinear interpolation of the probability at a world point (x, y) [m].

        It is exact at cell centres, and 1 off the map.
        """
        position = _checks.position("position", position)
        return bilinear(self.probability, self.frame.to_grid(position), jnp.float32(OUTSIDE))

    def plot(self) -> "Figure":
        """Draw the map in the world: free is white, occupied is black."""
        return lattice_figure(
            self.probability,
            self.frame,
            "probability of being occupied",
            colours="gray_r",
            limits=(0.0, 1.0),
        )

    @property
    def entropy(self) -> GridValues:
        """Entropy of each cell [nat], see `entropy`."""
        return entropy(self.probability)


def entropy(probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return the entropy `h(p) = -p ln p - (1 - p) ln(1 - p)` [nat], with `0 ln 0 = 0`."""
    return jax.scipy.special.entr(probability) + jax.scipy.special.entr(1.0 - probability)


def with_prior(probability: Float[Array, "*N"], prior: Scalar) -> Float[Array, "*N"]:
    """Return probabilities with `prior` in cells that were never measured: 0.5 to within 1e-3."""
    return jnp.where(jnp.abs(probability - 0.5) < 1e-3, prior, probability)
