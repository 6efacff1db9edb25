"""Read the tree of a parameter file of nav2: its controllers and the robot of its costmaps."""

from collections.abc import Callable, Mapping
from typing import Any

from jaxplore._files import parse_json
from jaxplore._text import short_repr

PLUGIN = "MPPIController"
"""End of the name of nav2's plugin, `nav2_mppi_controller::MPPIController`."""
PRIMARY = "primary_controller"
"""Parameter of a rotation shim: the controller that follows the path."""
MOST_LEVELS = 20
"""Largest number of dots in the name of a parameter."""
LARGEST = 1e9
"""Largest number that is accepted."""
_MOST_CORNERS = 4000
"""Longest text of a footprint [characters]."""

type Tree = Mapping[str, Any]
type Outline = float | list[tuple[float, float]] | None
"""The radius of a robot, its corners, or neither."""


def outline(tree: Tree) -> Outline:
    """Return the radius or the corners of the robot in the costmaps, or None without either."""
    for name in ("local_costmap", "global_costmap"):
        section = costmap(tree, name)
        corners = section.get("footprint")
        if isinstance(corners, str) and corners.strip() not in ("", "[]"):
            corners = _parse(name, corners)
        if isinstance(corners, list) and corners:
            try:
                return [(number("x", x), number("y", y)) for x, y in corners]
            except (TypeError, ValueError):
                given = short_repr(corners)
                raise ValueError(f"{name}.footprint is {given}; accepted: [x, y] pairs") from None
        if "robot_radius" in section:
            return number(f"{name}.robot_radius", section["robot_radius"])
    return None


def _parse(name: str, text: str) -> Any:
    try:
        return parse_json(text, _MOST_CORNERS)
    except ValueError:
        given = short_repr(text)
        raise ValueError(f"{name}.footprint is {given}; accepted: [[x, y], ...]") from None


def costmap(tree: Tree, name: str) -> Tree:
    """Return the parameters of a costmap; none if there is no such costmap."""
    outer = find(tree, lambda key, _: key == name) or {}
    return find(outer, lambda key, _: key == "ros__parameters") or {}


def controllers(tree: Tree) -> dict[str, tuple[Tree, Tree]]:
    """Return the MPPI controllers by name, each with the parameters of its server.

    One may be the primary controller of a rotation shim, whose parameters are beside those of the
    shim, or below `primary_controller` of it.
    """
    found: dict[str, tuple[Tree, Tree]] = {}
    for name, section in tree.items():
        if not isinstance(section, dict):
            continue
        primary = section.get(PRIMARY)
        inner = primary if isinstance(primary, dict) else {}
        plugins = (section.get("plugin"), primary, inner.get("plugin"))
        if any(str(each).endswith(PLUGIN) for each in plugins):
            of_shim = {key: each for key, each in section.items() if key != PRIMARY}
            found[name] = (tree, {**of_shim, **inner})
        else:
            found |= controllers(section)
    return found


def other_controllers(tree: Tree) -> dict[str, tuple[Tree, Tree]]:
    """Return the other controllers of the controller server, in the same way."""
    server = find(tree, lambda key, _: key.lstrip("/") == "controller_server") or {}
    listed = find(server, lambda key, _: key == "ros__parameters") or server
    names = listed.get("controller_plugins", [])
    named = [str(each) for each in names] if isinstance(names, list) else []
    sections = {name: listed.get(name) for name in named}
    return {
        name: (listed, section)
        for name, section in sections.items()
        if isinstance(section, dict) and "plugin" in section
    }


def find(tree: Tree, is_it: Callable[[str, Tree], bool]) -> dict[str, Any] | None:
    """Return the first mapping inside of a tree for which a function of its key and it is true."""
    for key, value in tree.items():
        if isinstance(value, dict):
            if is_it(key, value):
                return value
            inner = find(value, is_it)
            if inner is not None:
                return inner
    return None


def as_nested(values: Mapping[Any, Any]) -> dict[str, Any]:
    """Return mappings whose dotted keys, `FollowPath.vx_max`, have become mappings as well."""
    nested: dict[str, Any] = {}
    for key, value in values.items():
        *outer, last = str(key).split(".")
        if len(outer) > MOST_LEVELS:
            raise ValueError(
                f"parameter {short_repr(key)} has too many dots; accepted: {MOST_LEVELS}"
            )
        place = nested
        for name in outer:
            place = place.setdefault(name, {})
            if not isinstance(place, dict):
                raise ValueError(f"parameter {name} is {short_repr(place)}; accepted: a mapping")
        inner = as_nested(value) if isinstance(value, dict) else value
        known = place.get(last)
        place[last] = (
            {**known, **inner} if isinstance(known, dict) and isinstance(inner, dict) else inner
        )
    return nested


def as_flat(section: Tree, prefix: str = "") -> dict[str, Any]:
    """Return the parameters of a controller by their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in section.items():
        inner = as_flat(value, f"{prefix}{name}.") if isinstance(value, dict) else None
        flat |= {f"{prefix}{name}": value} if inner is None else inner
    return flat


def smoother(tree: Tree) -> dict[str, tuple[Any, Any]]:
    """Return the limits (along x, about z) of nav2's velocity smoother by their names."""
    outer = find(tree, lambda key, _: key.lstrip("/") == "velocity_smoother") or {}
    listed = find(outer, lambda key, _: key == "ros__parameters") or {}
    values = {name: listed.get(name) for name in ("max_velocity", "max_accel", "max_decel")}
    return {
        name: (each[0], each[2])
        for name, each in values.items()
        if isinstance(each, list) and len(each) == 3
    }


def number(name: str, value: object) -> float:
    """Return a value as a number, or raise a `ValueError` that names it."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not -LARGEST <= value <= LARGEST:  # type: ignore[operator]
        raise ValueError(f"{name} is {short_repr(value)}; accepted: a number")
    return float(value)  # type: ignore[arg-type]
