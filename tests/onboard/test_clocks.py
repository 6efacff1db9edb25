"""A pilot whose clocks jump, stop and differ, and whose messages are forged, in closed loop."""

import itertools

import numpy as np
import pytest

from jaxplore.onboard.drive_clock import STANDSTILL_SECONDS, Instant
from jaxplore.onboard.options import Mode
from jaxplore.sensing.beams import Scan

pytestmark = pytest.mark.long

LATENCY, BEGAN, PERIOD = 0.06, 1000.0, 0.02
NEVER = np.inf


class Drive:
    """Drives a simulated robot by a pilot, both by clocks that a test sets.

    Args:
        clock: clock of the stamps at a time of the robot.
        rate: seconds of a simulated clock in a second; a real clock when absent.
        has_steady: whether the pilot is told a steady clock as well.
        scan_ahead: by how much stamps of scans are ahead.
        scans_until: time of the last scan; likewise for the odometry and the node.
        forged: number of control periods between two forged scans without a wall, and by how much
            their stamps are ahead.
    """

    def __init__(self, pilot, robot, *, clock=lambda t: t, rate=None, has_steady=True,
                 scan_ahead=0.0, scans_until=NEVER, odometry_until=NEVER, node_until=NEVER,
                 forged=None) -> None:  # fmt: skip
        self.pilot, self.robot, self.clock, self.rate = pilot, robot, clock, rate
        self.has_steady, self.scan_ahead, self.forged = has_steady, scan_ahead, forged
        self.until = scans_until, odometry_until, node_until
        self.rows = []
        self.later = 0.0
        self.angles = pilot.sensor.beam_angles.astype(np.float64)

    def instant(self, t) -> Instant:
        steady = (t / (self.rate or 1.0) + self.later) if self.has_steady else None
        return Instant(BEGAN + self.clock(t), steady, self.rate is not None)

    def step(self) -> None:
        t, pilot, robot = self.robot.time, self.pilot, self.robot
        measured, at = robot.step(), self.instant(t)
        received = at if self.has_steady else None
        scans_until, odometry_until, node_until = self.until
        if t < odometry_until:
            pilot.add_odometry(at.clock, measured.pose, measured.twist, received)
        if measured.scan is not None and t < scans_until:
            ranges = np.asarray(measured.scan.ranges, np.float64)
            beams = ranges[:, None] * np.stack([np.cos(self.angles), np.sin(self.angles)], -1)
            points = beams[np.asarray(measured.scan.is_return)]
            pilot.add_scan(at.clock + self.scan_ahead, measured.scan, points, received)
        if self.forged is not None and t > 1.0 and robot.num_steps % self.forged[0] == 1:
            nothing = Scan(np.full(len(self.angles), 2.5, np.float32), np.zeros(72, bool))
            # One return that moves, so that it is not the same scan again.
            far = np.array([[2.4, 0.01 * np.sin(37.0 * t)]])
            pilot.add_scan(at.clock + self.forged[1], nothing, far, received)
        if t < node_until:
            command = pilot.command(at)
            pilot.update_belief(at)
            robot.set_velocity(command.twist)
            self.rows.append((t, float(np.hypot(*robot.velocity[:2])), command))
        else:
            self.rows.append((t, float(np.hypot(*robot.velocity[:2])), None))

    def run(self, seconds) -> "Drive":
        for _ in range(round(seconds / PERIOD)):
            self.step()
        return self

    def reasons(self, begin=0.0, end=NEVER) -> list[str]:
        rows = [row for row in self.rows if begin <= row[0] < end]
        return [name for name, _ in itertools.groupby(row[2].reason for row in rows)]

    def modes(self, begin, end=NEVER):
        return {row[2].mode for row in self.rows if begin <= row[0] < end}

    def first(self, begin, is_so) -> float:
        """Time after `begin` of the first row that is so [s]."""
        return next(row[0] - begin for row in self.rows if row[0] >= begin and is_so(row))

    def is_commanded_to_rest_after(self, begin) -> float:
        return self.first(begin, lambda row: not row[2].twist.any())

    def stands_after(self, begin) -> float:
        return self.first(begin, lambda row: row[1] == 0.0)


@pytest.fixture(scope="module")
def begin(make_pilot, make_robot):
    def begin(**given):
        pilot, robot = make_pilot(latency=LATENCY), make_robot(delay=0.04)
        return Drive(pilot, robot, **given)

    return begin


