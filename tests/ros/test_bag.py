"""Bags: ours read by rosbags itself, its own read by us, and what is refused."""

import bz2
import dataclasses
import sqlite3
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from rosbags import rosbag1
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jaxplore.ros import bag
from jaxplore.ros.bag import bag_topics, choose_topic, read_bag
from jaxplore.ros.bag_writer import BagWriter
from jaxplore.ros.unpacked import _check_unpacked, check_chunks, check_records

STORE = get_typestore(Stores.LATEST)
TYPES = STORE.types
BEGAN = 1_700_000_000


def plain(value: Any) -> Any:
    """A message-like object without any class of the package."""
    if not dataclasses.is_dataclass(value):
        return [plain(each) for each in value] if isinstance(value, list) else value
    names = [field.name for field in dataclasses.fields(value) if field.name != "__msgtype__"]
    return SimpleNamespace(**{name: plain(getattr(value, name)) for name in names})


def header(index: int, frame: str = "odom") -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=BEGAN, nanosec=index)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def pose(index: int) -> Any:
    point = TYPES["geometry_msgs/msg/Point"](x=0.1 * index, y=-1.0, z=0.0)
    turn = TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8)
    return TYPES["geometry_msgs/msg/Pose"](position=point, orientation=turn)


def with_covariance(index: int) -> Any:
    covariance = np.linspace(0.0, 1.0, 36)
    kind = TYPES["geometry_msgs/msg/PoseWithCovariance"]
    return kind(pose=pose(index), covariance=covariance)


def scan(index: int) -> Any:
    ranges = np.linspace(0.5, 5.0, 20, dtype=np.float32)
    ranges[index % 20] = np.inf
    return TYPES["sensor_msgs/msg/LaserScan"](
        header=header(index, "läser"),
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=0.1,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.05,
        range_max=10.0,
        ranges=ranges,
        intensities=np.zeros(0, np.float32),
    )


def twist(index: int) -> Any:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    return TYPES["geometry_msgs/msg/Twist"](
        linear=vector(x=0.1 * index, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=-0.3)
    )


def odometry(index: int) -> Any:
    speed = TYPES["geometry_msgs/msg/TwistWithCovariance"](
        twist=twist(index), covariance=np.zeros(36)
    )
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(index), child_frame_id="base_link", pose=with_covariance(index), twist=speed
    )


def grid(index: int) -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    info = TYPES["nav_msgs/msg/MapMetaData"](
        map_load_time=time, resolution=0.05, width=3, height=2, origin=pose(index)
    )
    cells = np.array([-1, 0, 100, 50, -1, 7], np.int8)
    return TYPES["nav_msgs/msg/OccupancyGrid"](header=header(index), info=info, data=cells)


def located(index: int) -> Any:
    kind = TYPES["geometry_msgs/msg/PoseWithCovarianceStamped"]
    return kind(header=header(index), pose=with_covariance(index))


def path(index: int) -> Any:
    stamped = TYPES["geometry_msgs/msg/PoseStamped"]
    poses = [stamped(header=header(i), pose=pose(i)) for i in range(index + 1)]
    return TYPES["nav_msgs/msg/Path"](header=header(index), poses=poses)


def transforms(index: int) -> Any:
    vector = TYPES["geometry_msgs/msg/Vector3"](x=0.1 * index, y=-1.0, z=0.2)
    moved = TYPES["geometry_msgs/msg/Transform"](
        translation=vector, rotation=pose(index).orientation
    )
    stamped = TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(index), child_frame_id="base_link", transform=moved
    )
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[stamped] * index)


def cloud(index: int) -> Any:
    fields = [
        TYPES["sensor_msgs/msg/PointField"](name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate("xyz")
    ]
    points = np.linspace(-2.0, 2.0, 3 * index, dtype=np.float32)
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header=header(index, "lidar"),
        height=1,
        width=index,
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * index,
        data=points.view(np.uint8),
        is_dense=True,
    )


