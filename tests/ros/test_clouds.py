"""Scans of the plane from point clouds, against a loop over points that reads each by `struct`."""

import array
import math
import re
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Lidar
from jaxplore.ros.bag_writer import BagWriter
from jaxplore.ros.clouds import MOST_CLOUD_POINTS, cloud_points, scan_of_cloud
from jaxplore.ros.further_lidars import FurtherLidars
from jaxplore.ros.messages import Mount
from jaxplore.ros.replay import replay, replay_topics
from jaxplore.sensing.beam_ends import scan_of_ends
from jaxplore.sensing.cloud_view import CloudView
from jaxplore.settings.node import NodeSettings, cloud_view
from jaxplore.tasks.exploration.pilot import make_node_settings

MANY = settings(max_examples=60, deadline=None)
SENSOR = Lidar(num_beams=36, max_range=5.0)
CAMERA = Lidar(num_beams=15, max_range=4.0, field_of_view=math.radians(87.0))
FORMATS = {7: ("f", 4), 8: ("d", 8)}
NUMBER = st.one_of(
    st.floats(-6.0, 6.0, width=32),
    st.sampled_from([math.nan, math.inf, -math.inf, 1e30, 0.0, 0.25, -0.25]),
)


def field(name, offset, datatype=7, count=1):
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


def cloud_message(points, *, frame="lidar", width=None, fields=None, step=16, padding=0, big=False):
    """A cloud of points (x, y, z), in rows of a width."""
    width = len(points) if width is None else width
    height = len(points) // width if width else 0
    fields = [field(name, 4 * i) for i, name in enumerate("xyz")] if fields is None else fields
    row = width * step + padding
    data = bytearray(b"\xa5" * (row * height))
    for index, point in enumerate(points):
        begins = index // width * row + index % width * step
        for each in fields:
            if each.name in ("x", "y", "z"):
                letter = (">" if big else "<") + FORMATS[each.datatype][0]
                number = point["xyz".index(each.name)]
                struct.pack_into(letter, data, begins + each.offset, number)
    stamp = SimpleNamespace(sec=3, nanosec=250_000_000)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=frame),
        width=width,
        height=height,
        fields=fields,
        is_bigendian=big,
        point_step=step,
        row_step=row,
        data=array.array("B", bytes(data)),
        is_dense=False,
    )


def read_slowly(message):
    """The points of a cloud, one number after the other."""
    found, data = [], bytes(message.data)
    for row in range(message.height):
        for column in range(message.width):
            begins, point = row * message.row_step + column * message.point_step, []
            for name in "xyz":
                (each,) = (one for one in message.fields if one.name == name)
                letter = (">" if message.is_bigendian else "<") + FORMATS[each.datatype][0]
                point.append(struct.unpack_from(letter, data, begins + each.offset)[0])
            if all(abs(each) <= 1000.0 for each in point):
                found.append(tuple(point))
    return found


@st.composite
def messages(draw):
    """Clouds whose fields have any order, gaps, types and byte order."""
    names = draw(st.permutations(["x", "y", "z", "intensity", "rgb"]))
    fields, end = [], 0
    for name in names:
        datatype = draw(st.sampled_from([7, 8]))
        offset = end + draw(st.integers(0, 5))
        fields.append(field(name, offset, datatype))
        end = offset + FORMATS[datatype][1]
    width, height = draw(st.integers(0, 6)), draw(st.integers(1, 3))
    size = width * height
    points = draw(st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=size, max_size=size))
    return cloud_message(
        points,
        width=width,
        fields=fields,
        step=end + draw(st.integers(0, 7)),
        padding=draw(st.integers(0, 9)) if height > 1 and width else 0,
        big=draw(st.booleans()),
    )


@MANY
@given(messages())
def test_points_of_any_layout_are_those_that_struct_reads(message) -> None:
    expected = np.reshape(read_slowly(message), (-1, 3)).astype(np.float32)
    np.testing.assert_array_equal(cloud_points(message).T, expected)


