"""What the guard expects of the robot, one period at a time; its closed loops are in
simulation/test_guard.py."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import Script

from jaxplore import DifferentialDrive, MotionGuard, Omnidirectional, Unicycle
from jaxplore.belief.belief import Belief
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.control.guard import PASSING, ScanPoints
from jaxplore.control.stops import FROZEN, GOOD
from jaxplore.costs import OcclusionCost
from jaxplore.robot.decision import Driver
from jaxplore.sensing.clusters import Edges

ROBOT = DifferentialDrive(max_speed=1.0)
PERIOD = jnp.asarray(0.05)
GUARD = MotionGuard(max_delay=4)
expect = eqx.filter_jit(
    lambda state, control: GUARD.advance(ROBOT, state, state.expected, control, PERIOD)
)
step = eqx.filter_jit(ROBOT.step)
COMMANDS = np.array([[0.1, -1.0], [0.3, 0.5], [-0.2, 1.5], [0.5, -0.4], [0.7, 0.9]], np.float32)
"""Sent before, the newest last."""
START = np.array([1.0, 2.0, 0.4, 0.6, 0.3], np.float32)


def after_commands(delay: int, stop: int):
    """The state of a guard to which a delay of so many periods explains the motion best."""
    state = GUARD.init(ROBOT, jnp.asarray(START))
    errors = np.ones(5, np.float32)
    errors[delay] = 0.0
    return state._replace(
        commands=jnp.asarray(COMMANDS),
        errors=jnp.asarray(errors),
        stops=state.stops._replace(code=jnp.asarray(stop, jnp.int32)),
    )


@pytest.mark.parametrize("delay", range(5))
def test_the_robot_moves_by_the_command_that_is_due(delay: int) -> None:
    """The command sent `delay` periods before the newest takes effect now."""
    after = expect(after_commands(delay, GOOD), jnp.zeros(2))
    wanted = np.asarray(step(jnp.asarray(START), jnp.asarray(COMMANDS[4 - delay]), PERIOD))
    np.testing.assert_array_equal(after.expected, wanted)
    turn = (wanted[:3] - START[:3]) / 0.05
    np.testing.assert_allclose(after.velocity, turn, atol=1e-4)
    others = [step(jnp.asarray(START), jnp.asarray(each), PERIOD) for each in COMMANDS]
    assert sum(np.array_equal(after.expected, each) for each in others) == 1


def test_a_stopped_robot_moves_by_its_braking() -> None:
    braking = jnp.asarray([-1.0, 0.2])
    after = expect(after_commands(2, FROZEN), braking)
    np.testing.assert_array_equal(after.expected, step(jnp.asarray(START), braking, PERIOD))


keep = eqx.filter_jit(
    lambda start, control, scan, age: GUARD.keep_clear(ROBOT, start, control, scan, age, PERIOD)
)


def test_a_command_is_kept_unless_the_robot_could_not_stand_in_time() -> None:
    start = jnp.asarray([0.0, 0.0, 0.0, 0.8, 0.0])
    go = jnp.asarray([0.5, 0.0])
    radius = float(ROBOT.radius)
    # It stands after 0.9 s and 0.36 m, in which somebody beside it walks 1.4 m.
    for x, y, speed, age, is_kept in (
        (0.0, radius + 2.3, 1.6, 0.0, True),
        (0.0, radius + 1.2, 1.6, 0.0, False),
        (0.0, radius + 2.3, 1.6, 0.7, False),
        (0.0, radius + 1.5, 0.5, 0.0, True),
        # A wall beside it, and one before it.
        (0.0, radius + 0.2, 0.0, 0.7, True),
        (radius + 0.45, 0.0, 0.0, 0.7, True),
        (radius + 0.33, 0.0, 0.0, 0.7, False),
    ):
        scan = ScanPoints.blank(3, 10.0)._replace(
            points=jnp.asarray([[9.0, 9.0], [x, -y], [0.0, 0.0]]),
            is_point=jnp.asarray([True, True, False]),
            speeds=jnp.asarray([1.6, speed, 1.6]),
        )
        checked = keep(start, go, scan, jnp.asarray(age))
        found = np.asarray(checked.control)
        assert bool(checked.is_replaced) != is_kept
        assert np.array_equal(found, go) == is_kept, (x, y, speed, age)
        if not is_kept:
            assert found[0] < -0.9
    # On hills, points say nothing of commands.
    hills = ScanPoints.blank(3, is_on_hills=True)
    assert GUARD.keep_clear(ROBOT, start, go, hills, jnp.zeros(()), PERIOD).control is go


def speed_near(distance: float) -> float:
    """The speed at which a robot of 1 m/s^2 stands in time, by bisection."""
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        needed = middle**2 / 2.0 + 1.6 * (0.2 + middle)
        low, high = (middle, high) if needed <= distance else (low, middle)
    return max(low, PASSING)


MODELS = {
    "wheels": (ROBOT, [0.0, 0.0, 0.3, 0.9, 0.2], [1.0, -0.5], 3),
    "velocity": (Unicycle(), [0.0, 0.0, 0.3], [0.9, 0.4], None),
    "omni": (Omnidirectional(), [0.0, 0.0, 0.3, 0.5, -0.6, 0.1], [0.4, -0.6, 0.3], (3, 4)),
}
"""A model, a state, a command, and which components of the state are its speed."""
SLOW = MotionGuard(occlusion=OcclusionCost())


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_a_command_is_slower_where_somebody_can_be_hidden(name: str) -> None:
    """The command is the one between it and braking that brakes least, of a thousand tried."""
    robot, state, command, speeds = MODELS[name]
    start, control = jnp.asarray(state), jnp.asarray(command)

    @eqx.filter_jit
    def both(edges):
        slower = SLOW.slow_down(robot, start, control, edges, PERIOD)
        shares = jnp.linspace(0.0, 1.0, 1001)[:, None]
        tried = control + shares * (robot.stopping_control(start, PERIOD) - control)
        return slower, tried, jax.vmap(lambda each: robot.step(start, each, PERIOD))(tried)

    for distance, is_there in ((0.4, True), (1.6, True), (2.2, True), (9.0, True), (0.4, False)):
        place = [[0.0, distance + float(robot.radius)], [30.0, 0.0]]
        edges = Edges(jnp.asarray(place), jnp.asarray([is_there, True]))
        slower, tried, after = (np.asarray(each) for each in both(edges))
        speed = np.abs(tried[:, 0]) if speeds is None else after[:, speeds]
        speed = np.hypot(*speed.T) if speed.ndim > 1 else speed
        gone = float(np.hypot(*(after[0, :2] - place[0])) - robot.radius)
        is_slow = speed <= speed_near(gone if is_there else 25.0) + 1e-4
        best = tried[np.argmax(is_slow)] if is_slow.any() else tried[-1]
        np.testing.assert_allclose(slower, best, atol=3e-3)
        assert not np.array_equal(slower, command) or is_slow[0]


def test_a_command_stays_where_nobody_is_expected_or_it_is_not_finite() -> None:
    start, go = jnp.asarray([0.0, 0.0, 0.0, 1.0, 0.0]), jnp.asarray([0.5, 0.0])
    edges = Edges(jnp.asarray([[0.5, 0.0]]), jnp.asarray([True]))
    assert GUARD.slow_down(ROBOT, start, go, edges, PERIOD) is go
    assert SLOW.slow_down(ROBOT, start, go, None, PERIOD) is go
    none = jnp.asarray([jnp.nan, 0.0])
    assert not jnp.isfinite(SLOW.slow_down(ROBOT, start, none, edges, PERIOD)).all()
    lost = jnp.full(5, jnp.nan)
    np.testing.assert_array_equal(SLOW.slow_down(ROBOT, lost, go, edges, PERIOD), go)
    # A robot that stands does not move by itself, and one may start.
    rest = jnp.zeros(5)
    np.testing.assert_array_equal(SLOW.slow_down(ROBOT, rest, jnp.zeros(2), edges, PERIOD), 0.0)
    np.testing.assert_array_equal(SLOW.slow_down(ROBOT, rest, go, edges, PERIOD), go)


@pytest.mark.long
def test_the_edges_of_the_belief_slow_the_command_of_a_controller() -> None:
    start = jnp.asarray([0.0, 0.0, 0.0, 0.9, 0.0])
    edges = Edges(jnp.full((8, 2), 0.7), jnp.arange(8) == 0)
    tracks = ObstacleTracker(2).init()
    ahead = Script(jnp.asarray([[1.0, 0.0]]))
    args = ScanPoints.blank(3), jnp.zeros(()), jax.random.key(0)
    for guard, belief, wanted in (
        (SLOW, Belief(tracks=tracks._replace(edges=edges)), -1.0),
        (SLOW, Belief(tracks=tracks), 1.0),
        (SLOW, Belief(), 1.0),
        (GUARD, Belief(tracks=tracks._replace(edges=edges)), 1.0),
    ):
        driver = Driver(ROBOT, ahead, guard, PERIOD)
        checked, _, _ = eqx.filter_jit(driver.plan)(ahead.init(), start, belief, *args)
        assert float(checked.control[0]) == pytest.approx(wanted, abs=1e-5)
