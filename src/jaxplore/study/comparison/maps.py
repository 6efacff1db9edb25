"""Maps of a comparison: ROS maps in a folder, and start poses."""

import contextlib
import dataclasses
import hashlib
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._files import read_yaml
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.packing import read_files
from jaxplore.maps.files.ros import map_datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.tasks.exploration.settings import read_settings

STARTS = "starts.yaml"
"""File in a folder of maps with start poses, NAME: [x, y, yaw]."""

Start = tuple[float, float, float]
"""Pose (x, y, yaw) [m, m, rad]."""

_SUFFIXES = (".yaml", ".yml")


@dataclasses.dataclass(frozen=True)
class MapFile:
    """A ROS map: its name in the results, and the absolute path of its YAML file.

    `content` is a hash of that file and of its image; a missing image counts as an empty one. The
    start is a pose; the position with the greatest clearance, heading along x, when None.
    """

    name: str
    path: str
    content: str
    start: Start | None = None


def maps_in(folder: str | os.PathLike[str]) -> tuple[MapFile, ...]:
    """Find the ROS maps in a folder and its subfolders, sorted by name.

    A map is a YAML file with an image and a resolution. Its name is the stem of the file. If that
    is ambiguous or just `map`, it is the name of its folder; if that is ambiguous too, FOLDER-FILE.
    Start poses are read from `starts.yaml` in the folder.

    Raises:
        ValueError: no folder, a folder without maps, two maps with the same name, start poses that
            are not accepted.
    """
    top = Path(os.path.realpath(folder))
    try:
        inner = sorted(path for path in top.iterdir() if path.is_dir() and path.name[0] != ".")
        files = [path for each in (top, *inner) for path in sorted(each.iterdir())]
    except OSError as error:
        raise ValueError(
            f"folder of maps {os.fspath(folder)!r} cannot be read: {error.strerror}; accepted: a "
            "folder with ROS maps"
        ) from None
    paths = [path for path in files if path.suffix.lower() in _SUFFIXES and _is_map(path)]
    if not paths:
        raise ValueError(
            f"folder of maps {os.fspath(folder)!r} holds no ROS map, neither do the folders in it; "
            "accepted: YAML files with an image and a resolution"
        )
    maps = tuple(
        MapFile(name, str(path), _content(path))
        for name, path in sorted(zip(_names(paths), paths, strict=True))
    )
    file = top / STARTS
    return with_starts(maps, file) if file.is_file() else maps


def with_starts(maps: tuple[MapFile, ...], file: str | os.PathLike[str]) -> tuple[MapFile, ...]:
    """Set the start poses of maps from a YAML file with a mapping NAME: [x, y, yaw] [m, m, rad].

    A map that is not in the file keeps its start. An unknown name raises a ValueError.
    """
    starts = {str(name): value for name, value in read_settings(file).items()}
    known = [each.name for each in maps]
    for name in starts:
        if name not in known:
            raise ValueError(
                f"{os.fspath(file)} has a start on {name!r}; accepted: the maps {', '.join(known)}"
            )
    return tuple(
        dataclasses.replace(each, start=_start(file, each.name, starts[each.name]))
        if each.name in starts
        else each
        for each in maps
    )


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


def read_grids(
    maps: Sequence[MapFile], resolution: float, reading: Mapping[str, Any] | None = None
) -> dict[str, OccupancyGrid]:
    """Read maps by name, without those that cannot be read; see `read_grid`."""
    grids = {}
    for each in maps:
        with contextlib.suppress(ValueError):
            grids[each.name] = read_grid(each.path, resolution, reading)
    return grids


def read_datums(maps: Sequence[MapFile]) -> dict[str, Datum]:
    """Read the datums of maps by name, without those of maps that cannot be read."""
    datums = {}
    for each in maps:
        with contextlib.suppress(ValueError):
            datums[each.name] = map_datum(each.path)
    return datums


def _is_map(path: Path) -> bool:
    try:
        entries = read_yaml(path)
    except ValueError:
        return False
    return "image" in entries and "resolution" in entries


def _content(path: Path) -> str:
    parts = [each or b"" for each in read_files(path)]
    # Hashes are hashed, so that bytes that move from one file to the other change the result.
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()[:20]


def _names(paths: list[Path]) -> list[str]:
    stems = Counter(path.stem for path in paths)
    short = [
        path.parent.name if path.stem == "map" or stems[path.stem] > 1 else path.stem
        for path in paths
    ]
    times = Counter(short)
    names = [
        name if times[name] == 1 else f"{path.parent.name}-{path.stem}"
        for name, path in zip(short, paths, strict=True)
    ]
    # Results are listed by name, so no two maps may share one.
    for name, number in Counter(names).items():
        if number > 1:
            same = [str(path) for each, path in zip(names, paths, strict=True) if each == name]
            raise ValueError(f"two maps have the name {name}: {', '.join(same)}; accepted: one")
    return names


def _start(file: str | os.PathLike[str], name: str, value: Any) -> Start:
    reason = (
        f"{os.fspath(file)}: the start on {name} is {value!r}; accepted: [x, y, yaw], finite "
        "numbers [m, m, rad]"
    )
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError(reason)
    for each in value:
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            raise ValueError(reason)
    x, y, yaw = map(float, value)
    return x, y, yaw