@pytest.mark.parametrize("has_steady", [True, False])
def test_a_clock_that_jumps_stops_the_robot_for_a_second(begin, has_steady) -> None:
    def clock(t):
        # Small steps, as of NTP, and then two jumps.
        small = -0.1 * (t >= 0.5) + 0.15 * (t >= 1.0) - 0.05 * (t >= 1.5)
        return t + small - 30.0 * (t >= 2.0) + 60.0 * (t >= 4.0)

    drive = begin(clock=clock, has_steady=has_steady).run(6.0)
    assert drive.modes(0.0, 1.99) == {Mode.DRIVING}
    for at, jump in ((2.0, -30.0), (4.0, 60.0)):
        assert drive.reasons(at, at + 0.9) == [f"the clock jumped by {jump:.1f} s"]
        assert drive.modes(at, at + 0.9) == {Mode.BRAKING}
        assert drive.is_commanded_to_rest_after(at) <= 0.2
        # It goes on within 2 s.
        assert drive.modes(at + 1.1, at + 1.99) <= {Mode.DRIVING, Mode.DONE}
        assert drive.first(at + 1.0, lambda row: row[1] > 0.1) < 1.0
    assert drive.robot.num_contacts == 0
    # It keeps its map.
    assert drive.robot.coverage > 0.8


def test_a_simulated_clock_may_be_slow_or_fast(begin) -> None:
    for rate in (0.2, 5.0):
        drive = begin(rate=rate).run(1.2)
        assert drive.modes(0.0) == {Mode.DRIVING}
        assert drive.rows[-1][1] > 0.8


def test_a_simulator_that_pauses_stops_the_robot_and_says_why(begin) -> None:
    drive = begin(rate=1.0).run(1.5)
    commands = []
    # The robot stands as long as its simulator does.
    for _ in range(50):
        drive.later += PERIOD
        commands.append(drive.pilot.command(drive.instant(drive.robot.time - PERIOD)))
    standing = [each.reason == "the simulated clock stands still" for each in commands]
    first = PERIOD * (1 + standing.index(True))
    assert first == pytest.approx(STANDSTILL_SECONDS, abs=1.5 * PERIOD)
    assert all(standing[standing.index(True) :])
    assert not commands[-1].twist.any()
    drive.run(0.6)
    assert drive.modes(1.6) == {Mode.DRIVING}
    # The clock dies, and the robot goes on.
    drive.clock = lambda t: min(t, 2.1)
    drive.run(1.0)
    assert drive.is_commanded_to_rest_after(2.1) <= STANDSTILL_SECONDS + 0.2
    assert drive.robot.num_contacts == 0


def test_a_simulator_that_begins_anew_is_driven_on(begin, make_robot) -> None:
    drive = begin(rate=1.0).run(2.0)
    robot = drive.robot
    drive.robot, drive.later, drive.rows = make_robot(delay=0.04), 2.0, []
    drive.run(2.0)
    assert drive.reasons(0.0, 0.9) == ["the clock jumped by -2.0 s"]
    assert drive.first(0.5, lambda row: row[1] > 0.1) < 1.5
    assert robot.num_contacts == drive.robot.num_contacts == 0


@pytest.mark.parametrize("has_steady", [True, False])
def test_scans_that_are_ahead_of_time_are_not_believed_longer(begin, has_steady) -> None:
    drive = begin(scan_ahead=0.9, has_steady=has_steady, scans_until=2.5).run(4.2)
    assert drive.is_commanded_to_rest_after(2.5) <= 0.42
    assert drive.stands_after(2.5) <= 0.5 + 1.0
    assert drive.robot.num_contacts == 0


def test_the_robot_goes_on_past_scans_that_are_forged_ahead_of_time(begin) -> None:
    drive = begin(forged=(25, 0.95)).run(5.0)
    assert drive.modes(0.0) == {Mode.DRIVING}
    assert drive.robot.num_contacts == 0
    assert drive.robot.coverage > 0.8


@pytest.mark.parametrize(("every", "ahead"), [(5, 1e-3), (1, -30.0)])
def test_forged_scans_without_walls_never_make_the_robot_drive_into_them(
    begin, every, ahead
) -> None:
    # With every fifth, each scan of the lidar is followed by a forged one in the same period.
    drive = begin(forged=(every, ahead)).run(6.0)
    assert drive.robot.num_contacts == 0


@pytest.mark.parametrize("what", ["scans_until", "odometry_until", "node_until"])
def test_whatever_ends_the_robot_stands_half_a_second_and_its_braking_later(begin, what) -> None:
    end = 2.07
    drive = begin(**{what: end}).run(end + 1.6)
    speed = next(row[1] for row in drive.rows if row[0] >= end)
    assert speed > 0.8
    # The robot brakes by 1 m/s^2.
    assert drive.stands_after(end) <= 0.5 + speed / 1.0
    assert drive.robot.num_contacts == 0


def test_messages_that_are_held_up_are_as_old_as_their_stamps(begin) -> None:
    """A network that stalls, and then delivers everything later than before, is not a clock."""
    drive = begin(scans_until=1.5).run(3.0)
    drive.until, drive.scan_ahead = (NEVER, NEVER, NEVER), -1.5
    drive.run(0.5)
    assert drive.modes(2.0) == {Mode.BRAKING}
    assert all("the scan is" in each for each in drive.reasons(2.0))
    drive.scan_ahead = 0.0
    drive.run(0.4)
    assert drive.modes(3.62) == {Mode.DRIVING}
    assert drive.robot.num_contacts == 0