def turned(point, yaw, pitch, roll):
    """Turn a point about x, then about y and then about z."""
    x, y, z = point
    y, z = math.cos(roll) * y - math.sin(roll) * z, math.sin(roll) * y + math.cos(roll) * z
    x, z = math.cos(pitch) * x + math.sin(pitch) * z, math.cos(pitch) * z - math.sin(pitch) * x
    x, y = math.cos(yaw) * x - math.sin(yaw) * y, math.sin(yaw) * x + math.cos(yaw) * y
    return x, y, z


def scan_slowly(message, sensor, mount, view):
    """The ranges, whether they are returns, and the points in the band, one after the other."""
    angles = [float(each) for each in sensor.beam_angles]
    spacing = float(sensor.beam_spacing)
    met, free, points = {}, {}, []
    for point in read_slowly(message):
        is_optical = message.header.frame_id.endswith("_optical_frame")
        if is_optical:
            right, down, ahead = point
            point = (ahead, -right, -down)
        if math.dist(point, (0, 0, 0)) < view.least_range:
            continue
        roll = view.roll + math.pi * mount.is_inverted
        x, y, z = turned(point, mount.yaw, view.pitch, roll)
        bearing, distance, up = math.atan2(y, x), math.hypot(x, y), z + view.height
        away = [abs(math.remainder(bearing - each, math.tau)) for each in angles]
        beam = min(range(len(angles)), key=away.__getitem__)
        if up < view.least_height:
            share = (view.height - view.least_height) / (view.height - up)
        elif up > view.greatest_height:
            share = (view.greatest_height - view.height) / (up - view.height)
        else:
            share = None
            points.append((x + mount.x, y + mount.y))
        if away[beam] > 0.5 * spacing:
            continue
        if share is None:
            met[beam] = min(met.get(beam, math.inf), distance)
        else:
            free[beam] = max(free.get(beam, 0.0), share * distance)
    most, ranges, returns = float(sensor.max_range), [], []
    for beam in range(len(angles)):
        rest = most if view.is_rest_free else 0.0
        left = min(free[beam], most) if free.get(beam) else rest
        ranges.append(min(met[beam], most) if beam in met else left)
        returns.append(beam in met and met[beam] <= most)
    return ranges, returns, points


@MANY
@given(
    st.lists(st.tuples(*[st.floats(-6.0, 6.0, width=32)] * 3), max_size=40),
    st.sampled_from([SENSOR, CAMERA]),
    st.tuples(*[st.floats(-1.0, 1.0)] * 5),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["lidar", "camera_optical_frame"]),
)
def test_a_scan_is_that_of_a_loop(points, sensor, numbers, is_inverted, is_free, frame) -> None:
    x, y, yaw, pitch, roll = numbers
    mount = Mount(x, y, 3.0 * yaw, is_inverted)
    view = CloudView(0.6, 0.1, 1.1, pitch, roll, 0.4, is_rest_free=is_free)
    message = cloud_message(points, frame=frame)
    found = scan_of_cloud(message, sensor, mount, view)
    ranges, returns, band = scan_slowly(message, sensor, mount, view)
    # A point on the border of two beams or of the band may be on either side of it.
    same = np.isclose(found.scan.ranges, ranges, rtol=1e-5, atol=1e-5)
    assert same.sum() >= len(ranges) - 2
    assert (np.asarray(found.scan.is_return) == returns).sum() >= len(ranges) - 2
    assert (found.time, found.frame) == (3.25, frame)
    # The nearest point in each of 720 directions is kept, and no other is made up.
    for each in found.points:
        assert min(math.dist(each, other) for other in band) < 1e-5
    if band:
        assert np.hypot(*found.points.T).min() == pytest.approx(
            min(math.hypot(*each) for each in band)
        )


