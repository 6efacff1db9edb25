"""The check that the robot can stop after a command."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Ackermann, DifferentialDrive, Unicycle
from jaxplore.control.validation import StopCheck

pytestmark = pytest.mark.long

ROBOT = DifferentialDrive(max_speed=1.0, max_acceleration=1.0, drag=0.0, radius=0.2)
CHECK = StopCheck(margin=0.05)
PERIOD = jnp.array(0.1)
NUM = 40


@eqx.filter_jit
def checked(check, robot, states, controls, points, is_point):
    def one(state, control, point, is_it):
        return check(robot, state, control, PERIOD, point, is_it)

    return jax.vmap(one)(states, controls, points, is_point)


stepped = eqx.filter_jit(lambda robot, state, control: robot.step(state, control, PERIOD))


def least_gap(state, control, points, turn=0.0) -> float:
    """Distance of the robot's edge while it executes a control for a period and brakes with a
    turn, float64."""
    x, y, yaw, v, omega = (float(each) for each in state)
    gap = np.inf
    dt = 1e-3

    def look() -> None:
        nonlocal gap
        if len(points):
            gap = min(gap, float(np.hypot(*(points - [x, y]).T).min()) - 0.2)

    look()
    for k in range(4000):
        if k * dt < 0.1 - 1e-9:
            a, alpha = (float(each) for each in control)
        else:
            a = -min(1.0, v / dt)
            # The turn rate that can be braked together with the speed.
            wanted = turn * min(2.0, 2.0 * max(v - dt, 0.0))
            alpha = float(np.clip((wanted - omega) / dt, -2.0, 2.0))
        x, y = x + v * np.cos(yaw) * dt, y + v * np.sin(yaw) * dt
        yaw += omega * dt
        v = min(max(v + a * dt, 0.0), 1.0)
        omega = min(max(omega + alpha * dt, -2.0), 2.0)
        look()
        if v == 0.0 and omega == 0.0 and k * dt > 0.1:
            break
    return gap


def best_gap(state, control, points) -> float:
    """The greatest of these distances over the turns that the check tries."""
    turns = np.linspace(-1.0, 1.0, CHECK.num_turns)
    return max(least_gap(state, control, points, turn) for turn in turns)


def cases():
    rng = np.random.default_rng(4)
    states = np.stack(
        [
            *rng.uniform(-0.2, 0.2, (2, NUM)),
            rng.uniform(-3, 3, NUM),
            rng.uniform(0, 1, NUM),
            rng.uniform(-1.5, 1.5, NUM),
        ],
        axis=-1,
    )
    controls = rng.uniform([-1, -2], [1, 2], (NUM, 2))
    angles, away = rng.uniform(-np.pi, np.pi, (NUM, 12)), rng.uniform(0.35, 1.2, (NUM, 12))
    points = away[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    is_point = rng.random((NUM, 12)) < 0.5
    return (
        states.astype(np.float32),
        controls.astype(np.float32),
        points.astype(np.float32),
        is_point,
    )


def test_a_command_is_replaced_exactly_where_the_robot_could_not_stop_in_time() -> None:
    states, controls, points, is_point = cases()
    found = checked(CHECK, ROBOT, states, controls, points, is_point)
    number = 0
    for k in range(NUM):
        gap = best_gap(states[k], controls[k], points[k][is_point[k]])
        # Half a time step of braking from full speed is 2.5 cm.
        if abs(gap - 0.05) < 0.03:
            continue
        number += 1
        assert bool(found.is_replaced[k]) == (gap < 0.05), k
        if gap >= 0.05:
            np.testing.assert_array_equal(found.control[k], controls[k])
            # That of braking straight, where that is enough.
            straight = least_gap(states[k], controls[k], points[k][is_point[k]])
            told = [each for each in (straight, gap) if each > 0.02]
            assert any(float(found.gap[k]) == pytest.approx(each, abs=0.06) for each in told)
    assert number > 20
    assert 5 < int(found.is_replaced.sum()) < NUM - 5


def test_a_replacement_brakes_and_keeps_at_least_the_distance_of_braking_straight() -> None:
    states, controls, points, is_point = cases()
    found = checked(CHECK, ROBOT, states, controls, points, is_point)
    for k in np.flatnonzero(np.asarray(found.is_replaced)):
        v = states[k, 3]
        assert float(found.control[k, 0]) == pytest.approx(-min(1.0, v / 0.1), abs=1e-4)
        stop = np.array([-min(1.0, v / 0.1), np.clip(-states[k, 4] / 0.1, -2, 2)])
        straight = least_gap(states[k], stop, points[k][is_point[k]])
        assert float(found.gap[k]) > straight - 0.04


def test_a_wall_ahead_stops_a_fast_robot_at_its_braking_distance() -> None:
    # As many points as in the other tests, and no other program: the last is none.
    wall = np.stack([np.full(12, 1.0), np.linspace(-1, 1.2, 12)], axis=-1).astype(np.float32)
    points, is_point = np.repeat(wall[None], NUM, 0), np.tile(np.arange(12) < 11, (NUM, 1))
    x = np.linspace(-0.4, 0.6, NUM)
    states = np.zeros((NUM, 5), np.float32)
    states[:, 0], states[:, 3] = x, 1.0
    controls = np.zeros((NUM, 2), np.float32)
    found = checked(CHECK, ROBOT, states, controls, points, is_point)
    # 0.1 m in the period, then v^2 / 2 a = 0.5 m; radius 0.2 m and margin 0.05 m.
    is_far = x + 0.1 + 0.5 + 0.25 < 1.0
    is_sure = np.abs(x + 0.85 - 1.0) > 0.04
    np.testing.assert_array_equal(~np.asarray(found.is_replaced)[is_sure], is_far[is_sure])


def test_a_robot_within_the_margin_may_drive_away_but_not_closer() -> None:
    points, is_point = np.zeros((NUM, 12, 2), np.float32), np.zeros((NUM, 12), bool)
    points[:, 0, 0], is_point[:, 0] = 0.22, True
    states = np.zeros((NUM, 5), np.float32)
    # Towards the point, and with the back to it.
    states[1, 2] = np.pi
    controls = np.array([[0.5, 0.0]] * NUM, np.float32)
    found = checked(CHECK, ROBOT, states, controls, points, is_point)
    assert np.asarray(found.is_replaced)[:2].tolist() == [True, False]


def test_a_command_that_is_not_finite_is_replaced_and_other_models_brake() -> None:
    nothing = np.zeros((NUM, 12, 2), np.float32), np.zeros((NUM, 12), bool)
    for robot, state in (
        (ROBOT, [0.0, 0.0, 0.0, 0.8, 0.0]),
        (Unicycle(), [0.0, 0.0, 0.0]),
        (Ackermann(max_speed=1.0), [0.0, 0.0, 0.0, 0.8, 0.1]),
    ):
        given = np.tile(np.float32(state), (NUM, 1))
        bad = np.full((NUM, robot.control_size), np.nan, np.float32)
        found = checked(CHECK, robot, given, bad, *nothing)
        assert bool(found.is_replaced[0])
        assert np.isfinite(np.asarray(found.control)).all()
        after = stepped(robot, given[0], np.asarray(found.control)[0])
        assert float(robot.speed(after)) <= float(robot.speed(jnp.asarray(given[0])))


def approached(age: float, speed: float, distances: np.ndarray):
    """Return the check of a robot at 0.8 m/s with something ahead that may move."""
    points = np.zeros((NUM, 12, 2), np.float32)
    points[:, 0, 0] = distances
    is_point = np.zeros((NUM, 12), bool)
    is_point[:, 0] = True
    state = np.tile(np.float32([0.0, 0.0, 0.0, 0.8, 0.0]), (NUM, 1))
    return growing(
        *(CHECK, ROBOT, state, np.zeros((NUM, 2), np.float32), points, is_point),
        *(np.full((NUM, 12), speed, np.float32), np.float32(age)),
    )


@eqx.filter_jit
def growing(check, robot, states, controls, points, is_point, speeds, age):
    def one(state, control, point, is_it, fast):
        return check(robot, state, control, PERIOD, point, is_it, fast, age)

    return jax.vmap(one)(states, controls, points, is_point, speeds)


def test_the_robot_stands_before_what_approaches_can_touch_it() -> None:
    # It drives 0.08 m in the period of the command, and 0.32 m in the 0.8 s in which it brakes.
    distances = np.linspace(0.5, 3.0, NUM)
    for age, speed in ((0.0, 0.0), (0.1, 1.6), (0.3, 0.5), (0.2, 2.0)):
        found = np.asarray(approached(age, speed, distances).is_replaced)
        needed = 0.2 + 0.05 + 0.08 + 0.32 + speed * (age + 0.1 + 0.8)
        # The time is rounded to steps of 0.05 s, and a little is driven within one.
        slack = 0.05 * (0.8 + speed) + 0.01
        assert found[distances < needed - slack].all(), (age, speed)
        assert not found[distances > needed + slack].any(), (age, speed)


def test_what_walks_into_a_robot_that_stands_stops_nothing() -> None:
    state = np.zeros((NUM, 5), np.float32)
    points = np.zeros((NUM, 12, 2), np.float32)
    points[:, 0, 0] = 0.4 + 0.05 * np.arange(NUM)
    is_point = np.zeros((NUM, 12), bool)
    is_point[:, 0] = True
    speeds, age = np.full((NUM, 12), 1.6, np.float32), np.float32(0.1)
    stay, go = np.zeros((NUM, 2), np.float32), np.tile(np.float32([1.0, 0.0]), (NUM, 1))
    stands = growing(CHECK, ROBOT, state, stay, points, is_point, speeds, age)
    starts = growing(CHECK, ROBOT, state, go, points, is_point, speeds, age)
    # Whatever is answered, the robot goes on standing.
    np.testing.assert_allclose(np.asarray(stands.control), 0.0, atol=1e-6)
    assert bool(starts.is_replaced[0])
    assert not bool(starts.is_replaced[-1])
    np.testing.assert_allclose(np.asarray(starts.control)[np.asarray(starts.is_replaced)], 0.0)


@eqx.filter_jit
def beside_walls(check, robot, states, controls, points, is_somebody, is_wall):
    def one(state, control, point, is_it, is_wall):
        speeds = jnp.where(is_it, 1.6, 0.0)
        with_walls = check(robot, state, control, PERIOD, point, is_it, speeds, PERIOD, is_wall)
        turns = jnp.linspace(-1.0, 1.0, 9)
        return with_walls, jax.vmap(lambda turn: robot.stopping_control(state, PERIOD, turn))(turns)

    return jax.vmap(one)(states, controls, points, is_somebody, is_wall)


@eqx.filter_jit
def braked(robot, states):
    """Return the poses (N, 9, T, 3) of the nine ways to brake."""

    def way(state, turn):
        def step(at, _):
            after = robot.step(
                at, robot.stopping_control(at, jnp.float32(0.05), turn), jnp.float32(0.05)
            )
            return after, robot.pose(after)

        return jax.lax.scan(step, state, length=50)[1]

    turns = jnp.linspace(-1.0, 1.0, 9)
    return jax.vmap(lambda state: jax.vmap(lambda turn: way(state, turn))(turns))(states)


def test_nobody_who_walks_makes_a_robot_brake_into_a_wall() -> None:
    # A pillar ahead to the left of a robot at speed, and somebody ahead to its right.
    rng = np.random.default_rng(3)
    states = np.zeros((NUM, 5), np.float32)
    states[:, 3:] = rng.uniform([0.6, -0.5], [1.0, 0.5], (NUM, 2))
    controls = np.zeros((NUM, 2), np.float32)
    points = np.zeros((NUM, 12, 2), np.float32)
    points[:, :, 0] = rng.uniform(0.4, 0.7, NUM)[:, None]
    points[:, :, 1] = rng.uniform(0.1, 0.3, NUM)[:, None] + np.linspace(0.0, 0.3, 12)
    points[:, 0] = rng.uniform([0.5, -0.9], [1.2, -0.2], (NUM, 2))
    is_somebody = np.zeros((NUM, 12), bool)
    is_somebody[:, 0] = True
    is_wall = ~is_somebody
    found, options = beside_walls(CHECK, ROBOT, states, controls, points, is_somebody, is_wall)
    poses = np.asarray(braked(ROBOT, states), float)
    away = np.linalg.norm(poses[..., None, :2] - points[:, None, None].astype(float), axis=-1) - 0.2
    rooms = np.where(is_wall[:, None, None], away, np.inf).min(axis=(2, 3))
    chosen = (
        np.abs(np.asarray(options) - np.asarray(found.control)[:, None]).max(axis=-1).argmin(axis=1)
    )
    is_replaced = np.asarray(found.is_replaced)
    assert is_replaced.sum() > 10
    can_avoid = rooms.max(axis=1) >= 0.05
    room = rooms[np.arange(NUM), chosen]
    assert (room[is_replaced & can_avoid] >= 0.05 - 1e-4).all()
    # Among the cases are some in which the way that is best for the walker alone ends in a wall.
    alone = growing(
        CHECK,
        ROBOT,
        states,
        controls,
        points,
        is_somebody,
        np.where(is_somebody, 1.6, 0.0),
        np.float32(0.1),
    )
    other = (
        np.abs(np.asarray(options) - np.asarray(alone.control)[:, None]).max(axis=-1).argmin(axis=1)
    )
    assert (rooms[np.arange(NUM), other][is_replaced & can_avoid] < 0.0).any()
