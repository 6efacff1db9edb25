"""A client of nav2's action `NavigateToPose`, which drives to goals that are chosen here."""

import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from jaxplore.ros import messages
from jaxplore.ros.link import Link
from jaxplore.ros.path_action import check_nav2

REJECTED = "rejected"
"""Status of a goal that the server does not take, such as one that is not active."""
_ENDS = {4: "succeeded", 5: "canceled", 6: "aborted"}
"""Values of `action_msgs/GoalStatus`."""


class Outcome(NamedTuple):
    """How a goal ended: its status, nav2's error code and its message."""

    status: str
    code: int = 0
    message: str = ""

    def __str__(self) -> str:
        code = f", error code {self.code}" if self.code else ""
        return f"{self.status}{code}{f': {self.message}' if self.message else ''}"


class Navigator:
    """Sends one goal at a time; a newer one replaces an older one, whose end nobody hears of.

    It raises a `ValueError` as of `check_nav2`.
    """

    def __init__(self, link: Link, action: str) -> None:
        check_nav2(link.ros)
        self._link, self._name = link, action
        self._client = link.ros.rclpy.action.ActionClient(
            link.node, link.ros.NavigateToPose, action
        )
        self._lock = threading.Lock()
        self._number = 0
        self._handle: Any = None
        self._outcome: Outcome | None = None

    @property
    def problem(self) -> str:
        """Why no goal can be sent; empty if one can."""
        if self._client.server_is_ready():
            return ""
        return f"no action server {self._link.topic(self._name)}"

    def send(self, pose: np.ndarray, now: float, frame: str) -> None:
        """Send a goal, a pose (3,) in a frame [m, m, rad], in place of the present one."""
        goal = self._link.ros.NavigateToPose.Goal()
        messages.fill_header(goal.pose.header, now, frame)
        messages.fill_pose(goal.pose.pose, pose)
        with self._lock:
            self._number += 1
            number, self._handle, self._outcome = self._number, None, None
        self._client.send_goal_async(goal).add_done_callback(partial(self._answer, number))

    def take(self) -> Outcome | None:
        """Return how the present goal ended, once; None while it goes on."""
        with self._lock:
            outcome, self._outcome = self._outcome, None
        return outcome

    def cancel(self) -> None:
        """Cancel the present goal, if there is one; its end is not told."""
        with self._lock:
            self._number += 1
            handle, self._handle, self._outcome = self._handle, None, None
        if handle is not None:
            handle.cancel_goal_async()

    def _answer(self, number: int, future: Any) -> None:
        handle = future.result()
        with self._lock:
            is_present = number == self._number
            if is_present and handle.accepted:
                self._handle = handle
            elif is_present:
                self._outcome = Outcome(REJECTED)
        if not handle.accepted:
            return
        if is_present:
            handle.get_result_async().add_done_callback(partial(self._end, number))
        else:
            # It was cancelled, or replaced, before the server took it.
            handle.cancel_goal_async()

    def _end(self, number: int, future: Any) -> None:
        found = future.result()
        code = int(getattr(found.result, "error_code", 0))
        message = messages.text_of(getattr(found.result, "error_msg", ""))
        status = _ENDS.get(int(found.status), "aborted")
        with self._lock:
            if number == self._number:
                self._handle, self._outcome = None, Outcome(status, code, message)
