"""Defaults and descriptions of settings, read from their owners.

The owner of a setting is the function or class that has it as a parameter. The default stands in
the owner's signature and nowhere else. `DIFFERENCES` lists the settings with another default, and
the reason.
"""

import inspect
import math
import re
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel, Field

from jaxplore.dynamics.kinematic_bicycle import KinematicBicycle
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.planning.presets.flight import FieldNumbers, Flight

Owner = Callable[..., Any]

_ARGUMENT = re.compile(r"    (\w+): (.*)")
# A pair of numbers in brackets is an interval, as in "in [0, 1]", and no unit.
_UNIT = re.compile(r"\[(?!\d+, \d+\])([^\]]+)\]")


class DefaultDifference(NamedTuple):
    """A default of a setting that differs from its owner's, and the reason."""

    value: Any
    reason: str


def parameter_default(owner: Owner, name: str) -> Any:
    """Return the default of a parameter of a function or a class; it must have one."""
    parameters = inspect.signature(owner).parameters
    known = [each.name for each in parameters.values() if each.default is not each.empty]
    if name not in known:
        raise ValueError(
            f"parameter is {name!r} of {owner.__qualname__}; accepted: {', '.join(known)}"
        )
    return parameters[name].default


def in_degrees(angle: float) -> float:
    """Convert an angle to degrees, rounded so that the digits of pi do not show."""
    return round(math.degrees(angle), 9)


DIFFERENCES: dict[str, DefaultDifference] = {
    "drive.node.contouring.temperature": DefaultDifference(3.0, "accuracy before speed"),
    "drive.node.contouring.contouring_weight": DefaultDifference(100.0, "accuracy before speed"),
    "drive.node.contouring.lag_weight": DefaultDifference(100.0, "accuracy before speed"),
    "drive.node.contouring.progress_weight": DefaultDifference(50.0, "accuracy before speed"),
    "path.robot.max_acceleration": DefaultDifference(6.0, "a race car of F1TENTH's size"),
    "path.robot.wheelbase": DefaultDifference(0.33, "a race car of F1TENTH's size"),
    "path.robot.max_steering": DefaultDifference(0.42, "a race car of F1TENTH's size"),
    "path.robot.max_steering_rate": DefaultDifference(3.2, "a race car of F1TENTH's size"),
    "car.robot.min_speed": DefaultDifference(
        -0.5, "a car that explores drives out of dead ends backwards"
    ),
    "bicycle.robot.radius": DefaultDifference(
        parameter_default(KinematicBicycle, "radius"),
        "that of `KinematicBicycle`, which reaches beyond both axles",
    ),
    "quadrotor.robot.model": DefaultDifference("quadrotor", "what its architectures control"),
    "quadrotor.robot.radius": DefaultDifference(
        parameter_default(Quadrotor, "radius"), "that of `Quadrotor`"
    ),
    "quadrotor.robot.max_speed": DefaultDifference(
        parameter_default(Flight, "max_speed"), "that of `Flight`"
    ),
    "quadrotor.lidar.num_beams": DefaultDifference(24, "a depth camera, from the design notes"),
    "quadrotor.lidar.max_range": DefaultDifference(4.0, "a depth camera, from the design notes"),
    "quadrotor.lidar.field_of_view_degrees": DefaultDifference(
        in_degrees(parameter_default(FieldNumbers, "field_of_view")), "that of `FieldNumbers`"
    ),
    "quadrotor.lidar.range_noise": DefaultDifference(0.0, "the design notes have no range noise"),
    "quadrotor.sensor_model.kind": DefaultDifference(
        "line_of_sight", "the model of `informative_mppi`"
    ),
    "quadrotor.fields.min_information": DefaultDifference(
        3.0, "a camera of 24 beams sees less at a time"
    ),
    "quadrotor.fields.occupancy_prior": DefaultDifference(
        0.5, "the design notes have no other prior"
    ),
    "quadrotor.rates.sensing": DefaultDifference(
        50.0, "a scan at every command, as in the design notes"
    ),
}
"""Settings whose default is not their owner's, by kind of run and name.

Those of `quadrotor` hold for the architectures that default to one, those of `car` for cars that
explore, and those of `bicycle` for one of the two models of cars."""


def descriptions(owner: Owner) -> dict[str, str]:
    """Return the descriptions of an owner's parameters from its docstring, by name."""
    found: dict[str, str] = {}
    _, _, arguments = (inspect.getdoc(owner) or "").partition("\nArgs:\n")
    for line in arguments.splitlines():
        begins = _ARGUMENT.fullmatch(line)
        if begins:
            found[begins[1]] = begins[2]
        # Further lines of a description are indented more. Anything else ends the section.
        elif line.startswith(8 * " ") and found:
            found[next(reversed(found))] += " " + line.strip()
        else:
            break
    return found


def description_in(found: dict[str, str], name: str) -> str:
    """Return a description by its name; an empty one where `python -OO` left docstrings out."""
    return found.get(name, "") if sys.flags.optimize > 1 else found[name]


def unit(description: str) -> str | None:
    """Return the unit in a description, its text in square brackets; None without one."""
    found = _UNIT.search(description)
    return None if found is None else found[1]


def setting(
    owner: Owner,
    name: str,
    convert: Callable[[Any], Any] = lambda default: default,
    *,
    differs: str | None = None,
) -> Any:
    """Make a field of a section with the default and the description of an owner's parameter.

    `convert` converts from the unit of the parameter to that of the setting. `differs` is the key
    of `DIFFERENCES`, if the default is not the owner's.
    """
    own = convert(parameter_default(owner, name))
    # `arguments` finds the settings of an owner by this entry of the schema.
    return Field(
        default=own if differs is None else DIFFERENCES[differs].value,
        description=description_in(descriptions(owner), name),
        json_schema_extra={"owner": owner.__qualname__, "parameter": name, "own": own},
    )


def difference_entries(kind: str) -> dict[str, Any]:
    """Return the `DIFFERENCES` of a kind of run as settings entries."""
    entries: dict[str, Any] = {}
    for name, difference in DIFFERENCES.items():
        first, *sections, last = name.split(".")
        if first == kind:
            place = entries
            for section in sections:
                place = place.setdefault(section, {})
            place[last] = difference.value
    return entries


def arguments(section: BaseModel, owner: Owner) -> dict[str, Any]:
    """Return the settings of a section that were declared with an owner, see `setting`, as keyword
    arguments of it, in the units of the settings: angles are in degrees."""
    taken = {}
    for name, field in type(section).model_fields.items():
        source = field.json_schema_extra
        if isinstance(source, dict) and source["owner"] == owner.__qualname__:
            taken[str(source["parameter"])] = getattr(section, name)
    return taken
