"""One recorded drive, given to the robot inside the closed loop of a simulation, to the mapper of a
pilot and to a whole pilot: all know, stop and command the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.onboard.conftest import LIDAR, ROBOT, rooms, scenario_in

from jaxplore import Faults, MotionGuard, OccupancyGrid
from jaxplore.control.base import Controller, Info
from jaxplore.control.stops import BLIND, FROZEN, GOOD, JUMPED, MISFIT, REASONS
from jaxplore.onboard.log import DriveLog
from jaxplore.onboard.mapper import Mapper
from jaxplore.onboard.options import PilotOptions
from jaxplore.onboard.pilot import Pilot
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.loop import closed_loop_step, initial_loop_state, moment_at, step_keys

pytestmark = pytest.mark.long

SECONDS = 12.0
DROPOUT, FREEZE, JUMP, WALLS = (2.0, 3.0), (4.0, 4.6), 6.0, 8.6
"""When scans are missing, when the odometry stands still, when it jumps, and when walls appear from
which scans do not fit for longer than a robot believes its map [s]."""
FAR = np.array([0.9, -0.1, 0.0])
"""How far it jumps [m, m, rad]."""


class Circles(Controller):
    """Drives in circles."""

    def init(self):
        return jnp.zeros(())

    def step(self, state, observation, belief=None, *, key):
        speeds = observation[3:]
        # Commands differ from step to step, as those of MPPI do.
        noise = 0.1 * jnp.sin(40.0 * observation[:2])
        wanted = jnp.array([0.3, 1.2]) + noise - speeds
        command = jnp.clip(2.0 * wanted, ROBOT.control_min, ROBOT.control_max)
        one = jnp.ones(())
        return command, state, Info(command[None], one[None], one[None], one, jnp.array(True))

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        raise NotImplementedError

    def at_period(self, control_period):
        return self


@eqx.filter_jit
def measure(scenario, state, key):
    """Return what the robot measures in the coming step, as the closed loop has it."""
    moment, (measure_key, _) = moment_at(scenario, state, key), step_keys(key, state.step)
    truth = scenario.true_world(state.task, moment)
    return scenario.instruments.measure(state.task, truth, moment, measure_key)[0]


step = eqx.filter_jit(closed_loop_step)


@pytest.fixture(scope="module")
def drives():
    """Return what the robot knew after each of its scans in the loop, and what the pilot did."""
    # The two rooms in the map of the pilots of the other tests, whose programs it shares.
    world = np.zeros((64, 80), np.float32)
    world[6:54, 6:70] = np.asarray(rooms().unpad().probability)
    ring = np.zeros(world.shape, bool)
    ring[10:24, 19:34] = True
    ring[11:23, 20:33] = False
    grid = OccupancyGrid(world, 0.1, (-1.6, -1.6, 0.0))
    faults = Faults(scan_dropout=DROPOUT, walls=ring, walls_from=WALLS)
    scenario = scenario_in(grid, (0.0, 0.0, -0.8), goal=(0.0, 0.0), faults=faults)
    scenario = scenario.with_guard(MotionGuard())
    controller, key = Circles(), jax.random.key(4)
    state = initial_loop_state(controller, scenario, key)
    mapper = Mapper(scenario, DriveLog(scenario))
    options = PilotOptions(latency=0.0, max_frozen=float(scenario.guard.max_frozen), margin=0.0)
    pilot, told, commands = Pilot(scenario, controller, key, options), [], []
    angles = LIDAR.beam_angles
    stops, known, fields, frozen = [], [], 0, None
    for number in range(round(SECONDS / scenario.period)):
        now = number * scenario.period
        robot = np.asarray(state.task.robot)
        if FREEZE[0] <= now < FREEZE[1]:
            frozen = robot if frozen is None else frozen
            robot = np.append(frozen[:3], robot[3:])
        if abs(now - JUMP) < 0.5 * scenario.period:
            robot = robot + np.append(FAR, np.zeros(2))
        state = state._replace(task=state.task._replace(robot=jnp.asarray(robot, jnp.float32)))
        measured = measure(scenario, state, key)
        state, record = step(controller, scenario, state, key)
        stops.append(int(record.stop))
        commands.append(np.asarray(state.task.robot)[3:])
        pilot.add_odometry(now, np.asarray(measured.pose, np.float64), robot[[3, 3, 4]] * [1, 0, 1])
        if bool(measured.is_scan_due) and not bool(measured.is_blind):
            scan = Scan(*measured.scans[0])
            beams = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            ends = np.asarray(scan.ranges)[:, None] * beams
            pilot.add_scan(now, scan, ends[np.asarray(scan.is_return)])
        told.append(pilot.command(now))
        pilot.update_belief(now)
        is_trusted = stops[-1] in (GOOD, MISFIT, BLIND)
        if not is_trusted:
            mapper.distrust()
        pose = np.asarray(measured.pose, np.float64)
        if bool(measured.is_scan_due) and not bool(measured.is_blind) and is_trusted:
            mapper.add(now, Scan(*measured.scans[0]), pose, now)
            mapper.map_scan(scenario.perception)
        if bool(measured.are_fields_due) and is_trusted:
            # A pilot counts from one update to the next, a simulation in control periods.
            fields += 1
            period = float(scenario.rates.since_fields)
            assert mapper.update_fields(scenario.perception, fields * period, pose) is not None
        if bool(measured.is_scan_due):
            known.append((now, state.task.belief, mapper.belief, mapper.is_misfit))
    return np.array(stops), known, told, np.array(commands)


def test_the_drive_has_all_that_can_go_wrong(drives) -> None:
    stops, known, *_ = drives
    assert set(stops.tolist()) == {GOOD, FROZEN, JUMPED, BLIND, MISFIT}
    misfits = [time for time, *_, is_misfit in known if is_misfit]
    assert misfits
    assert min(misfits) > WALLS - 0.2
    # After a while the walls are in the map.
    assert not known[-1][-1]


def test_both_stop_for_the_same_reasons_at_the_same_times(drives) -> None:
    stops, _, told, _ = drives
    begins = {GOOD: "", JUMPED: "the pose jumped by", BLIND: "the scan is "}
    for number, (code, command) in enumerate(zip(stops.tolist(), told, strict=True)):
        assert command.reason.startswith(begins.get(code, REASONS[code])), (number, code, command)
        assert (command.reason == "") == (code == GOOD), (number, code, command)


def test_both_command_the_same_but_for_rounding_where_neither_is_stopped(drives) -> None:
    stops, _, told, commands = drives
    twists = np.array([each.twist for each in told])[:, [0, 2]]
    np.testing.assert_allclose(twists[stops == GOOD], commands[stops == GOOD], atol=1e-7)


@pytest.mark.parametrize("name", ["grid", "clearance", "information", "guidance", "dwell"])
def test_both_believe_the_same_to_the_bit(drives, name) -> None:
    for time, one, other, _ in drives[1]:
        pairs = zip(*(jax.tree.leaves(getattr(each, name)) for each in (one, other)), strict=True)
        for loop, pilot in pairs:
            np.testing.assert_array_equal(np.asarray(loop), np.asarray(pilot), err_msg=f"{time}")
