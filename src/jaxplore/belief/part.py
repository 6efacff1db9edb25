"""The protocol of a part: a capability of a robot beside its map."""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Bool, Float

from jaxplore import _kinds
from jaxplore._types import Flag, GridMask, GridValues, Pose, Position, Scalar
from jaxplore.belief.obstacles import Obstacles
from jaxplore.information.field import InformationField
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan


class Observation(NamedTuple):
    """A scan of the first sensor that is in the map, as the parts of a robot see it.

    Args:
        sensor: the first sensor.
        grid: the map after its scan, before those of the other sensors.
        scan: the scan.
        is_seen: (H, W) cells that it observed.
        pose: pose (x, y, yaw) of the robot [m, m, rad].
        elapsed: time since the last scans [s].
        time: time since the start [s]; None for the sum of the times elapsed.
        obstacles: moving obstacles that the robot knows; None without any.
    """

    sensor: Sensor
    grid: OccupancyGrid
    scan: Scan
    is_seen: GridMask
    pose: Pose
    elapsed: Scalar
    time: Scalar | None
    obstacles: Obstacles | None = None


ERRAND_RADIUS = 0.3
"""Distance from the place of an errand within which a robot must come to rest [m]."""


class Errand(NamedTuple):
    """A place, (x, y) or (x, y, z) with z up [m], to which a part sends the robot.

    If `is_due`, the robot must go there now, before all else, and come to rest within
    `ERRAND_RADIUS`.
    """

    place: Float[Array, " D"]
    is_due: Flag


