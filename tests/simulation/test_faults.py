"""Faults, mostly in the closed loop with a controller that knows its commands beforehand: 3 s at
20 Hz, scans at every second step, fields at every fourth."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import kinds
from tests.kinds import FORWARD, HALL, NO_WALLS, Script, Yard, hall

from jaxplore import ExplorationScenario, Faults, Lidar
from jaxplore.control.base import Controller
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.simulation.run import record_run
from jaxplore.simulation.state import LoopState

pytestmark = pytest.mark.long

PERIOD, CHUNK = 0.05, kinds.HALL_CHUNK
WORLD, ROBOT = HALL, kinds.WALKER
UNKNOWN = np.full(HALL.shape, 0.5, np.float32)
RATES = {"control_rate": 20.0, "sensing_rate": 10.0, "field_rate": 5.0}
BARRIER = np.zeros(WORLD.shape, bool)
BARRIER[1:-1, 22:24] = True  # x from 2.2 to 2.4 m


class Run(NamedTuple):
    """A run step by step: N + 1 states of the loop, N records, what the controller was told."""

    states: list[LoopState]
    records: ExplorationRecord
    told: np.ndarray

    @property
    def robots(self) -> np.ndarray:
        return np.stack([state.task.robot for state in self.states])

    @property
    def maps(self) -> np.ndarray:
        return np.stack([state.task.belief.grid.unpad().probability for state in self.states])


def make(faults: Faults | None = NO_WALLS, x: float = 0.6, **more) -> ExplorationScenario:
    """Return a hall of which nothing is known, and that is never finished."""
    if faults is not None and faults.walls is None:
        faults = eqx.tree_at(
            lambda each: each.walls, faults, NO_WALLS.walls, is_leaf=lambda leaf: leaf is None
        )
    given = {"ends": {"max_unknown": 0.0}, "target_coverage": 1.0, **more}
    return hall(UNKNOWN, faults=faults, start=(x, 1.5, 0.0), **given)


def run(
    scenario: ExplorationScenario,
    commands: np.ndarray = FORWARD,
    controller: Controller | None = None,
    seed=0,
    capacity: int = CHUNK,
) -> Run:
    controller = Script(jnp.asarray(commands)) if controller is None else controller
    state, key = initial_loop_state(controller, scenario), jax.random.key(seed)
    states, rows, one = [jax.tree.map(np.asarray, state)], [], jnp.asarray(1, jnp.int32)
    for _ in range(60):
        state, records, _ = run_chunk((controller, scenario, key, one), copy_tree(state), capacity)
        states.append(jax.tree.map(np.asarray, state))
        rows.append(jax.tree.map(lambda leaf: np.asarray(leaf)[0], records))
    told = states[-1].controller[1] if isinstance(controller, Script) else np.zeros(0)
    return Run(states, jax.tree.map(lambda *parts: np.stack(parts), *rows), told)


def differs(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which rows of two stacks of maps differ anywhere."""
    return (a != b).reshape(len(a), -1).any(axis=1)


def during(begin: int, end: int) -> np.ndarray:
    """Which of the 60 steps are from one up to another."""
    return (np.arange(60) >= begin) & (np.arange(60) < end)


def wandering(seed: int) -> np.ndarray:
    """Commands that differ in every step."""
    return np.random.default_rng(seed).uniform([-0.5, -1.0], [1.0, 1.0], (60, 2)).astype(np.float32)


@pytest.fixture
def small_experiment(request):
    """Return the maker of the other files, whose name is taken here."""
    return request.getfixturevalue("make")


@pytest.fixture(scope="module")
def flawless() -> Run:
    return run(make())


