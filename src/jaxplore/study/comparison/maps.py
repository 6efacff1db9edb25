"""Maps of a comparison: files in folders or names of generated ones, and their starts."""

import contextlib
import dataclasses
import hashlib
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.tasks.exploration.settings import read_settings
from jaxplore.tasks.kind import Entries, Kind, OnMaps
from jaxplore.tasks.registry import KINDS, default_kind, files_of

STARTS = "starts.yaml"
"""File in a folder of maps with starts, NAME: [x, y, yaw]."""

Start = tuple[float, ...]
"""Pose (x, y, yaw), or (x, y, z, yaw) in a volume [m, rad]."""


@dataclasses.dataclass(frozen=True)
class MapFile:
    """A map, a volume or a path: its name in the results, the absolute path of its file, a hash of
    that file and of what belongs to it, a start if it has its own, and the setting that names it.
    The path of a generated one is its name, and its content is empty."""

    name: str
    path: str
    content: str
    start: Start | None = None
    selector: str = default_kind().selector


def kind_of_map(selector: str) -> tuple[Kind, OnMaps]:
    """Return the kind of task that a setting selects, and how it is compared on maps."""
    kind = next(each for each in KINDS.values() if each.selector == selector)
    return kind, files_of(selector)


def maps_in(places: str | os.PathLike[str], kind: Kind | None = None) -> tuple[MapFile, ...]:
    """Find the maps of a comparison, sorted by name.

    `places` is a folder, a file or the name of a generated one, or several separated by commas. All
    are of one kind of task: the first one that has files there when `kind` is absent. Folders are
    searched with the folders in them. The name of a map is the stem of its file. If that is
    ambiguous or just `map`, it is the name of its folder; if that is ambiguous too, FOLDER-FILE.
    Starts are read from `starts.yaml` in a folder.

    Raises:
        ValueError: a folder that cannot be read or has no maps, a file of another kind, two maps
            with the same name, starts that are not accepted.
    """
    whole = os.fspath(places)
    parts = [whole] if "," not in whole or os.path.lexists(whole) else whole.split(",")
    named = [part.strip() for part in parts]
    listed = {part: _files_at(part) for part in named if not _is_generated(part)}
    kinds = [each for each in KINDS.values() if each.on_maps] if kind is None else [kind]
    some = next((each for each in kinds if _has_some(each, named, listed)), kinds[0])
    _, compared = kind_of_map(some.selector)
    paths, generated = list[Path](), list[MapFile]()
    for part in named:
        if part in compared.names:
            generated.append(MapFile(part, part, "", selector=some.selector))
            continue
        found = [path for path in listed.get(part, ()) if compared.is_file(path)]
        if not found:
            what = (
                f"folder of maps {part!r} holds no {compared.files}, neither do the folders in it"
            )
            if not os.path.isdir(part):
                what = f"{part!r} is no {compared.files}"
            names = f", or {', '.join(compared.names)}" if compared.names else ""
            raise ValueError(f"{what}; accepted: {compared.accepted}{names}")
        paths += found
    files = [
        MapFile(name, str(path), _hash(compared.read(str(path))), selector=some.selector)
        for name, path in zip(_names(paths), paths, strict=True)
    ]
    maps = tuple(sorted([*files, *generated], key=lambda each: (each.name, each.path)))
    _check_names(maps)
    for part in listed:
        file = Path(os.path.realpath(part)) / STARTS
        maps = with_starts(maps, file) if file.is_file() else maps
    return maps


def _is_generated(name: str) -> bool:
    return any(each.on_maps is not None and name in each.on_maps.names for each in KINDS.values())


def _all_files() -> str:
    return ", ".join(f"{each.on_maps.files}s" for each in KINDS.values() if each.on_maps)


def _files_at(place: str) -> list[Path]:
    """Return the files of a folder and of the folders in it, or a file itself."""
    top = Path(os.path.realpath(place))
    if top.is_file():
        return [top]
    try:
        inner = sorted(path for path in top.iterdir() if path.is_dir() and path.name[0] != ".")
        return [path for each in (top, *inner) for path in sorted(each.iterdir())]
    except OSError as error:
        raise ValueError(
            f"folder of maps {place!r} cannot be read: {error.strerror}; accepted: a folder with "
            f"{_all_files()}"
        ) from None


def _has_some(kind: Kind, named: Sequence[str], listed: Mapping[str, Sequence[Path]]) -> bool:
    compared = kind.on_maps
    if compared is None:
        return False
    names = any(part in compared.names for part in named)
    return names or any(compared.is_file(path) for found in listed.values() for path in found)


def with_starts(maps: tuple[MapFile, ...], file: str | os.PathLike[str]) -> tuple[MapFile, ...]:
    """Set the starts of maps from a YAML file, a mapping NAME: [x, y, yaw] [m, m, rad].

    In a volume it is [x, y, z, yaw]. A map that is not in the file keeps its start. An unknown name
    raises a ValueError.
    """
    starts = {str(name): value for name, value in read_settings(file).items()}
    known = [each.name for each in maps]
    for name in starts:
        if name not in known:
            raise ValueError(
                f"{os.fspath(file)} has a start on {name!r}; accepted: the maps {', '.join(known)}"
            )
    return tuple(
        dataclasses.replace(each, start=_start(file, each, starts[each.name]))
        if each.name in starts
        else each
        for each in maps
    )


def read_plans(maps: Sequence[MapFile], entries: Entries) -> dict[str, tuple[OccupancyGrid, Datum]]:
    """Return the plan of each map by name, and its datum, without maps that cannot be read.

    The entries are those of the runs.
    """
    plans = {}
    for each in maps:
        kind, compared = kind_of_map(each.selector)
        with contextlib.suppress(ValueError):
            run = kind.make_settings({**entries, each.selector: each.path})
            plans[each.name] = compared.plan(run)
    return plans


def _hash(parts: Sequence[bytes | None]) -> str:
    # Hashes are hashed, so that bytes that move from one file to the other change the result.
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part or b"").digest())
    return whole.hexdigest()[:20]


def _names(paths: list[Path]) -> list[str]:
    stems = Counter(path.stem for path in paths)
    short = [
        path.parent.name if path.stem == "map" or stems[path.stem] > 1 else path.stem
        for path in paths
    ]
    times = Counter(short)
    return [
        name if times[name] == 1 else f"{path.parent.name}-{path.stem}"
        for name, path in zip(short, paths, strict=True)
    ]


def _check_names(maps: Sequence[MapFile]) -> None:
    # Results are listed by name, so no two maps may share one.
    for name, number in Counter(each.name for each in maps).items():
        if number > 1:
            same = [each.path for each in maps if each.name == name]
            raise ValueError(f"two maps have the name {name}: {', '.join(same)}; accepted: one")


def _start(file: str | os.PathLike[str], map_: MapFile, value: Any) -> Start:
    names = kind_of_map(map_.selector)[1].start
    units = ", ".join("rad" if name == "yaw" else "m" for name in names)
    reason = (
        f"{os.fspath(file)}: the start on {map_.name} is {value!r}; accepted: "
        f"[{', '.join(names)}], finite numbers [{units}]"
    )
    if not isinstance(value, list | tuple) or len(value) != len(names):
        raise ValueError(reason)
    for each in value:
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            raise ValueError(reason)
    return tuple(map(float, value))
