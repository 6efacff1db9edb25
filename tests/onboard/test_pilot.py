"""The pilot of a robot, with a simulated one in the same process."""

import jax
import numpy as np
import pytest
from tests.onboard.conftest import LIDAR, SHAPE, scenario_in

from jaxplore import OccupancyGrid
from jaxplore.onboard import Drive, Motors, identify_motors, steps
from jaxplore.onboard.options import Mode, PilotOptions
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.sensing.beams import Scan

pytestmark = pytest.mark.long

LATENCY = 0.06
"""Two periods of delay, and one in which a command waits for the next step."""


@pytest.fixture(scope="module")
def drive_once(make_pilot, make_robot, drive):
    def run(seconds, change=lambda now, measured: measured, offset=(0.0, 0.0)):
        def moved(now, measured):
            place = np.array([*offset, 0.0])
            return change(now, measured._replace(pose=measured.pose + place))

        pilot = make_pilot(latency=LATENCY)
        robot = make_robot(delay=0.04)
        commands, states = drive(pilot, robot, seconds, moved)
        return pilot, robot, commands, states

    return run


@pytest.fixture(scope="module")
def explored(make_pilot, make_robot, drive_until):
    """One drive until nothing is left to explore, of which most tests here look at a part."""
    pilot, robot = make_pilot(latency=LATENCY, done_after=2.0), make_robot(delay=0.04)
    return pilot, robot, *drive_until(lambda: pilot.finished, pilot, robot, 40.0)


def speeds(commands) -> np.ndarray:
    return np.array([np.hypot(*each.twist[:2]) for each in commands])


def test_the_robot_explores_without_a_contact(explored) -> None:
    _, robot, commands, _ = explored
    assert robot.coverage > 0.95
    assert robot.num_contacts == 0
    assert commands[0].mode is Mode.DRIVING
    assert robot.watchdog_stops == 0


def test_the_robot_is_done_when_nothing_is_worth_a_visit(explored) -> None:
    pilot, _, commands, _ = explored
    assert commands[-1].mode is Mode.DONE
    assert commands[-1].reason == "no place that is worth a visit is reachable"
    assert pilot.recording().metrics().is_finished


def test_the_same_data_give_the_same_commands_and_compile_nothing(explored, drive_once) -> None:
    programs = (steps.map_scan, steps.update_fields, steps.plan)
    before = [each._cached._cache_size() for each in programs]
    again = drive_once(2.0)[2]
    for one, other in zip(again, explored[2], strict=False):
        np.testing.assert_array_equal(one.twist, other.twist)
    assert [each._cached._cache_size() for each in programs] == before


def test_a_drive_far_from_the_origin_is_the_same_to_within_rounding(explored, drive_once) -> None:
    offset = (500_000.0, 4_649_776.0)
    pilot, robot, _, states = drive_once(2.0, offset=offset)
    np.testing.assert_allclose(states, explored[3][: len(states)], atol=2e-2)
    np.testing.assert_allclose(pilot.offset, np.array(offset) + 1.0, atol=0.05)
    # What is saved is where the odometry is.
    local, placed = pilot.recording(), pilot.recording(in_odometry=True)
    exact = {"rtol": 0.0, "atol": 1e-8}
    np.testing.assert_allclose(placed.positions, local.positions + pilot.offset, **exact)
    np.testing.assert_allclose(placed.origin[:2], local.origin[:2] + pilot.offset, **exact)
    np.testing.assert_allclose(
        placed.frames[-1].scan, local.frames[-1].scan + pilot.offset, **exact
    )
    assert abs(placed.positions[-1] - (states[-1, :2] + offset)).max() < 0.1
    assert robot.num_contacts == 0


