"""What is recorded of an exploration by a fleet."""

from typing import Any

import numpy as np

from jaxplore.control.base import Controller
from jaxplore.report.fleet.animation import LINK, robot_colour
from jaxplore.report.fleet.data import FleetData, FleetFrame, axes_of_robots
from jaxplore.topics import messages
from jaxplore.topics.channels import Channels
from jaxplore.topics.content import BASE, MAP, Content, evenly

MOST_TRAIL = 500
"""Greatest number of points of a trail in a message."""
OWN = {
    "coverages": "coverage",
    "clearance": "clearance",
    "is_collision": "is_collision",
    "is_contact": "is_contact",
}
"""Fields of a record with one value for each robot, and their names among its metrics."""


class FleetContent(Content):
    """What is recorded of an exploration by a fleet.

    In addition to the commands, states and metrics of all these are what the robots know together,
    and for each robot under its name, `robot1` for the first, its pose, plan and metrics; every
    half second its trail, and at the end its own map. Lines join the robots that hear each other.
    """

    def __init__(self, channels: Channels, recording: FleetData, controller: Controller) -> None:
        super().__init__(channels, recording, controller)
        self._names = [f"robot{number + 1}" for number in range(recording.num_robots)]
        self._axes = [list(each) for each in axes_of_robots(recording.state_names)]
        # Pieces (N, steps, 2) of the trails, in the order of the updates.
        self._trails = [recording.trails]

    def write_start(self) -> None:
        """Write the true map."""
        run = self.recording
        world = np.round(255.0 * np.asarray(run.world)).astype(np.uint8)
        self.log_levels("/world", world, run.frames[0].time, -2.0 * messages.FLAT)

    def write_steps(self, records: Any, times: np.ndarray, text: str | None = None) -> None:
        """Write the records of steps, with the metrics of each robot."""
        super().write_steps(records, times, text)
        if not len(times):
            return
        self._trails.append(np.stack([records.state[:, each] for each in self._axes]))
        for number, name in enumerate(self._names):
            columns = {shown: getattr(records, field)[:, number] for field, shown in OWN.items()}
            values = {
                shown: float(rows.any() if rows.dtype == bool else rows[-1])
                for shown, rows in columns.items()
            }
            self.channels.log_values(f"/{name}/metrics", values, float(times[-1]))

    def write_scene(self, frame: FleetFrame) -> None:
        """Write the poses, the plans, the robots, and who hears whom."""
        stamp, entities = self.channels.stamp(frame.time), {}
        for number, name in enumerate(self._names):
            place, heading = frame.positions[number], float(frame.headings[number])
            self.log_pose(frame.time, place, heading, 0.0, robot=name)
            line = messages.line(
                frame.plans[number], robot_colour(number), 3.0, z=2.0 * messages.FLAT
            )
            update = messages.scene(stamp, {"plan": (MAP, {"lines": [line]})})
            self.log(f"/{name}/plan", update, frame.time)
            body = messages.disc(
                np.zeros(2), float(self.recording.radii[number]), robot_colour(number)
            )
            entities[name] = (f"{name}/{BASE}", {"cylinders": [body]})
        pairs = np.argwhere(np.triu(frame.links, 1))
        lines = [messages.line(frame.positions[pair], LINK, 1.0) for pair in pairs]
        links: dict[str, Any] = {"links": (MAP, {"lines": lines})}
        if len(self.recording.targets):
            links["targets"] = self.mark_targets(frame)
        self.log("/objects", messages.scene(stamp, {**entities, **links}), frame.time)

    def write_maps(self, frame: FleetFrame) -> None:
        """Write what the robots know together, and the trail of each up to now."""
        self.log_levels("/belief", frame.probability, frame.time, -messages.FLAT)
        self._trails = [np.concatenate(self._trails, axis=1)]
        shown = self._trails[0][:, evenly(self._trails[0].shape[1], MOST_TRAIL)]
        stamp = self.channels.stamp(frame.time)
        for number, name in enumerate(self._names):
            line = messages.line(shown[number], robot_colour(number), 2.0, z=messages.FLAT)
            update = messages.scene(stamp, {"trail": (MAP, {"lines": [line]})})
            self.log(f"/{name}/trail", update, frame.time)

    def write_end(self, recording: FleetData) -> None:
        """Write the map of each robot."""
        time = float(recording.num_steps * recording.control_period)
        for name, levels in zip(self._names, recording.beliefs, strict=True):
            self.log_levels(f"/{name}/belief", levels, time, -messages.FLAT)
