"""What the registry says of a capability, and what its part is built from."""

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from jaxplore.belief.part import Part
from jaxplore.maps.datum import Datum
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.world import World
from jaxplore.settings.robot import RobotSettings
from jaxplore.settings.sections import Section
from jaxplore.simulation.disturbances import Disturbance
from jaxplore.simulation.exploration.part_truth import PartTruth


class Surroundings(NamedTuple):
    """What a part may be built from beside its own settings.

    Args:
        datum: point to which positions are relative; those of settings are in the map's
            coordinates.
        world: the world of the run, relative to the datum; None where the map is no world.
        robot: settings of a robot on a plane; None in a volume.
        radius: radius of the robot [m].
        grid: the true map or volume; None where it is not known, as on board.
        ground: the ground that the robot knows; None if it is level.
        seed: seed of the run.
        has_others: whether there are other robots.
        sensors: sensors of the robot in the plane.
        is_map_known: whether the robot knows the map in advance.
    """

    datum: Datum
    world: World | None = None
    robot: RobotSettings | None = None
    radius: float = 0.0
    grid: OccupancyGrid | VoxelGrid | None = None
    ground: Ground | None = None
    seed: int = 0
    has_others: bool = False
    sensors: tuple[Any, ...] = ()
    is_map_known: bool = False


class Built(NamedTuple):
    """What settings of a capability stand for.

    Args:
        part: what runs on board; None for what is only true.
        truth: what is true of it in a simulation; None for the default of the part, if it has one.
        perception: further arguments of the `Perception` in the plane.
        disturbance: what makes the simulated robot differ from its model.
        scenario: further arguments of the scenario.
    """

    part: Part | None = None
    truth: PartTruth | None = None
    perception: Mapping[str, Any] = MappingProxyType({})
    disturbance: Disturbance | None = None
    scenario: Mapping[str, Any] = MappingProxyType({})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Capability:
    """A row of the registry: all that settings and commands know of a capability.

    Args:
        name: name of its section in settings files.
        meaning: what the section is, for the page of settings.
        settings: class of the section; None for one that is given by the world alone.
        is_optional: whether a run without the section does not have the capability. Otherwise the
            section has its defaults there.
        build: function that builds what checked settings stand for, or None without a section.
        dimensions: 2 for a capability of robots on a plane, 3 for one in a volume, 1 for one along
            a path; None for all.
        control: function that returns what presets of controllers are told of it, by the name of
            their argument; nothing when absent.
        sends_robot: whether its part sends the robot to a place.
        is_on_board: whether a real robot can have it; the node does not read its settings
            otherwise.
        on_board: settings of a real robot where they are not given.
    """

    name: str
    meaning: str
    settings: type[Section] | None
    build: Callable[[Any, Surroundings], Built]
    dimensions: int | None = 2
    control: Callable[[Any, Surroundings], Mapping[str, Any]] = lambda *_: {}
    sends_robot: bool = False
    is_optional: bool = True
    is_on_board: bool = True
    on_board: Mapping[str, Any] = MappingProxyType({})

    def find_section(self, settings: Any) -> Section | None:
        """Return its section in settings; None if it is not given."""
        found = getattr(settings, self.name, None)
        # A row of the plane and one of the volume may share a name, and one class be the other's.
        return found if type(found) is self.settings else None
