"""The node that chooses goals on a map, and lets another program drive there."""

import collections
import json
import math
import threading
import time
from typing import Any

import numpy as np

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.onboard.drive_clock import DriveClock, Stamps
from jaxplore.onboard.goals import ChosenGoal, GoalChooser
from jaxplore.ros import map_messages, messages
from jaxplore.ros.inputs import Silence, subscribe_pose
from jaxplore.ros.link import Link
from jaxplore.ros.navigator import REJECTED, Navigator
from jaxplore.settings.node import NodeSettings

CHOICE_SECONDS = 1.0
"""Time between two looks at the map [s]."""
MAX_AGE = 5.0
"""Age of a pose beyond which no goal is chosen [s]; a robot that stands may publish rarely."""


class GoalNode:
    """Publishes goals for nav2 or another program that drives.

    Goals are chosen on a map with cells of `resolution` [m]. A finer map is resampled, and a
    coarser one gives a warning. `gave_up` says why the run ended without the robot, see `Silence`;
    it is empty otherwise.

    With `goal_by: action` the goals are those of nav2's `NavigateToPose`: one that is aborted or
    cancelled is given up for a while, and a better one replaces it.
    """

    def __init__(
        self, link: Link, chooser: GoalChooser, settings: NodeSettings, resolution: float
    ) -> None:
        self.link, self.chooser, self.settings = link, chooser, settings
        self._resolution = resolution
        self._lock = threading.Lock()
        self._map: tuple[OccupancyGrid, np.ndarray] | None = None
        self._pose: messages.Odometry | None = None
        self._frame = "map"
        ros = link.ros
        self._goals = link.publisher(ros.PoseStamped, settings.goal_topic, is_kept=True)
        self._state = link.publisher(ros.String, "~/state")
        link.subscribe(ros.OccupancyGrid, settings.map_topic, self._take_map, is_kept=True)
        subscribe_pose(link, settings, self._take_pose)
        pose_topic = "/tf" if settings.pose_type == "tf" else link.topic(settings.pose_topic)
        # The map of a robot that stands may be published rarely.
        self._pose_topic = pose_topic
        self._silence = Silence(link, (pose_topic,), settings.give_up_after)
        self._navigator: Navigator | None = None
        if settings.goal_by == "action":
            self._navigator = Navigator(link, settings.goal_action)
        self.outcomes: collections.Counter[str] = collections.Counter()
        """How many goals of the action ended in which way."""
        self.num_goals = 0
        self.gave_up = ""

    def _take_map(self, message: Any) -> None:
        # Whole metres are exact, and leave numbers that single precision can hold.
        place = np.floor(messages.pose_of(message.info.origin)[:2])
        grid = map_messages.grid_of(message, offset=place)
        if grid.resolution < self._resolution * (1.0 - 1e-6):
            grid = grid.resample(self._resolution)
        elif grid.resolution > self._resolution * (1.0 + 1e-6):
            raise ValueError(
                f"resolution is {grid.resolution:g} m; accepted: at most {self._resolution:g} m, "
                "the setting resolution"
            )
        with self._lock:
            self._map, self._frame = (grid, place), messages.text_of(message.header.frame_id)

    def _take_pose(self, pose: messages.Odometry) -> None:
        self._silence.hear(self._pose_topic)
        with self._lock:
            self._pose = pose

    def run(self, is_stopped: threading.Event) -> str:
        """Publish goals until no place is worth a visit or the event is set; return the reason."""
        try:
            return self._choose(is_stopped)
        finally:
            if self._navigator is not None:
                self._navigator.cancel()
                # The last messages need a moment to leave.
                time.sleep(0.2)

    def _choose(self, is_stopped: threading.Event) -> str:
        without_goal_since = math.inf
        shown: ChosenGoal | None = None
        clock, stamps = DriveClock(CHOICE_SECONDS), Stamps(CHOICE_SECONDS)
        placed: messages.Odometry | None = None
        placed_at = -math.inf
        while not is_stopped.wait(CHOICE_SECONDS):
            reason = self._silence.check()
            if reason:
                self.gave_up = reason
                self._publish_state("done", reason)
                return reason
            clock.advance(self.link.instant())
            now = clock.time
            if clock.jump is not None:
                # The pose keeps its age: a robot that stands may publish no other.
                stamps.forget()
                self.link.warn("clock", clock.jump)
            with self._lock:
                given, pose, frame = self._map, self._pose, self._frame
            if given is None or pose is None:
                self._publish_state("waiting", "no map yet" if given is None else "no pose yet")
                continue
            if pose is not placed:
                found = stamps.time_of(pose.time, *clock.arrival(pose.time, pose.received))
                placed, placed_at = pose, placed_at if found is None else found
            if clock.is_standing:
                self._publish_state("waiting", "the simulated clock stands still")
                continue
            if now - placed_at > MAX_AGE:
                if not self._silence.is_long:
                    self.link.warn("pose", f"the pose is {now - placed_at:.1f} s old")
                self._publish_state("waiting", "the pose is old")
                continue
            if pose.frame != frame:
                self.link.warn(
                    "frame",
                    f"the pose is in the frame {pose.frame!r}, the map in {frame!r}; accepted: one "
                    "frame, such as a localisation's pose, or node.pose_type 'tf' with the map's "
                    "frame as node.world_frame",
                )
                self._publish_state("waiting", "pose and map are in different frames")
                continue
            if self._navigator is not None:
                problem = self._navigator.problem
                shown = self._take_outcome(self._navigator, now, shown)
                if problem:
                    self._publish_state("waiting", problem)
                    continue
            goal = self.chooser.update(now, *given, pose.pose)
            if goal is None:
                without_goal_since = min(without_goal_since, now)
                if now - without_goal_since >= self.settings.done_after:
                    reason = "no place that is worth a visit is reachable"
                    self._publish_state("done", reason)
                    # The last messages need a moment to leave.
                    time.sleep(0.2)
                    return reason
                continue
            without_goal_since = math.inf
            if shown is None or not np.array_equal(goal.pose, shown.pose):
                shown = goal
                self.num_goals += 1
                self._publish_goal(goal, self.link.now(), frame)
            self._publish_state("driving", "")
        return "stopped"

    def _take_outcome(
        self, navigator: Navigator, now: float, shown: ChosenGoal | None
    ) -> ChosenGoal | None:
        """Obey how the present goal ended; return the goal that nav2 still drives to."""
        outcome = navigator.take()
        if outcome is None:
            return shown
        self.outcomes[outcome.status] += 1
        self.link.info(f"goal {outcome}")
        # A goal that was rejected is sent again.
        if outcome.status != REJECTED:
            self.chooser.finish(now, is_reached=outcome.status == "succeeded")
        return None

    def _publish_goal(self, goal: ChosenGoal, now: float, frame: str) -> None:
        message = self.link.ros.PoseStamped()
        messages.fill_header(message.header, now, frame)
        messages.fill_pose(message.pose, goal.pose)
        if self._navigator is None:
            self._goals.publish(message)
        else:
            self._navigator.send(goal.pose, now, frame)
        x, y, _ = goal.pose
        self.link.info(
            f"goal ({x:.2f}, {y:.2f}), {goal.distance:.1f} m away, {goal.information:.0f} nat"
        )

    def _publish_state(self, mode: str, reason: str) -> None:
        message = self.link.ros.String()
        message.data = json.dumps(
            {
                "mode": mode,
                "reason": reason,
                "goals": self.num_goals,
                "dropped": self.chooser.num_dropped,
                "outcomes": dict(self.outcomes),
                "warnings": sum(self.link.num_warnings.values()),
            }
        )
        self._state.publish(message)
