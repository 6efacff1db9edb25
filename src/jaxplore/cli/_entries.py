"""Conversion of options to settings entries."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._files import YAML_SUFFIXES, parse_yaml, yaml_beside
from jaxplore._spelling import match_spelling
from jaxplore._text import printable_path, short_repr
from jaxplore.maps.files.volume_file import SUFFIXES
from jaxplore.settings.exploration import (
    OFFICE,
    SCENARIOS,
    ZONES,
    is_scenario_file,
    read_settings,
)
from jaxplore.settings.fleet import FLEET
from jaxplore.settings.node import part_node
from jaxplore.settings.path import PATH, TRACK
from jaxplore.settings.volume import GENERATED, VOLUME, names_volume

_OF_PATHS = {"laps": "laps", "obstacles": "obstacles.number"}
"""Options of path following only, and their settings."""
_OF_VOLUMES = (
    "seed",
    "time_limit",
    "start",
    "goal",
    "people__number",
    "people__speed",
    "target_coverage",
    "resolution",
    "architecture",
    "robot__radius",
    "robot__max_speed",
    "controller__num_samples",
)
"""Options of the exploration of a volume."""
_OF_BOTH = (
    "seed",
    "time_limit",
    "start",
    "robot__model",
    "robot__radius",
    "robot__max_speed",
    "controller__num_samples",
)
"""Options of both exploration and path following."""


def option_entries(options: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values of the options of `with_options` and `path_options` to settings entries."""
    given = dict(options)
    settings_file, assignments = given.pop("settings_file"), given.pop("assignments")
    trust = given.pop("trust", False)
    # The section of the node, in a file that a drive reads too, is checked and not read.
    file = {} if settings_file is None else read_settings(settings_file, is_trusted=trust)
    entries, _ = part_node(file)
    entries = _with_map(entries, given.pop("map_"), given.pop("path_file", None), trust)
    along_path, in_volume = PATH in entries, VOLUME in entries
    for name, value in given.items():
        if value is None:
            continue
        if along_path and name not in (*_OF_PATHS, *_OF_BOTH):
            raise ValueError(
                f"{name.replace('__', '.')} is {value} beside a path; accepted: with a map"
            )
        if in_volume and name not in _OF_VOLUMES:
            raise ValueError(
                f"{name.replace('__', '.')} is {value} beside a volume; accepted: with a map"
            )
        if not along_path and name in _OF_PATHS:
            raise ValueError(f"--{name} is {value}; accepted: along a path")
        assign(entries, _OF_PATHS.get(name, name.replace("__", ".")), value)
    if not (along_path or in_volume) and given["controller__num_samples"] is not None:
        # The option sets the number of rollouts of every architecture.
        for section in ("informative", "portfolio"):
            assign(entries, f"{section}.num_samples", given["controller__num_samples"])
    # `--set` comes last, so that it overrides all other options.
    assign_all(entries, assignments)
    return entries


def _with_map(
    entries: dict[str, Any], map_: str | None, file: str | None, trust: bool
) -> dict[str, Any]:
    """Add the map or the path that the options name to settings entries."""
    if file is not None and map_ not in (None, PATH):
        raise ValueError(f"--path is {file!r} beside the map {map_!r}; accepted: one of them")
    if file is not None:
        return {**entries, PATH: str(Path(file).absolute())}
    if map_ == PATH:
        # The generated track is only a default: the settings file may name a path.
        return {PATH: TRACK, **entries}
    if map_ is None:
        return entries
    if map_ == FLEET:
        # The word stands for the default map, unless the settings file names one.
        return {"map": OFFICE, FLEET: {}, **entries}
    if names_volume(map_):
        # The word `volume` stands for what the settings file names, or the default.
        if map_ == VOLUME:
            return entries if VOLUME in entries else {VOLUME: map_, **entries}
        if map_ not in GENERATED:
            _check_file(Path(map_))
            map_ = str(Path(map_).absolute())
        return {**entries, VOLUME: map_}
    # The settings file overrides those of a scenario, but not the map that the user names.
    named = map_entries(map_, is_trusted=trust)
    return {**named, **entries, "map": named["map"]}


def folder_name(entries: Mapping[str, Any]) -> str:
    """Return a name for folders from the map or path of settings entries.

    A file that is just called `map` is named by its folder, as in a comparison on maps.
    """
    if entries.get(PATH) == TRACK:
        return PATH
    file = Path(str(entries.get(PATH, entries.get(VOLUME, entries.get("map")))))
    name = file.parent.name if file.stem == "map" and file.parent.name else file.stem
    return name if entries.get(FLEET) is None else f"{name}-{FLEET}"


def map_entries(name: str, *, is_trusted: bool = False) -> dict[str, Any]:
    """Return settings entries for a map, a world or a scenario, given by its file or name.

    A file that names code must be trusted.
    """
    name = match_spelling(name, SCENARIOS)
    if name in (OFFICE, ZONES, *SCENARIOS):
        return {"map": name}
    _check_file(Path(name))
    if is_scenario_file(name):
        return {"map": str(Path(name).absolute()), **read_settings(name, is_trusted=is_trusted)}
    return {"map": str(Path(name).absolute())}


def _check_file(path: Path) -> None:
    """Raise a `ValueError` that names what there is, if a map is not a file."""
    accepted = (
        "the YAML file of a ROS map, of a world or of a scenario, a mesh or another file of a "
        f"volume, or {', '.join((OFFICE, ZONES, *SCENARIOS, FLEET, PATH, *GENERATED))} or {VOLUME}"
    )
    if path.is_dir():
        inside = sorted(path.glob("*.yaml"))
        example = f", such as {printable_path(inside[0])}" if inside else ""
        raise ValueError(f"{printable_path(path)} is a folder; accepted: a file{example}")
    if not path.exists():
        raise ValueError(f"{printable_path(path)} is not there; accepted: {accepted}")
    endings = (*YAML_SUFFIXES, *SUFFIXES)
    if path.suffix and path.suffix.lower() not in endings:
        beside = yaml_beside(path)
        named = "" if beside is None else f"{printable_path(beside)}, which is beside it, or "
        raise ValueError(
            f"{printable_path(path)} is of another kind; accepted: {named}a file that ends with "
            f"{', '.join(endings)}"
        )


def assign(entries: dict[str, Any], name: str, value: Any) -> None:
    """Set one setting by its dotted name; sections that are missing are made."""
    *sections, last = name.split(".")
    for section in sections:
        inner = entries.setdefault(section, {})
        if not isinstance(inner, dict):
            raise ValueError(f"setting {section} is {short_repr(inner)}; accepted: a mapping")
        entries = inner
    entries[last] = value


def assign_all(entries: dict[str, Any], assignments: Sequence[str]) -> None:
    """Set the settings of the `--set` options, NAME=VALUE each, with values in YAML."""
    for assignment in assignments:
        name, separator, text = assignment.partition("=")
        if not separator:
            raise ValueError(f"--set is {short_repr(assignment)}; accepted: NAME=VALUE")
        try:
            value = parse_yaml(text)
        except ValueError as error:
            raise ValueError(
                f"--set is {short_repr(assignment)} ({error}); accepted: a value in YAML"
            ) from None
        assign(entries, name.strip(), value)
