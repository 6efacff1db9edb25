"""Velocities in the body frame, and controls that bring every model to rest."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import (
    RK4,
    Ackermann,
    Augmented,
    DifferentialDrive,
    KinematicBicycle,
    Omnidirectional,
    PathParameter,
    Pendulum,
    PointMass,
    Quadrotor,
    Unicycle,
)

pytestmark = pytest.mark.long

DT = 0.05
BACKWARDS = {"min_speed": -0.8}
ROBOTS = {
    "Ackermann": Ackermann(max_speed=1.5, drag=0.2, **BACKWARDS),
    "Ackermann with brakes": Ackermann(max_speed=1.5, max_deceleration=3.5, **BACKWARDS),
    "Augmented": Augmented(DifferentialDrive(), PathParameter(2.0)),
    "DifferentialDrive": DifferentialDrive(),
    "DifferentialDrive RK4": DifferentialDrive(max_deceleration=2.5, integrator=RK4()),
    "KinematicBicycle": KinematicBicycle(max_speed=1.5, **BACKWARDS),
    "Omnidirectional": Omnidirectional(**BACKWARDS),
    "Omnidirectional with brakes": Omnidirectional(max_deceleration=2.5, **BACKWARDS),
    "PointMass 2": PointMass(2, max_speed=1.5, drag=0.1),
    "PointMass 3": PointMass(3, max_speed=1.5, max_acceleration=[1.0, 0.5, 2.0]),
    "Unicycle": Unicycle(**BACKWARDS),
}
DECELERATION = {
    "Ackermann": 2.0,
    "Ackermann with brakes": 3.5,
    "DifferentialDrive RK4": 2.5,
    "KinematicBicycle": 2.0,
    "Omnidirectional with brakes": 2.5,
    "PointMass 3": 0.5,
}
every_robot = pytest.mark.parametrize("name", ROBOTS)
TWIST = jax.tree_util.Partial(
    eqx.filter_jit(lambda robot, state, control: robot.twist(state, control))
)
ACCELERATION = jax.tree_util.Partial(
    eqx.filter_jit(lambda robot, state, control: robot.acceleration(state, control))
)


def finite_difference(robot, state, control):
    """The velocity from two poses a short time apart, in the body frame between them."""
    h = 1e-3
    poses = [
        np.asarray(robot.pose(robot.step(state, control, jnp.asarray(t))), np.float64)
        for t in (0.0, h)
    ]
    x_rate, y_rate, _ = (poses[1] - poses[0]) / h
    turned = math.remainder(poses[1][2] - poses[0][2], math.tau)
    yaw = poses[0][2] + 0.5 * turned
    sin, cos = math.sin(yaw), math.cos(yaw)
    return [cos * x_rate + sin * y_rate, cos * y_rate - sin * x_rate, turned / h]


@pytest.mark.parametrize("name", [*ROBOTS, "Quadrotor"])
def test_twist_is_the_rate_of_the_pose(name: str) -> None:
    robot = ROBOTS.get(name, Quadrotor())
    random = np.random.default_rng(0)
    low, high = np.asarray(robot.control_min), np.asarray(robot.control_max)
    for _ in range(4):
        state = jnp.asarray(random.uniform(0.1, 0.5, robot.state_size), jnp.float32)
        state = robot.project(state) if isinstance(robot, Quadrotor) else state
        control = jnp.asarray(low + random.uniform(0.4, 0.6, low.shape) * (high - low), jnp.float32)
        found = TWIST(robot, state, control)
        # The difference is exact up to the curvature over a millisecond, and rounding.
        np.testing.assert_allclose(found, finite_difference(robot, state, control), atol=0.02)


@every_robot
def test_acceleration_is_that_of_the_position(name: str) -> None:
    robot, h = ROBOTS[name], 0.02
    random = np.random.default_rng(1)
    low, high = np.asarray(robot.control_min), np.asarray(robot.control_max)
    for _ in range(3):
        state = jnp.asarray(random.uniform(0.1, 0.5, robot.state_size), jnp.float32)
        control = jnp.asarray(low + random.uniform(0.4, 0.6, low.shape) * (high - low), jnp.float32)
        states = [state]
        for _ in range(2):
            states.append(robot.step(states[-1], control, jnp.asarray(h)))
        first, middle, last = (np.asarray(robot.position(each), np.float64) for each in states)
        x, y = (last - 2.0 * middle + first) / h**2
        yaw = float(robot.heading(states[1]))
        wanted = [math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x]
        # The second difference is exact up to rounding, and to the steps of Euler's method.
        np.testing.assert_allclose(ACCELERATION(robot, states[1], control), wanted, atol=0.03)


def test_acceleration_of_known_motions() -> None:
    # A car in a curve that also brakes: v^2 tan(steering) / wheelbase to the left.
    state, control = jnp.asarray([1.0, 2.0, 0.4, 2.0, 0.3]), jnp.asarray([-1.5, 0.0])
    found = ACCELERATION(Ackermann(wheelbase=0.5), state, control)
    np.testing.assert_allclose(found, [-1.5, 4.0 * math.tan(0.3) / 0.5], rtol=1e-5)


def test_twist_of_known_motions() -> None:
    rest, none = jnp.zeros(5), jnp.zeros(2)
    np.testing.assert_array_equal(TWIST(DifferentialDrive(), rest, none), 0.0)
    driving = jnp.asarray([1.0, 2.0, 2.5, 0.7, -0.4])
    np.testing.assert_allclose(
        TWIST(DifferentialDrive(), driving, none), [0.7, 0.0, -0.4], atol=1e-6
    )
    car = TWIST(Ackermann(wheelbase=0.5), driving.at[4].set(0.3), none)
    np.testing.assert_allclose(car, [0.7, 0.0, 0.7 * math.tan(0.3) / 0.5], atol=1e-6)
    commanded = TWIST(Unicycle(), jnp.asarray([1.0, 2.0, -1.1]), jnp.asarray([0.6, 0.9]))
    np.testing.assert_allclose(commanded, [0.6, 0.0, 0.9], atol=1e-6)
    slip = math.atan(0.5 * math.tan(0.2))
    bicycle = KinematicBicycle(0.2, 0.2)
    slipping = TWIST(bicycle, jnp.asarray([0.0, 0.0, 0.8, 0.5]), jnp.asarray([0.0, 0.2]))
    expected = [0.5 * math.cos(slip), 0.5 * math.sin(slip), 0.5 * math.sin(slip) / 0.2]
    np.testing.assert_allclose(slipping, expected, atol=1e-6)


def test_a_pendulum_has_no_twist() -> None:
    with pytest.raises(ValueError, match="Pendulum has no state component 'x'"):
        Pendulum().twist(jnp.zeros(2), jnp.zeros(1))


@eqx.filter_jit
def brake(robot, states, turns):
    """Stopping controls (N, T, nu) from N states, and twists (N, T, 3) before each."""

    def step(state, turn):
        control = robot.stopping_control(state, jnp.asarray(DT), turn)
        twist = robot.twist(state, control)
        return robot.step(state, control, jnp.asarray(DT)), (control, twist)

    def stop(state, turn):
        return jax.lax.scan(lambda at, _: step(at, turn), state, None, length=90)[1]

    return jax.vmap(stop)(states, turns)


speeds = eqx.filter_jit(lambda robot, states: jax.vmap(robot.speed)(states))
projected = eqx.filter_jit(lambda robot, states: jax.vmap(robot.project)(states))
COUNT = 60


def some_states(robot, count: int) -> np.ndarray:
    """Admissible states (count, nx), from rest to the bounds."""
    drawn = np.random.default_rng(1).uniform(-3.0, 3.0, (count, robot.state_size))
    physical = getattr(robot, "physical", robot)
    size = physical.state_size
    admissible = projected(physical, jnp.asarray(drawn[:, :size], jnp.float32))
    return np.concatenate([admissible, drawn[:, size:]], axis=1).astype(np.float32)


@every_robot
def test_it_comes_to_rest_as_fast_as_its_brakes_allow_and_stays(name: str) -> None:
    robot = ROBOTS[name]
    states = some_states(robot, COUNT)
    turns = np.tile(np.float32([-1.0, -0.3, 0.0, 1.0]), COUNT // 4)
    controls, twists = brake(robot, jnp.asarray(states), jnp.asarray(turns))
    controls, twists = np.asarray(controls), np.asarray(twists)
    assert (controls >= np.asarray(robot.control_min) - 1e-6).all()
    assert (controls <= np.asarray(robot.control_max) + 1e-6).all()
    is_moving = (np.abs(twists) > 1e-5).any(axis=-1)
    steps = np.array([0 if not each.any() else 1 + np.flatnonzero(each)[-1] for each in is_moving])
    physical = getattr(robot, "physical", robot)
    moving = states[:, : physical.state_size]
    speed = np.abs(speeds(physical, jnp.asarray(moving)))
    needed = speed / DECELERATION.get(name, 1.0)
    if "omega" in physical.state_names:
        needed = np.maximum(needed, np.abs(moving[:, physical.state_names.index("omega")]) / 2.0)
    assert (steps * DT <= needed + 2.0 * DT).all()
    # Not before the brakes allow it either: the drag helps a little.
    if name in ("DifferentialDrive RK4", "KinematicBicycle"):
        assert (steps * DT >= 0.8 * needed - 2.0 * DT).all()


# A point mass has no turning bound, and a unicycle stands at once.
TURNING = [name for name, each in ROBOTS.items() if not isinstance(each, (PointMass, Unicycle))]


@pytest.mark.parametrize("name", TURNING)
def test_it_turns_by_its_share_while_it_moves(name: str) -> None:
    robot = ROBOTS[name]
    start = np.array(robot.at_pose(0.0, 0.0, 0.3))
    start[3] = 0.9  # v or vx
    backwards = start.copy()
    backwards[3] *= -1.0
    turns = jnp.asarray(np.tile(np.float32([-1.0, 0.0, 0.1, 1.0]), COUNT // 4))

    def turned(start: np.ndarray) -> np.ndarray:
        # As many as in the other test: another number would be another program.
        _, twists = brake(robot, jnp.asarray(np.tile(start, (COUNT, 1))), turns)
        return DT * np.asarray(twists)[:4, :, 2].sum(axis=1)

    yaw = turned(start)
    assert yaw[0] < yaw[1] < yaw[2] < yaw[3]
    assert yaw[0] == pytest.approx(-yaw[3], rel=1e-3)
    assert yaw[1] == pytest.approx(0.0, abs=1e-4)
    if isinstance(robot, (Ackermann, KinematicBicycle)):
        yaw = turned(backwards)
        assert yaw[0] < yaw[1] < yaw[2] < yaw[3]


LIMITED = Ackermann(max_speed=2.0, min_speed=-1.0, max_acceleration=1.0, max_deceleration=4.0)
STEP = eqx.filter_jit(LIMITED.step)


@given(
    st.floats(-1.0, 2.0, width=32),
    st.floats(-6.0, 6.0, width=32),
    st.sampled_from([0.01, 0.05, 0.2]),
)
def test_speeding_up_and_braking_have_their_own_bounds(v: float, a: float, dt: float) -> None:
    before = jnp.asarray([0.0, 0.0, 0.0, v, 0.0], jnp.float32)
    after = float(STEP(before, jnp.asarray([a, 0.0], jnp.float32), jnp.asarray(dt, jnp.float32))[3])
    faster, slower = np.sign(v or 1.0) * (after - v), -np.sign(v or 1.0) * (after - v)
    assert faster <= 1.0 * dt + 1e-5
    # What brakes to zero within the step speeds up for the rest of it.
    to_zero = min(abs(v) / 4.0, dt)
    assert slower <= 4.0 * to_zero + 1.0 * (dt - to_zero) + 1e-5
    if abs(a) <= 1.0:
        assert after == pytest.approx(np.clip(v + a * dt, -1.0, 2.0), abs=1e-5)


def test_brakes_are_bounds_of_the_controls() -> None:
    robot = DifferentialDrive(max_acceleration=0.8, max_deceleration=2.5)
    np.testing.assert_allclose(robot.control_min, [-2.5, -2.0])
    np.testing.assert_allclose(robot.control_max, [0.8, 2.0])
    forwards = Ackermann(max_acceleration=0.8, max_deceleration=2.5)
    np.testing.assert_allclose([forwards.control_min[0], forwards.control_max[0]], [-2.5, 0.8])
    np.testing.assert_allclose([LIMITED.control_min[0], LIMITED.control_max[0]], [-4.0, 4.0])


@pytest.mark.parametrize("model", [Ackermann, DifferentialDrive])
def test_brakes_equal_to_the_motor_change_nothing(model) -> None:
    plain, same = model(max_acceleration=1.3), model(max_acceleration=1.3, max_deceleration=1.3)
    np.testing.assert_array_equal(plain.control_min, same.control_min)
    np.testing.assert_array_equal(plain.control_max, same.control_max)
    state, control = jnp.asarray([0.0, 0.0, 0.4, 0.03, 0.1]), jnp.asarray([-1.3, 0.3])
    dt = jnp.asarray(0.05)
    np.testing.assert_allclose(
        plain.step(state, control, dt), same.step(state, control, dt), atol=1e-7
    )
