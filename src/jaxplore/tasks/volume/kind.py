"""The kind of task in which a quadrotor explores a volume."""

from jaxplore.maps.files.volume_file import SUFFIXES
from jaxplore.report.volume.data import VolumeData
from jaxplore.tasks.kind import Kind, Shown
from jaxplore.tasks.volume.build import build_volume, with_start
from jaxplore.tasks.volume.memory import estimate_volume
from jaxplore.tasks.volume.scene import VolumeScene
from jaxplore.tasks.volume.settings import (
    GENERATED,
    VOLUME,
    VolumeExplorationSettings,
    make_volume_settings,
)
from jaxplore.tasks.volume.topics import VolumeContent

COMPARED = ("explorer", "nearest-cluster", "next-best-view", "gain-per-cost")
"""Architectures that are compared by default."""

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
    architectures=lambda _: COMPARED,
    with_start=with_start,
    shown=(Shown(VolumeData, VolumeScene, VolumeContent),),
)