def test_the_recording_of_a_drive_is_that_of_an_exploration(explored) -> None:
    pilot, robot, commands, states = explored
    recording = pilot.recording()
    assert recording.num_steps == pytest.approx(len(commands), abs=2)
    metrics = recording.metrics()
    truth = robot.recording(is_interrupted=False).metrics()
    assert metrics.path_length == pytest.approx(truth.path_length, rel=0.05)
    # The final map stands for the world, so all of it is covered in the end.
    assert metrics.coverage == pytest.approx(1.0)
    assert metrics.time_to["50"] is not None
    coverage = recording.records.coverage
    assert (np.diff(coverage) >= 0.0).all()
    assert 0.0 < metrics.minimum_clearance < 1.0
    # Relative to the first position.
    np.testing.assert_allclose(
        recording.positions[-1], states[-1, :2] - np.round(states[0, :2], 1), atol=0.1
    )
    assert set(recording.figures()) >= {"map", "coverage"}


def freeze(begin, end, what):
    """Return a change that repeats a part of what was measured, with new times."""
    kept = {}

    def change(now, measured):
        if begin <= now < end:
            if what == "scan" and measured.scan is not None:
                return measured._replace(scan=kept.get("scan", measured.scan))
            if what == "pose":
                return measured._replace(pose=kept["pose"], twist=np.array([0.5, 0.0, 0.0]))
        else:
            kept["pose"] = measured.pose
            kept["scan"] = measured.scan or kept.get("scan")
        return measured

    return change


def drop(begin, end, what):
    def change(now, measured):
        if begin <= now < end and what in ("scan", "both"):
            measured = measured._replace(scan=None)
        if begin <= now < end and what in ("pose", "both"):
            measured = measured._replace(pose=None)
        return measured

    return change


FAULTS = [
    (drop, "scan", "the scan is 0.3"),
    (drop, "pose", "the odometry is 0.3"),
    (drop, "both", "s old"),
    (freeze, "scan", "the scan does not change"),
    (freeze, "pose", "the pose does not change"),
]
FIRST, EVERY, LASTS = 1.5, 2.2, 0.9
"""When the first fault begins, how long after it the next does, and how long each lasts [s]."""


@pytest.fixture(scope="module")
def faulty(drive_once):
    """Drive through all faults, one after the other."""
    begins = [FIRST + EVERY * number for number in range(len(FAULTS))]
    changes = [
        make(begin, begin + LASTS, what)
        for begin, (make, what, _) in zip(begins, FAULTS, strict=True)
    ]

    def change(now, measured):
        for each in changes:
            measured = each(now, measured)
        return measured

    return drive_once(FIRST + EVERY * len(FAULTS), change)


@pytest.mark.parametrize(
    "number", range(len(FAULTS)), ids=[f"{m.__name__}-{w}" for m, w, _ in FAULTS]
)
def test_data_that_stop_or_freeze_brake_the_robot_and_say_why(faulty, number) -> None:
    _, robot, commands, _ = faulty
    reason, begin = FAULTS[number][2], FIRST + EVERY * number
    end = begin + LASTS
    times = robot.period * np.arange(len(commands)) + 1e-9
    braking = np.array([each.mode is Mode.BRAKING for each in commands])
    # It had gone on after the fault before.
    assert not braking[(times > begin - 1.0) & (times < begin)].any()
    first = np.argmax(braking & (times > begin))
    assert begin < times[first] <= begin + 0.32 + 1e-6
    assert reason in commands[first].reason
    # A ramp of 10 m/s^2 from at most 1 m/s.
    fast = speeds(commands)
    ramp = np.diff(fast[first - 1 : first + 10])
    assert (ramp >= -0.2 - 1e-6).all()
    assert (ramp <= 1e-9).all()
    stands = (times > begin + 0.42) & (times < end - 0.02)
    assert not fast[stands].any()
    # It goes on when the data are back.
    assert fast[(times > end) & (times < begin + EVERY)].max() > 0.1
    assert robot.num_contacts == 0


