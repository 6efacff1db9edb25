"""The parts of an exploration scenario whose arrays have the shape of the map."""

from typing import NamedTuple

from jaxtyping import Array, Bool

from jaxplore._types import GridMask
from jaxplore._xla import on_device
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.padding import padded_cells


class MapArrays(NamedTuple):
    """The map of a scenario, in arrays of one of a few shapes: similar maps share a program.

    `prior` is the map that the robot knows in advance, `reachable` (H, W) the cells that its centre
    can reach in the true `world`. `ground` is None if it is level.
    """

    world: OccupancyGrid
    prior: OccupancyGrid
    reachable: GridMask
    ground: Ground | None

    def padded(self, shape: tuple[int, int] | None = None) -> "MapArrays":
        """Return the map in larger arrays, see `OccupancyGrid.padded`."""
        world = self.world.padded(shape)
        same = world.shape
        return MapArrays(
            world,
            self.prior.padded(same),
            self.mask(self.reachable, same),
            None if self.ground is None else self.ground.padded(same),
        )

    def mask(
        self, cells: GridMask, shape: tuple[int, int] | None = None
    ) -> Bool[Array, "rows columns"]:
        """Return a mask of cells of the map in arrays of a shape; that of the world by default."""
        shape = self.world.shape if shape is None else shape
        return on_device(padded_cells("shape", self.world.cropped(cells), shape, False))

    def cropped(self) -> "MapArrays":
        """Return the map in arrays of its own shape."""
        world = self.world
        if world.map_shape is None:
            return self
        ground = self.ground
        return MapArrays(
            world.unpadded(),
            self.prior.unpadded(),
            on_device(world.cropped(self.reachable)),
            None if ground is None else ground.cropped(world.unpadded().shape),
        )