def test_no_faults_are_the_same_as_none_to_the_bit(flawless) -> None:
    without = run(make(None))
    for a, b in zip(jax.tree.leaves(without), jax.tree.leaves(flawless), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not flawless.records.is_faulty.any()
    np.testing.assert_array_equal(flawless.told, flawless.robots[:-1])
    np.testing.assert_array_equal(flawless.records.control, FORWARD)


def test_without_scans_the_map_stays_until_they_return(flawless) -> None:
    blind = run(make(Faults(scan_dropout=(0.5, 1.0))))
    grows = differs(blind.maps[1:], blind.maps[:-1])
    normal = differs(flawless.maps[1:], flawless.maps[:-1])
    assert not grows[10:20].any()
    assert normal[10:20].any()  # as it would have otherwise
    assert grows[20]
    np.testing.assert_array_equal(blind.maps[:11], flawless.maps[:11])
    np.testing.assert_array_equal(blind.records.unknown[10:20], blind.records.unknown[9])
    np.testing.assert_array_equal(blind.records.is_faulty, during(10, 20))
    # The robot knows where it is all the while.
    np.testing.assert_array_equal(blind.told, blind.robots[:-1])
    np.testing.assert_array_equal(blind.robots, flawless.robots)


def test_without_odometry_the_controller_is_told_so_and_the_run_goes_on(flawless) -> None:
    lost = run(make(Faults(lost_odometry=(0.5, 1.0))))
    assert np.isnan(lost.told[10:20]).all()
    np.testing.assert_array_equal(lost.told[~during(10, 20)], lost.robots[:-1][~during(10, 20)])
    np.testing.assert_array_equal(lost.robots, flawless.robots)  # it does not look
    np.testing.assert_array_equal(lost.records.is_faulty, during(10, 20))
    # Without a place for it, no scan and no field touches what is known.
    for state in lost.states[11:21]:
        for a, b in zip(
            jax.tree.leaves(state.task.belief),
            jax.tree.leaves(lost.states[10].task.belief),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)
    assert differs(lost.maps[20:22], lost.maps[19:21])[1]
    for leaf in jax.tree.leaves((lost.states[1:], lost.records)):
        assert leaf.shape == (60, 5) or np.isfinite(leaf).all()  # but for the controller's memory


def test_lost_from_the_very_beginning() -> None:
    lost = run(make(Faults(lost_odometry=(0.0, 0.2), frozen_odometry=(0.0, 0.4))))
    assert np.isnan(lost.told[:4]).all()
    np.testing.assert_array_equal(lost.told[4:8], np.tile(lost.robots[0], (4, 1)))
    np.testing.assert_array_equal(lost.maps[4], lost.maps[0])


def test_frozen_odometry_is_what_was_told_last(flawless) -> None:
    frozen = run(make(Faults(frozen_odometry=(0.5, 1.0))))
    np.testing.assert_array_equal(frozen.told[10:20], np.tile(frozen.told[10], (10, 1)))
    assert np.abs(frozen.told[10] - frozen.robots[10]).max() <= 0.06  # within a step of motion
    np.testing.assert_array_equal(frozen.told[~during(10, 20)], flawless.told[~during(10, 20)])
    np.testing.assert_array_equal(frozen.records.is_faulty, during(10, 20))
    np.testing.assert_array_equal(frozen.robots, flawless.robots)


def test_frozen_odometry_is_the_state_at_which_it_began() -> None:
    frozen = run(make(Faults(frozen_odometry=(0.5, 1.0))))
    np.testing.assert_array_equal(frozen.told[10:20], np.tile(frozen.robots[10], (10, 1)))


def test_frozen_odometry_of_a_robot_that_stands_is_a_fault_too() -> None:
    frozen = run(make(Faults(frozen_odometry=(0.5, 1.0))), 0.0 * FORWARD)
    np.testing.assert_array_equal(frozen.records.is_faulty, during(10, 20))


def test_odometry_that_freezes_while_it_is_lost_is_the_last_one_known() -> None:
    faults = Faults(lost_odometry=(0.5, 1.0), frozen_odometry=(0.8, 1.5))
    both = run(make(faults))
    assert np.isnan(both.told[10:20]).all()
    np.testing.assert_array_equal(both.told[20:30], np.tile(both.robots[9], (10, 1)))
    np.testing.assert_array_equal(both.told[30:], both.robots[30:-1])
    np.testing.assert_array_equal(both.records.is_faulty, during(10, 30))


def test_odometry_that_is_lost_while_it_is_frozen_comes_back_frozen() -> None:
    faults = Faults(frozen_odometry=(0.5, 1.5), lost_odometry=(0.8, 1.0))
    both = run(make(faults))
    assert np.isnan(both.told[16:20]).all()
    np.testing.assert_array_equal(both.told[20:30], np.tile(both.told[10], (10, 1)))


def test_a_map_made_with_frozen_odometry_is_out_of_place() -> None:
    """The robot closes in on the wall at x = 3.9 while it takes itself to be farther away."""
    frozen = run(make(Faults(frozen_odometry=(1.5, 2.0)), x=2.0))
    good = run(make(x=2.0))
    behind, gone = frozen.told[30][0], frozen.robots[38][0]  # the last scan of the fault
    ghosts = (frozen.maps[40] > 0.65) & (WORLD < 0.5)
    assert not ((good.maps[40] > 0.65) & (WORLD < 0.5)).any()
    straight = np.flatnonzero(ghosts[15])  # ahead of the robot
    assert 0.1 * straight.min() == pytest.approx(3.9 - (gone - behind), abs=0.11)


@pytest.fixture(scope="module")
def late():
    """Return commands, and a run in a yard with them, three periods late."""
    commands, yard = wandering(0), Yard(ROBOT, disturbed_by=(Faults(control_delay=3),))
    controller, key = Script(jnp.asarray(commands)), jax.random.key(0)
    begin = initial_loop_state(controller, yard)
    count = jnp.asarray(60, jnp.int32)
    state, (robots, told), _ = run_chunk((controller, yard, key, count), copy_tree(begin), 60)
    return commands, begin, state, np.asarray(robots), np.asarray(told)


def test_commands_come_late_and_in_order(late) -> None:
    commands, begin, state, robots, told = late
    np.testing.assert_array_equal(begin.pending, np.zeros((3, 2)))
    before = np.concatenate([begin.task.robot[None], robots[:-1]])
    controls = np.concatenate([np.zeros((3, 2), np.float32), commands[:-3]])
    step = jax.jit(jax.vmap(ROBOT.step, in_axes=(0, 0, None)))
    np.testing.assert_allclose(robots, step(before, controls, jnp.asarray(PERIOD)), atol=1e-6)
    # They are under way all the while, and nothing is lost of what the controller is told.
    np.testing.assert_array_equal(state.pending, commands[-3:])
    np.testing.assert_array_equal(told, before)
    assert not Faults(control_delay=3).is_active(jnp.asarray(0.05))


def test_until_commands_arrive_there_is_the_default_one(late) -> None:
    idle = jnp.asarray([0.25, -2.0])  # no control is the least one
    robot = eqx.tree_at(lambda each: each.control_min, ROBOT, idle)
    state = initial_loop_state(
        Script(jnp.asarray(late[0])), Yard(robot, disturbed_by=(Faults(control_delay=3),))
    )
    np.testing.assert_array_equal(state.pending, [[0.25, 0.0]] * 3)


@pytest.fixture(scope="module")
def walled() -> Run:
    """The robot drives towards a wall that is there from 1 s on."""
    return run(make(Faults(walls=BARRIER, walls_from=1.0), x=1.2))


def test_walls_appear_and_are_solid_seen_and_mapped(walled) -> None:
    in_sight = np.zeros_like(BARRIER)
    in_sight[13:17, 22] = True  # what is ahead
    before, after = walled.maps[20][in_sight], walled.maps[60][in_sight]
    np.testing.assert_allclose(before, 0.01, rtol=1e-5)
    np.testing.assert_allclose(after, 0.99, rtol=1e-5)
    np.testing.assert_allclose(walled.maps[21][15, 22], 0.99, rtol=1e-5)  # by the very next scan
    # Nothing is learned of what is behind any more.
    np.testing.assert_array_equal(walled.maps[60][:, 24:], walled.maps[20][:, 24:])
    assert not walled.records.is_collision[:20].any()
    assert walled.records.is_collision.any()
    gap = 2.2 - 0.2 - walled.records.state[:, 0]
    assert gap.min() >= -1e-4
    assert gap[19] < 0.4
    assert (walled.records.clearance[:20] >= 0.5).all()
    np.testing.assert_allclose(walled.records.clearance[20:], gap[20:], atol=1e-4)


def test_before_they_appear_walls_are_not_there(walled) -> None:
    never = run(make(Faults(walls=BARRIER, walls_from=100.0), x=1.2))
    np.testing.assert_array_equal(never.maps[:21], walled.maps[:21])
    assert never.robots[-1, 0] > 2.5
    assert not never.records.is_collision.any()
    assert not (never.maps[-1][BARRIER] > 0.65).any()


def test_a_look_at_the_run_shows_the_walls_that_appeared() -> None:
    scenario = make(Faults(walls=BARRIER, walls_from=0.0), x=1.6)
    recording = record_run(Script(jnp.asarray(FORWARD)), scenario, 1, key=jax.random.key(0))
    assert recording.frames[-1].scan[:, 0].max() <= 2.2 + 1e-3


def test_the_same_key_gives_the_same_run_and_times_do_not_compile_again(walled) -> None:
    noisy = Lidar(72, 1.0, range_noise=0.03)
    faults = Faults(walls=BARRIER, walls_from=0.5, scan_dropout=(0.2, 0.4))
    before = run_chunk._cached._cache_size()
    first, second = (run(make(faults, lidar=noisy), wandering(1), seed=4) for _ in range(2))
    other = run(make(faults, lidar=noisy), wandering(1), seed=5)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first.maps[-1], other.maps[-1])
    later = Faults(
        walls=BARRIER[::-1, ::-1],
        walls_from=0.7,
        scan_dropout=(0.1, 0.3),
        lost_odometry=(1.0, 1.1),
        frozen_odometry=(1.2, 1.3),
    )
    run(make(later))
    assert run_chunk._cached._cache_size() == before