def test_a_pose_that_jumps_brakes_the_robot_for_a_second(drive_once) -> None:
    def jump(now, measured):
        return measured._replace(pose=measured.pose + np.array([2.0 * (now >= 1.0), 0.0, 0.0]))

    _, _, commands, _ = drive_once(2.5, jump)
    reasons = [each.reason for each in commands]
    assert reasons[50].startswith("the pose jumped by 2.0")
    assert commands[50].mode is Mode.BRAKING
    assert commands[-1].mode is Mode.DRIVING


def test_scans_that_do_not_fit_the_map_brake_the_robot_until_they_do(drive_once) -> None:
    def misplace(now, measured):
        if not 1.2 <= now < 2.2 or measured.scan is None:
            return measured
        # Something that is half a metre away in all directions, and was not there before.
        ranges = np.asarray(measured.scan.ranges)
        near = np.full_like(ranges, 0.6) + 1e-3 * np.sin(10.0 * now)
        return measured._replace(scan=Scan(near.astype(np.float32), np.ones(len(ranges), bool)))

    _, robot, commands, _ = drive_once(3.2, misplace)
    reasons = [each.reason for each in commands]
    times = robot.period * np.arange(len(commands))
    says_so = np.array([each.startswith("the scan does not fit") for each in reasons])
    assert 1.2 <= times[np.argmax(says_so)] <= 1.5
    assert says_so[(times > 1.5) & (times < 2.2)].all()
    assert not says_so[times > 2.5].any()
    assert commands[-1].mode is Mode.DRIVING
    assert robot.num_contacts == 0


def test_measurements_that_are_not_finite_never_reach_the_robot(drive_once) -> None:
    def poison(now, measured):
        if 0.8 <= now < 1.4:
            bad = measured.pose.copy()
            bad[0] = np.nan
            return measured._replace(pose=bad)
        if 2.0 <= now < 2.4 and measured.scan is not None:
            nan = np.full_like(np.asarray(measured.scan.ranges), np.nan)
            return measured._replace(scan=Scan(nan, np.asarray(measured.scan.is_return)))
        return measured

    _, robot, commands, _ = drive_once(3.0, poison)
    assert np.isfinite([each.twist for each in commands]).all()
    assert robot.num_contacts == 0


def test_a_paused_pilot_stands_and_goes_on(make_pilot, make_robot, drive) -> None:
    pilot, robot = make_pilot(latency=LATENCY), make_robot(delay=0.04)
    drive(pilot, robot, 1.0)
    pilot.is_started = False
    commands, _ = drive(pilot, robot, 1.4)
    assert commands[-1].mode is Mode.PAUSED
    assert not commands[-1].twist.any()
    pilot.is_started = True
    assert speeds(drive(pilot, robot, 1.0)[0]).max() > 0.1
    pilot.finish("enough")
    commands, _ = drive(pilot, robot, 1.4)
    assert (commands[-1].mode, commands[-1].reason) == (Mode.DONE, "enough")
    assert not commands[-1].twist.any()


def test_a_late_plan_is_bridged_by_the_last_one_and_then_by_braking(
    make_pilot, make_robot, drive
) -> None:
    pilot, robot = make_pilot(latency=LATENCY), make_robot(delay=0.04)
    commands, _ = drive(pilot, robot, 1.0)
    now = robot.time
    bridged = [pilot.next_command(now + k * robot.period) for k in range(60)]
    assert all(each.reason == "a plan was late" for each in bridged)
    modes = [each.mode for each in bridged]
    assert modes[0] is Mode.DRIVING
    assert modes[-1] is Mode.BRAKING
    assert modes == sorted(modes, reverse=True)
    assert not bridged[-1].twist.any()
    # From one command to the next the speed changes by what the robot can do.
    steps_ = np.diff([commands[-1].twist[0], *(each.twist[0] for each in bridged)])
    assert np.abs(steps_)[: modes.index(Mode.BRAKING)].max() < 0.021
    assert np.abs(steps_).max() < 0.2 + 1e-6


