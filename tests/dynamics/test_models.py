"""What holds for every model."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    RK4,
    Ackermann,
    ContinuousDynamics,
    DifferentialDrive,
    Euler,
    KinematicBicycle,
    Omnidirectional,
    Pendulum,
    PointMass,
    Quadrotor,
    State,
    Unicycle,
)
from jaxplore.geometry import Disc

pytestmark = pytest.mark.long

# Each with every numeric argument and another value for it.
SPEEDS = {"max_speed": 1.1, "min_speed": -0.3}
CAR = {**SPEEDS, "max_steering": 0.3, "max_acceleration": 0.7}
TURNING = {
    "max_turn_rate": 0.9,
    "max_acceleration": 0.8,
    "max_deceleration": 1.4,
    "max_angular_acceleration": 0.7,
    "drag": 0.3,
    "radius": 0.7,
}
ARGUMENTS = {
    Ackermann: {
        **CAR,
        "max_deceleration": 1.4,
        "wheelbase": 0.8,
        "max_steering_rate": 0.9,
        "drag": 0.2,
    },
    DifferentialDrive: {**TURNING, "max_speed": 1.1},
    KinematicBicycle: {**CAR, "radius": 0.7, "front_length": 0.7, "rear_length": 0.6},
    Omnidirectional: {**SPEEDS, **TURNING, "max_lateral_speed": 0.6},
    Pendulum: {"mass": 2.0, "length": 0.7, "gravity": 9.0, "max_torque": 3.0, "max_rate": 5.0},
    PointMass: {"max_speed": 1.1, "max_acceleration": 0.7, "drag": 0.2, "radius": 0.7},
    Quadrotor: {
        "mass": 0.7,
        "gravity": 3.7,
        "rate_time_constant": 0.1,
        "max_thrust": 20.0,
        "max_rate": 4.0,
        "radius": 0.2,
    },
    Unicycle: {**SPEEDS, "radius": 0.7, "max_turn_rate": 0.8},
}
ROBOTS = {
    "Ackermann": Ackermann(min_speed=-1.0),
    "DifferentialDrive": DifferentialDrive(),
    "DifferentialDrive RK4": DifferentialDrive(integrator=RK4()),
    "KinematicBicycle": KinematicBicycle(min_speed=-1.0),
    "Omnidirectional": Omnidirectional(min_speed=-1.0),
    "Omnidirectional with brakes": Omnidirectional(min_speed=-1.0, max_deceleration=2.0),
    "Pendulum": Pendulum(),
    "PointMass 1": PointMass(1),
    "PointMass 2": PointMass(2, max_speed=1.5),
    "PointMass 3": PointMass(3, max_speed=1.5),
    "Quadrotor": Quadrotor(),
    "Unicycle": Unicycle(),
}
VEHICLES = {name: robot for name, robot in ROBOTS.items() if name != "Pendulum"}
POSE = (1.0, -2.0, 0.7)
SAMPLES = 18  # in all tests: another shape would compile again
every_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
every_vehicle = pytest.mark.parametrize("robot", VEHICLES.values(), ids=VEHICLES)
every_class = pytest.mark.parametrize("model", ARGUMENTS, ids=lambda model: model.__name__)


def at_rest(robot):
    return jnp.zeros(2) if isinstance(robot, Pendulum) else robot.at_pose(*POSE)


@eqx.filter_jit
def project_all(robot, states):
    return jax.vmap(robot.project, in_axes=-1, out_axes=-1)(states)


def some_states(robot, count: int) -> np.ndarray:
    """States (nx, count) within every bound, all components different."""
    drawn = np.random.default_rng(3).uniform(0.1, 0.4, (robot.state_size, count))
    return np.array(project_all(robot, jnp.asarray(drawn)))


def some_controls(robot, count: int) -> np.ndarray:
    low, high = np.asarray(robot.control_min)[:, None], np.asarray(robot.control_max)[:, None]
    return np.random.default_rng(4).uniform(low, high, (robot.control_size, count))


@eqx.filter_jit
def step_all(robot, states, controls):
    """The samples on the last axis, as the engine has them."""
    step = jax.vmap(robot.step, in_axes=(-1, -1, None), out_axes=-1)
    return step(states, controls, jnp.asarray(0.05))


@every_robot
def test_sizes_bounds_and_leaves(robot) -> None:
    assert isinstance(robot, ContinuousDynamics)
    assert robot.state_size == len(set(robot.state_names))
    assert robot.control_size == len(set(robot.control_names))
    assert robot.control_min.shape == robot.control_max.shape == (robot.control_size,)
    assert (robot.control_min < robot.control_max).all()
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(robot))
    is_coarse = robot is ROBOTS["DifferentialDrive"] or isinstance(robot, Omnidirectional)
    assert isinstance(robot.integrator, Euler if is_coarse else RK4)


@every_robot
def test_discs_of_its_radius_cover_it(robot) -> None:
    footprint = robot.footprint
    assert float(footprint.radius) == float(robot.radius)
    if not isinstance(robot, Ackermann):
        assert isinstance(footprint, Disc)
        np.testing.assert_array_equal(footprint.offsets, [0.0])
    traced = jax.jit(lambda robot: (robot.footprint.offsets, robot.footprint.radius))(robot)
    np.testing.assert_allclose(traced[0], footprint.offsets, rtol=1e-6)
    np.testing.assert_allclose(traced[1], footprint.radius, rtol=1e-6)


@every_vehicle
def test_at_a_pose_it_stands_still(robot, fly) -> None:
    start = robot.at_pose(*POSE)
    state = State(start, robot)
    assert start.dtype == jnp.float32
    on_a_line = robot.state_size == 2
    np.testing.assert_allclose(state.position, (POSE[0], 0.0 if on_a_line else POSE[1]))
    heading = 0.0 if isinstance(robot, PointMass) else POSE[2]
    assert float(state.heading) == pytest.approx(heading, abs=1e-6)
    assert float(state.speed) == 0.0
    assert (robot.default_control >= robot.control_min).all()
    assert (robot.default_control <= robot.control_max).all()
    left_alone = fly(robot, start, np.tile(robot.default_control, (200, 1)), 0.05)
    np.testing.assert_allclose(left_alone[-1], start, atol=1e-5)


@every_vehicle
def test_blocked_it_stays_without_speed_and_a_disc_may_turn(robot) -> None:
    before, after = jnp.asarray(some_states(robot, 2).T)
    blocked = robot.resolve_collision(before, after)
    np.testing.assert_array_equal(robot.position(blocked), robot.position(before))
    assert float(robot.speed(blocked)) == 0.0
    # A rectangle that turned on the spot would turn into what it touches.
    kept = set() if isinstance(robot.footprint, Disc) else {"yaw"}
    if not isinstance(robot, PointMass):
        turned = before if kept else after
        assert float(robot.heading(blocked)) == float(robot.heading(turned))
    for name in sorted(set(robot.state_names) - {"x", "y", "v", "vx", "vy", "vz"} - kept):
        assert float(robot.component(blocked, name)) == float(robot.component(after, name))


def test_a_flying_robot_does_not_fall_where_it_is_blocked() -> None:
    for robot in (ROBOTS["Quadrotor"], ROBOTS["PointMass 3"]):
        before, after = jnp.asarray(some_states(robot, 2).T)
        assert float(robot.component(robot.resolve_collision(before, after), "vz")) == 0.0


@every_robot
def test_samples_on_the_last_axis(robot, fly) -> None:
    states = jnp.asarray(some_states(robot, SAMPLES))
    controls = jnp.asarray(some_controls(robot, SAMPLES))
    together = step_all(robot, states, controls)
    for k in (0, SAMPLES - 1):
        alone = fly(robot, states[:, k], [controls[:, k]], 0.05)
        np.testing.assert_allclose(together[:, k], alone[0], rtol=1e-5, atol=1e-6)


# What these have, others have too, and more that could fail.
PLAIN = ("DifferentialDrive", "Omnidirectional", "PointMass 1", "PointMass 2")


@pytest.mark.parametrize("robot", [ROBOTS[name] for name in ROBOTS if name not in PLAIN])
def test_gradients_are_finite_at_rest(robot) -> None:
    read = [] if isinstance(robot, Pendulum) else [robot.position, robot.heading, robot.speed]

    def total(robot, state, control):
        reached = robot.step(state, control, jnp.asarray(0.05))
        # One gradient that is not finite spoils that of the sum.
        values = [reached, *(reading(at) for reading in read for at in (state, reached))]
        return sum(jnp.sum(value) for value in values)

    gradients = jax.jit(jax.grad(total, argnums=(0, 1, 2)))
    for leaf in jax.tree.leaves(gradients(robot, at_rest(robot), robot.default_control)):
        assert np.isfinite(leaf).all()


@every_robot
def test_controls_at_their_bounds_keep_the_state_admissible(robot, fly) -> None:
    is_high = np.random.default_rng(5).random((200, robot.control_size)) < 0.5
    controls = np.where(is_high, robot.control_max, robot.control_min)
    states = fly(robot, at_rest(robot), controls, 0.05)
    assert np.isfinite(states).all()
    admissible = project_all(robot, jnp.asarray(states.T))
    np.testing.assert_allclose(np.asarray(admissible).T, states, atol=1e-6)


@every_robot
def test_what_is_not_a_number_stays_so(robot) -> None:
    # The engine leaves out rollouts that are not finite: a bound must not hide that.
    states, controls = some_states(robot, SAMPLES), some_controls(robot, SAMPLES)
    size = robot.state_size + robot.control_size
    for k in range(size):
        if k < robot.state_size:
            states[k, k] = np.nan
        else:
            controls[k - robot.state_size, k] = np.nan
    reached = step_all(robot, jnp.asarray(states), jnp.asarray(controls))
    is_finite = np.isfinite(reached).all(axis=0)
    np.testing.assert_array_equal(is_finite, np.arange(SAMPLES) >= size)


@every_class
def test_another_parameter_compiles_nothing(model) -> None:
    traces = []

    @eqx.filter_jit
    def step(robot, state, control, dt):
        traces.append("compiled")
        return robot.step(state, control, dt), robot.default_control

    # A bound that may be absent has no place in a program that was compiled without it.
    with_bounds = {"max_speed": 1.0} if model is PointMass else {}
    if "max_deceleration" in ARGUMENTS[model]:
        with_bounds = {"max_deceleration": 1.1}
    robots = [model(**with_bounds)] + [
        model(**{**with_bounds, argument: value}) for argument, value in ARGUMENTS[model].items()
    ]
    state, control = jnp.asarray(some_states(robots[0], 1)[:, 0]), robots[0].control_max
    for dt in (0.05, 0.02):
        for robot in robots:
            step(robot, state, control, jnp.asarray(dt))
    assert len(traces) == 1


@every_class
def test_a_model_can_be_built_in_traced_code(model) -> None:
    arguments = ARGUMENTS[model]

    @jax.jit
    def bounds(values):
        robot = model(**values)
        return robot.control_min, robot.control_max, robot.radius, robot.default_control

    robot = model(**arguments)
    given = {name: jnp.asarray(value) for name, value in arguments.items()}
    expected = robot.control_min, robot.control_max, robot.radius, robot.default_control
    for found, value in zip(bounds(given), expected, strict=True):
        np.testing.assert_allclose(found, value, rtol=1e-6)


@every_class
def test_four_numbers_are_refused(model) -> None:
    for argument in ARGUMENTS[model]:
        with pytest.raises(ValueError, match=rf"^{argument} (is|has shape) .*; accepted: "):
            model(**{argument: np.ones(4)})


@pytest.mark.parametrize("model", [Unicycle, Ackermann, KinematicBicycle])
def test_speeds_are_in_order(model) -> None:
    with pytest.raises(ValueError, match=r"^min_speed is 1\.5; accepted: a finite number < 1\.5$"):
        model(max_speed=1.5, min_speed=1.5)
