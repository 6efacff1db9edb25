"""The reference turns the body by a rotation matrix, in double precision; no quaternion in it."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxplore import Quadrotor, State

MASS, GRAVITY, LAG = 1.3, 9.81, 0.08
ROBOT = Quadrotor(MASS, GRAVITY, LAG)
WEIGHT = MASS * GRAVITY
DOWN = np.array([0.0, 0.0, 1.0])
UNIT = st.floats(-1, 1, width=32)
_step = eqx.filter_jit(ROBOT.step)


def rigid_body(state, control):
    """State: position, velocity, the nine entries of R, body rates."""
    velocity, turn, rates = state[3:6], state[6:15].reshape(3, 3), state[15:]
    wx, wy, wz = rates
    spin = np.array([[0.0, -wz, wy], [wz, 0.0, -wx], [-wy, wx, 0.0]])
    return np.concatenate(
        [
            velocity,
            GRAVITY * DOWN - control[0] / MASS * turn @ DOWN,
            (turn @ spin).ravel(),
            (control[1:] - rates) / LAG,
        ]
    )


def rotation(states) -> Rotation:
    return Rotation.from_quat(np.asarray(states)[..., 6:10], scalar_first=True)


def state_of(position=(0, 0, 0), velocity=(0, 0, 0), turn=None, rates=(0, 0, 0)) -> np.ndarray:
    turn = Rotation.identity() if turn is None else turn
    return np.concatenate([position, velocity, turn.as_quat(scalar_first=True), rates])


def random_start(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return state_of(*rng.normal(size=(2, 3)), Rotation.random(rng=rng), rng.normal(size=3))


def random_controls(seed: int, steps: int, rate: float = 4.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(0.0, 3 * WEIGHT, steps), rng.uniform(-rate, rate, (steps, 3))]
    )


@pytest.mark.parametrize("seed", range(3))
def test_flight_is_that_of_a_rigid_body(seed: int, fly, solve) -> None:
    start, controls = random_start(seed), random_controls(seed + 10, 100)
    body = np.concatenate([start[:6], rotation(start).as_matrix().ravel(), start[10:]])
    exact = solve(rigid_body, body, controls, 0.01)
    found = fly(ROBOT, start, controls, 0.01)
    np.testing.assert_allclose(found[:, :6], exact[:, :6], atol=2e-4)
    np.testing.assert_allclose(
        rotation(found).as_matrix(), exact[:, 6:15].reshape(-1, 3, 3), atol=1e-4
    )
    np.testing.assert_allclose(found[:, 10:], exact[:, 15:], atol=1e-4)


def test_hover() -> None:
    np.testing.assert_allclose(ROBOT.default_control, [WEIGHT, 0.0, 0.0, 0.0], rtol=1e-6)
    rest = ROBOT.at_pose(1.0, 2.0, 0.5, -3.0)
    np.testing.assert_allclose(ROBOT.derivative(rest, ROBOT.default_control), 0.0, atol=1e-6)


def test_thrown_without_thrust_it_flies_a_parabola_and_keeps_its_energy(fly) -> None:
    dt = 0.02
    p, v, w = np.array([1.0, 2.0, -5.0]), np.array([3.0, -1.0, -4.0]), np.array([5.0, -4.0, 3.0])
    start = state_of(p, v, Rotation.from_euler("x", 0.3), w)
    # Commanded to spin on as it does: nothing turns it.
    states = fly(ROBOT, start, np.tile([0.0, *w], (100, 1)), dt)
    t = dt * np.arange(1, 101)[:, None]
    np.testing.assert_allclose(states[:, :3], p + v * t + GRAVITY * t**2 / 2 * DOWN, atol=1e-4)
    energy = (states[:, 3:6] ** 2).sum(axis=1) / 2 - GRAVITY * states[:, 2]
    np.testing.assert_allclose(energy, v @ v / 2 + GRAVITY * 5.0, rtol=1e-5)
    np.testing.assert_allclose(states[:, 10:], np.tile(w, (100, 1)), atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("rate", [-3.0, 2.0])
def test_about_one_axis_it_turns_by_the_rate_times_the_time(axis: int, rate: float, fly) -> None:
    w = rate * np.eye(3)[axis]
    start = state_of(turn=Rotation.from_euler("ZYX", [0.4, -0.3, 0.2]), rates=w)
    states = fly(ROBOT, start, np.tile([WEIGHT, *w], (50, 1)), 0.02)
    # In the body's axes: the rotation is applied on the right.
    expected = rotation(start) * Rotation.from_rotvec(np.outer(0.02 * np.arange(1, 51), w))
    np.testing.assert_allclose(rotation(states).as_matrix(), expected.as_matrix(), atol=1e-5)


@pytest.mark.parametrize(
    ("axis", "component", "sign"),
    # Forward-right-down: rolled right it goes right (east), pitched up it goes backwards (south).
    [(0, "vy", 1.0), (1, "vx", -1.0)],
)
def test_tilted_thrust_pulls_where_the_robot_leans(axis, component, sign, fly) -> None:
    command = np.zeros(3)
    command[axis] = 1.0
    reached = fly(ROBOT, state_of(), np.tile([WEIGHT, *command], (20, 1)), 0.02)[-1]
    values = dict(zip(ROBOT.state_names, reached, strict=True))
    assert sign * values[component] > 0.1
    assert values["vz"] > 0.0  # and it sinks, which is along +z
    other = "vx" if component == "vy" else "vy"
    assert values[other] == pytest.approx(0.0, abs=1e-6)


def test_rates_lag_behind_their_commands(fly) -> None:
    start, command = np.array([1.0, -2.0, 0.5]), np.array([-1.0, 2.0, 3.0])
    states = fly(ROBOT, state_of(rates=start), np.tile([WEIGHT, *command], (40, 1)), 0.01)
    t = 0.01 * np.arange(1, 41)[:, None]
    expected = command + (start - command) * np.exp(-t / LAG)
    np.testing.assert_allclose(states[:, 10:], expected, atol=1e-5)


def test_quaternion_stays_one_of_length_1(fly) -> None:
    states = fly(ROBOT, random_start(0), random_controls(1, 1000, rate=10.0), 0.05)
    np.testing.assert_allclose(np.linalg.norm(states[:, 6:10], axis=1), 1.0, atol=1e-6)


@given(st.floats(-3, 3, width=32), st.integers(0, 1000))
def test_turned_world_turned_flight(yaw: float, seed: int) -> None:
    start, control = random_start(seed), random_controls(seed, 1)[0]

    def turned(state):
        about = Rotation.from_euler("z", yaw)
        state = np.asarray(state, np.float64)
        return state_of(
            about.apply(state[:3]), about.apply(state[3:6]), about * rotation(state), state[10:]
        )

    def stepped(state):
        return _step(*(jnp.asarray(given) for given in (state, control, 0.05)))

    found, expected = stepped(turned(start)), turned(stepped(start))
    # A quaternion and its negative are one rotation.
    expected[6:10] *= np.sign(expected[6:10] @ np.asarray(found[6:10]))
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(st.tuples(UNIT, UNIT, UNIT, UNIT).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_heading_is_the_first_of_yaw_pitch_and_roll(quaternion) -> None:
    q = np.array(quaternion) / np.linalg.norm(quaternion)
    turn = Rotation.from_quat(q, scalar_first=True)
    nose = turn.apply([1.0, 0.0, 0.0])
    state = jnp.asarray(state_of(turn=turn))
    if np.hypot(nose[0], nose[1]) > 1e-2:
        expected = turn.as_euler("ZYX")[0]
        difference = float(ROBOT.heading(state)) - expected
        assert math.remainder(difference, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert np.isfinite(jax.grad(ROBOT.heading)(state)).all()


def test_nose_up_heading_is_finite_and_so_is_its_gradient() -> None:
    half = np.float32(math.sqrt(0.5))
    for q in ([half, 0.0, half, 0.0], [half, 0.0, -half, 0.0], [0.5, 0.5, 0.5, -0.5]):
        state = jnp.zeros(13).at[6:10].set(jnp.asarray(q))
        heading, gradient = jax.value_and_grad(ROBOT.heading)(state)
        assert np.isfinite(heading)
        assert np.isfinite(gradient).all()


def test_speed_is_over_ground() -> None:
    state = State(jnp.asarray(state_of((1, 2, -3), (0.3, -0.4, 5.0))), ROBOT)
    assert float(state.speed) == pytest.approx(0.5)
    np.testing.assert_array_equal(state.position, [1.0, 2.0])
    assert float(state["z"]) == -3.0
    gradient = jax.grad(ROBOT.speed)(jnp.asarray(state_of(velocity=(0.0, 0.0, 2.0))))
    np.testing.assert_array_equal(gradient, 0.0)


@given(st.floats(-3, 3, width=32))
def test_at_a_pose_it_is_level(yaw: float) -> None:
    state = ROBOT.at_pose(1.0, 2.0, yaw, -1.5)
    expected = state_of((1.0, 2.0, -1.5), turn=Rotation.from_euler("z", yaw))
    np.testing.assert_allclose(
        rotation(state).as_matrix(), rotation(expected).as_matrix(), atol=1e-6
    )
    np.testing.assert_array_equal(np.delete(state, range(6, 10)), np.delete(expected, range(6, 10)))
    assert float(ROBOT.heading(state)) == pytest.approx(yaw, abs=1e-5)


def test_blocked() -> None:
    before, after = ROBOT.at_pose(1.0, 2.0, 0.5, -1.0), jnp.asarray(random_start(0))
    blocked = ROBOT.resolve_collision(before, after)
    np.testing.assert_array_equal(blocked[:2], [1.0, 2.0])
    np.testing.assert_array_equal(blocked[3:6], 0.0)
    np.testing.assert_array_equal(blocked[2], after[2])
    np.testing.assert_array_equal(blocked[6:], after[6:])


@pytest.mark.parametrize("scale", [1e-3, 0.5, 1.1, 1e3])
def test_a_measured_quaternion_need_not_have_length_1(scale: float) -> None:
    exact = jnp.asarray(random_start(2))
    measured = exact.at[6:10].multiply(scale)
    control, dt = jnp.asarray(random_controls(3, 1)[0]), jnp.asarray(0.05)
    np.testing.assert_allclose(_step(measured, control, dt), _step(exact, control, dt), atol=1e-5)


def test_a_zero_quaternion_becomes_level_and_no_gradient_is_lost() -> None:
    state = ROBOT.at_pose(1.0, 2.0, 0.0).at[6].set(0.0)
    control, dt = ROBOT.default_control, jnp.asarray(0.05)
    np.testing.assert_array_equal(_step(state, control, dt)[6:10], [1.0, 0.0, 0.0, 0.0])
    jacobian = jax.jacfwd(ROBOT.step)(state, control, dt)
    assert np.isfinite(jacobian).all()


@pytest.mark.parametrize("value", [math.inf, math.nan, 1e30])
def test_a_quaternion_beyond_all_numbers_is_not_made_one(value: float) -> None:
    state = ROBOT.at_pose(1.0, 2.0, 0.0).at[7].set(value)
    assert not np.isfinite(ROBOT.project(state)[6:10]).any()


def test_control_bounds() -> None:
    np.testing.assert_allclose(ROBOT.control_max, [4 * WEIGHT, 10.0, 10.0, 10.0], rtol=1e-6)
    np.testing.assert_array_equal(ROBOT.control_min, [0.0, -10.0, -10.0, -10.0])
    robot = Quadrotor(max_thrust=5.0, max_rate=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(robot.control_max, [5.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(robot.control_min, [0.0, -1.0, -2.0, -3.0])
    # Too weak to hover, it gives what it has.
    np.testing.assert_array_equal(robot.default_control, [5.0, 0.0, 0.0, 0.0])


def test_rates_are_named() -> None:
    with pytest.raises(ValueError, match=r"^max_rate is \[.*accepted: one positive number, or 3$"):
        Quadrotor(max_rate=[1.0, 2.0])


@pytest.mark.parametrize("seed", range(4))
def test_another_pose_turns_attitude_and_velocity_about_the_vertical(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, pose, error = random_start(seed), rng.normal(size=3), rng.normal(size=2)
    found = np.asarray(
        ROBOT.with_pose(*(jnp.asarray(each, jnp.float32) for each in (state, pose, error)))
    )
    about = Rotation.from_euler("z", pose[2] - rotation(state).as_euler("ZYX")[0])
    wrong = Rotation.from_euler("z", pose[2]).apply([*error, 0.0])
    expected = state_of(
        [*pose[:2], state[2]],
        about.apply(state[3:6]) + wrong,
        about * rotation(state),
        state[10:],
    )
    expected[6:10] *= np.sign(expected[6:10] @ found[6:10])
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(ROBOT.pose(jnp.asarray(found)), pose, atol=1e-5)
    # Roll and pitch are those of before.
    angles = rotation(found).as_euler("ZYX"), rotation(state).as_euler("ZYX")
    np.testing.assert_allclose(angles[0][1:], angles[1][1:], atol=1e-5)


def test_without_a_pose_it_still_knows_what_it_brakes_by() -> None:
    state = jnp.asarray(random_start(1))
    found = ROBOT.with_pose(state, jnp.full(3, jnp.nan))
    assert np.isnan(found[:2]).all()
    np.testing.assert_allclose(found[2:], state[2:], atol=1e-6)
