"""Settings of an idleness map."""

from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.watch.robot import IdlenessMap
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import NonNegative, Positive, Section


class WatchSettings(Section):
    """The idleness map, for search and patrol: see `jaxplore.parts.IdlenessMap`."""

    memory: Positive | None = setting(IdlenessMap, "memory")
    weight: NonNegative = setting(IdlenessMap, "weight")
    doubling: Positive | None = setting(IdlenessMap, "doubling")


def build_watch(given: WatchSettings, _: Surroundings) -> Built:
    """Build the map."""
    return Built(IdlenessMap(**arguments(given, IdlenessMap)))


WATCH = Capability(
    name="watch",
    meaning="settings of the idleness map, for search and patrol; none when absent.",
    settings=WatchSettings,
    build=build_watch,
)
