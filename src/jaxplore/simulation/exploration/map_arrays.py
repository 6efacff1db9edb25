"""The parts of an exploration scenario whose arrays have the shape of the map."""

from typing import NamedTuple

from jaxtyping import Array, Bool

from jaxplore._types import GridMask
from jaxplore._xla import on_device
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.padding import pad_cells


class MapArrays(NamedTuple):
    """The map of a scenario, in arrays of one of a few shapes: similar maps share a program.

    `prior` is the map that the robot knows in advance, `reachable` (H, W) the cells that its centre
    can reach in the true `world`. `ground` is None if it is level. `closed` (H, W) are the cells
    that it must not enter; None if it may enter all.
    """

    world: OccupancyGrid
    prior: OccupancyGrid
    reachable: GridMask
    ground: Ground | None
    closed: GridMask | None = None

    def pad(self, shape: tuple[int, int] | None = None) -> "MapArrays":
        """Return the map in larger arrays, see `OccupancyGrid.pad`."""
        world = self.world.pad(shape)
        same = world.shape
        return MapArrays(
            world,
            self.prior.pad(same),
            self.mask(self.reachable, same),
            None if self.ground is None else self.ground.pad(same),
            None if self.closed is None else self.mask(self.closed, same),
        )

    def mask(
        self, cells: GridMask, shape: tuple[int, int] | None = None
    ) -> Bool[Array, "rows columns"]:
        """Return a mask of cells of the map in arrays of a shape; that of the world by default."""
        shape = self.world.shape if shape is None else shape
        return on_device(pad_cells("shape", self.world.crop(cells), shape, False))

    @property
    def traversable(self) -> GridMask | None:
        """Cells (H, W) that the robot may enter; None if it may enter all that are free."""
        passable = None if self.ground is None else self.ground.is_traversable
        if self.closed is None:
            return passable
        return ~self.closed if passable is None else passable & ~self.closed

    def crop(self) -> "MapArrays":
        """Return the map in arrays of its own shape."""
        world = self.world
        if world.map_shape is None:
            return self
        ground = self.ground
        return MapArrays(
            world.unpad(),
            self.prior.unpad(),
            on_device(world.crop(self.reachable)),
            None if ground is None else ground.crop(world.unpad().shape),
            None if self.closed is None else on_device(world.crop(self.closed)),
        )
