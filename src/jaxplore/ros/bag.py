"""Read bags without ROS: rosbag2 folders, `.db3` and `.mcap` files, and `.bag` files of ROS 1.

A bag from elsewhere is not trusted. Its own definitions of messages are not read, because a reader
makes code of them: the messages here are the same in all versions of ROS 2 since Humble, and in
ROS 1 since they were last changed, before Indigo.
"""

import functools
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from jaxplore import _kinds
from jaxplore._files import read_yaml
from jaxplore._optional import import_optional
from jaxplore._text import error_reason, printable_path, short_repr
from jaxplore.ros.unpacked import check_chunks, check_records

EXTRA = "bags"
"""Extra that installs the package which reads and writes bags."""
KINDS = {
    "LaserScan": "sensor_msgs/msg/LaserScan",
    "Odometry": "nav_msgs/msg/Odometry",
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "OccupancyGrid": "nav_msgs/msg/OccupancyGrid",
    "Path": "nav_msgs/msg/Path",
    "Twist": "geometry_msgs/msg/Twist",
    "TwistStamped": "geometry_msgs/msg/TwistStamped",
    "BatteryState": "sensor_msgs/msg/BatteryState",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "TFMessage": "tf2_msgs/msg/TFMessage",
}
"""Kinds of messages that are read and written, and their names in ROS."""
FILES_LIMIT = 1000
"""Greatest number of files of a bag."""
SIZE_LIMIT = 2**36
"""Greatest size of all its files [bytes]."""
METADATA_LIMIT = 2_000_000
"""Greatest size of its `metadata.yaml` [bytes]."""
MESSAGE_LIMIT = 2**26
"""Greatest size of a message [bytes]."""
COUNT_LIMIT = 10_000_000
"""Greatest number of messages that are read."""

_METADATA = "metadata.yaml"
_SUFFIXES = (".db3", ".mcap")
_ROS1 = ".bag"
_ACCEPTED = "a rosbag2 folder, its .db3 or .mcap file, or a .bag of ROS 1"
_SAME = {"tf/msg/tfMessage": KINDS["TFMessage"]}
"""Types of ROS 1 that have the fields of others."""


class BagTopic(NamedTuple):
    """A topic of a bag: its kind, its type in ROS and its number of messages.

    The kind is one of `KINDS`, or None for a type that is not read.
    """

    kind: str | None
    type: str
    number: int


class BagMessage(NamedTuple):
    """A message of a bag.

    `time` is when it was recorded [s]. `message` has the attributes of the ROS message; its arrays
    are NumPy's.
    """

    time: float
    topic: str
    message: Any


def bag_topics(path: str | os.PathLike[str]) -> dict[str, BagTopic]:
    """Return the topics of a bag by name."""
    with _open_bag(path) as reader:
        return _topics(path, reader)


def choose_topic(topics: Mapping[str, BagTopic], kind: str, name: str | None = None) -> str:
    """Return the topic of a kind, one of `KINDS`, in a bag.

    A name must be that of a topic of the kind. Without one there must be exactly one such topic.
    Otherwise it raises a `ValueError`.
    """
    known = [each for each, topic in topics.items() if topic.kind == kind]
    if name is None and len(known) == 1:
        return known[0]
    if name is not None and name in known:
        return name
    accepted = f"one of {', '.join(map(repr, known))}" if known else f"a bag with a {kind}"
    if name is not None:
        raise ValueError(f"topic is {short_repr(name)}, not of a {kind}; accepted: {accepted}")
    number = f"{len(known)} topics" if known else "no topic"
    raise ValueError(f"bag has {number} of kind {kind}; accepted: {accepted}")


def read_bag(path: str | os.PathLike[str], topics: Collection[str]) -> Iterator[BagMessage]:
    """Read the messages of some topics, in the order of their times."""
    if isinstance(topics, str) or not topics:
        raise ValueError(f"topics is {short_repr(topics)}; accepted: names of topics in a list")
    known, wanted = bag_topics(path), frozenset(topics)
    for name in sorted(wanted):
        if name not in known:
            names = ", ".join(map(repr, sorted(known)))
            raise ValueError(f"topics has {short_repr(name)}; accepted: of this bag {names}")
        if known[name].kind is None:
            raise ValueError(
                f"topic {short_repr(name)} is of type {short_repr(known[name].type)}; accepted: "
                f"{', '.join(KINDS)}"
            )
    count = sum(known[name].number for name in wanted)
    if count > COUNT_LIMIT:
        raise ValueError(f"topics have {count} messages; accepted: at most {COUNT_LIMIT}")
    return _messages(path, wanted)


def _messages(path: str | os.PathLike[str], topics: frozenset[str]) -> Iterator[BagMessage]:
    is_ros1, count = _is_ros1(Path(path)), 0
    store = typestore(is_ros1=is_ros1)
    unpack = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
    with _open_bag(path, is_checked=True) as reader:
        # By type as well: a damaged bag may have a topic twice.
        chosen = [
            each
            for each in reader.connections
            if each.topic in topics and _type(each) in KINDS.values()
        ]
        source = reader.messages(connections=chosen)
        while True:
            with _readable(path):
                found = next(source, None)
                if found is None:
                    return
                connection, nanoseconds, data = found
                count += 1
                if len(data) > MESSAGE_LIMIT or count > COUNT_LIMIT:
                    raise ValueError(f"message {count} of {len(data)} bytes is too large or many")
                message = unpack(data, _type(connection))
                time = int(nanoseconds) / 10**9
            yield BagMessage(time, connection.topic, message)


