"""The registry of capabilities. Nothing else lists them."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import Field, create_model

from jaxplore.belief.part import Part
from jaxplore.parts.anomalies.settings import ANOMALIES
from jaxplore.parts.battery.settings import BATTERY, BATTERY_IN_VOLUME
from jaxplore.parts.capability import Capability, Surroundings
from jaxplore.parts.faults.settings import FAULTS
from jaxplore.parts.keep_out.settings import KEEP_OUT, KEEP_OUT_BOXES
from jaxplore.parts.localisation.settings import LOCALISATION, LOCALISATION_IN_VOLUME
from jaxplore.parts.moving.settings import PEOPLE, PEOPLE_IN_VOLUME
from jaxplore.parts.recognition.settings import DETECTOR
from jaxplore.parts.targets.settings import TARGETS
from jaxplore.parts.variation.settings import VARIATION
from jaxplore.parts.watch.settings import WATCH
from jaxplore.parts.wheels.settings import CHASSIS
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.disturbances import Disturbance
from jaxplore.simulation.exploration.part_truth import PartTruth

CAPABILITIES: tuple[Capability, ...] = (
    VARIATION,
    FAULTS,
    PEOPLE,
    PEOPLE_IN_VOLUME,
    WATCH,
    ANOMALIES,
    KEEP_OUT,
    KEEP_OUT_BOXES,
    TARGETS,
    DETECTOR,
    CHASSIS,
    BATTERY,
    BATTERY_IN_VOLUME,
    LOCALISATION,
    LOCALISATION_IN_VOLUME,
)
"""Capabilities, a row each. A robot has its parts and its disturbances in this order."""


class Equipment(NamedTuple):
    """What a robot has beside its map, what is given as true of it, arguments of its `Perception`,
    what disturbs it, and arguments of its scenario."""

    parts: tuple[Part, ...]
    truths: tuple[PartTruth, ...]
    perception: dict[str, Any]
    disturbances: tuple[Disturbance, ...]
    scenario: dict[str, Any]


def with_capabilities[Settings: RunSettings](
    kind: type[Settings], dimensions: int = 2
) -> type[Settings]:
    """Return a class of settings with a section for each capability."""
    sections: dict[str, Any] = {
        each.name: (
            (each.settings | None, Field(default=None, description=each.meaning))
            if each.is_optional
            else (each.settings, Field(default=each.settings(), description=each.meaning))
        )
        for each in CAPABILITIES
        if each.settings is not None and each.dimensions in (None, dimensions)
    }
    made: type[Settings] = create_model(
        kind.__name__, __base__=kind, __module__=kind.__module__, __doc__=kind.__doc__, **sections
    )
    return made


def build_parts(settings: RunSettings, surroundings: Surroundings) -> Equipment:
    """Build the parts that settings describe, and their truths.

    Raises:
        ValueError: settings that a part rejects.
    """
    built = [each.build(own, surroundings) for each, own in _given(settings)]
    return Equipment(
        tuple(each.part for each in built if each.part is not None),
        tuple(each.truth for each in built if each.truth is not None),
        {name: value for each in built for name, value in each.perception.items()},
        tuple(each.disturbance for each in built if each.disturbance is not None),
        {name: value for each in built for name, value in each.scenario.items()},
    )


def control_arguments(settings: RunSettings, surroundings: Surroundings) -> dict[str, Any]:
    """Return what presets of controllers are told of the capabilities that settings describe."""
    told = (each.control(own, surroundings) for each, own in _given(settings))
    return {name: value for each in told for name, value in each.items()}


def _given(settings: RunSettings) -> Iterator[tuple[Capability, Any]]:
    """Yield the capabilities whose section is given, and the section; None of those without."""
    for each in CAPABILITIES:
        own = each.find_section(settings)
        if own is not None or each.settings is None:
            yield each, own