def test_a_wall_the_floor_and_a_beam_above() -> None:
    """A camera at 0.4 m that looks down by 0.2 rad sees a wall, the floor and a lamp."""
    view = CloudView(0.4, 0.1, 1.0, pitch=0.2)
    scene = [(2.0, 0.0, 0.5), (3.0, 1.0, 0.0), (3.0, -1.0, 1.9)]
    inverse = [
        (
            math.cos(0.2) * x - math.sin(0.2) * (z - 0.4),
            y,
            math.sin(0.2) * x + math.cos(0.2) * (z - 0.4),
        )
        for x, y, z in scene
    ]
    optical = [(-y, -z, x) for x, y, z in inverse]
    for frame, points in (("camera_link", inverse), ("camera_depth_optical_frame", optical)):
        found = scan_of_cloud(cloud_message(points, frame=frame), CAMERA, Mount(), view)
        ranges, is_return = np.asarray(found.scan.ranges), np.asarray(found.scan.is_return)
        beam = [int(np.abs(CAMERA.beam_angles - math.atan2(y, x)).argmin()) for x, y, _ in scene]
        assert ranges[beam[0]] == pytest.approx(2.0, abs=1e-5)
        # Of the ray to the floor three quarters are above 0.1 m; of that to the lamp 0.6 m of 1.5.
        assert ranges[beam[1]] == pytest.approx(0.75 * math.hypot(3.0, 1.0), abs=1e-5)
        assert ranges[beam[2]] == pytest.approx(0.4 * math.hypot(3.0, 1.0), abs=1e-5)
        assert is_return.nonzero()[0].tolist() == [beam[0]]
        assert (ranges > 0.0).sum() == 3
        np.testing.assert_allclose(found.points, [[2.0, 0.0]], atol=1e-5)


def test_an_empty_cloud_is_a_scan_without_a_measurement() -> None:
    view = CloudView(0.4)
    found = scan_of_cloud(cloud_message([]), SENSOR, Mount(), view)
    assert not np.asarray(found.scan.ranges).any()
    assert found.points.shape == (0, 2)
    ends = scan_of_ends(SENSOR, np.zeros((2, 0)), np.zeros((2, 0)), is_rest_free=True)
    np.testing.assert_array_equal(ends.ranges, np.full(36, 5.0, np.float32))


def test_what_is_too_near_is_left_out_and_what_is_far_is_cut() -> None:
    near = cloud_message([(1.5, 0.0, 0.0), (0.0, 2.5, 0.0), (0.5, 0.0, -0.4)])
    found = scan_of_cloud(near, SENSOR, Mount(), CloudView(0.4, least_range=2.0))
    np.testing.assert_allclose(found.points, [[0.0, 2.5]], atol=1e-6)
    assert (np.asarray(found.scan.ranges) > 0.0).sum() == 1
    # The sensor's range is 5 m: of a return beyond it, and of a ray to 9 m, that much is free.
    ends = scan_of_ends(SENSOR, np.array([[7.0], [0.0]]), np.array([[0.0], [9.0]]))
    assert np.asarray(ends.ranges)[[18, 27]].tolist() == [5.0, 5.0]
    assert not np.asarray(ends.is_return).any()


POINTS = [(1.0, 2.0, 3.0)] * 6
XYZ = {name: 4 * i for i, name in enumerate("xyz")}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"width": 1000, "height": 1000}, "width x height of a cloud is 1000 x 1000; accepted: a"),
        ({"width": 2**32 - 1}, f"accepted: at most {MOST_CLOUD_POINTS} points"),
        ({"width": -1}, "width of a cloud is -1; accepted"),
        ({"point_step": 0}, "point_step of a cloud is 0; accepted: 1 to 1024 bytes"),
        ({"point_step": 2**31}, "point_step of a cloud is 2147483648"),
        (
            {"point_step": 20},
            "row_step of a cloud is 48; accepted: at least width x point_step, 60",
        ),
        ({"row_step": 47}, "row_step of a cloud is 47; accepted: at least width x point_step, 48"),
        ({"row_step": 64}, "data of a cloud is 96 bytes; accepted: height x row_step, 128"),
        ({"height": 3}, "data of a cloud is 96 bytes; accepted: height x row_step, 144"),
        ({"data": array.array("B")}, "data of a cloud is 0 bytes"),
        ({"data": np.zeros((2, 48), np.uint8)}, "data of a cloud is 96 bytes"),
        ({"data": np.zeros(12, np.float64)}, "data of a cloud is 96 bytes"),
        ({"data": np.zeros(192, np.uint8)[::2]}, "data of a cloud is 96 bytes"),
        ({"fields": []}, "fields of a cloud are none; accepted: x, y and z, each once"),
        ({"fields": [field("x", 0), field("y", 4)]}, "fields of a cloud are x, y; accepted"),
        ({"fields": [field(n, 0) for n in "xxyz"]}, "fields of a cloud are x, x, y, z; accepted"),
        ({"fields": [field("x", 0)] * 100}, "a cloud has 100 fields; accepted: at most 64"),
        ({"fields": [field("x", 13), *[field(n, 0) for n in "yz"]]}, "offset of the field x of a"),
        ({"fields": [field("x", 9, 8), *[field(n, 0) for n in "yz"]]}, "less its size, 8"),
        ({"fields": [field("x", -4), *[field(n, 0) for n in "yz"]]}, "is -4; accepted: 0 to poi"),
        ({"fields": [field(n, 0, 4) for n in "xyz"]}, "is 1 of the datatype 4; accepted: 1 of 7"),
        ({"fields": [field(n, 0, 7, 3) for n in "xyz"]}, "is 3 of the datatype 7; accepted"),
    ],
)
def test_malformed_clouds_are_refused_in_one_line(changes, said) -> None:
    message = cloud_message(POINTS, width=3)
    assert cloud_points(message).shape == (3, 6)
    message.__dict__.update(changes)
    with pytest.raises(ValueError, match=re.escape(said)) as caught:
        scan_of_cloud(message, SENSOR, Mount(), CloudView(0.4))
    assert "\n" not in str(caught.value)