def test_mppi_keeps_its_head_while_it_is_lost(small_experiment) -> None:
    mppi, scenario = small_experiment(rates=RATES, faults=Faults(lost_odometry=(0.5, 1.0)))
    lost = run(scenario, controller=mppi.at_period(PERIOD), capacity=25)
    records = lost.records
    assert np.isfinite(records.control).all()
    assert (records.control >= ROBOT.control_min).all()
    assert (records.control <= ROBOT.control_max).all()
    np.testing.assert_array_equal(records.is_finite, ~during(10, 20))
    np.testing.assert_array_equal(records.effective_sample_size == 0.0, during(10, 20))
    np.testing.assert_array_equal(records.is_faulty, during(10, 20))
    np.testing.assert_array_equal(lost.maps[11:21], lost.maps[10:20])
    for leaf in jax.tree.leaves(lost.states):
        assert np.isfinite(leaf).all()
    is_free = np.asarray(scenario.world.probability) < 0.5
    assert lost.maps[-1][is_free].min() < lost.maps[20][is_free].max()


@pytest.mark.parametrize("period", [0.02, 0.05, 1.0 / 30.0, 0.1])
def test_a_fault_lasts_from_its_beginning_up_to_its_end(period: float) -> None:
    """Times are products in single precision, also an hour later."""
    steps = np.arange(0, int(3600 / period), 7)
    times = jnp.float32(period) * jnp.asarray(steps, jnp.float32)
    for begin, end in ((0, 7), (70, 700), (7000, 7007), (int(steps[-30]), int(steps[-10]))):
        faults = Faults(scan_dropout=(begin * period, end * period))
        found = jax.vmap(faults.is_blind)(times)
        np.testing.assert_array_equal(found, (steps >= begin) & (steps < end))