class Part(eqx.Module):
    """A capability of a robot: what it knows beside the map, and what that adds to the fields.

    A `Perception` has parts. The state of each is in `Belief.parts` under its `name`. All methods
    have a default that does nothing, so a part writes those that it needs. A part is traced: what
    it returns has the same shapes at every step.
    """

    name: ClassVar[str]
    """Name of the part, under which its state is kept; no two parts of a robot share one."""
    dimensions: ClassVar[tuple[int, ...]] = (2,)
    """2 for a part of the plane, 3 for one of a volume. In a volume `init` and `closed_cells` have
    a `VoxelGrid` and masks (D, H, W), places have z, and of the other methods `look`, `errand` and
    `plan_errand` are called."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Names of the parts that must come before it."""
    is_revisiting: ClassVar[bool] = True
    """Whether places must be seen again for it, so that none is given up."""
    is_patrol: ClassVar[bool] = False
    """Whether the map is no end of a run of a robot with it, unless that is asked for."""

    def check(self, sensors: Sequence[Sensor], ground: Ground | None) -> None:
        """Check that a robot with these sensors on this ground can have the part.

        Args:
            sensors: sensors of the robot.
            ground: ground of the map; None if it is level.

        Raises:
            ValueError: it cannot.
        """

    def init(self, grid: Any) -> Any:
        """Return the state before the first scan; None if the task gives one, or none is kept.

        Args:
            grid: the map that the robot knows in advance.
        """
        return None

    def unplaced(self) -> "Part":
        """Return the part of a robot on board, which learns with its first pose where it is.

        Nothing that has a place counts in a state of it before `locate`.
        """
        return self

    def locate(self, own: Any, grid: Any, origin: Position) -> Any:
        """Return the state of a robot whose coordinates begin at `origin`.

        Args:
            own: the state before the first scan.
            grid: the map that the robot knows in advance.
            origin: position (x, y) in the coordinates in which the part was given its places [m].
        """
        return own

    def observe(self, own: Any, observation: Observation) -> Any:
        """Return the state after a scan that was mapped.

        Args:
            own: the state before.
            observation: the scan.
        """
        return own

    def look(self, own: Any, measured: Any, time: Scalar) -> Any:
        """Return the state after a measurement by an instrument of the part's own.

        Args:
            own: the state before.
            measured: what the instrument says.
            time: time since the start [s].
        """
        return own

    def interest(self, own: Any) -> GridValues | None:
        """Return the information of seeing each cell (H, W) beside that on the map [nat], or None.

        Args:
            own: the state.
        """
        return None

    def add_information(
        self, own: Any, field: InformationField, grid: OccupancyGrid, sensor: Sensor
    ) -> InformationField:
        """Return the information field with what the part adds to it.

        Args:
            own: the state.
            field: the field.
            grid: the robot's map.
            sensor: the first sensor.
        """
        return field

    def closed_cells(self, own: Any) -> Bool[Array, "*cells"] | None:
        """Return the cells (H, W) that the robot must not enter, or None.

        Nothing is to be learned there either.

        Args:
            own: the state.
        """
        return None

    def found(self, own: Any) -> Bool[Array, " N"] | None:
        """Return which of the things that are looked for have been found by the part, or None.

        It is for a part that finds them another way than by having them in sight.

        Args:
            own: the state.
        """
        return None

    def errand(self, own: Any) -> Errand | None:
        """Return the place to which the robot is sent, and whether it must go there; or None.

        While it must, the place is the only one that guidance leads to, and nothing else ends the
        task.

        Args:
            own: the state.
        """
        return None

    def plan_errand(self, own: Any, way: Scalar) -> Any:
        """Return the state with the decision whether the errand is due, when fields are updated.

        Args:
            own: the state before.
            way: cost-to-go from the robot to the place through known free space [m]; infinite
                without a way.
        """
        return own

    def merge(self, own: Any, told: Any, is_heard: Bool[Array, " N"]) -> Any:
        """Return the state of a robot after the robots of its fleet have told it theirs.

        They tell it again and again, in any order, so nothing may count twice: least, greatest and
        newest values are merged, sums are not. A part that does not override it has no place in a
        fleet.

        Args:
            own: the state.
            told: states of N robots, stacked along a first axis.
            is_heard: (N,) which of them the robot hears.

        Raises:
            ValueError: a part that has no place in a fleet, see `check_fleet`.
        """
        self.check_fleet()
        return own

    def check_fleet(self) -> None:
        """Check that a robot of a fleet can have the part.

        Raises:
            ValueError: it cannot.
        """
        if type(self).merge is Part.merge:
            raise ValueError(
                f"{self.name} is a {type(self).__name__}; accepted in a fleet: parts with `merge`"
            )

    @property
    def closes_cells(self) -> bool:
        """Whether there are cells that the robot must not enter."""
        return type(self).closed_cells is not Part.closed_cells

    @property
    def finds_things(self) -> bool:
        """Whether what is looked for counts as found by the part."""
        return type(self).found is not Part.found

    @property
    def has_errands(self) -> bool:
        """Whether the part sends the robot somewhere."""
        return type(self).errand is not Part.errand

    @property
    def has_instrument(self) -> bool:
        """Whether an instrument of its own measures for the part."""
        return type(self).look is not Part.look

    @property
    def adds_information(self) -> bool:
        """Whether the part changes the field itself: such a field is made anew at each update."""
        return type(self).add_information is not Part.add_information


@_kinds.check_arguments
def as_parts(
    parts: Sequence[Part],
    sensors: Sequence[Sensor],
    ground: Ground | None,
    dimensions: int = 2,
) -> tuple[Part, ...]:
    """Return parts as a tuple, each checked against the sensors, the ground and the other parts."""
    if not isinstance(parts, (list, tuple)):
        _kinds.instance("parts", parts, list, tuple)
    names: list[str] = []
    for index, each in enumerate(parts):
        if dimensions not in each.dimensions:
            kinds = {2: "the plane", 3: "a volume"}
            given = f"{type(each).__name__}, of {kinds[each.dimensions[0]]}"
            raise ValueError(f"parts[{index}] is a {given}; accepted: parts of {kinds[dimensions]}")
        if each.name in names:
            raise ValueError(
                f"parts[{index}] is a second {each.name!r}; accepted: one part of a name"
            )
        missing = [name for name in each.needs if name not in names]
        if missing:
            raise ValueError(
                f"parts has no {missing[0]!r} before {each.name!r}; accepted: both, in this order"
            )
        each.check(sensors, ground)
        names.append(each.name)
    return tuple(parts)
