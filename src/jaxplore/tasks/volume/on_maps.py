"""How explorations are compared in several volumes."""

from pathlib import Path

import numpy as np

from jaxplore._files import read_bytes
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.volume_file import FILE_LIMIT, SUFFIXES
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.tasks.kind import OnMaps
from jaxplore.tasks.volume.build import build_volume, build_world
from jaxplore.tasks.volume.settings import GENERATED, VolumeSettings

ARCHITECTURES = ("explorer", "nearest-cluster", "next-best-view", "gain-per-cost")
"""Architectures that are compared by default."""


def plan_volume(settings: VolumeSettings) -> tuple[OccupancyGrid, Datum]:
    """Return what is solid of each column of a volume, as seen from above, and the datum.

    The value of a column is the share of its voxels that are solid, without floor and ceiling.
    """
    world, datum = build_world(settings)
    solid = ~np.asarray(world.is_free)
    inside = solid[1:-1] if len(solid) > 2 else solid
    x, y, _ = np.asarray(world.origin).tolist()
    share = inside.mean(axis=0, dtype=np.float32)
    return OccupancyGrid(share, world.resolution, (x, y, 0.0)), datum


IN_VOLUMES = OnMaps(
    files="volume",
    accepted=f"files that end with {', '.join(SUFFIXES)}",
    is_file=lambda path: path.suffix.lower() in SUFFIXES,
    read=lambda path: (read_bytes(Path(path), "a volume", FILE_LIMIT),),
    plan=plan_volume,
    build=lambda settings, _: build_volume(settings),
    names=tuple(GENERATED),
    variants=ARCHITECTURES,
    shared=("robot", "lidar", "camera", "sensor_model", "rates", "generated"),
    start=("x", "y", "z", "yaw"),
)
