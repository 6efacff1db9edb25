"""Checks of places in a volume, on the host."""

import numpy as np

from jaxplore.maps.datum import Datum
from jaxplore.maps.voxel_grid import VoxelGrid


def show_place(place: np.ndarray, datum: Datum) -> str:
    """Return the coordinates (x, y, z) of a place in the file's, for a message."""
    # To the millimetre: single precision has no more.
    rounded = (round(float(each), 3) for each in datum.round_to_map(place[:3]))
    return f"({', '.join(f'{each:.10g}' for each in rounded)})"


def check_free(name: str, place: np.ndarray, world: VoxelGrid, datum: Datum) -> None:
    """Check that a place (x, y, z) [m] is in a voxel that is known to be free."""
    voxel = np.floor((place - np.asarray(world.origin))[::-1] / world.resolution).astype(int)
    is_in = ((voxel >= 0) & (voxel < world.shape)).all()
    if not is_in or not np.asarray(world.is_free)[tuple(voxel)]:
        raise ValueError(
            f"{name} is {show_place(place, datum)}, not in a free voxel; accepted: a place in free "
            "space"
        )


def check_reachable(
    name: str,
    place: np.ndarray,
    world: VoxelGrid,
    places: np.ndarray,
    radius: float,
    within: float,
    datum: Datum,
) -> None:
    """Check that a place (x, y, z) is within a distance [m] of a voxel at whose centre a robot can
    get.

    `places` (D, H, W) are these voxels, and `radius` is that of the robot [m].
    """
    side = world.resolution
    at = np.asarray(place, np.float64) - np.asarray(world.origin, np.float64)
    centres = (np.argwhere(places)[:, ::-1] + 0.5) * side
    nearest = float(np.linalg.norm(centres - at, axis=1).min())
    # Between the centres of voxels there is room as well.
    most = max(within, side)
    if nearest > most:
        raise ValueError(
            f"{name} is {show_place(place, datum)}, which a robot of radius {radius:g} m cannot "
            f"reach from its start: {nearest:.2f} m is the nearest it gets; accepted: a {name} "
            f"within {most:g} m of where it can go"
        )