MAKERS = {
    "/scan": ("LaserScan", scan),
    "/points": ("PointCloud2", cloud),
    "/odom": ("Odometry", odometry),
    "/amcl_pose": ("PoseWithCovarianceStamped", located),
    "/map": ("OccupancyGrid", grid),
    "/plan": ("Path", path),
    "/cmd_vel": ("Twist", twist),
    "/tf": ("TFMessage", transforms),
}
COUNT = 4


def messages() -> list[tuple[float, str, str, Any]]:
    """Time, topic, kind and message of a bag, in the order of time."""
    return [
        (BEGAN + 0.25 * i, topic, kind, make(i))
        for i in range(COUNT)
        for topic, (kind, make) in MAKERS.items()
    ]


def write_theirs(
    folder: Path, storage: StoragePlugin, version: int = 9, **compression: Any
) -> Path:
    """Write a bag with the package alone."""
    writer = Writer(folder, version=version, storage_plugin=storage)
    if compression:
        writer.set_compression(**compression)
    with writer:
        connections = {
            topic: writer.add_connection(topic, bag.KINDS[kind], typestore=STORE)
            for topic, (kind, _) in MAKERS.items()
        }
        for time, topic, kind, message in messages():
            writer.write(connections[topic], nanoseconds(time), packed(message, kind))
    return folder


def write_ours(folder: Path, storage: str = "sqlite3") -> Path:
    with BagWriter(folder, storage=storage) as writer:
        for time, topic, kind, message in messages():
            writer.write(topic, kind, plain(message), time)
    return folder


def nanoseconds(time: float) -> int:
    return BEGAN * 10**9 + round((time - BEGAN) * 1e9)


def packed(message: Any, kind: str) -> bytes:
    return bytes(STORE.serialize_cdr(message, bag.KINDS[kind]))


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_of_ours_is_read_by_the_package(tmp_path: Path, storage: str) -> None:
    folder = write_ours(tmp_path / "drive", storage)
    assert [each.name for each in tmp_path.iterdir()] == ["drive"]
    with AnyReader([folder]) as reader:
        found = [
            (time, connection.topic, data, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]
    expected = {(nanoseconds(time), topic): each for time, topic, _, each in messages()}
    assert len(found) == len(expected)
    for time, topic, data, message in found:
        kind = MAKERS[topic][0]
        assert bytes(data) == packed(expected[time, topic], kind)
        if kind == "LaserScan":
            assert message.header.frame_id == "läser"
            np.testing.assert_array_equal(message.ranges, expected[time, topic].ranges)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("is_file", [False, True])
def test_a_bag_of_the_package_is_read(
    tmp_path: Path, storage: StoragePlugin, version: int, is_file: bool
) -> None:
    place = write_theirs(tmp_path / "drive", storage, version)
    if is_file:
        (place,) = (each for each in place.iterdir() if each.suffix != ".yaml")
    topics = bag_topics(place)
    assert {name: topic.number for name, topic in topics.items()} == dict.fromkeys(MAKERS, COUNT)
    assert {name: topic.kind for name, topic in topics.items()} == {
        name: kind for name, (kind, _) in MAKERS.items()
    }
    found = list(read_bag(place, list(MAKERS)))
    times = [each.time for each in found]
    assert times == sorted(times)
    expected = {(time, topic): message for time, topic, _, message in messages()}
    assert len(found) == len(expected)
    for time, topic, message in found:
        kind = MAKERS[topic][0]
        assert packed(message, kind) == packed(expected[time, topic], kind)
    # One topic alone.
    assert {each.topic for each in read_bag(place, ["/odom"])} == {"/odom"}


ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)


def of_ros1(value: Any) -> Any:
    """The same message as one of ROS 1, whose headers count."""
    if isinstance(value, list):
        return [of_ros1(each) for each in value]
    if not dataclasses.is_dataclass(value):
        return value
    names = [field.name for field in dataclasses.fields(value) if field.name != "__msgtype__"]
    fields = {name: of_ros1(getattr(value, name)) for name in names}
    if "frame_id" in fields:
        fields["seq"] = 7
    return ROS1.types[value.__msgtype__](**fields)