def test_beams_start_at_the_lidar_and_not_at_the_robots_centre(make_pilot, make_robot) -> None:
    scan = make_robot().step().scan
    yaw, ahead, left = 0.4, 0.22, -0.13
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    x, y = turn @ np.array([ahead, left])
    mounted, centred = make_pilot(lidar_x=ahead, lidar_y=left), make_pilot()
    for time, place in ((0.0, (0.0, 0.0)), (0.1, (0.0, 0.0))):
        mounted.add_odometry(time, np.array([*place, yaw]), np.zeros(3))
    # The same map is made by a robot whose centre is where that lidar is.
    for time, place in ((0.0, (0.0, 0.0)), (0.1, (x, y))):
        centred.add_odometry(time, np.array([*place, yaw]), np.zeros(3))
    for each in (mounted, centred):
        each.add_scan(0.1, scan, np.zeros((0, 2)))
        each.command(0.1)
        each.update_belief(0.1)
    seen = np.asarray(mounted.belief.grid.probability)
    assert np.count_nonzero(seen != 0.5) > 100
    np.testing.assert_allclose(seen, np.asarray(centred.belief.grid.probability), atol=1e-5)


def test_a_robot_that_is_told_to_return_drives_back_to_its_start(
    make_pilot, make_robot, drive, drive_until
) -> None:
    pilot, robot = make_pilot(latency=LATENCY), make_robot(delay=0.04)
    before = steps.update_fields._cached._cache_size()
    _, states = drive(pilot, robot, 2.5)
    assert np.hypot(*(states[-1][:2] - states[0][:2])) > 1.0
    pilot.task.turn_back(2.5, "told to return")
    drive_until(lambda: pilot.finished, pilot, robot, 8.0)
    commands, states = drive(pilot, robot, 0.5)
    assert pilot.finished == "told to return; the robot is back at its start"
    assert np.hypot(*(states[-1][:2] - 1.0)) < 0.25
    assert not commands[-1].twist.any()
    assert robot.num_contacts == 0
    # The way out and the way back are one program.
    assert steps.update_fields._cached._cache_size() <= before + 1


def test_an_order_to_go_on_ends_the_way_back(make_pilot) -> None:
    task = make_pilot().task
    task.turn_back(3.0, "told to return")
    assert task.is_returning
    assert float(task.perception.max_unknown) == 1.0
    task.go_on()
    assert not task.is_returning
    assert float(task.perception.max_unknown) == 0.0


def test_a_way_back_that_is_blocked_is_given_up(make_pilot) -> None:
    task = make_pilot().task
    task.turn_back(3.0, "told to return")
    far = np.array([3.0, 1.0])
    assert task.update(4.0, np.inf, far, is_started=True) == ""
    assert task.update(5.0, 503.0, far, is_started=True) == ""
    assert task.update(14.0, np.inf, far, is_started=True) == ""
    ended = task.update(15.5, np.inf, far, is_started=True)
    assert ended == "told to return; no way back to the start is known"


@pytest.mark.parametrize(
    ("name", "value"), [("latency", -0.1), ("max_age", 0.0), ("margin", -1.0), ("max_jump", 0)]
)
def test_options_that_make_no_sense_are_refused(name, value) -> None:
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        PilotOptions(**{name: value})


