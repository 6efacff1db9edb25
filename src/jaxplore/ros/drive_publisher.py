"""What a node publishes of its drive beside the commands: state, maps, plan and rollouts."""

import json
import math
import time
from typing import Any

import numpy as np

from jaxplore.onboard.pilot import Pilot
from jaxplore.report.drawing.rollout_costs import (
    WEIGHT,
    cost_colours,
    cost_names,
    costs_of_rollouts,
)
from jaxplore.ros import map_messages, messages
from jaxplore.ros.link import Link

MAP_SECONDS, STATE_SECONDS, PLAN_SECONDS = 1.0, 0.5, 0.5
"""Time between two messages of the maps, of the state, and of the plan [s]."""
COST_OPACITY = 0.8
"""Opacity of rollouts that are coloured by cost."""


class DrivePublisher:
    """Publishes state, belief, information, plan and rollouts of a pilot, which is compiled.

    What nobody has subscribed to is not computed. `rollout_colour` is what colours the rollouts:
    their weight, their total cost or a term of it. A name that the controller does not know raises
    a `ValueError`.
    """

    def __init__(self, link: Link, pilot: Pilot, rollout_colour: str = WEIGHT) -> None:
        self._link, self._pilot = link, pilot
        self._known = (WEIGHT, *cost_names(pilot.make_frame()))
        self.check_colour(rollout_colour)
        self.rollout_colour = rollout_colour
        ros = link.ros
        self._due = dict.fromkeys(("map", "state", "plan"), -math.inf)
        self._state = link.publisher(ros.String, "~/state")
        self._plan = link.publisher(ros.Path, "~/plan")
        self._belief = link.publisher(ros.OccupancyGrid, "~/belief", is_kept=True)
        self._information = link.publisher(ros.OccupancyGrid, "~/information", is_kept=True)
        self._correction: Any = None
        self._transforms: Any = None
        self._rollouts = None
        if ros.MarkerArray is not None:
            self._rollouts = link.publisher(ros.MarkerArray, "~/rollouts")

    def check_colour(self, name: object) -> None:
        """Raise a `ValueError` unless the controller tells this of its rollouts."""
        if name not in self._known:
            raise ValueError(f"rollout_colour is {name!r}; accepted: {', '.join(self._known)}")

    def publish_due(self, now: float, frame: str, state: dict[str, object]) -> bool:
        """Publish what is due at a time [s] in the fixed frame; return whether the state was."""
        is_told = self._is_due("state", STATE_SECONDS)
        if is_told:
            self.publish_state(state)
        if self._is_due("map", MAP_SECONDS):
            self._publish_maps(now, frame)
        watched = [each for each in (self._plan, self._rollouts) if each is not None]
        if any(each.get_subscription_count() for each in watched) and self._is_due(
            "plan", PLAN_SECONDS
        ):
            self._publish_plan(now, frame)
        return is_told

    def publish_transform(self, now: float, frame: str, child: str) -> None:
        """Publish the pose of the odometry's frame, `child`, in the map's, as SLAM nodes do."""
        link, ros = self._link, self._link.ros
        if self._correction is None:
            self._correction = link.publisher(ros.TransformStamped, "~/correction")
            # Without the package nobody else on this machine listens to transforms either.
            if ros.TFMessage is not None:
                self._transforms = link.publisher(ros.TFMessage, "/tf")
        one = ros.TransformStamped()
        messages.fill_transform(one, now, frame, child, self._pilot.correction)
        self._correction.publish(one)
        if self._transforms is not None:
            message = ros.TFMessage()
            message.transforms = [one]
            self._transforms.publish(message)

    def publish_state(self, state: dict[str, object]) -> None:
        """Publish the state as JSON."""
        message = self._link.ros.String()
        message.data = json.dumps(state)
        self._state.publish(message)

    def _is_due(self, what: str, seconds: float) -> bool:
        # The clock of ROS may go back, and then nothing would be due for long.
        now = time.monotonic()
        if now - self._due[what] < seconds:
            return False
        self._due[what] = now
        return True

    def _publish_maps(self, now: float, frame: str) -> None:
        pilot, ros = self._pilot, self._link.ros
        grid, field = pilot.belief.grid, pilot.belief.information
        offset = np.append(pilot.offset, 0.0)
        if self._belief.get_subscription_count():
            message = ros.OccupancyGrid()
            origin = np.asarray(grid.frame.origin, np.float64) + offset
            probability = grid.crop(grid.probability)
            map_messages.fill_grid(message, probability, grid.resolution, origin, now, frame)
            self._belief.publish(message)
        if self._information.get_subscription_count():
            message = ros.OccupancyGrid()
            origin = np.asarray(field.frame.origin, np.float64) + offset
            values = np.asarray(field.total)
            # Relative to a high percentile, because a single cell may have far more than others.
            scaled = np.clip(values / max(float(np.percentile(values, 99)), 1e-6), 0.0, 1.0)
            map_messages.fill_grid(message, scaled, field.frame.resolution, origin, now, frame)
            self._information.publish(message)

    def _publish_plan(self, now: float, frame: str) -> None:
        pilot, ros = self._pilot, self._link.ros
        shown = pilot.make_frame()
        positions = shown.plan + pilot.offset
        ahead = np.diff(positions, axis=0, append=positions[-1:])
        headings = np.arctan2(ahead[:, 1], ahead[:, 0])
        message = ros.Path()
        poses = np.concatenate([positions, headings[:, None]], axis=1)
        map_messages.fill_path(message, ros.PoseStamped, poses, now, frame)
        self._plan.publish(message)
        if self._rollouts is None or not self._rollouts.get_subscription_count():
            return
        markers = ros.MarkerArray()
        colours = rollout_colours(shown, self.rollout_colour)
        points = shown.samples + pilot.offset
        map_messages.fill_rollouts(markers, ros.Marker, ros.Point, points, colours, now, frame)
        self._rollouts.publish(markers)


def rollout_colours(frame: Any, name: str) -> np.ndarray:
    """Return red, green, blue and opacity (N, 4) of the rollouts of a frame, from 0 to 1.

    They show the weight, from blue to red, the total cost or a term of it, by name.
    """
    if name != WEIGHT:
        colours = cost_colours(costs_of_rollouts(frame, name)) / 255.0
        return np.concatenate([colours, np.full((len(colours), 1), COST_OPACITY)], axis=1)
    shares = frame.weights / max(float(frame.weights.max()), 1e-9)
    return np.stack([shares, 0.2 + 0.0 * shares, 1.0 - shares, 0.15 + 0.85 * shares], axis=-1)
