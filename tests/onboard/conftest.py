import jax
import numpy as np
import pytest

from jaxplore import DifferentialDrive, Lidar, OccupancyGrid, Perception, explorer, mpcc
from jaxplore.costs import ObstacleCost
from jaxplore.localisation import Localiser, Odometry
from jaxplore.onboard.following import Following, blank_path
from jaxplore.onboard.options import PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.simulated_robot import SimulatedRobot
from jaxplore.settings.defaults import arguments
from jaxplore.settings.node import NodeContouring
from jaxplore.simulation import Localisation
from jaxplore.simulation.exploration.scenario import ExplorationScenario

SHAPE = (48, 64)
ROBOT = DifferentialDrive(max_speed=1.0)
LIDAR = Lidar(num_beams=72, max_range=2.5, range_noise=0.01)


def rooms() -> OccupancyGrid:
    """Two rooms with a door and a pillar, 6.4 x 4.8 m."""
    world = np.zeros(SHAPE, np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[:16, 32] = world[26:, 32] = 1.0
    world[20:24, 14:18] = 1.0
    return OccupancyGrid(world, 0.1)


def blank() -> OccupancyGrid:
    """The pilot's map before a drive that starts at (1, 1): the two rooms, and little more."""
    return OccupancyGrid(np.zeros((64, 80), np.float32), 0.1, (-1.6, -1.6, 0.0))


def scenario_in(
    world: OccupancyGrid, start, robot=ROBOT, goal=None, lidar=LIDAR, faults=None
) -> ExplorationScenario:
    perception = Perception(lidar, 0.1, 0.2, num_directions=16, margin=0.05, goal=goal)
    parts = {"perception": perception, "goal": goal}
    made = ExplorationScenario(world, robot, lidar, start, **parts, target_coverage=0.97)
    return made.with_disturbances([] if faults is None else [faults])


@pytest.fixture(scope="session")
def make_robot():
    """Return a maker of simulated robots, all of one compiled program with the same lidar."""

    def make(start=(1.0, 1.0, 0.3), lidar=LIDAR, **options) -> SimulatedRobot:
        scenario = scenario_in(rooms(), start, lidar=lidar)
        return SimulatedRobot(scenario, jax.random.key(2), **options)

    return make


@pytest.fixture(scope="session")
def make_pilot():
    """Return a maker of pilots, all of one compiled program."""

    def make(**options) -> Pilot:
        controller = explorer(ROBOT, horizon=30, num_samples=128)
        # Its goal is the way back.
        scenario = scenario_in(blank(), (0.0, 0.0, 0.0), goal=(0.0, 0.0))
        return Pilot(scenario, controller, jax.random.key(5), PilotOptions(**options))

    return make


@pytest.fixture(scope="session")
def make_follower():
    """Return a maker of pilots that follow paths, all of one compiled program.

    Those with an `end_heading`, to whatever heading, have another.
    """

    def make(end_heading=None, **options) -> Pilot:
        weights = arguments(NodeContouring(num_samples=128), mpcc)
        weights["end_heading"] = end_heading
        following = mpcc(ROBOT, blank_path(), other=ObstacleCost(), **weights)
        scenario = scenario_in(blank(), (0.0, 0.0, 0.0), following.model)
        options, key = PilotOptions(**options), jax.random.key(5)
        task = Following(scenario.perception)
        return Pilot(scenario, following.controller, key, options, task)

    return make


@pytest.fixture(scope="session")
def drive():
    """Return a function that lets a pilot drive a robot, and may change what it is told."""

    def drive(pilot, robot, seconds, change=lambda now, measured: measured, began=0.0):
        """Return the commands, and the robot's true states after each."""
        commands, states = [], []
        angles = LIDAR.beam_angles.astype(np.float64)
        for _ in range(round(seconds / robot.period)):
            now = began + robot.time
            measured = change(now, robot.step())
            if measured.pose is not None:
                pilot.add_odometry(now, measured.pose, measured.twist)
            if measured.scan is not None:
                ranges = np.asarray(measured.scan.ranges, np.float64)
                beams = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
                is_return = np.asarray(measured.scan.is_return)
                pilot.add_scan(now, measured.scan, beams[is_return])
            commands.append(pilot.command(now))
            pilot.update_belief(now)
            robot.set_velocity(commands[-1].twist)
            states.append(np.asarray(robot.state.robot))
        return commands, np.array(states)

    return drive


@pytest.fixture(scope="session")
def drive_until(drive):
    """Return a function that lets a pilot drive a robot until something is so, for seconds."""

    def drive_until(is_so, pilot, robot, seconds, *changes):
        """Look every half second; return what `drive` returns."""
        commands, states = [], []
        while not commands or (len(commands) < round(seconds / robot.period) and not is_so()):
            more = drive(pilot, robot, 0.5, *changes)
            commands += more[0]
            states.append(more[1])
        return commands, np.concatenate(states)

    return drive_until


@pytest.fixture(scope="session")
def make_localised():
    """Return a maker of pilots that find their pose themselves, all of one compiled program."""

    def make(closer=None, **options) -> Pilot:
        controller = explorer(ROBOT, horizon=30, num_samples=128)
        scenario = scenario_in(blank(), (0.0, 0.0, 0.0), goal=(0.0, 0.0))
        odometry = Odometry(scale=0.1, turn_scale=0.1)
        # Short memory and few scans, so that loops of a small building are loops.
        localiser = Localiser(odometry, memory=4.0, capacity=256)
        found = Localisation(localiser=localiser, closer=closer)
        key, given = jax.random.key(5), PilotOptions(**options)
        return Pilot(scenario, controller, key, given, localisation=found)

    return make
