"""The guard in the closed loop: 4 s at 20 Hz, with a controller that drives until it is told that
the wall is near. All guarded runs are one compiled program."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    DifferentialDrive,
    ExplorationScenario,
    Faults,
    InverseSensorModel,
    Lidar,
    MotionGuard,
    OccupancyGrid,
    Perception,
    Variation,
)
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.plausibility import MAX_AGE
from jaxplore.control.stops import BLIND, FROZEN, GOOD, LOST, MISFIT, REASONS
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

STEPS, PERIOD = 80, 0.05
WORLD = np.zeros((30, 40), np.float32)
WORLD[0], WORLD[-1], WORLD[:, 0], WORLD[:, -1] = 1.0, 1.0, 1.0, 1.0
ROBOT = DifferentialDrive(max_speed=1.0)
LIDAR = Lidar(72, 2.0, range_noise=0.0)
BRAKE_AT = 2.9
"""Position at which the controller brakes [m]; the wall is at 3.9 m, the robot's radius 0.2 m."""


NO_WALLS = {"walls": np.zeros(WORLD.shape, bool), "walls_from": 100.0}
RING = np.zeros(WORLD.shape, bool)
RING[5:26, 4:26] = True
RING[6:25, 5:25] = False  # closed walls around the robot


class ToTheWall(Controller):
    """Drives ahead in slight curves, brakes near the wall, and remembers what it was told."""

    brake_at: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(BRAKE_AT))

    def init(self):
        return jnp.zeros((), jnp.int32), jnp.zeros((STEPS, 5))

    def step(self, state, observation, belief=None, *, key):
        count, told = state
        _, _, yaw, _, turn = observation
        # The command differs in every step, as those of MPPI do.
        noise = jax.random.uniform(key, (2,), minval=-0.3, maxval=0.3)
        ahead = jnp.where(observation[0] < self.brake_at, 0.7, -1.0)
        command = jnp.clip(
            jnp.stack([ahead, -2.0 * yaw - 2.0 * turn]) + noise,
            ROBOT.control_min,
            ROBOT.control_max,
        )
        one = jnp.ones(())
        info = Info(command[None], one[None], one[None], one, jnp.array(True))
        return command, (count + 1, told.at[count].set(observation)), info

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50) -> SampledPlan:
        raise NotImplementedError

    def at_period(self, control_period):
        return self


class Watched(NamedTuple):
    """A run: records, true states (N + 1, 5), what the controller was told, its delay."""

    records: object
    robots: np.ndarray
    told: np.ndarray
    delay: int


def scenario(
    faults: Faults | None = None, variation: Variation | None = None
) -> ExplorationScenario:
    perception = Perception(
        LIDAR, 0.1, 0.2, sensor_model=InverseSensorModel.line_of_sight(), num_directions=4
    )
    made = ExplorationScenario(
        OccupancyGrid(WORLD, 0.1),
        ROBOT,
        LIDAR,
        (0.6, 1.5, 0.0),
        perception=perception,
        target="never",
        control_rate=20.0,
        sensing_rate=10.0,
        field_rate=5.0,
    )
    varied = Variation(control_delay=(0, 4)) if variation is None else variation
    failing = Faults(**NO_WALLS) if faults is None else faults
    return made.with_disturbances([varied, failing]).with_guard(MotionGuard())


def drive(
    task: ExplorationScenario, seed: int = 0, delay: int = 0, brake_at: float = BRAKE_AT
) -> Watched:
    controller, key = ToTheWall(jnp.asarray(brake_at)), jax.random.key(seed)
    state = initial_loop_state(controller, task, key)
    state = eqx.tree_at(
        lambda at: at.drawn["variation"].control_delay, state, jnp.asarray(delay, jnp.int32)
    )
    first = np.asarray(state.task.robot)[None]
    state, records, done = run_chunk(
        (controller, task, key, jnp.asarray(STEPS, jnp.int32)), copy_tree(state), STEPS
    )
    records = jax.tree.map(lambda leaf: np.asarray(leaf)[: int(done)], records)
    told = np.asarray(state.controller[1])
    return Watched(records, np.concatenate([first, records.state]), told, delay)


@pytest.fixture(scope="module")
def free() -> Watched:
    return drive(scenario())


def test_without_a_fault_it_stops_nothing(free) -> None:
    assert not free.records.stop.any()
    assert not free.records.is_collision.any()
    np.testing.assert_allclose(free.told, free.robots[:-1], atol=1e-6)
    assert free.robots[-1, 0] > BRAKE_AT


def test_without_scans_it_brakes_as_on_a_robot_and_goes_on_with_them(free) -> None:
    found = drive(scenario(Faults(scan_dropout=(1.0, 3.0), **NO_WALLS)))
    stops = found.records.stop
    first, last = np.flatnonzero(stops)[[0, -1]]
    # The last scan was at 0.9 s.
    assert 0.9 + MAX_AGE < first * PERIOD + 1e-6 <= 0.9 + MAX_AGE + PERIOD + 1e-3
    assert (stops[first : last + 1] == BLIND).all()
    assert REASONS[BLIND] == "the scan is old"
    # The first scan after the dropout is at 3.0 s, and ends the stop in its own period.
    assert last * PERIOD == pytest.approx(3.0 - PERIOD)
    speeds = found.robots[:, 3]
    assert speeds[first] > 0.5
    braking = round(speeds[first] / 1.0 / PERIOD) + 1
    assert (speeds[first + braking : last] < 1e-6).all()
    np.testing.assert_array_equal(found.robots[: first + 1], free.robots[: first + 1])
    assert speeds[-1] > 0.3
    assert not found.records.is_collision.any()


