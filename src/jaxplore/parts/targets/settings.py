"""The row of targets, which a world has and settings do not."""

from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.targets.truth import Targets


def build_targets(given: None, around: Surroundings) -> Built:
    """Build the targets of a world."""
    places = () if around.world is None else around.world.targets
    return Built(truth=Targets(places) if places else None)


TARGETS = Capability(
    name=Targets.name,
    meaning="targets of the world, all of which are to be found.",
    settings=None,
    build=build_targets,
)
