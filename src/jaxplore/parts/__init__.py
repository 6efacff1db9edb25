"""Parts of a robot: what it knows and looks for beside its map, and what is true of it.

Each part is a folder: `robot` is what runs on board, `truth` what a simulation knows, and `report`
what a run shows.
"""

import importlib
from typing import TYPE_CHECKING, Any

from jaxplore.parts.anomalies.robot import Anomalies as Anomalies
from jaxplore.parts.anomalies.robot import AnomalyTest as AnomalyTest
from jaxplore.parts.battery.robot import Battery as Battery
from jaxplore.parts.keep_out.boxes import KeepOutBoxes as KeepOutBoxes
from jaxplore.parts.keep_out.robot import KeepOut as KeepOut
from jaxplore.parts.recognition.robot import Look as Look
from jaxplore.parts.recognition.robot import ObjectClasses as ObjectClasses
from jaxplore.parts.recognition.robot import Recognition as Recognition
from jaxplore.parts.watch.robot import IdlenessMap as IdlenessMap

if TYPE_CHECKING:
    from jaxplore.parts.anomalies.truth import PlantedAnomalies as PlantedAnomalies
    from jaxplore.parts.battery.truth import TrueBattery as TrueBattery
    from jaxplore.parts.recognition.truth import Objects as Objects
    from jaxplore.parts.wheels.truth import Wheels as Wheels

_TRUTHS = {
    "Objects": "recognition.truth",
    "PlantedAnomalies": "anomalies.truth",
    "TrueBattery": "battery.truth",
    "Wheels": "wheels.truth",
}
"""Modules of the truths, which rest on the simulation: they are imported when they are used."""


def __getattr__(name: str) -> Any:
    """Import a truth when it is first used."""
    if name in _TRUTHS:
        value = getattr(importlib.import_module(f"jaxplore.parts.{_TRUTHS[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'jaxplore.parts' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List what there is, imported or not."""
    return sorted({*globals(), *_TRUTHS})
