"""One scan of several lidars, in a rectangular room whose ranges have a closed form."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from tests.ros.test_inputs import FakeLink

from jaxplore import Lidar
from jaxplore.onboard.drive_clock import Instant
from jaxplore.ros.further_lidars import FurtherLidars, further_lidars
from jaxplore.ros.inputs import subscribe_further, subscribe_scan
from jaxplore.ros.messages import Mount, Odometry, laser_scan_of
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.node import NodeSettings, full_topic
from jaxplore.tasks.exploration.pilot import make_node_settings

SENSOR = Lidar(num_beams=120, max_range=8.0)
WALLS = (-3.0, 4.0, -2.0, 3.0)
FRONT, REAR = Mount(0.25, 0.1), Mount(-0.25, -0.1, math.pi)
TWIST = np.array([0.5, 0.0, 1.0])


def range_in_room(x, y, angle):
    """Distance of the nearest wall of the room from a place inside it in a direction."""
    cos, sin = math.cos(angle), math.sin(angle)
    left, right, low, high = WALLS
    return min(
        ((right if cos > 0.0 else left) - x) / cos if abs(cos) > 1e-12 else math.inf,
        ((high if sin > 0.0 else low) - y) / sin if abs(sin) > 1e-12 else math.inf,
    )


def pose_at(seconds):
    """Pose on a circle with a velocity of `TWIST`, at the origin at the time 10 s."""
    yaw = TWIST[2] * (seconds - 10.0)
    radius = TWIST[0] / TWIST[2]
    return np.array([radius * math.sin(yaw), radius * (1.0 - math.cos(yaw)), yaw])


def place_of(pose, mount):
    x, y, yaw = pose
    return (
        x + math.cos(yaw) * mount.x - math.sin(yaw) * mount.y,
        y + math.sin(yaw) * mount.x + math.cos(yaw) * mount.y,
        yaw + mount.yaw,
    )


def half_scan(seconds, mount, *, stamp=None, range_max=20.0):
    """A message of a lidar that sees 200 degrees, measured at a time at once."""
    x, y, yaw = place_of(pose_at(seconds), mount)
    angles = np.radians(np.arange(-100.0, 100.5, 1.0))
    ranges = [range_in_room(x, y, yaw + each) for each in angles]
    stamp = seconds if stamp is None else stamp
    time = SimpleNamespace(sec=int(stamp), nanosec=round(stamp % 1.0 * 1e9))
    return SimpleNamespace(
        header=SimpleNamespace(stamp=time, frame_id="laser"),
        angle_min=angles[0],
        angle_increment=math.radians(1.0),
        time_increment=0.0,
        range_min=0.0,
        range_max=range_max,
        ranges=[each if each <= range_max else math.inf for each in ranges],
    )


def lidars(max_age=0.5):
    return FurtherLidars(SENSOR, FRONT, {"/rear": REAR}, max_age=max_age)


def first_scan(seconds, received=None, **options):
    scan = laser_scan_of(half_scan(seconds, FRONT, **options), SENSOR, FRONT)
    return scan._replace(received=Instant(seconds if received is None else received))


def drive(further, *, with_poses=True):
    """Let a rear lidar measure at 9.92 s and the front one at 10 s; return the whole scan."""
    for index in range(8):
        seconds = 9.8 + 0.04 * index
        if with_poses:
            further.add_pose(Odometry(seconds, "odom", pose_at(seconds), TWIST))
    further.read("/rear", half_scan(9.92, REAR), Instant(9.93))
    return further.complete(first_scan(10.0))


def errors(scan):
    """What the ranges of a whole scan of 9.92 s differ by from those of the room, and points."""
    x, y, yaw = place_of(pose_at(9.92), FRONT)
    expected = [range_in_room(x, y, yaw + float(each)) for each in SENSOR.beam_angles]
    placed = np.array([place_of(pose_at(9.92), Mount(*each))[:2] for each in scan.points])
    left, right, low, high = WALLS
    away = np.abs(
        np.stack(
            [placed[:, 0] - left, placed[:, 0] - right, placed[:, 1] - low, placed[:, 1] - high]
        )
    ).min(axis=0)
    return np.abs(np.asarray(scan.scan.ranges) - expected), away


def test_front_and_rear_are_one_scan_of_the_time_of_the_older_one() -> None:
    scan = drive(lidars())
    assert (scan.time, scan.received, scan.sweep) == (pytest.approx(9.92), Instant(10.0), None)
    assert np.asarray(scan.scan.is_return).all()
    error, away = errors(scan)
    # A beam has the nearest of the readings within 1.5 degrees, oblique to a wall at 4 m.
    assert np.median(error) < 0.03
    assert error.max() < 0.35
    assert away.max() < 0.002
    assert len(scan.points) == 2 * 201
    # The motion matters: without poses walls are elsewhere.
    _, away = errors(drive(lidars(), with_poses=False))
    assert away.max() > 0.1


def test_where_no_lidar_measures_there_is_no_measurement_and_free_is_free() -> None:
    further = FurtherLidars(SENSOR, FRONT, {"/side": Mount(0.0, 0.2, 0.5 * math.pi)}, max_age=0.5)
    message = half_scan(10.0, Mount(0.0, 0.2, 0.5 * math.pi), range_max=2.0)
    further.read("/side", message, Instant(10.0))
    scan = further.complete(first_scan(10.0, range_max=2.0))
    ranges, is_return = np.asarray(scan.scan.ranges), np.asarray(scan.scan.is_return)
    bearing = np.degrees(SENSOR.beam_angles)
    # Front sees from -100 degrees on, the other one from -10 to 190.
    assert not ranges[(bearing > -165.0) & (bearing < -105.0)].any()
    assert not is_return[(bearing > -165.0) & (bearing < -105.0)].any()
    ahead = np.abs(bearing) < 20.0
    # Beams ahead met nothing within 2 m, and say so.
    assert not is_return[ahead].any()
    np.testing.assert_allclose(ranges[ahead], 2.0, atol=0.3)
    right = np.abs(bearing + 90.0) < 5.0
    assert is_return[right].all() == (2.0 + FRONT.y <= 2.0)


def test_the_nearest_return_counts() -> None:
    """The further lidar sees a post at 1 m to the left before the wall that the first one sees."""
    further = FurtherLidars(SENSOR, Mount(), {"/low": Mount()}, max_age=0.5)
    low = half_scan(10.0, Mount())
    low.ranges = [1.0 if 85 <= i - 100 <= 95 else math.nan for i in range(201)]
    further.read("/low", low, Instant(10.0))
    scan = further.complete(
        laser_scan_of(half_scan(10.0, Mount()), SENSOR, Mount())._replace(received=Instant(10.0))
    )
    ranges, bearing = np.asarray(scan.scan.ranges), np.degrees(SENSOR.beam_angles)
    np.testing.assert_allclose(ranges[np.abs(bearing - 90.0) < 4.0], 1.0, atol=1e-5)
    assert ranges[np.abs(bearing) < 1.6] == pytest.approx(4.0, abs=0.01)


def test_a_lidar_that_stops_leaves_no_scan() -> None:
    further = lidars()
    with pytest.raises(ValueError, match=r"the scan of /rear is missing; accepted: at most 0.5 s"):
        further.complete(first_scan(10.0))
    further.read("/rear", half_scan(10.0, REAR), Instant(10.0))
    assert further.complete(first_scan(10.4)).time == pytest.approx(10.0)
    with pytest.raises(ValueError, match=r"the scan of /rear is 0.60 s older than this one"):
        further.complete(first_scan(10.6))
    # After a jump back of the clock it is no newer one.
    with pytest.raises(ValueError, match=r"is -7.00 s older"):
        further.complete(first_scan(3.0))
    # However great the age that is accepted, clocks agree to a second.
    slack = lidars(max_age=30.0)
    slack.read("/rear", half_scan(10.0, REAR), Instant(10.0))
    with pytest.raises(ValueError, match=r"1.50 s older than this one; accepted: at most 1 s"):
        slack.complete(first_scan(11.5))


def test_stamps_of_another_clock_count_from_their_arrival() -> None:
    further = lidars()
    further.read("/rear", half_scan(10.0, REAR, stamp=0.0), Instant(10.1))
    assert further.complete(first_scan(10.3)).time == pytest.approx(10.1)
    # In a replay that has left out 500 s stamps are earlier by them.
    further.read("/rear", half_scan(510.0, REAR), Instant(10.15), 500.0)
    assert further.complete(first_scan(10.3)).time == pytest.approx(10.0)
    further.read("/rear", half_scan(10.0, REAR), Instant(510.0))
    with pytest.raises(ValueError, match="older"):
        further.complete(first_scan(10.3))


def test_the_node_hears_all_lidars() -> None:
    link, taken, heard = FakeLink(), [], []
    link.instant = lambda: Instant(10.0, 7.0)
    link.warn_of_clock = lambda *_: None
    further = lidars()

    def take(scan) -> None:
        taken.append(further.complete(scan))

    subscribe_scan(link, NodeSettings(), SENSOR, FRONT, NoEcho(), take)
    subscribe_further(link, further, heard.append)
    assert set(link.handles) == {"/scan", "/rear"}
    with pytest.raises(ValueError, match=r"the scan of /rear is missing"):
        link.handles["/scan"](half_scan(10.0, FRONT))
    link.handles["/rear"](half_scan(10.0, REAR))
    link.handles["/scan"](half_scan(10.0, FRONT))
    assert heard == ["/rear"]
    assert np.asarray(taken[0].scan.is_return).all()
    other = half_scan(10.0, REAR)
    other.header.frame_id = "side"
    with pytest.raises(ValueError, match="of /rear is 'side'; accepted: 'laser'"):
        link.handles["/rear"](other)


def test_each_lidar_has_a_topic_of_its_own() -> None:
    rear = [-0.2, 0.1, 180.0]
    entries = {"further_lidars": {"rear": rear, "/side": rear}, "namespace": "robot1"}
    _, node = make_node_settings({"node": entries})
    found = further_lidars(node, SENSOR, FRONT, 0.05, partial(full_topic, node))
    assert found is not None
    assert found.topics == ("/robot1/rear", "/side")
    assert further_lidars(NodeSettings(), SENSOR, FRONT, 0.05, str) is None
    for wrong, said in (
        ({"rear": rear, "/rear": rear}, "has the topic /rear of another lidar; accepted: a topic"),
        ({"scan": rear}, "has the topic /scan of another lidar"),
        ({"rear": [1.0]}, r"setting node.further_lidars.rear is \[1.0\]; accepted"),
        ({"a b": rear}, "node.further_lidars"),
        ({f"t{i}": rear for i in range(9)}, "node.further_lidars"),
    ):
        with pytest.raises(ValueError, match=said):
            make_node_settings({"node": {"further_lidars": wrong}})
