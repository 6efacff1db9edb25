"""Settings of areas that robots must not enter."""

from typing import Annotated

from pydantic import Field

from jaxplore._limits import MOST_NAMES
from jaxplore.settings.sections import Real, Section

Corners = Annotated[tuple[tuple[Real, Real], ...], Field(max_length=MOST_NAMES)]


class KeepOutSettings(Section):
    """Areas that robots must not enter: see `jaxplore.parts.KeepOut`.

    Args:
        areas: polygons, each a list of its corners (x, y), in the map's coordinates [m].
        mask: YAML file of a ROS map whose occupied cells must not be entered, as that of nav2's
            keep-out filter; none when absent.
    """

    areas: Annotated[tuple[Corners, ...], Field(max_length=MOST_NAMES)] = ()
    mask: str | None = None