def write_ros1(file: Path, compression: rosbag1.Writer.CompressionFormat | None) -> Path:
    writer = rosbag1.Writer(file)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {
            topic: writer.add_connection(topic, bag.KINDS[kind], typestore=ROS1)
            for topic, (kind, _) in MAKERS.items()
        }
        for time, topic, kind, message in messages():
            data = ROS1.serialize_ros1(of_ros1(message), bag.KINDS[kind])
            writer.write(connections[topic], nanoseconds(time), data)
    return file


@pytest.mark.parametrize("compression", [None, *rosbag1.Writer.CompressionFormat])
def test_a_bag_of_ros1_is_read(tmp_path: Path, compression: Any) -> None:
    file = write_ros1(tmp_path / "drive.bag", compression)
    assert {name: (topic.kind, topic.number) for name, topic in bag_topics(file).items()} == {
        name: (kind, COUNT) for name, (kind, _) in MAKERS.items()
    }
    found = list(read_bag(file, list(MAKERS)))
    expected = {(time, topic): message for time, topic, _, message in messages()}
    assert len(found) == len(expected)
    for time, topic, message in found:
        name = bag.KINDS[MAKERS[topic][0]]
        wanted = ROS1.serialize_ros1(of_ros1(expected[time, topic]), name)
        assert ROS1.serialize_ros1(message, name) == wanted


def test_damaged_bags_of_ros1_are_one_line(tmp_path: Path) -> None:
    """Bytes are flipped and cut off, and numbers of bytes become huge."""
    file, rng = tmp_path / "drive.bag", np.random.default_rng(3)
    number = 0
    for compression in (None, rosbag1.Writer.CompressionFormat.BZ2):
        file.unlink(missing_ok=True)
        data = write_ros1(file, compression).read_bytes()
        for index in range(60):
            some = bytearray(data)
            for at in rng.integers(0, len(data) - 4, rng.integers(1, 8)):
                some[at : at + 4] = rng.bytes(4) if index % 2 else b"\xff\xff\xff\x7f"
            file.write_bytes(some[: rng.integers(len(data))] if index % 5 == 0 else some)
            said = ""
            try:
                list(read_bag(file, ["/scan", "/tf"]))
            except ValueError as error:
                said = str(error)
            assert "\n" not in said
            number += bool(said)
    assert number > 60


def test_a_few_bytes_of_ros1_that_stand_for_many_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "drive.bag"
    large = grid(0)
    large.data = np.zeros(3_000_000, np.int8)
    for compression in rosbag1.Writer.CompressionFormat:
        file.unlink(missing_ok=True)
        writer = rosbag1.Writer(file)
        writer.set_compression(compression)
        with writer:
            added = writer.add_connection("/map", bag.KINDS["OccupancyGrid"], typestore=ROS1)
            message = ROS1.serialize_ros1(of_ros1(large), bag.KINDS["OccupancyGrid"])
            writer.write(added, 5, message)
        assert file.stat().st_size < 100_000
        check_records(file, 2**23)
        with pytest.raises(ValueError, match="a chunk has more than 1000000 bytes unpacked"):
            check_records(file, 1_000_000)
        # A chunk may say less than it holds.
        data = file.read_bytes()
        at = data.index(b"size=") + 5
        file.write_bytes(data[:at] + struct.pack("<I", 10) + data[at + 4 :])
        with pytest.raises(ValueError, match="a chunk has more than 1000000 bytes unpacked"):
            check_records(file, 1_000_000)