def test_a_signalling_nan_is_no_point_and_gives_no_warning() -> None:
    message = cloud_message([(1.0, 2.0, 0.0)] * 2)
    message.data[0:4] = array.array("B", struct.pack("<I", 0x7F800001))
    assert cloud_points(message).T.tolist() == [[1.0, 2.0, 0.0]]


def test_the_settings_of_a_cloud() -> None:
    assert cloud_view(NodeSettings()) is None
    entries = {"height": 0.5, "pitch_degrees": 90.0, "least_height": 0.05}
    _, node = make_node_settings({"node": {"cloud": entries, "no_echo": "zero"}})
    expected = CloudView(0.5, least_height=0.05, pitch=math.pi / 2, is_rest_free=True)
    assert cloud_view(node) == expected
    for wrong, said in (
        (
            {"height": 1.2},
            "height of a cloud's sensor is 1.2; accepted: between its least_height, 0.1",
        ),
        ({}, "node.cloud.height"),
        ({"height": 0.5, "axes": "sideways"}, "node.cloud.axes"),
        ({"height": 0.5, "pitch_degrees": 200.0}, "node.cloud.pitch_degrees"),
    ):
        with pytest.raises(ValueError, match=said):
            make_node_settings({"node": {"cloud": wrong}})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"height": math.nan}, "height is nan"),
        ({"pitch": 4.0}, "pitch is 4.0"),
        ({"least_range": -0.1}, "least_range is -0.1"),
        ({"axes": "up"}, "axes is 'up'; accepted: auto, body, optical"),
    ],
)
def test_wrong_views_are_refused(change, said) -> None:
    with pytest.raises(ValueError, match=said):
        CloudView(**{"height": 0.4, **change})


def pose_message(seconds):
    blank = {"x": 0.0, "y": 0.0, "z": 0.0}
    spread = np.zeros(36)
    pose = SimpleNamespace(
        position=SimpleNamespace(**blank), orientation=SimpleNamespace(**blank, w=1.0)
    )
    twist = SimpleNamespace(linear=SimpleNamespace(**blank), angular=SimpleNamespace(**blank))
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=0), frame_id="odom"),
        child_frame_id="base_link",
        pose=SimpleNamespace(pose=pose, covariance=spread),
        twist=SimpleNamespace(twist=twist, covariance=spread),
    )


class ListeningPilot:
    """A pilot that keeps the scans that it gets, and commands nothing."""

    def __init__(self) -> None:
        self.sensor, self.period, self.scans, self.poses = SENSOR, 0.1, [], 0
        self.task = SimpleNamespace(perception=SimpleNamespace(part=lambda _: None))
        frames = SimpleNamespace(add_when_due=lambda *_: None)
        self.log, self.make_frame = SimpleNamespace(frames=frames), None

    def command(self, now):
        return now

    def update_belief(self, now) -> None:
        pass

    def add_odometry(self, *_) -> None:
        self.poses += 1

    def add_scan(self, time, scan, points, received, sweep) -> None:
        self.scans.append((time, scan, points, sweep))


