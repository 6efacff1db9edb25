"""What is recorded of the runs of any task."""

from typing import Any

import jax
import numpy as np

from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.report.drawing.colours import belief_colours
from jaxplore.report.drawing.palette import FAINT, PLAN, ROBOT, STRONG, Colour
from jaxplore.report.drawing.rollout_costs import WEIGHT, cost_names, costs_of_rollouts
from jaxplore.report.drawing.shapes import STRONG_SHARE
from jaxplore.topics import messages
from jaxplore.topics.channels import Channels

MAP, BASE = "map", "base_link"
"""Frames of the world and of the robot, with ROS's names."""
SLOW_SECONDS = 0.5
"""Least time between two maps of a recording [s]."""
MARK = 0.25
"""Radius of the mark of a goal or a target [m]."""
MOST_ROLLOUTS, MOST_POINTS = 20, 11
"""Greatest number of rollouts in a recording, and of points of each."""


class Content:
    """What is recorded of the runs of any task: the commands, the states and the metrics, which are
    the fields of the record of a step that are single numbers. A flag is 1 if it was set in any
    step since the last message. The `recording` is the run when it begins, with no step and one
    frame."""

    def __init__(self, channels: Channels, recording: Any, controller: Controller) -> None:
        self.channels, self.recording = channels, recording
        self._vectors = {
            topic: (field, names)
            for topic, field, names in (
                ("command", "control", _control_names(controller, recording)),
                ("state", "state", tuple(getattr(recording, "state_names", ()))),
            )
            if names and len(names) == getattr(recording.records, field).shape[-1]
        }
        self._slow_at: float | None = None

    def write_start(self) -> None:
        """Write what stays the same during the run; nothing by default."""

    def write_steps(self, records: Any, times: np.ndarray, text: str | None = None) -> None:
        """Write the records, a row for each step, with the time at the end of each step [s].

        `text` is the progress of the task in words.
        """
        if not len(times):
            return
        fields = {name: rows for name, rows in records._asdict().items() if rows is not None}
        for part, record in fields.pop("parts", {}).items():
            fields |= {f"{part}.{name}": rows for name, rows in record._asdict().items()}
        # Messages are in the order of their times.
        given = {
            f"/{topic}": (names, fields[field].tolist())
            for topic, (field, names) in self._vectors.items()
        }
        for step, time in enumerate(times.tolist()):
            for topic, (names, rows) in given.items():
                self.channels.log_values(topic, dict(zip(names, rows[step], strict=True)), time)
        values: dict[str, float | str] = {
            name: float(rows.any() if rows.dtype == bool else rows[-1])
            for name, rows in fields.items()
            if isinstance(rows, np.ndarray) and rows.ndim == 1
        }
        if text is not None:
            values["text"] = " ".join(text.split())
        self.channels.log_values("/metrics", values, float(times[-1]))

    def write_frame(self, frame: Any) -> None:
        """Write a frame: the scene, and the maps if the last ones are old enough."""
        is_slow = self._slow_at is None or frame.time > self._slow_at + SLOW_SECONDS - 1e-6
        if is_slow:
            self._slow_at = frame.time
        self.write_scene(frame)
        if is_slow:
            self.write_maps(frame)

    def write_scene(self, frame: Any) -> None:
        """Write what a frame shows of the robot and of what moves; nothing by default."""

    def write_maps(self, frame: Any) -> None:
        """Write the maps of a frame; nothing by default."""

    def write_end(self, recording: Any) -> None:
        """Write what is known of the finished run only; nothing by default."""

    def log(self, topic: str, message: Any, time: float) -> None:
        """Write a message; see `Channels.log`."""
        self.channels.log(topic, message, time)

    def log_levels(self, topic: str, level: np.ndarray, time: float, height: float) -> None:
        """Write probabilities in 256 levels as a grid, coloured as in the animation.

        `level` (H, W) is that of the cells of the run's map; the grid is drawn at `height` [m].
        """
        run, colours = self.recording, belief_colours()[level]
        values = {
            "probability": level,
            "red": colours[..., 0],
            "green": colours[..., 1],
            "blue": colours[..., 2],
            "alpha": np.full(level.shape, 255, np.uint8),
        }
        stamp = self.channels.stamp(time)
        message = messages.grid(stamp, MAP, run.origin, run.resolution, values, height=height)
        self.log(topic, message, time)

    def log_pose(
        self, time: float, position: np.ndarray, heading: float, z: float, robot: str | None = None
    ) -> None:
        """Write the pose of the robot [m, m, rad], and the transform from its frame to the world's.

        Where there are several robots, the topic and the frame are under the name of the robot.
        """
        topic, frame = ("/pose", BASE) if robot is None else (f"/{robot}/pose", f"{robot}/{BASE}")
        x, y = np.asarray(position, np.float64).tolist()
        yaw = heading if np.isfinite(heading) else 0.0
        stamp = self.channels.stamp(time)
        self.log("/tf", messages.frame_transform(stamp, MAP, frame, x, y, yaw, z=z), time)
        self.log(topic, messages.pose_in_frame(stamp, MAP, x, y, yaw, z=z), time)

    def log_plan(self, frame: Any, **others: tuple[np.ndarray, Colour]) -> None:
        """Write the plan and some rollouts, with what each of them weighs and costs.

        Rollouts of great weight have another colour. `others` are further lines beside the plan,
        with their colours.
        """
        stamp, samples = self.channels.stamp(frame.time), frame.samples
        lines = {**others, "plan": (frame.plan, PLAN)}
        entities: dict[str, Any] = {
            name: (MAP, {"lines": [messages.line(points, colour, 3.0, z=2.0 * messages.FLAT)]})
            for name, (points, colour) in lines.items()
        }
        self.log("/plan", messages.scene(stamp, entities), frame.time)
        known = np.nan_to_num(frame.weights)
        bold = STRONG_SHARE * known.max(initial=0.0)
        # The last in the order of weight is the rollout of greatest weight, which is kept.
        shown = np.argsort(known, kind="stable")[evenly(len(samples), MOST_ROLLOUTS)]
        points = evenly(samples.shape[1], MOST_POINTS)
        rollouts = [
            messages.line(
                samples[i, points],
                STRONG if known[i] > 0.0 and known[i] >= bold else FAINT,
                1.0,
                z=messages.FLAT,
            )
            for i in shown.tolist()
        ]
        update = messages.scene(stamp, {"rollouts": (MAP, {"lines": rollouts})})
        self.log("/rollouts", update, frame.time)
        if names := cost_names(frame):
            costs = {name: costs_of_rollouts(frame, name)[shown].tolist() for name in names}
            weights = {WEIGHT: frame.weights[shown].tolist()}
            self.channels.log_lists("/rollout_costs", weights | costs, frame.time)

    def body(self) -> tuple[str, dict[str, Any]]:
        """Return the robot as an entity of a scene."""
        footprint = np.asarray(self.recording.footprint)
        if len(footprint):
            return BASE, {"triangles": [messages.polygon(footprint, ROBOT)]}
        return BASE, {"cylinders": [messages.disc(np.zeros(2), self.recording.robot_radius, ROBOT)]}


def _control_names(controller: Controller, recording: Any) -> tuple[str, ...]:
    """Return the names of the controls in a recording, those of the controller's robot."""
    control = recording.records._asdict().get("control")
    if control is None:
        return ()
    size = control.shape[-1]
    for each in jax.tree.leaves(controller, is_leaf=lambda each: isinstance(each, Dynamics)):
        if isinstance(each, Dynamics) and each.control_size == size:
            return tuple(each.control_names)
    return tuple(f"u{i}" for i in range(size))


def evenly(number: int, most: int) -> np.ndarray:
    """Return indices of some of a number of things, the first and the last included."""
    return np.linspace(0, number - 1, min(number, most)).round().astype(int)