def test_the_only_topic_of_a_kind_is_chosen_and_several_must_be_named() -> None:
    def topic(kind: str | None) -> bag.BagTopic:
        return bag.BagTopic(kind, "some/msg/Type", 3)

    topics = {"/front": topic("LaserScan"), "/odom": topic("Odometry"), "/image": topic(None)}
    assert choose_topic(topics, "LaserScan") == "/front"
    topics["/rear"] = topic("LaserScan")
    assert choose_topic(topics, "LaserScan", "/rear") == "/rear"
    for kind, name, reason in (
        ("LaserScan", None, "2 topics of kind LaserScan; accepted: one of '/front', '/rear'"),
        ("LaserScan", "/odom", "'/odom', not of a LaserScan; accepted: one of '/front', '/rear'"),
        ("Path", None, "no topic of kind Path; accepted: a bag with a Path"),
        ("Path", "/plan", "'/plan', not of a Path; accepted: a bag with a Path"),
    ):
        with pytest.raises(ValueError, match=reason):
            choose_topic(topics, kind, name)


def test_topics_that_cannot_be_read_are_refused_before_reading(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    with Writer(folder, version=9) as writer:
        added = writer.add_connection("/note", "std_msgs/msg/String", typestore=STORE)
        note = TYPES["std_msgs/msg/String"](data="hello")
        writer.write(added, 5, STORE.serialize_cdr(note, "std_msgs/msg/String"))
    assert bag_topics(folder)["/note"].kind is None
    for topics, reason in (
        (["/note"], "of type 'std_msgs/msg/String'; accepted: LaserScan, Odometry"),
        (["/gone"], "topics has '/gone'; accepted: of this bag '/note'"),
        ([], "accepted: names of topics in a list"),
        ("/note", "accepted: names of topics in a list"),
    ):
        with pytest.raises(ValueError, match=reason):
            read_bag(folder, topics)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_damaged_bags_are_one_line(tmp_path: Path, storage: str) -> None:
    folder = write_ours(tmp_path / "drive", storage)
    (file,) = (each for each in folder.iterdir() if each.suffix != ".yaml")
    data, rng = file.read_bytes(), np.random.default_rng(0)
    damaged = [b"", data[:50], data[: len(data) // 2], data[:-20], bytes(len(data))]
    for _ in range(30):
        some = np.frombuffer(data, np.uint8).copy()
        at = rng.integers(0, len(some), 200)
        some[at] = rng.integers(0, 256, 200)
        damaged.append(some.tobytes())
    reasons = []
    for each in damaged:
        file.write_bytes(each)
        try:
            # Damage that spares the structure only changes numbers.
            list(read_bag(folder, ["/scan", "/plan"]))
        except ValueError as error:
            reasons.append(str(error))
    assert len(reasons) > 5
    assert not [reason for reason in reasons if "\n" in reason or "drive" not in reason]


def test_a_message_that_is_cut_is_one_line(tmp_path: Path) -> None:
    folder = write_ours(tmp_path / "drive")
    with sqlite3.connect(folder / "drive.db3") as database:
        database.execute("UPDATE messages SET data = substr(data, 1, 30)")
    database.close()
    with pytest.raises(ValueError, match=r"drive' cannot be read \(.*\); accepted: a ros"):
        list(read_bag(folder, ["/scan"]))


def test_what_is_no_bag_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def check(place: Path, reason: str) -> None:
        with pytest.raises(ValueError, match=reason) as caught:
            bag_topics(place)
        assert "\n" not in str(caught.value)

    check(tmp_path / "gone", "is not there; accepted: a rosbag2 folder")
    check(tmp_path, "holds no metadata.yaml")
    (tmp_path / "drive.bag").write_text("")
    check(tmp_path / "drive.bag", "it is no bag of ROS 1")
    (tmp_path / "drive.txt").write_text("")
    check(tmp_path / "drive.txt", r"no \.db3 or \.mcap file")
    with BagWriter(tmp_path / "empty"):
        pass
    check(tmp_path / "empty", "holds no messages; accepted: a bag with messages")
    packed = {"mode": CompressionMode.FILE, "fmt": CompressionFormat.ZSTD}
    check(
        write_theirs(tmp_path / "packed", StoragePlugin.SQLITE3, **packed),
        "is compressed by 'file'; accepted: one that 'ros2 bag convert' has unpacked",
    )
    folder = write_ours(tmp_path / "drive")
    entries = yaml.safe_load((folder / "metadata.yaml").read_text())
    about = entries["rosbag2_bagfile_information"]
    for files, reason in (
        (["../../etc/passwd"], r"no \.db3 or \.mcap file"),
        ([f"{i}.db3" for i in range(bag.FILES_LIMIT + 1)], "has 1001 files; accepted: at most"),
        ("drive.db3", "names no files"),
    ):
        changed = {"rosbag2_bagfile_information": {**about, "relative_file_paths": files}}
        (folder / "metadata.yaml").write_text(yaml.safe_dump(changed))
        check(folder, reason)
    changed = {"rosbag2_bagfile_information": {**about, "files": "drive.db3"}}
    (folder / "metadata.yaml").write_text(yaml.safe_dump(changed))
    check(folder, "names no files")
    (folder / "metadata.yaml").write_text(yaml.safe_dump(entries))
    assert bag_topics(folder)
    monkeypatch.setattr(bag, "COUNT_LIMIT", 3)
    with pytest.raises(ValueError, match="topics have 4 messages; accepted: at most 3"):
        read_bag(folder, ["/scan"])
    monkeypatch.setattr(bag, "MESSAGE_LIMIT", 10)
    monkeypatch.setattr(bag, "COUNT_LIMIT", 10)
    with pytest.raises(ValueError, match="is too large"):
        list(read_bag(folder, ["/scan"]))
    monkeypatch.setattr(bag, "SIZE_LIMIT", 100)
    check(folder, "bytes; accepted: at most 100")


def test_a_bag_is_written_completely_or_not_at_all(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "drive")

    def fail() -> None:
        with writer:
            writer.write("/cmd_vel", "Twist", plain(twist(0)), 1.0)
            # A hidden folder and its lock.
            assert len(list(tmp_path.glob(".jaxplore-*"))) == len(list(tmp_path.iterdir())) == 2
            with (
                pytest.raises(ValueError, match=r"^bag '.*drive' is in use by another process"),
                BagWriter(tmp_path / "drive"),
            ):
                pass
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="is not open"):
        writer.write("/cmd_vel", "Twist", plain(twist(0)), 1.0)
    # What a process that was killed has left is removed by the next one that writes there.
    killed = (
        "import os, signal, sys\nfrom jaxplore.ros.bag_writer import BagWriter\n"
        "with BagWriter(sys.argv[1]):\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", killed, str(tmp_path / "killed")], check=False)
    assert len(list(tmp_path.rglob("*.db3"))) == 1
    write_ours(tmp_path / "drive")
    assert [each.name for each in tmp_path.iterdir()] == ["drive"]
    for place, reason in (
        ("drive", "which exists; accepted: the path of a new folder"),
        ("there/drive", "accepted: a folder in one that exists"),
    ):
        with pytest.raises(ValueError, match=reason):
            BagWriter(tmp_path / place)
    with pytest.raises(ValueError, match="storage is 'rosbag1'; accepted: sqlite3, mcap"):
        BagWriter(tmp_path / "other", storage="rosbag1")


def test_messages_of_other_types_are_one_line(tmp_path: Path) -> None:
    bad, far, long, text = (plain(scan(0)) for _ in range(4))
    del bad.header.stamp.sec
    far.header.stamp.sec = 2**40
    long.angle_min = "wide"
    text.ranges = "all"
    map_ = plain(grid(0))
    map_.data = [0, 300]
    turned = plain(odometry(0))
    turned.pose.covariance = [0.0] * 35
    with BagWriter(tmp_path / "drive") as writer:
        for kind, message, reason in (
            ("LaserScan", bad, "LaserScan.header.stamp.sec is missing; accepted: all fields"),
            ("LaserScan", far, "LaserScan cannot be packed"),
            ("LaserScan", long, "LaserScan cannot be packed"),
            ("LaserScan", text, "LaserScan.ranges is 'all'; accepted: numbers"),
            ("OccupancyGrid", map_, r"OccupancyGrid.data is \[0, 300\]; accepted: a list of int8"),
            ("Odometry", turned, "Odometry.pose.covariance has 35 numbers; accepted: 36"),
            ("Image", None, "kind is 'Image'; accepted: LaserScan"),
        ):
            with pytest.raises(ValueError, match=reason) as caught:
                writer.write("/it", kind, message, 1.0)
            assert "\n" not in str(caught.value)
        writer.write("/it", "Twist", plain(twist(0)), 1.0)
        with pytest.raises(ValueError, match="kind is 'LaserScan' of topic '/it'"):
            writer.write("/it", "LaserScan", plain(scan(0)), 1.0)
    assert {name: each.number for name, each in bag_topics(tmp_path / "drive").items()} == {
        "/it": 1
    }


def test_the_unpacked_size_is_limited_to_the_byte_for_every_way_to_pack() -> None:
    rng = np.random.default_rng(0)
    skippable = struct.pack("<II", 0x184D2A50, 3) + b"abc"
    for data in (rng.bytes(300_000), bytes(3_000_000), b"abc" * 100_000):
        packed = [("bz2", bz2.compress(data, 9))]
        for level in (1, 19):
            for given in ({}, {"write_checksum": True, "write_content_size": False}):
                compress = zstandard.ZstdCompressor(level=level, **given).compress
                packed.append(("zstd", compress(data) + skippable))
        for size in (4, 7):
            for given in ({}, {"content_checksum": True, "block_checksum": True}):
                frame = lz4.frame.compress(data, block_size=size, store_size=False, **given)
                packed.append(("lz4", frame + skippable))
        for name, one in packed:
            # Several streams may follow each other.
            _check_unpacked(name, 2 * one, 2 * len(data))
            with pytest.raises(ValueError, match=f"more than {2 * len(data) - 1} bytes unpacked"):
                _check_unpacked(name, 2 * one, 2 * len(data) - 1)
            with pytest.raises(ValueError, match=f"a chunk of {name} is cut off"):
                _check_unpacked(name, one[: len(one) // 2], 2 * len(data))


def test_a_few_bytes_that_stand_for_many_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "drive"
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    large = grid(0)
    large.data = np.zeros(3_000_000, np.int8)
    with writer:
        added = writer.add_connection("/map", bag.KINDS["OccupancyGrid"], typestore=STORE)
        writer.write(added, 5, packed(large, "OccupancyGrid"))
    file = folder / "drive.mcap"
    assert file.stat().st_size < 100_000
    ((_, _, message),) = read_bag(folder, ["/map"])
    np.testing.assert_array_equal(message.data, large.data)
    with pytest.raises(ValueError, match="more than 1000000"):
        check_chunks(file, 1_000_000)
    # A chunk may say less than it holds.
    data = bytearray(file.read_bytes())
    assert data.count(struct.pack("<Q", 5) * 2) > 0
    at = data.index(struct.pack("<Q", 5) * 2) + 16
    assert struct.unpack_from("<Q", data, at)[0] > 3_000_000
    struct.pack_into("<Q", data, at, 10)
    file.write_bytes(data)
    with pytest.raises(ValueError, match="more than 1000000 bytes unpacked"):
        check_chunks(file, 1_000_000)
    monkeypatch.setattr(bag, "check_chunks", lambda path: check_chunks(path, 1_000_000))
    with pytest.raises(ValueError, match="a chunk has more than"):
        bag_topics(folder)
    # No more is read of a name than a name has.
    struct.pack_into("<I", data, at + 12, 2**31)
    file.write_bytes(data)
    with pytest.raises(ValueError, match="has 2147483648 bytes"):
        check_chunks(file, 1_000_000)