def test_what_is_told() -> None:
    faults = Faults(lost_odometry=(1.0, 2.0), frozen_odometry=(1.5, 3.0))
    state, last = jnp.arange(5.0), jnp.arange(5.0) + 10.0
    for time, expected in ((0.5, state), (1.0, np.nan), (1.7, np.nan), (2.0, last), (3.0, state)):
        now = jnp.asarray(time), jnp.asarray(0.1), jax.random.key(0)
        told = faults.observe(ROBOT, state, last, None, *now)
        np.testing.assert_array_equal(told, jnp.broadcast_to(jnp.asarray(expected), 5))


@pytest.mark.parametrize(
    ("argument", "value", "accepted"),
    [
        ("scan_dropout", (1.0, 0.5), "beginning and end"),
        ("frozen_odometry", (1.0,), "2 finite numbers"),
    ],
)
def test_bad_faults_are_named(argument: str, value, accepted: str) -> None:
    with pytest.raises(ValueError, match=f"{argument} is .*; accepted: {accepted}"):
        Faults(**{argument: value})


@pytest.mark.parametrize("walls", [np.zeros((3, 4)), np.zeros((3, 4), int), np.zeros(4, bool)])
def test_bad_walls_are_named(walls: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"walls has type .* and shape .*; accepted: \(H, W\)"):
        Faults(walls=walls)


def test_traced_times_pass() -> None:
    begin, blind = jax.jit(lambda t: (Faults(scan_dropout=t).scan_dropout[0], t[1]))(
        jnp.asarray([2.0, 1.0])
    )
    assert (float(begin), float(blind)) == (2.0, 1.0)