def _topics(path: str | os.PathLike[str], reader: Any) -> dict[str, BagTopic]:
    """Return the topics of an open bag."""
    names = {name: kind for kind, name in KINDS.items()}
    found: dict[str, BagTopic] = {}
    is_ros1 = _is_ros1(Path(path))
    store = typestore(is_ros1=is_ros1)
    with _readable(path):
        for each in reader.connections:
            if each.topic in found and found[each.topic].type != each.msgtype:
                raise ValueError(f"topic {each.topic!r} is of two types")
            kind = names.get(_type(each))
            if kind is not None and each.digest and each.digest != _digest(store, KINDS[kind]):
                version = 1 if is_ros1 else 2
                raise ValueError(f"its {kind} differs from that of ROS {version}")
            before = found[each.topic].number if each.topic in found else 0
            found[each.topic] = BagTopic(kind, str(each.msgtype), before + int(each.msgcount))
    if not sum(each.number for each in found.values()):
        where = printable_path(Path(path))
        raise ValueError(f"bag {where!r} holds no messages; accepted: a bag with messages")
    return found


def _is_ros1(path: Path) -> bool:
    return path.suffix == _ROS1 and not path.is_dir()


def _type(connection: Any) -> str:
    return _SAME.get(str(connection.msgtype), str(connection.msgtype))


def _digest(store: Any, name: str) -> str:
    """Return the hash of a type, by which a bag says that it means the same."""
    if store is typestore(is_ros1=True):
        return str(store.generate_msgdef(name, ros_version=1)[1])
    return str(store.hash_rihs01(name))


@contextmanager
@_kinds.check_arguments
def _open_bag(path: str | os.PathLike[str], *, is_checked: bool = False) -> Iterator[Any]:
    """Yield an open reader of a bag, whose files are checked unless they have been."""
    version = 1 if _is_ros1(Path(path)) else 2
    module: Any = import_optional(f"rosbags.rosbag{version}", EXTRA)
    if not is_checked:
        _check_files(Path(path))
    with ExitStack() as stack:
        with _readable(path), _limit_rows():
            reader = stack.enter_context(module.Reader(Path(path)))
        yield reader


@contextmanager
def _limit_rows() -> Iterator[None]:
    """Let the databases that are opened refuse long rows before they take memory for them."""
    apsw = import_optional("apsw", EXTRA)

    def limit(connection: Any) -> None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, MESSAGE_LIMIT + METADATA_LIMIT)

    apsw.connection_hooks.append(limit)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(limit)


def _check_files(path: Path) -> None:
    """Check the files of a bag before any is opened."""
    where, accepted = printable_path(path), _ACCEPTED
    if "\0" in str(path) or not path.exists():
        raise ValueError(f"bag {where!r} is not there; accepted: {accepted}")
    files = [path]
    if path.is_dir():
        if not (path / _METADATA).is_file():
            raise ValueError(f"bag {where!r} holds no {_METADATA}; accepted: {accepted}")
        entries = read_yaml(path / _METADATA, of="bag", limit=METADATA_LIMIT)
        about = entries.get("rosbag2_bagfile_information")
        names = about.get("relative_file_paths") if isinstance(about, dict) else None
        # When it closes, the reader empties `files`, and fails if that is something else.
        listed = about.get("files", []) if isinstance(about, dict) else None
        if (
            not isinstance(about, dict)
            or not isinstance(names, list)
            or not isinstance(listed, list)
        ):
            raise ValueError(f"{_METADATA} of bag {where!r} names no files; accepted: {accepted}")
        if about.get("compression_mode") not in (None, "", "none", "NONE"):
            # The reader would unpack it without a limit.
            raise ValueError(
                f"bag {where!r} is compressed by {short_repr(about['compression_mode'])}; "
                "accepted: one that 'ros2 bag convert' has unpacked"
            )
        if len(names) > FILES_LIMIT:
            raise ValueError(
                f"bag {where!r} has {len(names)} files; accepted: at most {FILES_LIMIT}"
            )
        # The reader looks for them in the folder alone.
        files = [path / Path(str(name)).name for name in names]
    for file in files:
        suffixes = _SUFFIXES if path.is_dir() else (*_SUFFIXES, _ROS1)
        if not file.is_file() or file.suffix not in suffixes:
            raise ValueError(
                f"file {printable_path(file)!r} of a bag is not there or no .db3 or .mcap file; "
                f"accepted: {accepted}"
            )
    size = sum(file.stat().st_size for file in files)
    if size > SIZE_LIMIT:
        raise ValueError(f"bag {where!r} has {size} bytes; accepted: at most {SIZE_LIMIT}")
    for file in files:
        with _readable(path):
            if file.suffix == ".mcap":
                check_chunks(file)
            elif file.suffix == _ROS1:
                check_records(file)


@contextmanager
def _readable(path: str | os.PathLike[str]) -> Iterator[None]:
    """Convert the errors of a reader into one line."""
    try:
        yield
    except Exception as error:
        # Readers of formats and databases raise errors of many kinds for damaged files.
        raise ValueError(
            f"bag {printable_path(Path(path))!r} cannot be read ({error_reason(error)}); "
            f"accepted: {_ACCEPTED}"
        ) from None


@functools.cache
def typestore(*, is_ros1: bool = False) -> Any:
    """Return the definitions of the messages, those of ROS 2 or of ROS 1."""
    typesys: Any = import_optional("rosbags.typesys", EXTRA)
    if not is_ros1:
        return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    # The package has the messages of ROS 1 itself, and none of tf2.
    definition = "geometry_msgs/TransformStamped[] transforms"
    store.register(typesys.get_types_from_msg(definition, KINDS["TFMessage"]))
    return store
