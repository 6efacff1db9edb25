"""The memory of the exploration of a volume, estimated: see `jaxplore.tasks.memory`."""

from collections.abc import Iterator

from jaxplore.belief.rolling_map import BLOCK
from jaxplore.belief.volume import COARSE
from jaxplore.belief.volume_lattice import NODE
from jaxplore.parts.localisation.settings import LOCALISATION_IN_VOLUME
from jaxplore.tasks.memory import CONTROLS, Part, estimate_programs, estimate_record
from jaxplore.tasks.volume.build import volume_size
from jaxplore.tasks.volume.settings import VolumeSettings

_READING = 0.5
"""Share of the memory that reading a file may take."""


def estimate_volume(settings: VolumeSettings, limit: float) -> tuple[Part, ...]:
    """Estimate the memory of a run, part by part. A file is read with at most half of `limit`."""
    return (estimate_programs(), *_volume(settings, limit))


def _volume(settings: VolumeSettings, limit: float) -> Iterator[Part]:
    # What a reader finds is held by this process too.
    (depth, height, width), side = volume_size(settings, _READING * limit)
    voxels = float(depth) * height * width
    # Of those outside a window the true world is held, and what is stored of the map.
    share = 1.0
    for extent, size in zip(
        reversed(settings.fields.window or ()), (depth, height, width), strict=False
    ):
        share *= min(1.0, (extent / side + NODE * BLOCK * max(1.0, COARSE / side)) / size)
    yield Part(
        "voxels",
        f"{depth} x {height} x {width} voxels: generated.size, the file, resolution, fields.window",
        60.0 * voxels * (1.0 + share),
    )
    if LOCALISATION_IN_VOLUME.find_section(settings) is not None:
        # Surfaces, and the map at the true poses.
        yield Part("localisation", "generated.size, the file, resolution", 30.0 * voxels)
    spacing = NODE * max(side, COARSE) / side
    camera, lidar = settings.camera, settings.lidar
    rays = (0 if camera is None else camera.columns * camera.rows) + (
        0 if lidar is None else lidar.columns * lidar.rings
    )
    yield Part(
        "views",
        "fields.num_sectors, camera.columns, camera.rows, resolution",
        64.0 * settings.fields.num_sectors * share * voxels / spacing**3 + 24.0 * rays,
    )
    given = settings.controller
    yield Part(
        "controller",
        "controller.num_samples, controller.horizon",
        8.0 * given.num_samples * given.horizon * CONTROLS["quadrotor"] + 200.0 * given.num_samples,
    )
    yield estimate_record("time_limit, rates.control", settings.time_limit * settings.rates.control)