def test_a_replay_reads_clouds_and_leaves_out_malformed_ones(tmp_path) -> None:
    clouds = [
        cloud_message([(2.0, 0.1 * i, 0.2), (1.0, 1.0, -0.6)], frame="lidar") for i in range(3)
    ]
    clouds[1].fields[2].name = "height"
    with BagWriter(tmp_path / "drive") as writer:
        for i, each in enumerate(clouds):
            each.header.stamp.sec = 5 + i
            writer.write("/odom", "Odometry", pose_message(5 + i), 5.0 + i)
            writer.write("/points", "PointCloud2", each, 5.25 + i)
    folder, pilot = tmp_path / "drive", ListeningPilot()
    topics = replay_topics(folder, None, None, is_cloud=True)
    assert topics == ("/points", "/odom")
    view, mount = CloudView(0.5), Mount(x=0.2)
    found = replay(folder, pilot, *topics, mount=mount, view=view)
    assert (found.num_messages, found.num_malformed, pilot.poses) == (6, 1, 3)
    assert found.reason == "fields of a cloud are x, y, height; accepted: x, y and z, each once"
    assert [each[0] for each in pilot.scans] == [5.25, 7.25]
    for (_, scan, points, sweep), each in zip(pilot.scans, clouds[::2], strict=True):
        expected = scan_of_cloud(each, SENSOR, mount, view)
        np.testing.assert_array_equal(scan.ranges, expected.scan.ranges)
        np.testing.assert_array_equal(points, expected.points)
        assert len(points) == 1
        assert sweep is None
    with pytest.raises(ValueError, match="bag has no topic of kind LaserScan"):
        replay_topics(folder, None, None)


def laser_message(seconds, ranges):
    stamp = SimpleNamespace(sec=seconds, nanosec=0)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id="laser"),
        angle_min=0.0,
        angle_max=0.0,
        angle_increment=math.radians(10.0),
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.0,
        range_max=10.0,
        ranges=ranges,
        intensities=[],
    )


def test_a_replay_completes_scans_by_a_further_lidar(tmp_path) -> None:
    """The rear lidar, of 5 s and of 7 s, is missing at first, and too old at 6.5 s."""
    with BagWriter(tmp_path / "drive") as writer:
        for time, topic, seconds, ranges in (
            (5.1, "/scan", 5, [2.0]),
            (5.2, "/rear", 5, [1.5]),
            (5.3, "/scan", 5, [2.5]),
            (6.5, "/scan", 6, [2.5]),
            (7.1, "/rear", 7, [1.0]),
            (7.2, "/scan", 7, [3.0]),
        ):
            writer.write("/odom", "Odometry", pose_message(seconds), time - 0.01)
            writer.write(topic, "LaserScan", laser_message(seconds, ranges), time)
    pilot, rear = ListeningPilot(), Mount(-0.5, 0.0, math.pi)
    further = FurtherLidars(SENSOR, Mount(), {"/rear": rear}, max_age=0.5)
    found = replay(tmp_path / "drive", pilot, "/scan", "/odom", further=further)
    assert (found.num_malformed, len(pilot.scans)) == (2, 2)
    assert found.reason.startswith("the scan of /rear is missing")
    for (time, scan, points, _), (seconds, ahead, behind) in zip(
        pilot.scans, ((5.0, 2.5, 2.0), (7.0, 3.0, 1.5)), strict=True
    ):
        assert time == seconds
        np.testing.assert_allclose(points, [[ahead, 0.0], [-behind, 0.0]], atol=1e-9)
        expected = np.zeros(36)
        expected[[0, 18]] = behind, ahead
        np.testing.assert_allclose(scan.ranges, expected, atol=1e-6)
    wrong = FurtherLidars(SENSOR, Mount(), {"/left": rear}, max_age=0.5)
    with pytest.raises(ValueError, match="topic is '/left', not of a LaserScan"):
        replay(tmp_path / "drive", pilot, "/scan", "/odom", further=wrong)
