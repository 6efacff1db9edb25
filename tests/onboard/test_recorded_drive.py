"""One recorded drive, given to the robot inside the closed loop of a simulation and to the mapper
of a pilot: both know the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.onboard.conftest import ROBOT, rooms, scenario_in

from jaxplore import Faults, MotionGuard, OccupancyGrid
from jaxplore.control.base import Controller, Info
from jaxplore.control.guard import BLIND, FROZEN, GOOD, JUMPED, MISFIT
from jaxplore.onboard.log import DriveLog
from jaxplore.onboard.mapper import Mapper
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
        noise = jax.random.uniform(key, (2,), minval=-0.1, maxval=0.1)
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
    return np.array(stops), known


def test_the_drive_has_all_that_can_go_wrong(drives) -> None:
    stops, known = drives
    assert set(stops.tolist()) == {GOOD, FROZEN, JUMPED, BLIND, MISFIT}
    misfits = [time for time, *_, is_misfit in known if is_misfit]
    assert misfits
    assert min(misfits) > WALLS - 0.2
    # After a while the walls are in the map.
    assert not known[-1][-1]


@pytest.mark.parametrize("name", ["grid", "clearance", "information", "guidance", "dwell"])
def test_both_believe_the_same_to_the_bit(drives, name) -> None:
    for time, one, other, _ in drives[1]:
        pairs = zip(*(jax.tree.leaves(getattr(each, name)) for each in (one, other)), strict=True)
        for loop, pilot in pairs:
            np.testing.assert_array_equal(np.asarray(loop), np.asarray(pilot), err_msg=f"{time}")
