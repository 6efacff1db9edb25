"""What is true of the parts of a robot in a simulation."""

from collections.abc import Callable, Sequence

from jaxplore import _kinds
from jaxplore.belief.part import Part
from jaxplore.parts.anomalies.truth import PlantedAnomalies
from jaxplore.parts.battery.truth import TrueBattery
from jaxplore.parts.recognition.truth import Objects
from jaxplore.parts.watch.truth import WatchTruth
from jaxplore.parts.wheels.truth import Wheels
from jaxplore.simulation.exploration.part_truth import PartTruth

TRUTHS: tuple[type[PartTruth], ...] = (
    WatchTruth,
    PlantedAnomalies,
    Objects,
    Wheels,
    TrueBattery,
)
"""Truths that come with the package, a row each. A run that is read finds their reports here."""
DEFAULTS: dict[str, Callable[[], PartTruth]] = {
    each.name: each for each in (WatchTruth, PlantedAnomalies, Objects)
}
"""Truth of a part for which none is given, by the name of the part."""


def as_truths(truths: Sequence[PartTruth], parts: Sequence[Part]) -> tuple[PartTruth, ...]:
    """Return the truths of a robot's parts in the order of the parts, and then the others.

    Raises:
        ValueError: something that is no truth, two of one name, or one of a part that the robot
            does not have.
    """
    _kinds.instances("truths", truths, PartTruth)
    given: dict[str, PartTruth] = {}
    names = [part.name for part in parts]
    for index, each in enumerate(truths):
        if each.name in given:
            raise ValueError(
                f"truths[{index}] is a second {each.name!r}; accepted: one truth of a name"
            )
        if each.needs_part and each.name not in names:
            raise ValueError(
                f"truths[{index}] is a {type(each).__name__}, and the perception has no part "
                f"{each.name!r}; accepted: truths of its parts"
            )
        given[each.name] = each
    of_parts = [
        given.get(name) or DEFAULTS[name]() for name in names if name in {*given, *DEFAULTS}
    ]
    return (*of_parts, *(each for name, each in given.items() if name not in names))
