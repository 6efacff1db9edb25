"""Names of settings that set a single parameter of the controller.

The setting `controller.information_weight` and the parameter `cost.information.weight` are the same
number. The setting's name is the one that is stored.
"""

from typing import Any

from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.presets.flight import Flight
from jaxplore.planning.presets.ground_vehicle import ground_portfolio
from jaxplore.planning.presets.path_following import mpcc
from jaxplore.settings.sections import Section

PER_METRE = "progress_weight"
"""Name of a weight per metre, whose cost sums a rate over steps: the parameter has `dt` in it."""


def controller_parameter(owner: str | None, name: str) -> str | None:
    """Return the path of the controller parameter that a setting of an owner sets, see
    `jaxplore.find_parameter`; None if it sets none, several, or one with another name.
    """
    if name == "temperature" and owner in {
        each.__qualname__ for each in (explorer, mpcc, Flight, ground_portfolio)
    }:
        return "weighting.temperature"
    # The terms of these two are called like their weights.
    if name.endswith("_weight") and owner in {explorer.__qualname__, mpcc.__qualname__}:
        return f"cost.{name.removesuffix('_weight')}.weight"
    return None


def under_their_settings(entries: dict[str, Any], controller: type[Section]) -> dict[str, Any]:
    """Return settings entries whose `parameters` are without those that settings of the section
    `controller` set. A parameter overrides a setting, so it does here as well, and the run is the
    same."""
    given, section = entries.get("parameters"), entries.get("controller", {})
    # What is no mapping is refused by the check that follows.
    if not isinstance(given, dict) or not isinstance(section, dict):
        return entries
    names = {}
    for name, field in controller.model_fields.items():
        declared = field.json_schema_extra
        if isinstance(declared, dict) and name != PER_METRE:
            names[controller_parameter(str(declared["owner"]), name)] = name
    moved = {names[path]: value for path, value in given.items() if path in names}
    kept = {path: value for path, value in given.items() if path not in names}
    return {**entries, "parameters": kept, "controller": {**section, **moved}}
