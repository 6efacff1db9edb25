"""What the registry says of a capability, and what its part is built from."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from jaxplore.belief.part import Part
from jaxplore.maps.datum import Datum
from jaxplore.maps.world import World
from jaxplore.settings.robot import RobotSettings
from jaxplore.settings.sections import Section
from jaxplore.simulation.exploration.part_truth import PartTruth


class Surroundings(NamedTuple):
    """What a part may be built from beside its own settings.

    Args:
        datum: point to which positions are relative; those of settings are in the map's
            coordinates.
        world: the world of the run, relative to the datum; None where the map is no world.
        robot: settings of a robot on a plane; None in a volume.
        radius: radius of the robot [m].
    """

    datum: Datum
    world: World | None = None
    robot: RobotSettings | None = None
    radius: float = 0.0


class Built(NamedTuple):
    """What settings of a capability stand for.

    Args:
        part: what runs on board; None for what is only true.
        truth: what is true of it in a simulation; None for the default of the part, if it has one.
    """

    part: Part | None = None
    truth: PartTruth | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Capability:
    """A row of the registry: all that settings and commands know of a capability.

    Args:
        name: name of its section in settings files.
        meaning: what the section is, for the page of settings.
        settings: class of the section; a run without it does not have the capability. None for one
            that is given by the world alone.
        build: function that builds what checked settings stand for, or None without a section.
        dimensions: 2 for a capability of robots on a plane, 3 for one in a volume.
        control: function that returns what presets of controllers are told of it, by the name of
            their argument; nothing when absent.
        sends_robot: whether its part sends the robot to a place.
        is_on_board: whether a real robot can have it; the node does not read its settings
            otherwise.
    """

    name: str
    meaning: str
    settings: type[Section] | None
    build: Callable[[Any, Surroundings], Built]
    dimensions: int = 2
    control: Callable[[Any, Surroundings], Mapping[str, Any]] = lambda *_: {}
    sends_robot: bool = False
    is_on_board: bool = True

    def find_section(self, settings: Any) -> Section | None:
        """Return its section in settings; None if it is not given."""
        found = getattr(settings, self.name, None)
        return found if self.settings is not None and isinstance(found, self.settings) else None
