"""Settings of a fleet: several robots that explore together."""

from typing import Annotated, Literal

from pydantic import Field

from jaxplore._limits import MOST_ROBOTS
from jaxplore.settings.defaults import setting
from jaxplore.settings.sections import Positive, Rate, Real, Section
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.fleet.scenario import Fleet

FLEET = "fleet"
"""Name that selects a fleet on the default map, and name of the section."""

Robots = Annotated[int, Field(ge=1, le=MOST_ROBOTS)]
Starts = Annotated[tuple[tuple[Real, Real, Real], ...], Field(max_length=MOST_ROBOTS)]


class FleetSettings(Section):
    """Several robots of one kind that share what they know: see `jaxplore.Fleet` and
    `jaxplore.Radio`.

    Args:
        robots: number of robots.
        starts: start pose (x, y, yaw) of each robot [m, m, rad]; chosen around `start` when absent,
            as near to one another as there is room.
        workers: number of workers of a local Ray cluster among which `jaxplore run` divides the
            robots; with 1, as in all other commands, one process computes them.
    """

    robots: Robots = 4
    starts: Starts | None = None
    workers: Robots = 1
    radio_range: Positive = setting(Radio, "radio_range")
    uses_sight: bool = setting(Radio, "uses_sight")
    is_central: bool = setting(Radio, "is_central")
    exchange_rate: Rate = setting(Fleet, "exchange_rate")
    coordination: Literal["claims", "assignment", "none"] = setting(Fleet, "coordination")
    is_start_known: bool = setting(Fleet, "is_start_known")
    claim_sharpness: Positive = setting(Radio, "claim_sharpness")
    claim_memory: Positive = setting(Radio, "claim_memory")
