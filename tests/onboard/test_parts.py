"""Parts of a robot on board: areas and docks in the frame of its poses, and instruments."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from tests.onboard.conftest import LIDAR, ROBOT, blank, rooms
from tests.onboard.test_replay import blank as blank_message
from tests.onboard.test_replay import laser, odometry

from jaxplore import Perception, explorer
from jaxplore.onboard.options import Mode, PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.parts import Battery, KeepOut
from jaxplore.ros import messages
from jaxplore.ros.bag_writer import BagWriter
from jaxplore.ros.replay import replay
from jaxplore.simulation.exploration.scenario import ExplorationScenario

pytestmark = pytest.mark.long

AREA = ((4.5, 3.0), (5.5, 4.6))
"""Lower and upper corner of an area in the second room, in the frame of the poses [m]."""
DOCK = (2.4, 1.2)
FULL, LOW = 3600.0, 730.0
"""Energies of a battery of 1 Wh [J]: all of it, and just above its reserve."""


@pytest.fixture(scope="module")
def make():
    """Return a maker of pilots with an area and a battery, all of one compiled program."""

    def make(area=AREA, **options) -> Pilot:
        (left, low), (right, high) = area
        corners = [[left, low], [right, low], [right, high], [left, high]]
        parts = (KeepOut([corners]).unplaced(), Battery(DOCK, capacity=1.0, reserve=0.2).unplaced())
        perception = Perception(
            LIDAR, 0.1, 0.2, num_directions=16, margin=0.05, goal=(0.0, 0.0), parts=parts
        )
        scenario = ExplorationScenario(
            blank(), ROBOT, LIDAR, (0.0, 0.0, 0.0), perception=perception, goal=(0.0, 0.0)
        )
        controller = explorer(ROBOT, horizon=30, num_samples=128)
        given = PilotOptions(latency=0.06, done_after=2.0, **options)
        return Pilot(scenario, controller, jax.random.key(5), given)

    return make


@pytest.fixture(scope="module")
def make_robot():
    def make() -> SimulatedRobot:
        perception = Perception(LIDAR, 0.1, 0.2, num_directions=16, margin=0.05)
        scenario = ExplorationScenario(
            rooms(), ROBOT, LIDAR, (1.0, 1.0, 0.3), perception=perception
        )
        return SimulatedRobot(scenario, jax.random.key(2), delay=0.04)

    return make


def test_areas_and_the_dock_are_in_the_frame_of_the_poses(make, make_robot, drive) -> None:
    pilot, robot = make(), make_robot()

    def charged(now, measured):
        pilot.add_look("battery", FULL)
        return measured

    commands, states = drive(pilot, robot, 45.0, charged)
    np.testing.assert_allclose(pilot.offset, (1.0, 1.0), atol=1e-6)
    np.testing.assert_allclose(pilot.belief.parts["battery"].dock, np.array(DOCK) - 1.0, atol=1e-6)
    # Whole cells of 0.1 m: those whose square touches the rectangle, with a cell of rounding.
    closed = np.asarray(pilot.belief.parts["keep_out"])
    rows, columns = np.nonzero(closed)
    x, y = (columns + 0.5) * 0.1 - 1.6 + 1.0, (rows + 0.5) * 0.1 - 1.6 + 1.0
    (left, low), (right, high) = AREA
    for found, edges in ((x, (left, right)), (y, (low, high))):
        np.testing.assert_allclose((found.min(), found.max()), edges, atol=0.11)
    is_in = (states[:, :2] > AREA[0]) & (states[:, :2] < AREA[1])
    assert not is_in.all(axis=1).any()
    assert states[:, 0].max() > 3.5, "the second room was visited"
    assert robot.coverage > 0.8
    assert robot.num_contacts == 0
    assert commands[-1].mode is Mode.DONE


def test_a_robot_is_sent_to_its_dock_by_the_charge_that_it_hears(make, make_robot, drive) -> None:
    pilot, robot, share = make(max_look_age=1.0), make_robot(), [FULL]

    def told(now, measured):
        pilot.add_look("battery", share[0])
        return measured

    commands, _ = drive(pilot, robot, 0.5)
    assert {each.mode for each in commands} <= {Mode.WAITING, Mode.BRAKING}
    assert commands[-1].reason == "the measurement of the battery is not there yet"
    commands, _ = drive(pilot, robot, 4.0, told)
    assert commands[-1].mode is Mode.DRIVING
    commands, _ = drive(pilot, robot, 1.3)
    assert commands[-1].reason == "the measurement of the battery is 1 s old"
    assert not commands[-1].twist.any()
    share[0] = LOW
    _, states = drive(pilot, robot, 12.0, told)
    assert np.hypot(*(states[-50:, :2] - DOCK).T).max() < 0.3
    share[0] = FULL
    commands, states = drive(pilot, robot, 6.0, told)
    assert np.hypot(*(states[-1, :2] - DOCK)) > 0.5


def test_a_robot_does_not_begin_in_an_area(make, make_robot, drive) -> None:
    pilot, robot = make(((0.5, 0.5), (1.5, 1.5))), make_robot()
    commands, _ = drive(
        pilot, robot, 1.0, lambda now, each: pilot.add_look("battery", FULL) or each
    )
    assert commands[-1].reason == "the robot stands in a keep-out area"
    assert not any(each.twist.any() for each in commands)


@pytest.mark.parametrize(
    ("name", "measured", "message"),
    [
        ("camera", 1.0, "name is 'camera'; accepted: battery"),
        ("battery", np.nan, "measured is nan; accepted: a finite number"),
    ],
)
def test_measurements_that_no_part_takes_are_refused(make, name, measured, message) -> None:
    pilot = make()
    pilot.add_odometry(0.0, np.zeros(3), np.zeros(3))
    pilot.command(0.0)
    with pytest.raises(ValueError, match=message):
        pilot.add_look(name, measured)


def charge(now, share) -> SimpleNamespace:
    """Make a `sensor_msgs/BatteryState` of a time and a share."""
    numbers = dict.fromkeys(
        ("voltage", "temperature", "current", "charge", "capacity", "design_capacity"), np.nan
    )
    kinds = {f"power_supply_{name}": 0 for name in ("status", "health", "technology")}
    message = blank_message(
        **numbers, **kinds, percentage=share, present=True, location="", serial_number=""
    )
    message.cell_voltage = message.cell_temperature = np.zeros(0, np.float32)
    messages.fill_header(message.header, now, "base_link")
    return message


def test_a_replay_reads_the_charge_that_was_recorded(make, make_robot, drive, tmp_path) -> None:
    """The kind of its messages was not among those of bags, so no replay with a battery began."""
    pilot, robot, began = make(), make_robot(), 1_700_000_000.0
    with BagWriter(tmp_path / "drive") as writer:

        def record(now, measured):
            pilot.add_look("battery", FULL)
            writer.write("/odom", "Odometry", odometry(now, measured), now)
            writer.write("/battery_state", "BatteryState", charge(now, 1.0), now)
            if measured.scan is not None:
                writer.write("/scan", "LaserScan", laser(now, measured.scan, LIDAR), now)
            return measured

        drive(pilot, robot, 2.0, record, began=began)
    again = make(is_obeyed=False)
    found = replay(tmp_path / "drive", again, "/scan", "/odom")
    assert found.num_malformed == 0
    late = [each for time, each in zip(found.times, found.commands, strict=True) if time > 1.0]
    assert {each.mode for each in late} == {Mode.DRIVING}
