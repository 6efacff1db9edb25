"""What a node publishes of its drive beside the commands: state, maps, plan and rollouts."""

import json
import math

import numpy as np

from jaxplore.onboard.pilot import Pilot
from jaxplore.ros import map_messages
from jaxplore.ros.link import Link

MAP_SECONDS, STATE_SECONDS, PLAN_SECONDS = 1.0, 0.5, 0.5
"""Time between two messages of the maps, of the state, and of the plan [s]."""


class DrivePublisher:
    """Publishes state, belief, information, plan and rollouts of a pilot.

    What nobody has subscribed to is not computed.

    Args:
        link: connection to ROS 2.
        pilot: the pilot.
    """

    def __init__(self, link: Link, pilot: Pilot) -> None:
        self._link, self._pilot = link, pilot
        ros = link.ros
        self._due = dict.fromkeys(("map", "state", "plan"), -math.inf)
        self._state = link.publisher(ros.String, "~/state")
        self._plan = link.publisher(ros.Path, "~/plan")
        self._belief = link.publisher(ros.OccupancyGrid, "~/belief", is_kept=True)
        self._information = link.publisher(ros.OccupancyGrid, "~/information", is_kept=True)
        self._rollouts = None
        if ros.MarkerArray is not None:
            self._rollouts = link.publisher(ros.MarkerArray, "~/rollouts")

    def publish_due(self, now: float, frame: str, state: dict[str, object]) -> bool:
        """Publish what is due; return whether the state was.

        Args:
            now: present time [s].
            frame: name of the fixed frame.
            state: entries of the state.
        """
        is_told = self._is_due("state", now, STATE_SECONDS)
        if is_told:
            self.publish_state(state)
        if self._is_due("map", now, MAP_SECONDS):
            self._publish_maps(now, frame)
        watched = [each for each in (self._plan, self._rollouts) if each is not None]
        if any(each.get_subscription_count() for each in watched) and self._is_due(
            "plan", now, PLAN_SECONDS
        ):
            self._publish_plan(now, frame)
        return is_told

    def publish_state(self, state: dict[str, object]) -> None:
        """Publish the state as JSON.

        Args:
            state: entries of the state.
        """
        message = self._link.ros.String()
        message.data = json.dumps(state)
        self._state.publish(message)

    def _is_due(self, what: str, now: float, seconds: float) -> bool:
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
            probability = grid.cropped(grid.probability)
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
        shares = shown.weights / max(float(shown.weights.max()), 1e-9)
        # Blue for rollouts without weight, red for the heaviest.
        colours = np.stack(
            [shares, 0.2 + 0.0 * shares, 1.0 - shares, 0.15 + 0.85 * shares], axis=-1
        )
        points = shown.samples + pilot.offset
        map_messages.fill_rollouts(markers, ros.Marker, ros.Point, points, colours, now, frame)
        self._rollouts.publish(markers)
