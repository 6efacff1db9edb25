"""The legend of an exploration animation: an entry for everything that its frames show."""

from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER,
    MOVER_EDGE,
    OCCUPIED,
    UNKNOWN,
    blend,
)
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import (
    HEAT,
    HIDDEN_WALL,
    LIDAR_RAY,
    MAX_HEAT,
    PLAN,
    REFERENCE,
    ROBOT,
    STRONG,
    TRAIL,
    Colour,
)
from jaxplore.report.exploration.data import TEAM, ExplorationData
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.progress import is_known_map


def legend_entries(recording: ExplorationData, *, has_closed: bool) -> tuple[Entry, ...]:
    """Return the legend's entries; `has_closed` is set if untraversable ground is drawn."""
    # The legend of several robots has one entry for each, which stands for its trail and plan.
    frames, is_one = recording.frames, TEAM not in recording.parts
    entries = (
        (Entry("robot", ROBOT, "disc"), is_one),
        (Entry("trail", TRAIL, "line"), is_one and recording.num_steps > 0),
        (Entry("plan", PLAN, "line"), is_one and any(each.plan.size for each in frames)),
        (Entry("rollouts", STRONG[:3], "line"), any(len(each.samples) for each in frames)),
        (Entry("reference", REFERENCE, "dashes"), any(len(each.reference) > 1 for each in frames)),
        (Entry("lidar", LIDAR_RAY[:3], "line"), any(len(each.scan) for each in frames)),
        (
            Entry("information", blend(HEAT, FREE, MAX_HEAT)),
            any(each.information.size for each in frames),
        ),
        (Entry("unknown", UNKNOWN), True),
        (Entry("wall", OCCUPIED), True),
        (Entry("unseen wall", HIDDEN_WALL), not is_known_map(recording)),
        (Entry("goal", REFERENCE, "disc"), recording.goal is not None),
        *((each, True) for each in mission_entries(recording)),
        (Entry("mover", MOVER, "disc", MOVER_EDGE), len(recording.mover_radii) > 0),
        (Entry("untraversable", blend(CLOSED, FREE, CLOSED_SHARE)), has_closed),
    )
    return tuple(entry for entry, is_drawn in entries if is_drawn)


def mission_entries(recording: MissionData) -> tuple[Entry, ...]:
    """Return the entries of parts."""
    return tuple(entry for each in recording.parts.values() for entry in each.legend())


def mission_colours(recording: MissionData) -> list[Colour]:
    """Return the colours of parts."""
    colours: list[Colour] = []
    for each in recording.parts.values():
        colours += [colour for colour in each.colours() if colour not in colours]
    return colours
