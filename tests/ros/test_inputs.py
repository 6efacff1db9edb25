"""What a node hears, without ROS: messages of several frames on one topic."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxplore.onboard.drive_clock import Instant
from jaxplore.ros.inputs import CHAIN_SECONDS, subscribe_pose, subscribe_scan
from jaxplore.ros.messages import Mount
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.node import CloudSettings, NodeSettings


class FakeLink:
    """A connection that keeps what was subscribed to; its clock is that of the stamps."""

    def __init__(self, **kinds) -> None:
        names = ("Odometry", "PoseWithCovarianceStamped", "LaserScan", "TFMessage", "PointCloud2")
        self.ros = SimpleNamespace(**{name: name for name in names}, **kinds)
        self.handles, self.infos, self.warnings = {}, [], []
        self.kinds: dict[str, tuple[str, int | None]] = {}

    def info(self, message) -> None:
        self.infos.append(message)

    def warn(self, kind, message) -> None:
        self.warnings.append(message)

    def subscribe(self, kind, topic, handle, *, depth=None, **_) -> None:
        self.handles[topic], self.kinds[topic] = handle, (kind, depth)

    def topic(self, name) -> str:
        return f"/{name}"

    def frame(self, name) -> str:
        return name

    def instant(self) -> Instant:
        return Instant(3.0, 7.0)

    def warn_of_clock(self, name, stamped, at) -> None:
        assert (stamped, at.steady) == (3.0, 7.0)


def header(frame, seconds=3):
    return SimpleNamespace(frame_id=frame, stamp=SimpleNamespace(sec=seconds, nanosec=0))


def placed(x, y):
    orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=orientation)


def pose(frame, x):
    return SimpleNamespace(header=header(frame), pose=SimpleNamespace(pose=placed(x, 2.0)))


def scan(frame, ranges=(1.0, 2.0, 3.0)):
    return SimpleNamespace(
        header=header(frame),
        angle_min=-0.1,
        angle_increment=0.1,
        time_increment=0.0,
        range_min=0.0,
        range_max=10.0,
        ranges=ranges,
    )


def test_poses_of_another_frame_than_the_first_are_refused() -> None:
    link, taken = FakeLink(), []
    subscribe_pose(link, NodeSettings(pose_type="pose"), taken.append)
    take = link.handles["/odom"]
    take(pose("map", 1.0))
    with pytest.raises(ValueError, match="of /odom is 'odom'; accepted: 'map', that of the first"):
        take(pose("odom", 5.0))
    take(pose("map", 1.5))
    assert [each.pose[0] for each in taken] == [1.0, 1.5]


def test_scans_of_another_lidar_are_refused() -> None:
    link, taken = FakeLink(), []
    lidar = Lidar(num_beams=8, max_range=5.0)
    subscribe_scan(link, NodeSettings(), lidar, Mount(x=0.3), NoEcho(), taken.append)
    take = link.handles["/scan"]
    take(scan("front_laser"))
    with pytest.raises(ValueError, match="of /scan is 'rear_laser'; accepted: 'front_laser'"):
        take(scan("rear_laser"))
    # A message that is malformed does not set the frame.
    with pytest.raises(ValueError, match="ranges has shape"):
        take(scan("front_laser", ()))
    take(scan("front_laser"))
    assert len(taken) == 2
    np.testing.assert_allclose(taken[0].points[1], [2.3, 0.0], atol=1e-6)


def test_what_the_lidar_reports_for_open_space_is_said_once() -> None:
    link, taken = FakeLink(), []
    lidar = Lidar(num_beams=8, max_range=5.0)
    subscribe_scan(link, NodeSettings(), lidar, Mount(), NoEcho("auto", 0.05), taken.append)
    for _ in range(3):
        link.handles["/scan"](scan("laser", [2.0, 10.0] * 4))
    (said,) = link.infos
    assert "reports its greatest range" in said
    # Others than the four walls are no points.
    assert [len(each.points) for each in taken] == [4, 4, 4]


def cloud(frame, point):
    names = enumerate("xyz")
    fields = [SimpleNamespace(name=n, offset=4 * i, datatype=7, count=1) for i, n in names]
    data = np.array(point, np.float32).tobytes()
    sizes = {"width": 1, "height": 1, "point_step": 12, "row_step": 12}
    return SimpleNamespace(
        header=header(frame), fields=fields, is_bigendian=False, data=data, **sizes
    )


def test_clouds_are_scans_where_the_settings_say_so() -> None:
    link, taken = FakeLink(), []
    lidar = Lidar(num_beams=8, max_range=5.0)
    settings = NodeSettings(scan_topic="points", cloud=CloudSettings(height=0.4))
    subscribe_scan(link, settings, lidar, Mount(x=0.3), NoEcho(), taken.append)
    # Of clouds none waits behind another.
    assert link.kinds == {"/points": ("PointCloud2", 1)}
    take = link.handles["/points"]
    take(cloud("camera", (2.0, 0.0, 0.1)))
    with pytest.raises(ValueError, match="of /points is 'rear'; accepted: 'camera', that of the f"):
        take(cloud("rear", (2.0, 0.0, 0.1)))
    (scan,) = taken
    assert (scan.time, scan.received, scan.frame) == (3.0, Instant(3.0, 7.0), "camera")
    np.testing.assert_allclose(scan.points, [[2.3, 0.0]])
    np.testing.assert_allclose(np.asarray(scan.scan.ranges), [0, 0, 0, 0, 2, 0, 0, 0])


def test_transforms_need_their_package() -> None:
    link = FakeLink()
    link.ros.TFMessage = None
    with pytest.raises(ValueError, match="tf2_msgs is not installed; accepted: odometry or pose"):
        subscribe_pose(link, NodeSettings(pose_type="tf"), print)


def transform(parent, child, x, seconds=3):
    place = SimpleNamespace(x=x, y=0.0, z=0.0)
    rotation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    inner = SimpleNamespace(translation=place, rotation=rotation)
    return SimpleNamespace(header=header(parent, seconds), child_frame_id=child, transform=inner)


def test_only_transforms_between_the_named_frames_count() -> None:
    link, taken = FakeLink(), []
    subscribe_pose(link, NodeSettings(pose_type="tf"), taken.append)
    several = [transform("map", "odom", 9.0), transform("odom", "base_link", 4.0)]
    link.handles["/tf"](SimpleNamespace(transforms=several))
    link.handles["/tf"](SimpleNamespace(transforms=several[:1]))
    assert [each.pose[0] for each in taken] == [4.0]


def test_a_pose_leads_over_all_transforms_between_and_is_news_with_all_of_them() -> None:
    link, taken = FakeLink(), []
    link.warn_of_clock = lambda *_: None
    settings = NodeSettings(pose_type="tf", world_frame="map")
    subscribe_pose(link, settings, taken.append)

    def hear(*transforms, topic="/tf"):
        link.handles[topic](SimpleNamespace(transforms=transforms))

    hear(transform("base_footprint", "base_link", 0.5, 0), topic="/tf_static")
    hear(transform("odom", "base_footprint", 4.0, 3))
    assert taken == []
    hear(transform("map", "odom", 10.0, 3))
    # The odometry goes on, the localisation does not: the robot's place is not known anew.
    hear(transform("odom", "base_footprint", 5.0, 4))
    # That of a gripper that nobody has calibrated hides no other.
    broken = transform("wrist", "gripper", float("nan"), 5)
    with pytest.raises(ValueError, match="translation is"):
        hear(broken, transform("map", "odom", 10.0, 4))
    assert [(each.time, each.frame, each.pose[0]) for each in taken] == [
        (3.0, "map", 14.5),
        (4.0, "map", 15.5),
    ]


def test_a_gap_between_transforms_is_named_after_a_while(monkeypatch) -> None:
    link, times = FakeLink(), iter((0.0, CHAIN_SECONDS - 0.1, CHAIN_SECONDS))
    monkeypatch.setattr("jaxplore.ros.inputs.time.monotonic", lambda: next(times))
    subscribe_pose(link, NodeSettings(pose_type="tf", world_frame="map"), print)
    for _ in range(3):
        link.handles["/tf"](SimpleNamespace(transforms=[transform("odom", "base_link", 4.0)]))
    assert link.warnings == [
        "no transforms lead from map to base_link; heard: odom -> base_link",
    ]
