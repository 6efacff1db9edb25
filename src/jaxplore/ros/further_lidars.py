"""One scan of several lidars, such as those at the front and at the rear of a robot."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jaxplore.onboard.drive_clock import CLOCK_TOLERANCE, Instant
from jaxplore.onboard.localisation import difference
from jaxplore.onboard.odometry import KEPT_SECONDS, PoseHistory
from jaxplore.onboard.scan_points import TakenScan
from jaxplore.ros.messages import LaserScan, Mount, Odometry, laser_scan_of
from jaxplore.sensing.beam_ends import scan_of_ends
from jaxplore.sensing.beams import Beams
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.node import NodeSettings


class FurtherLidars:
    """Keeps the newest scan of each further lidar, and completes those of the first one by them.

    Each scan is moved by the motion of the robot to the time of the oldest one, which is that of
    the result. Beams start at the first lidar. A beam has the nearest return of all lidars in its
    direction; without one it is free as far as any lidar tells.

    Args:
        sensor: sensor whose beams are filled.
        first: place of the first lidar.
        mounts: places of the further ones, by topic.
        max_age: greatest time by which a scan may be older than that of the first lidar [s], at
            most `CLOCK_TOLERANCE`.
        no_echo: rule of the readings that met nothing, see `NoEcho`.
        margin: margin of that rule [m].
    """

    def __init__(
        self,
        sensor: Beams,
        first: Mount,
        mounts: Mapping[str, Mount],
        *,
        max_age: float,
        no_echo: str = "auto",
        margin: float = 0.0,
    ) -> None:
        self._sensor, self._first, self._mounts = sensor, first, dict(mounts)
        # What is older by more is not believed to be of this clock.
        self._max_age = min(max_age, CLOCK_TOLERANCE)
        self._no_echo = {topic: NoEcho(no_echo, margin) for topic in mounts}
        self._newest: dict[str, LaserScan] = {}
        self._history = PoseHistory()

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics of the further lidars."""
        return tuple(self._mounts)

    def add_pose(self, pose: Odometry) -> None:
        """Take a pose of the robot, by which scans of different times are moved."""
        last = self._history.last
        if last is not None and pose.time < last.time - KEPT_SECONDS:
            # The clock has jumped back.
            self._history.forget()
        self._history.add(pose.time, pose.pose, pose.twist)

    def read(self, topic: str, message: Any, received: Instant, skipped: float = 0.0) -> LaserScan:
        """Convert and keep a message of a further lidar, and return it.

        `skipped` is the time that a replay has left out [s].

        Raises:
            ValueError: a malformed message.
        """
        scan = laser_scan_of(message, self._sensor, self._mounts[topic], self._no_echo[topic])
        scan = scan._replace(time=scan.time - skipped, received=received)
        self._newest[topic] = scan
        return scan

    def news(self, topic: str) -> str:
        """Return what was found about beams that met nothing since it was asked last."""
        rule = self._no_echo[topic]
        news, rule.news = rule.news, ""
        return f"{topic}: {news}" if news else ""

    def complete(self, scan: LaserScan) -> LaserScan:
        """Return a scan of the first lidar, with its arrival, completed by the others.

        Raises:
            ValueError: no scan of a lidar yet, or one that is too old.
        """
        now, scans = _time(scan), [(scan, self._first)]
        for topic, mount in self._mounts.items():
            newest = self._newest.get(topic)
            age = math.inf if newest is None else now - _time(newest)
            # A clock that has jumped back leaves a scan that is ahead.
            if newest is None or not abs(age) <= self._max_age:
                told = "missing" if newest is None else f"{age:.2f} s older than this one"
                raise ValueError(
                    f"the scan of {topic} is {told}; accepted: at most {self._max_age:g} s older"
                )
            scans.append((newest, mount))
        time = min(_time(each) for each, _ in scans)
        moved = [self._moved(each, mount, time) for each, mount in scans]
        points, met, free = (np.concatenate(each) for each in zip(*moved, strict=True))
        place = np.array([self._first.x, self._first.y])
        seen = scan_of_ends(self._sensor, (met - place).T, (free - place).T)
        return scan._replace(time=time, scan=seen, points=points, sweep=None)

    def _moved(
        self, given: LaserScan, mount: Mount, time: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points, ends that met something and ends that did not, of a scan at a time [s]."""
        place, last = np.array([mount.x, mount.y]), self._history.last
        twist = np.zeros(3) if last is None else last.twist
        taken = TakenScan(given.time, given.scan, given.points, given.sweep)
        taken = taken.undistort(self._sensor, twist, place)
        ranges, is_return = (np.asarray(each) for each in taken.scan)
        angles = self._sensor.beam_angles.astype(np.float64)
        ends = place + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        motion = self._motion(time, _time(given))
        cos, sin = math.cos(motion[2]), math.sin(motion[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        points, met, free = (
            each @ turn + motion[:2]
            for each in (taken.points, ends[is_return], ends[~is_return & (ranges > 0.0)])
        )
        # Readings between two beams of the sensor count as well.
        return points, np.concatenate([points, met]), free

    def _motion(self, begin: float, end: float) -> np.ndarray:
        """Return the motion (3,) of the robot between two times [s]; 0 where it is not known."""
        last = self._history.last
        if last is None or max(abs(each - last.time) for each in (begin, end)) > KEPT_SECONDS:
            return np.zeros(3)
        return difference(self._history.at(begin), self._history.at(end))


def _time(scan: LaserScan) -> float:
    """Return the stamp of a scan, or its arrival where the clocks do not agree [s]."""
    assert scan.received is not None
    clock = scan.received.clock
    return scan.time if abs(scan.time - clock) <= CLOCK_TOLERANCE else clock


def further_lidars(
    settings: NodeSettings,
    sensor: Beams,
    first: Mount,
    margin: float,
    full_name: Callable[[str], str],
) -> FurtherLidars | None:
    """Return the further lidars of the settings; None if there are none.

    `full_name` returns the full name of a topic of the settings.
    """
    if not settings.further_lidars:
        return None
    mounts = {
        full_name(topic): Mount(x, y, math.radians(yaw))
        for topic, (x, y, yaw) in settings.further_lidars.items()
    }
    return FurtherLidars(
        *(sensor, first, mounts),
        max_age=settings.max_age,
        no_echo=settings.no_echo,
        margin=margin,
    )
