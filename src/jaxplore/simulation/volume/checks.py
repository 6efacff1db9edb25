"""Checks of places in a volume, on the host."""

import math

import jax.numpy as jnp
import numpy as np

from jaxplore.belief.volume_goal import EASE, INSIDE, resting_place
from jaxplore.maps.datum import Datum
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.simulation.volume.observable import room_around


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
    solid: np.ndarray,
    places: np.ndarray,
    radius: float,
    within: float,
    datum: Datum,
) -> None:
    """Check that a robot that knows the world would come to rest at a place (`resting_place`).

    The place is (x, y, z), and the robot comes to rest within a distance of it [m]. `solid` and
    `places` (D, H, W) are the voxels that it must not touch and those at whose centres it can get.
    `radius` is that of the robot [m].
    """
    side = world.resolution
    voxel = np.floor(np.asarray(world.to_grid(jnp.asarray(place)))).astype(int)
    # All that is solid to the robot near the place; off the volume all is.
    reach = math.ceil((within + radius + EASE) / side) + 3
    low, high = np.maximum(voxel - reach, 0), np.maximum(voxel + reach + 1, 0)
    near = solid[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    room = room_around(near) * side if near.size else np.zeros((1, 1, 1))
    corner = world.to_world(jnp.asarray(low + 0.5, jnp.float32))
    field = VolumeField(jnp.asarray(room, jnp.float32), corner, side, jnp.zeros(()))
    at, most, least = (jnp.asarray(each, jnp.float32) for each in (place, within, radius))
    rest, fits = resting_place(field, field, at, most, least)
    # The robot can get to a place between voxels if it can to one of these.
    low = np.floor(np.asarray(world.to_grid(rest)) - 0.5).astype(int)
    around = places[tuple(slice(max(0, each), max(0, each + 2)) for each in low)]
    if bool(fits) and around.any():
        return
    local = np.asarray(place, np.float64) - np.asarray(world.origin, np.float64)
    centres = (np.argwhere(places)[:, ::-1] + 0.5) * side
    nearest = float(np.linalg.norm(centres - local, axis=1).min())
    raise ValueError(
        f"{name} is {show_place(place, datum)}, which a robot of radius {radius:g} m cannot reach "
        f"from its start: {nearest:.2f} m is the nearest it gets; accepted: a {name} within "
        f"{INSIDE * within:.3g} m of where it can go"
    )


def check_visible(
    name: str, places: np.ndarray, world: VoxelGrid, seen: np.ndarray, datum: Datum
) -> None:
    """Check that things (M, 3) [m] are in voxels (D, H, W) that a level sensor can see."""
    voxels = np.stack(find_voxels(places, world), axis=-1)
    for index, (place, voxel) in enumerate(zip(places, voxels, strict=True)):
        is_in = ((voxel >= 0) & (voxel < seen.shape)).all()
        if not is_in or not seen[tuple(voxel)]:
            raise ValueError(
                f"{name}[{index}] is {show_place(place, datum)}; accepted: a free voxel that a "
                "sensor sees from where the robot can get"
            )


def find_voxels(places: np.ndarray, world: VoxelGrid) -> tuple[np.ndarray, ...]:
    """Return the voxels (k, j, i) of places (M, 3) [m], an array (M,) for each axis."""
    apart = np.asarray(places, np.float64) - np.asarray(world.origin)
    return tuple(np.floor(apart / world.resolution).astype(int)[:, ::-1].T)
