"""Motors of a base: their model, its inverse, and what is found of them in a drive."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.onboard.test_replay import blank, odometry

from jaxplore.cli import main
from jaxplore.cli._identify import read_motors
from jaxplore.onboard import Drive, Motors, identify_motors
from jaxplore.ros.bag_writer import BagWriter

STEP = 5e-4
"""Step of the slow simulation that is the oracle [s]."""


def simulate(motors, seed, seconds=60.0, noise=0.01):
    """Return a drive of a base by Euler steps of half a millisecond, at uneven times.

    The commands are ramps between speeds that are drawn, with stops.
    """
    rng = np.random.default_rng(seed)
    sent = np.cumsum(rng.uniform(0.03, 0.07, round(seconds / 0.05)))
    rows, now, wanted = [], np.zeros(3), np.zeros(3)
    for _ in sent:
        for axis, (low, high, often) in ((0, (0.0, 1.3, 0.03)), (2, (-2.0, 2.0, 0.05))):
            if rng.random() < often:
                wanted[axis] = rng.choice([0.0, rng.uniform(low, high)])
        now = now + np.clip(wanted - now, (-0.03, 0, -0.06), (0.03, 0, 0.06))
        rows.append(now)
    commands = np.stack(rows)
    times = np.arange(0.0, seconds, STEP)
    last = np.searchsorted(sent, times - motors.delay, side="right") - 1
    held = np.where(last[:, None] >= 0, commands[np.maximum(last, 0)], 0.0)
    velocity, states = np.zeros(3), []
    for command in held:
        moved = [c if abs(c) >= z else 0.0 for c, z in zip(command, motors.dead_zone, strict=True)]
        goal = np.minimum(np.maximum(moved, -motors.max_speed), motors.max_speed)
        velocity = velocity + STEP / np.maximum(motors.lag, STEP) * (goal - velocity)
        states.append(velocity)
    measured = np.sort(rng.uniform(0.2, seconds - 0.2, round(50.0 * seconds)))
    found = np.stack([np.interp(measured, times, each) for each in np.transpose(states)], axis=1)
    return Drive(sent, commands, measured, found + rng.normal(0.0, noise, found.shape) * (1, 0, 1))


@pytest.mark.parametrize(
    "motors",
    [
        Motors(0.08, (0.2, 0.0, 0.12), (0.06, 0.0, 0.1), (1.0, None, 1.5)),
        Motors(0.25, (0.5, 0.0, 0.3), (0.1, 0.0, 0.3), (0.8, None, None)),
        Motors(0.03, (0.05, 0.0, 0.4)),
    ],
)
def test_the_motors_of_a_base_are_found_in_a_minute(motors) -> None:
    drive = simulate(motors, seed=3)
    found = identify_motors(drive)
    assert found.is_used.tolist() == [True, False, True]
    assert found.motors.delay == pytest.approx(motors.delay, rel=0.1, abs=0.003)
    for axis in (0, 2):
        assert found.motors.lag[axis] == pytest.approx(motors.lag[axis], rel=0.1)
        # Between two commands that occur nobody can tell where the zone ends.
        zone, error = found.motors.dead_zone[axis], found.dead_zone_errors[axis]
        assert abs(zone - motors.dead_zone[axis]) <= error + 1e-6
        assert error < 0.04
        top = motors.max_speed[axis]
        assert found.motors.max_speed[axis] == pytest.approx(top, rel=0.02)
        # What is left is the noise of the odometry.
        assert found.after[axis] < min(0.012, 0.8 * found.before[axis])
    assert found.delay_error < 0.01
    assert np.isnan(found.max_speed_errors[1])


def test_what_is_missing_for_a_while_says_nothing() -> None:
    """A base without commands is braked by a watchdog, which is no motor."""
    motors = Motors(0.1, 0.2)
    drive = simulate(motors, seed=5, seconds=80.0)
    is_sent = (drive.command_times < 30.0) | (drive.command_times > 36.0)
    stopped = drive.velocities * ~((drive.times > 30.3) & (drive.times < 36.0))[:, None]
    cut = Drive(drive.command_times[is_sent], drive.commands[is_sent], drive.times, stopped)
    found = identify_motors(cut)
    assert found.seconds == pytest.approx(74.0, abs=1.5)
    assert found.motors.delay == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(found.motors.lag[[0, 2]], 0.2, rtol=0.1)


numbers = st.floats(-2.0, 2.0)
axes = st.tuples(numbers, numbers, numbers).map(np.array)


@given(axes, axes, st.floats(0.0, 1.0), st.floats(0.01, 0.2))
def test_the_command_for_a_velocity_leads_to_it(velocity, wanted, lag, dt) -> None:
    motors = Motors(lag=lag)
    command = motors.command_for(velocity, wanted, dt)
    after = motors.respond(velocity, command, dt)
    kept = np.exp(-dt / lag) if lag > 0.0 else 0.0
    # A base that shall slow down faster than it can is told to stand, not to reverse.
    possible = (wanted - kept * velocity) * wanted > 0.0
    np.testing.assert_allclose(after[possible], wanted[possible], atol=1e-6)
    np.testing.assert_array_equal(command[~possible], 0.0)


@given(axes, axes, axes)
def test_commands_are_within_what_the_motors_do(velocity, wanted, zones) -> None:
    zone = np.abs(zones)
    motors = Motors(0.1, 0.3, zone.tolist(), (zone + 0.5).tolist())
    command = motors.command_for(velocity, wanted, 0.05)
    assert (np.abs(command) <= motors.max_speed).all()
    assert ((command == 0.0) | (np.abs(command) >= motors.dead_zone)).all()
    assert (command * wanted >= 0.0).all()
    np.testing.assert_array_equal(motors.limit(command), command)


def without(drive, **changes):
    return drive._replace(**changes)


def test_what_says_nothing_is_refused() -> None:
    drive = simulate(Motors(0.1, 0.2), seed=1, seconds=12.0)
    nan = drive.commands.copy()
    nan[3, 0] = np.nan
    for bad, message in (
        (without(drive, commands=nan), "commands are not finite; accepted: finite numbers"),
        (without(drive, times=drive.times[::-1]), "times of velocities do not rise"),
        (without(drive, commands=drive.commands[1:]), r"commands have the shape \(239, 3\) at 240"),
        (without(drive, times=drive.times + 8.0), "overlap for [34].* s; accepted: at least 10 s"),
        (without(drive, commands=0.0 * drive.commands + 0.3), "change less than 8 times"),
    ):
        with pytest.raises(ValueError, match=message):
            identify_motors(bad)
    for name, value in (("lag", -0.1), ("lag", (0.1, 0.2)), ("dead_zone", np.inf), ("lag", "x")):
        with pytest.raises(ValueError, match=f"{name} is .*; accepted: a number of at least 0, or"):
            Motors(**{name: value})
    with pytest.raises(ValueError, match=r"max_speed is \[0.1, .* accepted: greater on each axis"):
        Motors(dead_zone=0.1, max_speed=0.1)


def twist(values) -> SimpleNamespace:
    parts = zip(("linear", "angular"), ((*values[:2], 0.0), (0.0, 0.0, values[2])), strict=True)
    return SimpleNamespace(
        **{name: SimpleNamespace(**dict(zip("xyz", each, strict=True))) for name, each in parts}
    )


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Write a drive as a bag, whose clock is not that of the stamps, with a message that is bad."""
    drive, began = simulate(Motors(0.1, (0.2, 0.0, 0.3)), seed=2, seconds=40.0), 1_700_000_000.0
    folder = tmp_path_factory.mktemp("bags") / "teleop"
    with BagWriter(folder) as writer:
        for now, command in zip(drive.command_times, drive.commands, strict=True):
            bad = (np.nan, 0.0, 0.0) if 10.0 < now < 10.08 else command
            stamped = blank(twist=twist(bad))
            stamped.header.stamp.sec = 5
            writer.write("/cmd_vel", "TwistStamped", stamped, began + now)
        for now, velocity in zip(drive.times, drive.velocities, strict=True):
            measured = SimpleNamespace(pose=np.zeros(3), twist=velocity)
            writer.write("/odom", "Odometry", odometry(began + now, measured), began + now)
    return folder