def test_a_robot_drives_on_where_its_lidar_meets_nothing_but_not_where_it_must(
    make_pilot, drive
) -> None:
    """In the open with one pillar."""
    world = np.zeros(SHAPE, np.float32)
    world[22:26, 6:8] = 1.0
    scenario = scenario_in(OccupancyGrid(world, 0.1), (2.4, 2.4, 0.0))

    def run(seconds, change=lambda now, measured: measured):
        robot = SimulatedRobot(scenario, jax.random.key(2))
        return drive(make_pilot(), robot, seconds, change)[0]

    def without_returns(begin):
        def change(now, measured):
            if measured.scan is None or now < begin:
                return measured
            none = np.zeros(LIDAR.num_beams, bool)
            far = np.full(LIDAR.num_beams, LIDAR.max_range, np.float32)
            return measured._replace(scan=Scan(far, none))

        return change

    def leave(now, measured):
        measured = without_returns(0.0)(now, measured)
        if measured.scan is None or now >= 1.0:
            return measured
        # The last that it met was near the end of its range.
        is_return = np.arange(LIDAR.num_beams) == 0
        ranges = np.where(is_return, 2.2 + 0.12 * now, LIDAR.max_range).astype(np.float32)
        return measured._replace(scan=Scan(ranges, is_return))

    commands = run(4.0, leave)
    assert commands[-1].mode is Mode.DRIVING
    assert not any("lidar" in each.reason or "scan" in each.reason for each in commands[20:])
    # A lidar that sees no more, beside the pillar.
    died = run(2.5, without_returns(1.0))
    braked = [each for each in died if "lidar" in each.reason]
    assert braked[0].reason == "the lidar meets nothing, although something must be in its range"
    assert not braked[-1].twist.any()
    # One that never saw anything.
    blind = run(2.0, without_returns(0.0))
    assert blind[-1].reason == "the lidar met nothing yet"
    assert not blind[-1].twist.any()


MOTORS = Motors(0.06, (0.3, 0.0, 0.25), (0.02, 0.0, 0.05))


@pytest.fixture(scope="module")
def errors(make_pilot, make_robot, drive):
    """Return how far a slow base is from the velocities that are planned, without and with an
    allowance for its motors, and the contacts of both."""
    found = []
    for motors in (None, MOTORS):
        pilot, robot = make_pilot(latency=0.04, motors=motors), make_robot(motors=MOTORS)
        planned, driven = [], []

        def look(now, measured, pilot=pilot, robot=robot, planned=planned, driven=driven):
            planned.append(pilot._twist.copy())
            driven.append(robot.velocity.copy())
            return measured

        drive(pilot, robot, 20.0, look)
        # A command has effect after the delay, three periods of 20 ms, and a period of its own.
        errors = np.array(planned)[:-4] - np.array(driven)[4:]
        found.append((np.sqrt(np.mean(errors[100:, [0, 2]] ** 2, axis=0)), robot.num_contacts))
    return found


def test_a_base_with_slow_motors_drives_as_planned_where_they_are_known(errors) -> None:
    (unknown, _), (known, contacts) = errors
    # A base that brakes is not told to reverse, so that it slows down later than planned.
    assert (known < (0.8, 0.2) * unknown).all(), (unknown, known)
    assert contacts == 0


def test_the_motors_of_the_simulated_robot_are_found_in_its_drive(make_robot) -> None:
    robot, rng = make_robot(start=(4.8, 2.4, 0.0), motors=MOTORS), np.random.default_rng(4)
    times, commands, velocities = [], [], []
    command, wanted = np.zeros(3), np.zeros(3)
    for step in range(2000):
        if step % 25 == 0:
            # Circles of at most 0.3 m, and stops.
            wanted = rng.integers(2) * np.array([rng.uniform(0.0, 0.3), 0.0, rng.uniform(1.0, 2.0)])
        command = command + np.clip(wanted - command, (-0.01, 0, -0.03), (0.01, 0, 0.03))
        measured = robot.step()
        times.append(robot.time - robot.period)
        commands.append(command)
        velocities.append(measured.twist)
        robot.set_velocity(command)
    assert robot.num_contacts == 0
    # What is measured at a time is sent an answer at once.
    drive = Drive(*(np.array(each) for each in (times, commands, times, velocities)))
    found = identify_motors(drive).motors
    # Of the periods of 20 ms one passes before a velocity is measured.
    assert found.delay == pytest.approx(0.06, abs=0.02)
    np.testing.assert_allclose(found.lag[[0, 2]], MOTORS.lag[[0, 2]], rtol=0.1)
    np.testing.assert_allclose(found.dead_zone[[0, 2]], (0.02, 0.05), atol=0.016)
