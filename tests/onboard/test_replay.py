"""A recorded drive that is fed to a pilot, and monitors of a drive."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader

from jaxplore.onboard.options import Mode
from jaxplore.onboard.watch import DriveWatch
from jaxplore.parameters import get_parameters
from jaxplore.recorder import SwitchedRecorder
from jaxplore.ros import messages
from jaxplore.ros.bag import read_bag
from jaxplore.ros.bag_writer import BagWriter
from jaxplore.ros.replay import GAP_SECONDS, replay, replay_topics
from jaxplore.simulation.monitor import Monitor, Requests

BEGAN, LATENCY = 1_700_000_000.0, 0.06
WEIGHT = "cost.information.weight"


def blank(**fields) -> SimpleNamespace:
    stamp = SimpleNamespace(sec=0, nanosec=0)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=""), **fields)


def place() -> SimpleNamespace:
    return SimpleNamespace(
        position=SimpleNamespace(x=0.0, y=0.0, z=0.0),
        orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
    )


def odometry(now, measured) -> SimpleNamespace:
    speeds = (SimpleNamespace(x=0.0, y=0.0, z=0.0) for _ in range(2))
    twist = SimpleNamespace(**dict(zip(("linear", "angular"), speeds, strict=True)))
    message = blank(
        child_frame_id="",
        pose=SimpleNamespace(pose=place(), covariance=np.zeros(36)),
        twist=SimpleNamespace(twist=twist, covariance=np.zeros(36)),
    )
    given = messages.Odometry(now, "odom", measured.pose, measured.twist)
    messages.fill_odometry(message, given, "base_link")
    return message


def laser(now, scan, sensor) -> SimpleNamespace:
    message = blank(intensities=np.zeros(0, np.float32))
    messages.fill_laser_scan(message, scan, sensor, now, "laser", period=0.1)
    message.ranges = np.asarray(message.ranges, np.float32)
    return message


@pytest.fixture(scope="module")
def recorded(make_pilot, make_robot, drive, tmp_path_factory):
    """Record a drive of six seconds, with a gap and two bad scans; return it, and its pilot."""
    pilot, robot = make_pilot(latency=LATENCY), make_robot(delay=0.04)
    folder = tmp_path_factory.mktemp("bags") / "drive"
    with BagWriter(folder) as writer:

        def record(now, measured):
            # In the gap the robot has its data, but the recorder does not.
            if 3.0 <= now - BEGAN < 3.7:
                return measured
            writer.write("/odom", "Odometry", odometry(now, measured), now)
            if measured.scan is not None:
                message = laser(now, measured.scan, pilot.sensor)
                if 2.0 <= now - BEGAN < 2.15:
                    message.angle_increment = math.nan
                writer.write("/scan", "LaserScan", message, now)
            return measured

        drive(pilot, robot, 6.0, record, began=BEGAN)
    return folder, pilot


def test_a_replay_makes_the_same_map_and_commands_from_where_the_robot_was(
    recorded, make_pilot
) -> None:
    folder, driven = recorded
    assert replay_topics(folder, None, None) == ("/scan", "/odom")
    pilot = make_pilot(latency=LATENCY, is_obeyed=False)
    shares = []
    found = replay(folder, pilot, "/scan", "/odom", on_progress=shares.append)
    assert found.num_messages == 265 + 53
    assert found.num_malformed == 2
    assert "angle_increment is nan" in found.reason
    assert shares == sorted(shares)
    known, expected = (np.asarray(each.belief.grid.probability) for each in (pilot, driven))
    is_known = (known != 0.5) & (expected != 0.5)
    # Nine of sixty scans are missing.
    assert is_known.sum() > 0.95 * (expected != 0.5).sum()
    assert (((known > 0.5) == (expected > 0.5))[is_known]).mean() > 0.99
    modes = {
        name: [
            each.mode
            for time, each in zip(found.times, found.commands, strict=True)
            if a < time < b
        ]
        for name, a, b in (("drive", 1.0, 2.9), ("gap", 3.4, 3.65), ("after", 4.2, 5.9))
    }
    assert set(modes["drive"]) == set(modes["after"]) == {Mode.DRIVING}
    assert set(modes["gap"]) == {Mode.BRAKING}
    recording = pilot.recording()
    assert recording.num_steps == pytest.approx(300, abs=3)
    again = make_pilot(latency=LATENCY, is_obeyed=False)
    same = replay(folder, again, "/scan", "/odom")
    for one, other in zip(found.commands, same.commands, strict=True):
        np.testing.assert_array_equal(one.twist, other.twist)


def test_time_that_jumps_by_years_is_a_gap_of_some_seconds(
    make_pilot, make_robot, drive, tmp_path
) -> None:
    kept = []

    def keep(now, measured):
        kept.append((now, measured))
        return measured

    drive(make_pilot(latency=LATENCY), make_robot(delay=0.04), 3.0, keep)
    # Times that are exact in binary and in nanoseconds, before and after the jump.
    times = np.array([2.0**30 + round(512.0 * now) / 512.0 for now, _ in kept])
    half = len(kept) // 2
    times[half:] += GAP_SECONDS - (times[half] - times[half - 1])
    found = []
    for jump in (0.0, 2.0**29):
        pilot, folder = make_pilot(latency=LATENCY, is_obeyed=False), tmp_path / f"{jump:.0f}"
        with BagWriter(folder) as writer:
            for index, (_, measured) in enumerate(kept):
                now = float(times[index]) + (jump if index >= half else 0.0)
                writer.write("/odom", "Odometry", odometry(now, measured), now)
                if measured.scan is not None:
                    message = laser(now, measured.scan, pilot.sensor)
                    writer.write("/scan", "LaserScan", message, now)
        found.append(replay(folder, pilot, "/scan", "/odom"))
        assert pilot.recording().num_steps == pytest.approx((3.0 + GAP_SECONDS) / 0.02, abs=4)
    near, far = found
    assert (near.skipped, far.skipped) == (0.0, 2.0**29)
    assert near.times == far.times
    assert near.times[-1] == pytest.approx(3.0 + GAP_SECONDS, abs=0.05)
    assert near.commands[-1].mode is Mode.DRIVING
    for one, other in zip(near.commands, far.commands, strict=True):
        np.testing.assert_array_equal(one.twist, other.twist)
        assert (one.mode, one.reason) == (other.mode, other.reason)


def transform(parent: str, child: str, now: float, x: float, y: float, yaw: float):
    """A message with a transform, such as a driver publishes."""
    stamped = blank(
        child_frame_id=child,
        transform=SimpleNamespace(translation=place().position, rotation=place().orientation),
    )
    messages.fill_time(stamped.header.stamp, now)
    stamped.header.frame_id = parent
    stamped.transform.translation.x, stamped.transform.translation.y = x, y
    stamped.transform.rotation.z = math.sin(0.5 * yaw)
    stamped.transform.rotation.w = math.cos(0.5 * yaw)
    return SimpleNamespace(transforms=[stamped])


def test_the_pose_follows_from_transforms(recorded, make_pilot, tmp_path) -> None:
    """Of a bag without odometry: map -> odom -> base_footprint -> base_link, one of them static."""
    folder, driven = recorded
    with BagWriter(tmp_path / "tf", storage="mcap") as writer:
        for each in read_bag(folder, ["/scan", "/odom"]):
            if each.topic == "/scan":
                writer.write("/scan", "LaserScan", each.message, each.time)
                continue
            measured = messages.odometry_of(each.message)
            # The odometry has begun elsewhere, turned by a quarter.
            x, y, yaw = measured.pose
            own = transform("odom", "base_footprint", measured.time, y, -x, yaw - 0.5 * math.pi)
            writer.write("/tf", "TFMessage", own, each.time)
            odom = transform("/map", "/odom", measured.time, 0.0, 0.0, 0.5 * math.pi)
            writer.write("/tf", "TFMessage", odom, each.time)
        # Recorded late, as of a latched topic.
        link = transform("base_footprint", "base_link", 0.0, 0.0, 0.0, 0.0)
        link.transforms += transform("base_link", "camera", 0.0, 0.1, 0.0, math.nan).transforms
        writer.write("/tf_static", "TFMessage", link, each.time)
    assert replay_topics(tmp_path / "tf", None, None) == ("/scan", "/tf")
    pilot = make_pilot(latency=LATENCY, is_obeyed=False)
    found = replay(tmp_path / "tf", pilot, "/scan", "/tf")
    assert {each.mode for each in found.commands[80:145]} == {Mode.DRIVING}
    known, expected = (np.asarray(each.belief.grid.probability) for each in (pilot, driven))
    is_known = (known != 0.5) & (expected != 0.5)
    assert is_known.sum() > 0.95 * (expected != 0.5).sum()
    assert (((known > 0.5) == (expected > 0.5))[is_known]).mean() > 0.99


def test_a_bag_without_a_pose_is_refused_in_words(tmp_path, recorded) -> None:
    folder, _ = recorded
    scans = list(read_bag(folder, ["/scan"]))[:3]
    for name, child in (("none", None), ("arm", "gripper")):
        with BagWriter(tmp_path / name) as writer:
            for each in scans:
                writer.write("/scan", "LaserScan", each.message, each.time)
                if child is not None:
                    message = transform("base", child, each.time, 0.0, 0.0, 0.0)
                    writer.write("/tf", "TFMessage", message, each.time)
    with pytest.raises(ValueError, match="bag has no pose: its topics are '/scan'; accepted: a ba"):
        replay_topics(tmp_path / "none", None, None)
    with pytest.raises(ValueError, match="no transform places base_link or base_footprint, only g"):
        replay(tmp_path / "arm", SimpleNamespace(), "/scan", "/tf")


def test_topics_of_other_kinds_are_refused(recorded) -> None:
    folder, _ = recorded
    with pytest.raises(ValueError, match="'/odom', not of a LaserScan; accepted: one of '/scan'"):
        replay_topics(folder, "/odom", None)
    with pytest.raises(ValueError, match="'/scan', not of a Odometry"):
        replay_topics(folder, None, "/scan")


class Notes(Monitor):
    """Keeps what it is shown, and asks for what it is told to."""

    def __init__(self) -> None:
        self.asked, self.updates, self.refused, self.began, self.ended = Requests(), [], [], 0, 0

    def begin(self, recording, controller) -> None:
        self.began += 1
        assert recording.num_steps == 0
        assert (recording.world == 0.5).all()
        assert WEIGHT in get_parameters(controller)

    def is_due(self, simulated, elapsed) -> bool:
        return simulated > 0.1 - 1e-6

    def show(self, update) -> None:
        self.updates.append(update)

    def requests(self) -> Requests:
        return self.asked

    def refuse(self, message) -> None:
        self.refused.append(message)

    def end(self, recording) -> None:
        self.ended += 1


def test_monitors_see_a_drive_and_change_it(make_pilot, make_robot, drive, tmp_path) -> None:
    pilot, robot, notes = make_pilot(latency=LATENCY), make_robot(delay=0.04), Notes()
    recorder = SwitchedRecorder(tmp_path, began=BEGAN)
    watch = DriveWatch(pilot, [notes, recorder])
    watch.begin()
    assert notes.began == 1

    def step(seconds):
        for _ in range(round(seconds / robot.period)):
            (command,), _ = drive(pilot, robot, robot.period)
            watch.show(command)
        return command

    step(1.0)
    assert len(notes.updates) == pytest.approx(9, abs=1)
    states = np.concatenate([each.records.state for each in notes.updates])
    times = np.concatenate([each.time for each in notes.updates])
    assert len(states) == len(times)
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-6)
    assert notes.updates[-1].text.startswith("driving, explored ")
    shown = notes.updates[-1].frame
    assert shown.plan.shape[0] == 31
    assert shown.samples.shape[0] == 30
    # A part of the drive is recorded, with wall-clock times.
    recorder.start()
    step(0.5)
    recorder.stop()
    step(0.1)
    (file,) = tmp_path.glob("*.mcap")
    with file.open("rb") as stream:
        at = [each.log_time for *_, each in make_reader(stream).iter_messages(["/command"])]
    np.testing.assert_allclose(np.diff(at), 0.02e9, atol=1e4)
    assert 0.4e9 < at[-1] - at[0] < 0.62e9
    assert at[0] > 1e9 * (BEGAN + 0.99)
    notes.asked = Requests({WEIGHT: 7.0, "cost.beauty.weight": 1.0})
    step(0.2)
    assert float(get_parameters(pilot.controller)[WEIGHT]) == 7.0
    assert len(notes.refused) == 1
    notes.asked = Requests({WEIGHT: 7.0}, is_paused=True)
    assert step(0.5).mode is Mode.PAUSED
    notes.asked = Requests({WEIGHT: 7.0})
    assert step(0.5).mode is Mode.DRIVING
    notes.asked = Requests(is_stopped=True)
    last = step(0.5)
    assert (last.mode, last.reason) == (Mode.DONE, "stopped in the view")
    watch.end(None)
    assert notes.ended == 1


def test_if_one_monitor_does_not_begin_those_before_it_are_told_of_the_end(make_pilot) -> None:
    class Refusal(Notes):
        def begin(self, recording, controller) -> None:
            raise ValueError("it does not begin")

    first, refusal = Notes(), Refusal()
    with pytest.raises(ValueError, match="it does not begin"):
        DriveWatch(make_pilot(latency=LATENCY), [first, refusal]).begin()
    assert (first.began, first.ended, refusal.ended) == (1, 1, 0)


def test_the_commands_of_a_drive_are_a_table(recorded) -> None:
    _, pilot = recorded
    header, *rows = pilot.log.command_table().splitlines()
    assert header == "time,vx,vy,omega,mode,reason"
    assert len(rows) == 300
    assert rows[0].startswith("0.0000,")
    assert rows[0].split(",")[4] == "driving"
    assert float(rows[-1].split(",")[0]) == pytest.approx(5.98)
