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
from jaxplore.report.exploration.data import ExplorationData, ObjectData
from jaxplore.report.exploration.objects import class_colours, is_false
from jaxplore.report.exploration.progress import is_known_map


def legend_entries(recording: ExplorationData, *, has_closed: bool) -> tuple[Entry, ...]:
    """Return the legend's entries; `has_closed` is set if untraversable ground is drawn."""
    frames = recording.frames
    has_anomalies = recording.anomalies is not None and len(recording.anomalies.boxes) > 0
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
        (Entry("target", TARGET, "star"), len(recording.targets) > 0),
        (Entry("target found", TARGET, "found"), len(recording.targets) > 0),
        *((each, True) for each in _object_entries(recording.objects)),
        (Entry("anomaly", ALARM, "star"), has_anomalies),
        (Entry("reported", ALARM, "found"), has_anomalies),
        (Entry("mover", MOVER, "disc", MOVER_EDGE), len(recording.mover_radii) > 0),
        (Entry("untraversable", blend(CLOSED, FREE, CLOSED_SHARE)), has_closed),
    )
    return tuple(entry for entry, is_drawn in entries if is_drawn)


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