def test_the_command_prints_and_writes_what_the_node_reads(bag, tmp_path, capsys) -> None:
    out = tmp_path / "motors.yaml"
    main(["identify", str(bag), "-o", str(out)])
    told = capsys.readouterr()
    assert "Reading /cmd_vel and /odom" in told.err
    assert "malformed messages were left out" in told.err
    assert "vy hardly changes" in told.err
    for name in ("delay [ms]", "lag [ms]", "dead zone", "not reached", "error after"):
        assert name in told.out
    motors = read_motors(out)
    assert motors.delay == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(motors.lag, (0.2, 0.0, 0.3), rtol=0.1)
    assert np.isinf(motors.max_speed).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.mcap"], "bag 'nothing.mcap' is not there"),
        (["1/bad topic"], "BAG_OR_TOPIC is '1/bad topic'; accepted: a topic such as"),
        (["BAG", "--command", "/odom"], "topic is '/odom', not of a TwistStamped"),
        (["BAG", "--pose", "/cmd_vel"], "topic is '/cmd_vel', not of a Odometry"),
        (["BAG", "-o", "BAG"], "exists; accepted: another file, or --overwrite"),
    ],
)
def test_bad_input_is_one_line(bag, arguments, message, capsys) -> None:
    given = [str(bag) if each == "BAG" else each for each in arguments]
    with pytest.raises(SystemExit) as error:
        main(["identify", *given])
    assert error.value.code == 2
    told = capsys.readouterr().err.splitlines()
    assert message in told[-1]
    assert not any("Traceback" in each for each in told)
