"""What is recorded of path following."""

from typing import Any

import numpy as np

from jaxplore.report.drawing.colours import MOVER, MOVER_EDGE
from jaxplore.report.drawing.palette import INK, PALE
from jaxplore.report.following.data import PathFrame
from jaxplore.topics import messages
from jaxplore.topics.content import MAP, Content


class PathContent(Content):
    """What is recorded of path following.

    Beside the commands, states and metrics these are the course, the pose, the plan, rollouts and
    obstacles.
    """

    def write_start(self) -> None:
        """Write the course: the path, and the edges of its corridor."""
        run = self.recording
        time, closed = run.frames[0].time, run.is_closed
        lines = [messages.line(run.centre, PALE, 1.0, closed=closed)]
        lines += [messages.line(edge, INK, 2.0, closed=closed) for edge in run.edges]
        update = messages.scene(self.channels.stamp(time), {"course": (MAP, {"lines": lines})})
        self.log("/course", update, time)

    def write_scene(self, frame: PathFrame) -> None:
        """Write the pose, the plan, rollouts and obstacles."""
        run, time = self.recording, frame.time
        self.log_pose(time, frame.position, frame.heading, 0.0)
        self.log_plan(frame)
        primitives: dict[str, list[Any]] = {"cylinders": [], "triangles": [], "lines": []}
        for corners, radius in zip(frame.corners, run.obstacle_radii.tolist(), strict=True):
            if np.isfinite(corners).all():
                _add_obstacle(primitives, corners, radius)
        entities = {"robot": self.body(), "obstacles": (MAP, primitives)}
        self.log("/objects", messages.scene(self.channels.stamp(time), entities), time)


def _add_obstacle(primitives: dict[str, list[Any]], corners: np.ndarray, radius: float) -> None:
    """Add a polygon (V, 2) that is inflated by a radius, or a disc: its outline and its edge."""
    places = np.unique(corners, axis=0)
    if radius > 0.0:
        primitives["cylinders"] += [messages.disc(each, radius, MOVER) for each in places]
    if len(places) < 2:
        return
    primitives["lines"].append(
        messages.line(corners, MOVER_EDGE, 2.0, closed=True, z=2.0 * messages.FLAT)
    )
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        length = float(np.hypot(*along))
        if radius > 0.0 and length > 0.0:
            aside = radius / length * np.array([-along[1], along[0]])
            strip = np.stack([start - aside, end - aside, end + aside, start + aside])
            primitives["triangles"].append(messages.polygon(strip, MOVER))
