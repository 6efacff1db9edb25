"""Conversions of ROS messages, with plain objects in their place."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Lidar, OccupancyGrid
from jaxplore.report.drawing.rollout_costs import cost_colours
from jaxplore.ros import map_messages, messages
from jaxplore.ros.drive_publisher import rollout_colours
from jaxplore.ros.messages import Mount
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.lidar_errors import LidarErrors

SENSOR = Lidar(num_beams=36, max_range=5.0)
FINITE = st.floats(-1e4, 1e4)
ANGLE = st.floats(-3.14, 3.14)
MANY = settings(max_examples=40, deadline=None)


class Plain:
    """A message whose fields come into being when they are read or set."""

    def __init__(self, **fields) -> None:
        self.__dict__.update(fields)

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        self.__dict__[name] = Plain()
        return self.__dict__[name]


def battery_message(**fields):
    given = {"percentage": math.nan, "charge": math.nan, "capacity": math.nan}
    return SimpleNamespace(**{**given, "design_capacity": math.nan, **fields})


@pytest.mark.parametrize(
    ("fields", "share"),
    [
        ({"percentage": 0.42}, 0.42),
        ({"percentage": 1.03}, 1.0),
        ({"charge": 1.5, "capacity": 6.0, "design_capacity": 9.0}, 0.25),
        ({"charge": 1.5, "capacity": 0.0, "design_capacity": 7.5}, 0.2),
    ],
)
def test_the_charge_is_a_share_of_what_the_battery_holds(fields, share) -> None:
    assert messages.battery_share_of(battery_message(**fields)) == pytest.approx(share)


@pytest.mark.parametrize(
    "fields",
    [{}, {"percentage": 87.0}, {"percentage": -0.1}, {"charge": 2.0}, {"percentage": math.inf}],
)
def test_a_charge_that_is_no_share_is_refused(fields) -> None:
    with pytest.raises(ValueError, match=r"percentage of a battery is .*; accepted: a share"):
        messages.battery_share_of(battery_message(**fields))


def scan_message(ranges, **fields):
    header = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=250_000_000), frame_id="laser")
    given = {
        "angle_min": -math.pi,
        "angle_increment": 2.0 * math.pi / max(len(ranges), 1),
        "range_min": 0.1,
        "range_max": 30.0,
        "time_increment": 0.0,
    }
    return SimpleNamespace(header=header, ranges=ranges, **{**given, **fields})


@MANY
@given(st.tuples(FINITE, FINITE, ANGLE))
def test_poses_go_there_and_back(pose) -> None:
    message = Plain()
    messages.fill_pose(message, pose)
    found = messages.pose_of(message)
    np.testing.assert_array_equal(found[:2], pose[:2])
    assert found[2] == pytest.approx(pose[2], abs=1e-15)


@MANY
@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_times_go_there_and_back_to_a_microsecond(seconds, nanoseconds) -> None:
    stamp, other = Plain(sec=seconds, nanosec=nanoseconds), Plain()
    messages.fill_time(other, messages.time_of(stamp))
    # Double precision has a quarter of a microsecond left in this century.
    assert abs((other.sec - seconds) * 10**9 + other.nanosec - nanoseconds) < 500
    assert 0 <= other.nanosec < 10**9


def test_a_time_just_below_a_second_is_the_second() -> None:
    """Half a nanosecond or less below it: nanoseconds end at 999,999,999."""
    stamp = Plain()
    messages.fill_time(stamp, 8.0 - 2.0**-32)
    assert (stamp.sec, stamp.nanosec) == (8, 0)
    messages.fill_time(stamp, 8.0 - 2.0**-29)
    assert (stamp.sec, stamp.nanosec) == (7, 999_999_998)


@MANY
@given(st.tuples(FINITE, FINITE, ANGLE), st.tuples(FINITE, FINITE, FINITE))
def test_odometry_goes_there_and_back(pose, twist) -> None:
    message = Plain()
    given_ = messages.Odometry(12.5, "odom", np.array(pose), np.array(twist))
    messages.fill_odometry(message, given_, "base")
    found = messages.odometry_of(message)
    assert (found.time, found.frame, message.child_frame_id) == (12.5, "odom", "base")
    np.testing.assert_allclose(found.pose, pose, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(found.twist, twist)


def test_a_pose_with_covariance_has_no_velocity_and_a_yaw_from_any_quaternion() -> None:
    message = SimpleNamespace(header=Plain(frame_id="map"), pose=SimpleNamespace(pose=Plain()))
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    messages.fill_pose(message.pose.pose, (1.0, 2.0, 0.0))
    # Roll and pitch of a tilted robot beside a yaw of 1 rad, from the product of three quaternions.
    roll, pitch, yaw = 0.2, -0.1, 1.0
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    message.pose.pose.orientation = SimpleNamespace(
        w=cr * cp * cy + sr * sp * sy,
        x=sr * cp * cy - cr * sp * sy,
        y=cr * sp * cy + sr * cp * sy,
        z=cr * cp * sy - sr * sp * cy,
    )
    found = messages.odometry_of(message)
    assert found.twist is None
    np.testing.assert_allclose(found.pose, [1.0, 2.0, yaw], atol=1e-12)


@pytest.mark.parametrize(
    "orientation", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, math.nan, 1.0), (0.0, 0.0, 2.0, 2.0)]
)
def test_an_orientation_that_is_no_rotation_is_refused(orientation) -> None:
    given_ = dict(zip("xyzw", orientation, strict=True))
    with pytest.raises(ValueError, match=r"orientation is .*; accepted: a unit quaternion"):
        messages.yaw_of(SimpleNamespace(**given_))


def test_a_scan_has_the_readings_of_its_beams_and_all_points() -> None:
    ranges = [2.0] * 360
    ranges[90], ranges[180], ranges[270], ranges[10] = math.inf, math.nan, 0.05, 40.0
    found = messages.laser_scan_of(scan_message(ranges), SENSOR)
    assert (found.time, found.frame) == (3.25, "laser")
    # Beam k of the sensor is reading 10 k: the first one, 10, is beyond range_max, as some drivers
    # report a beam that met nothing.
    returns, far = np.asarray(found.scan.is_return), np.asarray(found.scan.ranges)
    assert not returns[[1, 9, 18, 27]].any()
    assert returns.sum() == 32
    np.testing.assert_array_equal(far[[1, 9, 18, 27]], [5.0, 5.0, 0.0, 0.0])
    assert len(found.points) == 356
    np.testing.assert_allclose(np.hypot(*found.points.T), 2.0)


@MANY
@given(
    st.lists(st.floats(0.2, 29.0), min_size=1, max_size=50),
    st.floats(-math.pi, math.pi),
    st.floats(0.001, 0.1),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), ANGLE),
)
def test_a_reversed_scan_and_an_inverted_lidar_see_the_same_points(
    ranges, first, step, place
) -> None:
    last = first + step * (len(ranges) - 1)
    plain = scan_message(ranges, angle_min=first, angle_increment=step)
    backwards = scan_message(ranges[::-1], angle_min=last, angle_increment=-step)
    # Upside down, the same readings come at the negative angles.
    turned = scan_message(ranges, angle_min=-first, angle_increment=-step)
    found = [
        messages.laser_scan_of(plain, SENSOR, Mount(*place)),
        messages.laser_scan_of(backwards, SENSOR, Mount(*place)),
        messages.laser_scan_of(turned, SENSOR, Mount(*place, is_inverted=True)),
    ]
    for other, order in ((found[1], slice(None, None, -1)), (found[2], slice(None))):
        np.testing.assert_allclose(other.points[order], found[0].points, atol=1e-9)
    # By rigid motion of the points in the frame of the lidar.
    angles = first + step * np.arange(len(ranges))
    own = np.array(ranges)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    cos, sin = math.cos(place[2]), math.sin(place[2])
    expected = own @ np.array([[cos, sin], [-sin, cos]]) + place[:2]
    np.testing.assert_allclose(found[0].points, expected, atol=1e-9)


def test_a_scan_of_ours_goes_there_and_back_to_the_bit() -> None:
    rng = np.random.default_rng(0)
    is_return = rng.random(SENSOR.num_beams) < 0.7
    ranges = np.where(is_return, rng.uniform(0.1, 5.0, SENSOR.num_beams), 5.0).astype(np.float32)
    message = Plain()
    scan = Scan(ranges, is_return)
    messages.fill_laser_scan(message, scan, SENSOR, 7.0, "laser", period=0.1)
    found = messages.laser_scan_of(message, SENSOR)
    np.testing.assert_array_equal(found.scan.is_return, is_return)
    np.testing.assert_array_equal(found.scan.ranges, ranges)


def test_a_beam_without_a_measurement_is_no_free_space() -> None:
    message, number = Plain(), SENSOR.num_beams
    ranges = np.where(np.arange(number) % 2 == 0, 0.0, 5.0).astype(np.float32)
    scan = Scan(ranges, np.zeros(number, bool))
    messages.fill_laser_scan(message, scan, SENSOR, 7.0, "laser", period=0.1)
    found = messages.laser_scan_of(message, SENSOR)
    np.testing.assert_array_equal(found.scan.ranges, ranges)
    assert not np.asarray(found.scan.is_return).any()


def test_a_tilted_lidar_does_not_take_the_floor_for_a_wall() -> None:
    tilted = Lidar(36, 5.0, height=0.2, errors=LidarErrors(pitch=0.1))
    found = messages.laser_scan_of(scan_message([2.5] * 360), tilted)
    angles = tilted.beam_angles.astype(np.float64)
    # Straight ahead it meets the floor at 0.2 m / sin 0.1 = 2.003 m.
    is_floor = 2.5 * np.sin(0.1) * np.cos(angles) >= 0.9 * 0.2
    assert 5 < is_floor.sum() < 18
    np.testing.assert_array_equal(np.asarray(found.scan.is_return), ~is_floor)
    np.testing.assert_array_equal(np.asarray(found.scan.ranges)[is_floor], 0.0)
    assert found.points[:, 0].max() < 0.9 * 0.2 / np.sin(0.1) + 1e-6


def test_the_times_of_readings_are_those_of_the_message() -> None:
    message = scan_message([2.0] * 360)
    assert messages.laser_scan_of(message, SENSOR).sweep is None
    message.time_increment = 0.1 / 360
    sweep = messages.laser_scan_of(message, SENSOR, Mount(0.1, 0.0, 0.5)).sweep
    angles = 0.5 + message.angle_min + message.angle_increment * np.arange(360)
    np.testing.assert_allclose(sweep.times(angles), 0.1 * np.arange(360) / 360, atol=1e-6)
    message.time_increment = 1.0
    assert messages.laser_scan_of(message, SENSOR).sweep is None


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"ranges": []}, r"ranges has shape \(0,\)"),
        ({"ranges": [1.0] * 100_001}, "ranges has shape"),
        ({"angle_increment": 0.0}, "angle_increment is 0.0"),
        ({"angle_min": math.nan}, "angle_min is nan"),
        ({"range_min": 3.0, "range_max": 2.0}, "range_max is 2.0"),
    ],
)
def test_scans_that_make_no_sense_are_refused(fields, message) -> None:
    given_ = scan_message([1.0] * 10)
    given_.__dict__.update(fields)
    with pytest.raises(ValueError, match=message):
        messages.laser_scan_of(given_, SENSOR)


@MANY
@given(
    st.integers(1, 12),
    st.integers(1, 12),
    st.tuples(FINITE, FINITE, ANGLE),
    st.randoms(use_true_random=False),
)
def test_maps_go_there_and_back_exactly(rows, columns, origin, random) -> None:
    message, other = Plain(), Plain()
    data = [random.randint(-1, 100) for _ in range(rows * columns)]
    message.info.height, message.info.width, message.info.resolution = rows, columns, 0.05
    messages.fill_pose(message.info.origin, origin)
    message.data = data
    grid = map_messages.grid_of(message)
    assert isinstance(grid, OccupancyGrid)
    place = np.asarray(grid.frame.origin, np.float64)
    map_messages.fill_grid(other, np.asarray(grid.probability), grid.resolution, place, 1.0, "map")
    assert list(other.data) == data
    assert (other.info.height, other.info.width) == (rows, columns)
    np.testing.assert_allclose(messages.pose_of(other.info.origin), origin, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "data", "message"),
    [
        ({"height": 0}, [], "map has 0 rows"),
        ({"height": 10**5, "width": 10**5}, [], "accepted: 1 to 64000000 cells"),
        ({}, [0] * 5, r"data has shape \(5,\); accepted: \(6,\)"),
        ({}, [0, 0, 0, 0, 0, 101], "data spans 0 to 101"),
        ({}, [0, 0, 0, 0, 0, -2], "data spans -2 to 0"),
        ({"resolution": 0.0}, [0] * 6, "resolution is 0.0"),
        ({"resolution": math.nan}, [0] * 6, "resolution is nan"),
    ],
)
def test_maps_that_make_no_sense_are_refused(fields, data, message) -> None:
    given_ = Plain(data=data)
    given_.info = Plain(**{"height": 2, "width": 3, "resolution": 0.1, **fields})
    messages.fill_pose(given_.info.origin, (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=message):
        map_messages.grid_of(given_)


@MANY
@given(st.lists(st.tuples(FINITE, FINITE, ANGLE), max_size=6))
def test_paths_and_rollouts_go_there(poses) -> None:
    given_ = np.array(poses).reshape(-1, 3)
    message = Plain()
    map_messages.fill_path(message, Plain, given_, 2.0, "map")
    frame, found = map_messages.path_of(message)
    assert frame == "map"
    np.testing.assert_allclose(found, given_, atol=1e-12)
    markers = Plain()
    lines = np.stack([given_[:, :2], -given_[:, :2]])
    colours = np.full((2, 4), 0.25)
    map_messages.fill_rollouts(markers, Plain, Plain, lines, colours, 2.0, "map")
    assert [each.id for each in markers.markers] == [0, 1]
    drawn = [[(point.x, point.y) for point in each.points] for each in markers.markers]
    np.testing.assert_array_equal(np.array(drawn).reshape(lines.shape), lines)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_velocities_that_are_not_finite_are_refused(value) -> None:
    message = Plain()
    messages.fill_twist(message, (value, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"twist is .*; accepted: finite numbers"):
        messages.twist_of(message)


def test_texts_of_messages_are_printable_and_short() -> None:
    assert messages.text_of("odom\n\x1b[31m") == "odom??[31m"
    assert len(messages.text_of("x" * 1000)) == messages.MOST_LETTERS + 3


def test_markers_are_coloured_by_weight_or_by_a_cost() -> None:
    terms = {"a": np.array([1.0, 2.0, np.inf]), "b": np.array([1.0, -1.0, 0.0])}
    frame = SimpleNamespace(weights=np.array([0.0, 0.5, 0.25]), sample_terms=terms)
    by_weight = rollout_colours(frame, "weight")
    np.testing.assert_allclose(by_weight[:2], [[0.0, 0.2, 1.0, 0.15], [1.0, 0.2, 0.0, 1.0]])
    for name, costs in (("total cost", terms["a"] + terms["b"]), ("b", terms["b"])):
        colours = rollout_colours(frame, name)
        assert colours.shape == (3, 4)
        np.testing.assert_allclose(255.0 * colours[:, :3], cost_colours(costs), atol=1e-9)
    with pytest.raises(ValueError, match="is 'c'; accepted: weight, total cost, a, b"):
        rollout_colours(frame, "c")
