"""How explorations are compared on several ROS maps."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxplore._files import YAML_SUFFIXES, read_yaml
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.packing import PACKED, pack_map, read_files
from jaxplore.maps.files.ros import map_datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.settings.architectures import GROUND
from jaxplore.settings.defaults import arguments
from jaxplore.tasks.exploration.build import build_exploration
from jaxplore.tasks.exploration.settings import Settings, merge_entries
from jaxplore.tasks.kind import Entries, OnMaps

PROTOCOL: dict[str, Any] = {
    "rates": {"control": 20.0, "sensing": 10.0, "fields": 5.0},
    "lidar": {"num_beams": 180, "max_range": 5.0},
    "resolution": 0.1,
    "target_coverage": 0.99,
    "time_limit": 900.0,
}
"""Default settings of a comparison on maps."""
QUADROTOR: dict[str, Any] = {
    "lidar": {"field_of_view_degrees": 90.0, "num_beams": 46, "range_noise": 0.02},
    "sensor_model": {"kind": "log_odds"},
    "robot": {"radius": 0.3, "max_speed": 2.0},
}
"""The same for a quadrotor, whose sensor faces ahead with the same angle between beams.

`two-layer` and `parallel` have other defaults than the ground vehicles' explorers; on maps all
variants share these. The section `fields` keeps the defaults of each architecture."""


def with_protocol(entries: Entries) -> dict[str, Any]:
    """Merge entries over the default settings of a comparison on maps."""
    robot = entries.get("robot")
    flies = isinstance(robot, Mapping) and robot.get("model") == "quadrotor"
    protocol = merge_entries(PROTOCOL, QUADROTOR) if flies else PROTOCOL
    return merge_entries(protocol, dict(entries))


def read_grid(
    path: str | os.PathLike[str], resolution: float, reading: Mapping[str, Any] | None = None
) -> OccupancyGrid:
    """Read a ROS map at the resolution of a run [m]; a finer one is resampled, a coarser one kept.

    It is relative to its datum, as in a run. `reading` are arguments of `OccupancyGrid.from_ros`.
    """
    grid = OccupancyGrid.from_ros(path, datum=map_datum(path), **(reading or {}))
    # The tolerance keeps a map from resampling when both resolutions differ by rounding only.
    is_finer = grid.resolution < resolution * (1.0 - 1e-6)
    return grid.resample(resolution) if is_finer else grid


def _plan(settings: Settings) -> tuple[OccupancyGrid, Datum]:
    reading = arguments(settings.map_file, OccupancyGrid.from_ros)
    return read_grid(settings.map, settings.resolution, reading), map_datum(settings.map)


def _is_map(path: Path) -> bool:
    if path.suffix.lower() not in YAML_SUFFIXES:
        return False
    try:
        entries = read_yaml(path)
    except ValueError:
        return False
    return "image" in entries and "resolution" in entries


ON_ROS_MAPS = OnMaps(
    files="ROS map",
    accepted="YAML files with an image and a resolution",
    is_file=_is_map,
    read=read_files,
    plan=_plan,
    build=build_exploration,
    packed=PACKED,
    pack=pack_map,
    variants=GROUND,
    with_protocol=with_protocol,
    shared=("robot", "lidar", "camera", "sensor_model", "rates"),
)