@pytest.mark.parametrize(
    ("fault", "code", "within"),
    [("frozen_odometry", FROZEN, 0.3), ("lost_odometry", LOST, 1e-3)],
)
@pytest.mark.parametrize("begin", [1.5, 2.0])
def test_without_a_pose_it_brakes_to_rest_and_says_why(free, fault, code, within, begin) -> None:
    found = drive(scenario(Faults(**{fault: (begin, 10.0)}, **NO_WALLS)))
    stops = found.records.stop
    first = int(np.flatnonzero(stops)[0])
    assert begin - 1e-3 <= first * PERIOD <= begin + within
    # A robot that stands tries again after two seconds if its scan fits, and is stopped again.
    assert (stops[first : first + 38] == code).all()
    assert REASONS[code]
    assert not found.records.is_collision.any()
    # It brakes as hard as it can: at 1 m/s^2 and by the drag.
    speed = found.robots[:, 3]
    assert (np.diff(speed[first : first + 5]) < -0.9 * PERIOD).all()
    np.testing.assert_allclose(found.robots[first + 38, 3:], 0.0, atol=1e-3)
    # The map is that of before: nothing is mapped without a pose.
    coverage = found.records.coverage[first : first + 38]
    np.testing.assert_array_equal(coverage, coverage[0])


def blind_guard() -> MotionGuard:
    """A guard that never finds that the odometry is frozen, and checks no command."""
    guard = MotionGuard(max_frozen=100.0)
    return eqx.tree_at(lambda each: each.check.margin, guard, jnp.asarray(-100.0, jnp.float32))


def test_without_a_guard_it_runs_into_the_wall() -> None:
    task = scenario(Faults(frozen_odometry=(1.5, 10.0), **NO_WALLS)).with_guard(blind_guard())
    found = drive(task)
    assert not (found.records.stop == FROZEN).any()
    assert found.records.is_collision.any()


def test_a_controller_that_does_not_brake_is_kept_from_the_wall() -> None:
    free = drive(scenario().with_guard(blind_guard()), brake_at=100.0)
    assert free.records.is_collision.any()
    kept = drive(scenario(), brake_at=100.0)
    assert not kept.records.is_collision.any()
    assert not kept.records.stop.any()
    # It comes as near as it can stop: the rest is the margin and what one period is long.
    last = kept.robots[-1, 0] + float(ROBOT.radius)
    assert 3.9 - 0.2 < last < 3.9


def test_it_goes_on_when_the_pose_is_back() -> None:
    for fault in ("frozen_odometry", "lost_odometry"):
        found = drive(scenario(Faults(**{fault: (0.8, 1.6)}, **NO_WALLS)))
        after = np.arange(STEPS) * PERIOD > 1.75
        assert found.records.stop.any()
        assert not found.records.stop[after].any()
        assert found.robots[-1, 0] > found.robots[36, 0] + 0.3
        assert not found.records.is_collision.any()


def test_scans_that_do_not_fit_stop_it_until_they_are_taken_for_a_changed_world() -> None:
    found = drive(scenario(Faults(walls=RING, walls_from=0.9)))
    stops = found.records.stop
    first, last = np.flatnonzero(stops)[[0, -1]]
    assert 0.9 <= first * PERIOD <= 1.2
    assert (stops[first : last + 1] == MISFIT).all()
    assert 2.0 <= (last - first) * PERIOD <= 2.5
    assert not found.records.is_collision[: last + 1].any()
    np.testing.assert_allclose(found.robots[last, 3:], 0.0, atol=1e-3)


@pytest.mark.parametrize("delay", [0, 2, 4])
def test_it_finds_the_delay_and_plans_from_where_the_command_takes_effect(delay) -> None:
    found = drive(scenario(), seed=delay, delay=delay)
    assert not found.records.stop.any()
    assert not found.records.is_collision.any()
    # From the third of a second on: the state that the controller is told is the later one.
    steps = np.arange(20, STEPS - delay)
    np.testing.assert_allclose(found.told[steps], found.robots[steps + delay], atol=1e-4)


def test_ordinary_errors_are_no_fault() -> None:
    """Slip, gains, noise of commands and of the pose, and the delays of the other tests."""
    errors = Variation(
        gain=(0.8, 1.2),
        slip=(0.0, 0.2),
        turn_slip=(0.0, 0.2),
        control_noise=(0.0, 0.1),
        position_noise=(0.0, 0.02),
        heading_noise=(0.0, 0.02),
        control_delay=(0, 4),
    )
    for seed in range(8):
        found = drive(scenario(variation=errors), seed=seed, delay=seed % 3)
        np.testing.assert_array_equal(found.records.stop, GOOD)


def test_a_robot_that_slips_gets_less_far() -> None:
    slips = Variation(slip=(0.3, 0.3), control_delay=(0, 4))
    found = drive(scenario(variation=slips))
    ways = np.hypot(*np.diff(found.robots[:, :2], axis=0).T)
    assert ways.sum() > 0.5
    # The integrator is Euler's: a step goes as far as the speed at its beginning says.
    speeds = np.abs(found.robots[:-1, 3])
    np.testing.assert_allclose(ways, 0.7 * PERIOD * speeds, atol=1e-6)


def test_nothing_compiles_again() -> None:
    drive(scenario())
    before = run_chunk._cached._cache_size()
    drive(scenario(Faults(lost_odometry=(0.1, 0.2), **NO_WALLS)), seed=7, delay=1)
    task = scenario().with_guard(MotionGuard(max_frozen=0.2))
    drive(task)
    assert run_chunk._cached._cache_size() == before
