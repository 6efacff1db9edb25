"""The kind of task in which a quadrotor explores a volume."""

from jaxplore.maps.files.volume_file import SUFFIXES
from jaxplore.report.volume.data import VolumeData
from jaxplore.tasks.kind import Kind, Shown
from jaxplore.tasks.volume.build import build_volume, with_start
from jaxplore.tasks.volume.memory import estimate_volume
from jaxplore.tasks.volume.on_maps import ARCHITECTURES, IN_VOLUMES
from jaxplore.tasks.volume.scene import VolumeScene
from jaxplore.tasks.volume.settings import (
    GENERATED,
    VOLUME,
    VolumeExplorationSettings,
    make_volume_settings,
)
from jaxplore.tasks.volume.topics import VolumeContent

EXPLORATION_OF_VOLUME = Kind(
    name="volume",
    title="Volumes",
    place="in a volume",
    selector=VOLUME,
    settings=VolumeExplorationSettings,
    check=make_volume_settings,
    build=build_volume,
    needs=estimate_volume,
    places={name: {VOLUME: name} for name in GENERATED},
    words={VOLUME: {VOLUME: VOLUME}},
    suffixes=SUFFIXES,
    files="a mesh or another file of a volume",
    architectures=lambda _: ARCHITECTURES,
    with_start=with_start,
    on_maps=IN_VOLUMES,
    shown=(Shown(VolumeData, VolumeScene, VolumeContent),),
)
