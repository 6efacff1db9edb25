"""Settings of areas and boxes that robots must not enter."""

from typing import Annotated

from pydantic import Field

from jaxplore._limits import MOST_NAMES
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.keep_out.boxes import KeepOutBoxes
from jaxplore.parts.keep_out.robot import KeepOut
from jaxplore.settings.sections import Real, Section

Corners = Annotated[tuple[tuple[Real, Real], ...], Field(max_length=MOST_NAMES)]
Box = tuple[Real, Real, Real, Real, Real, Real]


class KeepOutSettings(Section):
    """Areas that robots must not enter: see `jaxplore.parts.KeepOut`.

    Args:
        areas: polygons, each a list of its corners (x, y), in the map's coordinates [m].
        mask: YAML file of a ROS map whose occupied cells must not be entered, as that of nav2's
            keep-out filter; none when absent.
    """

    areas: Annotated[tuple[Corners, ...], Field(max_length=MOST_NAMES)] = ()
    mask: str | None = None


class BoxSettings(Section):
    """Boxes that the robot must not enter: see `jaxplore.parts.KeepOutBoxes`.

    Args:
        boxes: boxes (x_min, y_min, z_min, x_max, y_max, z_max) with z up [m].
    """

    boxes: Annotated[tuple[Box, ...], Field(max_length=MOST_NAMES)] = ()


def build_keep_out(given: KeepOutSettings, around: Surroundings) -> Built:
    """Build the areas."""
    datum = around.datum
    areas = [datum.to_local([list(corner) for corner in area]) for area in given.areas]
    mask = None if given.mask is None else OccupancyGrid.from_ros(given.mask, datum=datum)
    return Built(KeepOut(areas, mask))


def build_boxes(given: BoxSettings, around: Surroundings) -> Built:
    """Build the boxes."""
    to_local = around.datum.to_local
    return Built(KeepOutBoxes([[*to_local(box[:3]), *to_local(box[3:])] for box in given.boxes]))


KEEP_OUT = Capability(
    name="keep_out",
    meaning="areas that robots must not enter; none when absent.",
    settings=KeepOutSettings,
    build=build_keep_out,
)
KEEP_OUT_BOXES = Capability(
    name="keep_out",
    meaning="boxes that the robot must not enter; none when absent.",
    settings=BoxSettings,
    build=build_boxes,
    dimensions=3,
)
