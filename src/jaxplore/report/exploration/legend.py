"""The legend of an exploration animation: an entry for everything that its frames show."""

from jaxplore.report.drawing.colours import (
    ALARM,
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER,
    MOVER_EDGE,
    OCCUPIED,
    TARGET,
    UNKNOWN,
    blend,
)
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import (
    HEAT,
    HIDDEN_WALL,
    INK,
    LIDAR_RAY,
    MAX_HEAT,
    PALE,
    PLAN,
    REFERENCE,
    ROBOT,
    STRONG,
    TRAIL,
)
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.exploration.mission import MissionData, ObjectData
from jaxplore.report.exploration.objects import class_colours, is_false
from jaxplore.report.exploration.progress import is_known_map


def legend_entries(recording: ExplorationData, *, has_closed: bool) -> tuple[Entry, ...]:
    """Return the legend's entries; `has_closed` is set if untraversable ground is drawn."""
    frames = recording.frames
    entries = (
        (Entry("robot", ROBOT, "disc"), True),
        (Entry("trail", TRAIL, "line"), recording.num_steps > 0),
        (Entry("plan", PLAN, "line"), any(len(each.plan) for each in frames)),
        (Entry("rollouts", STRONG[:3], "line"), any(len(each.samples) for each in frames)),
        (Entry("reference", REFERENCE, "dashes"), any(len(each.reference) > 1 for each in frames)),
        (Entry("lidar", LIDAR_RAY[:3], "line"), any(len(each.scan) for each in frames)),
        (Entry("information", blend(HEAT, FREE, MAX_HEAT)), True),
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
    """Return the entries of what is looked for beside the map."""
    entries: list[Entry] = []
    if len(recording.targets):
        entries += [Entry("target", TARGET, "star"), Entry("target found", TARGET, "found")]
    entries += _object_entries(recording.objects)
    if recording.anomalies is not None and len(recording.anomalies.boxes):
        entries += [Entry("anomaly", ALARM, "star"), Entry("reported", ALARM, "found")]
    return tuple(entries)


def _object_entries(objects: ObjectData | None) -> tuple[Entry, ...]:
    """Return the entries of objects and of the classes that they may be taken for."""
    if objects is None:
        return ()
    colours = class_colours(objects)
    entries = [
        Entry(name, colour, "disc", INK)
        for name, colour in zip(objects.classes, colours, strict=True)
    ]
    if (objects.label != objects.target).any():
        entries.insert(0, Entry("other object", PALE))
    if is_false(objects).any():
        entries.append(Entry("false report", ALARM, "cross"))
    return tuple(entries)
