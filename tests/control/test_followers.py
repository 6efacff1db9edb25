"""References: gains by hand, the law with matrices in double precision, flights integrated anew."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplore import (
    MPPI,
    Ackermann,
    BiasedProposal,
    DifferentialDrive,
    GaussianProposal,
    KinematicBicycle,
    Knots,
    Omnidirectional,
    PointMass,
    Quadrotor,
    Smooth,
    Softmax,
    Unicycle,
)
from jaxplore.control import Direct
from jaxplore.costs import ReferenceCost
from jaxplore.planning.strategy.follower import Follower
from jaxplore.planning.strategy.followers import (
    DifferentialDriveFollower,
    UnicycleFollower,
    follower_for,
)
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower
from jaxplore.planning.strategy.twist_follower import TwistFollower

pytestmark = pytest.mark.long

MASS, GRAVITY, LAG = 1.3, 9.81, 0.05
FLIGHT = Quadrotor(MASS, GRAVITY, LAG)
PILOT = QuadrotorFollower()
CARS = {
    "differential drive": DifferentialDrive(max_speed=2.0),
    "unicycle": Unicycle(max_speed=2.0),
    "unicycle with a reverse gear": Unicycle(max_speed=2.0, min_speed=-1.0),
}
STEERED = {
    "car": Ackermann(max_speed=1.5, min_speed=-1.0),
    "bicycle": KinematicBicycle(max_speed=1.5, min_speed=-1.0),
}
OMNI = Omnidirectional(max_speed=2.0)
STEP, STEPS = jnp.float32(0.05), 60
GROUND_STEP, GROUND_STEPS = jnp.float32(0.1), 100
TIMES = 0.05 * np.arange(1, STEPS + 1)
GROUND_TIMES = 0.1 * np.arange(1, GROUND_STEPS + 1)
DOWN = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def follow():
    """Return controls and states of a robot that follows a reference; says how often it traced."""

    @eqx.filter_jit
    def run(follower, model, state, reference, dt):
        call.traces += 1
        controls = follower(model, state, reference, dt)

        def advance(state, control):
            reached = model.step(state, control, dt)
            return reached, reached

        return controls, jax.lax.scan(advance, state, controls)[1]

    def call(reference, state=None, follower=None, model=FLIGHT, dt=None):
        is_flight = isinstance(model, Quadrotor)
        state = model.at_pose(0.0, 0.0, 0.0) if state is None else jnp.asarray(state, jnp.float32)
        dt = (STEP if is_flight else GROUND_STEP) if dt is None else dt
        follower = follower_for(model) if follower is None else follower
        found = run(follower, model, state, jnp.asarray(reference, jnp.float32), dt)
        return tuple(np.asarray(each) for each in found)

    call.traces = 0
    return call


@pytest.fixture(scope="module")
def law():
    """Return the control of a law as it is."""

    @eqx.filter_jit
    def run(follower, model, state, target, velocity):
        return follower.control(model, state, target, velocity)

    def call(state, target, velocity=(0.0, 0.0, 0.0), follower=PILOT, model=FLIGHT):
        given = (jnp.asarray(each, jnp.float32) for each in (state, target, velocity))
        return np.asarray(run(follower, model, *given))

    return call


def held(point, steps=STEPS):
    return np.tile(np.asarray(point, float), (steps, 1))


def circle(times, radius, speed, height=True):
    turned = speed / radius * times
    columns = [radius * np.sin(turned), radius * (1.0 - np.cos(turned))]
    return np.column_stack([*columns, 0.0 * times] if height else columns)


def tilt(states):
    turned = Rotation.from_quat(states[:, 6:10], scalar_first=True).as_matrix()
    return np.arccos(np.clip(turned[:, 2, 2], -1.0, 1.0))


def distance(states, reference):
    size = np.shape(reference)[1]
    return np.linalg.norm(states[:, :size] - reference, axis=1)


def flown(state, controls, dt):
    """The quadrotor's states by RK4 in double precision, with SciPy's rotations."""

    def rate(body, control):
        # Of length 1 for the thrust, as it is for the change of q.
        down = Rotation.from_quat(body[6:10], scalar_first=True).as_matrix()[:, 2]
        scalar, vector, rates = body[6], body[7:10], body[10:]
        product = [-vector @ rates, *(scalar * rates + np.cross(vector, rates))]
        force = GRAVITY * DOWN - control[0] / MASS * down
        return np.concatenate(
            [body[3:6], force, np.array(product) / 2, (control[1:] - rates) / LAG]
        )

    body, states = np.asarray(state, float), []
    for control in np.asarray(controls, float):
        k1 = rate(body, control)
        k2 = rate(body + dt / 2 * k1, control)
        k3 = rate(body + dt / 2 * k2, control)
        k4 = rate(body + dt * k3, control)
        body = body + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        body[6:10] /= np.linalg.norm(body[6:10])
        states.append(body)
    return np.array(states)


class TestQuadrotorLaw:
    @pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
    def test_on_the_target_it_hovers(self, yaw, law, follow) -> None:
        state = FLIGHT.at_pose(1.0, -2.0, yaw, -3.0)
        hover = [MASS * GRAVITY, 0.0, 0.0, 0.0]
        np.testing.assert_allclose(law(state, state[:3]), hover, atol=1e-5)
        controls, _ = follow(held(state[:3]), state)
        np.testing.assert_allclose(controls, np.tile(hover, (STEPS, 1)), atol=1e-5)

    # North-east-down, nose north. To the north it pitches down, to the east it rolls right. Gains
    # 6 / s^2 and 4 / s for position and velocity, 8 / s for the attitude; 1 cm or 1 cm / s off.
    @pytest.mark.parametrize(
        ("offset", "acceleration"),
        [
            ((0.01, 0.0, 0.0, 0.0, 0.0, 0.0), (0.06, 0.0, 0.0)),
            ((0.0, 0.01, 0.0, 0.0, 0.0, 0.0), (0.0, 0.06, 0.0)),
            ((0.0, 0.0, 0.01, 0.0, 0.0, 0.0), (0.0, 0.0, 0.06)),
            ((0.0, 0.0, 0.0, 0.01, 0.0, 0.0), (0.04, 0.0, 0.0)),
            ((0.0, 0.0, 0.0, 0.0, 0.01, 0.0), (0.0, 0.04, 0.0)),
            ((0.0, 0.0, 0.0, 0.0, 0.0, 0.01), (0.0, 0.0, 0.04)),
        ],
    )
    def test_small_errors_are_answered_by_the_gains(self, offset, acceleration, law) -> None:
        state = np.array(FLIGHT.at_pose(1.0, -2.0, 0.0, -3.0))
        state[3:6] = -np.array(offset[3:])  # too slow by that: the target stands
        north, east, down = acceleration
        thrust, wx, wy, wz = law(state, state[:3] + offset[:3])
        assert thrust == pytest.approx(1.3 * (9.81 - down), abs=1e-5)
        assert wx == pytest.approx(8.0 * east / 9.81, rel=1e-3, abs=1e-6)
        assert wy == pytest.approx(-8.0 * north / 9.81, rel=1e-3, abs=1e-6)
        assert wz == 0.0

    def test_it_leans_by_the_body_s_axes(self, law) -> None:
        # Nose east: north is to the left.
        state = np.array(FLIGHT.at_pose(0.0, 0.0, math.pi / 2))
        _, wx, wy, _ = law(state, [0.01, 0.0, 0.0])
        assert wx == pytest.approx(-8.0 * 0.06 / 9.81, rel=1e-3)
        assert wy == pytest.approx(0.0, abs=1e-6)

    def test_it_is_the_law_of_matrices_in_double_precision(self, law) -> None:
        rng, pilot = np.random.default_rng(0), QuadrotorFollower(5.0, 3.0, 7.0, 1.5, 0.4)
        steep = 0
        for _ in range(30):
            turned = Rotation.random(rng=rng)
            p, v, target, velocity = rng.normal(size=(4, 3)) * [[1.0], [1.0], [0.15], [2.0]]
            target += p
            state = [*p, *v, *turned.as_quat(scalar_first=True), *rng.normal(size=3)]
            # What a state estimate says need not be of length 1.
            state[6:10] = rng.uniform(0.5, 2.0) * np.array(state[6:10])
            force = GRAVITY * DOWN - 5.0 * (target - p) - 3.0 * (velocity - v)
            force[2] = max(force[2], 0.2 * GRAVITY)
            level = np.linalg.norm(force[:2])
            steep += level > math.tan(0.4) * force[2]
            force[:2] *= min(1.0, math.tan(0.4) * force[2] / level)
            axes = turned.as_matrix()
            normal = np.cross(axes[:, 2], force)
            lean = math.acos(axes[:, 2] @ force / np.linalg.norm(force))
            rates = 7.0 * lean * axes.T @ normal / np.linalg.norm(normal)
            # The nose is right where the body's y axis is square to the direction of motion.
            ahead = np.array([velocity[0], velocity[1], 0.0])
            rates[2] = 1.5 * math.atan2(axes[:, 1] @ ahead, axes[:, 0] @ ahead)
            expected = [MASS * force @ axes[:, 2], *rates]
            found = law(state, target, velocity, pilot)
            np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-3)
        assert 5 < steep < 30

    def test_a_quaternion_of_zeros_is_level(self, law) -> None:
        state = np.array(FLIGHT.at_pose(0.0, 0.0, 0.0))
        level = law(state, [0.3, 0.2, 0.1], [0.5, 0.5, 0.0])
        state[6:10] = 0.0
        np.testing.assert_array_equal(law(state, [0.3, 0.2, 0.1], [0.5, 0.5, 0.0]), level)

    def test_upside_down_it_rolls_over_without_thrust(self, law, follow) -> None:
        state = np.array(FLIGHT.at_pose(0.0, 0.0, 0.0))
        state[6:10] = [0.0, 1.0, 0.0, 0.0]
        thrust, wx, wy, wz = law(state, [0.0, 0.0, 0.0])
        assert thrust < 0.0
        assert wx == pytest.approx(8.0 * math.pi, rel=1e-5)
        assert wy == wz == 0.0
        controls, states = follow(held([0.0, 0.0, 0.0]), state)
        assert controls[0, 0] == 0.0
        assert controls[0, 1] == FLIGHT.control_max[1]
        assert tilt(states)[-20:].max() < 0.05
        assert distance(states, held([0.0, 0.0, 0.0]))[-1] < 0.1


class TestQuadrotorFlight:
    @pytest.mark.parametrize(
        "direction", [(1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0.6, -0.6, 0.5)]
    )
    def test_a_point_1_m_away_is_reached(self, direction, follow) -> None:
        target = np.array(direction) / np.linalg.norm(direction)
        controls, states = follow(held(target))
        away = distance(states, held(target))
        assert away[TIMES > 2.0].max() < 0.03
        assert (states[:, :3] @ target).max() < 1.03
        assert tilt(states).max() < 0.7
        assert controls[:, 0].min() > 0.0
        assert controls[:, 0].max() < FLIGHT.control_max[0]

    def test_far_away_it_leans_as_far_as_it_may_and_brakes_in_time(self, follow) -> None:
        pilot = QuadrotorFollower(max_tilt=0.4)
        _, states = follow(held([4.0, 3.0, 0.0]), follower=pilot)
        assert 0.4 < tilt(states).max() < 0.45
        assert np.abs(states[:, 2]).max() < 0.15
        assert (states[:, :2] @ [0.8, 0.6]).max() < 5.05
        assert distance(states, held([4.0, 3.0, 0.0]))[-1] < 0.3
        # About half of what the tilt allows; without slowing down in time it would be all of it.
        speeds = states[:, 3:5] @ [0.8, 0.6]
        assert np.diff(speeds).min() / 0.05 > -0.75 * GRAVITY * math.tan(0.4)

    @pytest.mark.parametrize(
        ("reference", "bound"),
        [
            (np.outer(2.0 * TIMES, [1.0, 0.0, 0.0]), 0.06),
            (np.outer(2.0 * TIMES, [-0.6, 0.64, -0.48]), 0.06),
            # Not at its centripetal acceleration: 1.125 / 6 m remain.
            (circle(TIMES, 2.0, 1.5), 0.2),
        ],
        ids=["north", "aslant", "circle"],
    )
    def test_it_keeps_up(self, reference, bound, follow) -> None:
        controls, states = follow(reference)
        away = distance(states, reference)
        assert away.max() < 0.55  # it starts at rest
        assert away[TIMES > 1.5].max() < bound
        exact = flown(FLIGHT.at_pose(0.0, 0.0, 0.0), controls, 0.05)
        np.testing.assert_allclose(states, exact, atol=1e-3)

    def test_on_a_line_nothing_is_left_to_correct(self, follow) -> None:
        # Flying as the reference does: it is where to be now that counts, not one step later.
        state = np.array(FLIGHT.at_pose(0.0, 0.0, 0.0))
        state[3] = 2.0
        controls, _ = follow(np.outer(2.0 * TIMES, [1.0, 0.0, 0.0]), state)
        np.testing.assert_allclose(
            controls, np.tile([MASS * GRAVITY, 0, 0, 0], (STEPS, 1)), atol=1e-3
        )

    @pytest.mark.parametrize("heading", [2.0, -1.0])
    def test_it_turns_to_its_heading_where_the_reference_stands(self, heading, follow) -> None:
        pilot = QuadrotorFollower(heading=heading)
        still = held([0.0, 0.0, 0.0])
        _, states = follow(still, follower=pilot)
        quaternions = states[-1, 6:10]
        yaw = Rotation.from_quat(quaternions, scalar_first=True).as_euler("ZYX")[0]
        assert yaw == pytest.approx(heading, abs=0.05)
        assert distance(states, still).max() < 0.05
        # Where it moves, the nose is ahead as without a heading.
        north = np.outer(2.0 * TIMES, [1.0, 0.0, 0.0])
        for found, expected in zip(follow(north, follower=pilot), follow(north), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-5)

    @pytest.mark.parametrize("angle", [0.9, -2.2])
    def test_the_world_may_turn_and_move(self, angle, follow) -> None:
        rng = np.random.default_rng(1)
        state = np.concatenate(
            [
                [0.2, -0.1, 0.3, 0.5, -0.4, 0.2],
                Rotation.from_euler("ZYX", [0.3, -0.2, 0.25]).as_quat(scalar_first=True),
                rng.normal(size=3),
            ]
        )
        reference = circle(TIMES, 2.0, 1.5) + 0.4 * DOWN
        turn, shift = Rotation.from_euler("z", angle), np.array([10.0, -5.0, 3.0])
        turned = state.copy()
        turned[:3] = turn.apply(state[:3]) + shift
        turned[3:6] = turn.apply(state[3:6])
        attitude = turn * Rotation.from_quat(state[6:10], scalar_first=True)
        turned[6:10] = attitude.as_quat(scalar_first=True)
        controls, _ = follow(reference, state)
        same, _ = follow(turn.apply(reference) + shift, turned)
        np.testing.assert_allclose(same, controls, atol=5e-3)
        assert np.abs(controls[:, 1:]).max() > 1.0

    @pytest.mark.parametrize("direction", [0.8, -2.0, 3.0])
    def test_the_nose_turns_to_where_it_flies(self, direction, follow) -> None:
        along = np.array([math.cos(direction), math.sin(direction), 0.0])
        _, states = follow(np.outer(1.5 * TIMES, along))
        assert jax.vmap(FLIGHT.heading)(states)[-1] == pytest.approx(direction, abs=0.05)

    def test_the_nose_stays_where_the_reference_does_not_move(self, follow) -> None:
        state = FLIGHT.at_pose(0.0, 0.0, 0.7)
        crawl = np.outer(0.09 * TIMES, [0.0, -1.0, 0.0])
        climb = np.outer(1.0 * TIMES, [0.0, 0.0, -1.0])
        for reference in (held([0.5, -0.5, 0.0]), crawl, climb):
            controls, states = follow(reference, state)
            np.testing.assert_array_equal(controls[:, 3], 0.0)
            np.testing.assert_allclose(jax.vmap(FLIGHT.heading)(states), 0.7, atol=0.1)

    def test_without_a_height_it_keeps_its_own(self, follow) -> None:
        state = FLIGHT.at_pose(0.0, 0.0, 0.0, -2.0)
        reference = circle(TIMES, 2.0, 1.5)[:, :2]
        controls, states = follow(reference, state)
        same, _ = follow(np.column_stack([reference, np.full(STEPS, -2.0)]), state)
        np.testing.assert_allclose(controls, same, atol=1e-5)
        np.testing.assert_allclose(states[:, 2], -2.0, atol=0.15)


@pytest.mark.parametrize("model", CARS.values(), ids=CARS)
class TestGround:
    @pytest.mark.parametrize(
        "target", [(2, 0), (-2, 0), (0, 2), (0, -2), (-1.5, 0.5), (0.3, 0), (-0.3, 0), (0, 0.3)]
    )
    def test_it_reaches_a_point(self, model, target, follow) -> None:
        target = np.array(target, float)
        controls, states = follow(held(target, GROUND_STEPS), model=model)
        away = distance(states, held(target, GROUND_STEPS))
        assert away[GROUND_TIMES > 5.0].max() < 0.06
        assert (controls >= np.asarray(model.control_min)).all()
        assert (controls <= np.asarray(model.control_max)).all()
        # It does not drive before it has turned: a target behind is turned to on the spot.
        start = np.zeros((1, 3))
        poses = np.concatenate([start, states[:, :3]])
        to = target - poses[:-1, :2]
        facing = to[:, 0] * np.cos(poses[:-1, 2]) + to[:, 1] * np.sin(poses[:-1, 2])
        turning = np.cumprod(facing < 0.0).astype(bool)
        assert turning[0] == (target[0] < 0.0)
        moved = np.linalg.norm(poses[:-1, :2], axis=1)
        assert np.all(moved[turning] < 1e-6)

    @pytest.mark.parametrize("yaw", [0.0, 1.0, -3.0])
    def test_on_the_target_it_rests_and_prefers_no_direction(self, model, yaw, law) -> None:
        state, follower = model.at_pose(1.0, 2.0, yaw), follower_for(model)
        still = law(state, state[:2], (0.0, 0.0), follower, model)
        np.testing.assert_array_equal(still, 0.0)
        for angle in np.linspace(0.0, 6.0, 7):
            near = np.asarray(state[:2]) + 1e-3 * np.array([math.cos(angle), math.sin(angle)])
            found = law(state, near, (0.0, 0.0), follower, model)
            assert np.abs(found).max() < 0.02

    def test_it_keeps_up(self, model, follow) -> None:
        for slope, bound in ((0.0, 0.01), (0.8, 0.01)):
            along = [math.cos(slope), math.sin(slope)]
            reference = np.outer(GROUND_TIMES, along)
            _, states = follow(reference, model=model)
            assert distance(states, reference)[GROUND_TIMES > 5.0].max() < bound
        reference = circle(GROUND_TIMES, 2.0, 1.0, height=False)
        _, states = follow(reference, model=model)
        assert distance(states, reference)[GROUND_TIMES > 5.0].max() < 0.25

    def test_the_world_may_turn_and_move(self, model, follow) -> None:
        state = np.zeros(model.state_size)
        state[:3] = [0.2, -0.4, 0.5]
        reference = circle(GROUND_TIMES, 2.0, 1.0, height=False)
        controls, _ = follow(reference, state, model=model)
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        state[:2], state[2] = turn @ state[:2] + [3.0, -4.0], state[2] + math.pi / 2
        same, _ = follow(reference @ turn.T + [3.0, -4.0], state, model=model)
        np.testing.assert_allclose(same, controls, atol=2e-3)

    def test_heights_are_not_read(self, model, follow) -> None:
        reference = circle(GROUND_TIMES, 2.0, 1.0, height=False)
        controls, _ = follow(reference, model=model)
        higher = np.column_stack([reference, np.full(GROUND_STEPS, np.nan)])
        np.testing.assert_array_equal(follow(higher, model=model)[0], controls)


def test_a_unicycle_nears_a_point_ahead_exponentially(follow) -> None:
    # v = 1.5 d, held for 0.1 s: each step leaves 0.85 of the way.
    _, states = follow(held([1.0, 0.0], GROUND_STEPS), model=CARS["unicycle"])
    expected = 1.0 - 0.85 ** np.arange(1, GROUND_STEPS + 1)
    np.testing.assert_allclose(states[:, 0], expected, atol=1e-5)
    np.testing.assert_array_equal(states[:, 1:], 0.0)


def test_a_heavy_robot_brakes_in_time(follow) -> None:
    car = DifferentialDrive(max_speed=4.0, drag=0.0)
    controls, states = follow(held([9.0, 0.0], GROUND_STEPS), model=car)
    assert states[:, 0].max() < 9.02
    assert states[-1, 0] > 8.8
    braking = controls[GROUND_TIMES > 5.0, 0].min()
    assert -0.7 < braking < -0.45  # half of the greatest deceleration, and what the lag costs
    # Turning round takes half of the greatest acceleration too, and does not swing beyond.
    _, states = follow(held([-9.0, 0.5], GROUND_STEPS), model=car)
    assert states[:, 2].max() < math.pi + 0.05


def test_drag_is_made_up_for(law) -> None:
    state = jnp.asarray([0.0, 0.0, 0.0, 0.5, 0.3])
    sticky, free = (
        law(state, (1.0, 0.5), (0.2, 0.1), DifferentialDriveFollower(), DifferentialDrive(drag=c))
        for c in (0.4, 0.0)
    )
    np.testing.assert_allclose(sticky - free, [0.4 * 0.5, 0.4 * 0.3], atol=1e-5)


class TestContained:
    @pytest.mark.parametrize(
        "model",
        [FLIGHT, *CARS.values(), STEERED["car"]],
        ids=["quadrotor", *CARS, "car"],
    )
    @pytest.mark.parametrize("value", [math.nan, math.inf, 1e30])
    def test_controls_are_finite(self, model, value, follow) -> None:
        is_flight = model is FLIGHT
        times = TIMES if is_flight else GROUND_TIMES
        good = circle(times, 2.0, 1.0, height=is_flight)
        low, high = np.asarray(model.control_min), np.asarray(model.control_max)
        default = np.asarray(model.default_control)
        start = np.array(model.at_pose(0.0, 0.0, 0.0))
        for component in range(model.state_size):
            state = start.copy()
            state[component] = value
            controls, _ = follow(good, state, model=model)
            assert (controls >= low).all()
            assert (controls <= high).all()
            if math.isnan(value):
                np.testing.assert_array_equal(controls, np.tile(default, (len(good), 1)))
        for row in (0, 7, len(good) - 1):
            bad = good.copy()
            bad[row, 1] = value
            controls, states = follow(bad, model=model)
            assert (controls >= low).all()
            assert (controls <= high).all()
            if not math.isfinite(value):
                # It is on its way to the row, or just was there; then it goes on.
                gone = {max(row, 0), min(row + 1, len(good) - 1), *([1] if row == 0 else [])}
                np.testing.assert_array_equal(
                    controls[list(gone)], default[None].repeat(len(gone), 0)
                )
                if row < len(good) - 1:
                    assert distance(states, good)[-1] < 0.3

    def test_the_rollout_goes_on_from_the_last_finite_state(self, follow) -> None:
        class Gap(Unicycle):
            def step_at(self, state, control, t, dt):
                reached = self.step(state, control, dt)
                return jnp.where((t > 0.95) & (t < 1.95), jnp.nan, reached)

        reference = held([5.0, 0.0], GROUND_STEPS)
        controls, _ = follow(reference, model=Gap())
        expected, _ = follow(reference, model=Unicycle())
        # Ten steps that lead nowhere: as if they had not been.
        np.testing.assert_array_equal(controls[:10], expected[:10])
        np.testing.assert_array_equal(controls[10:20], expected[10:11].repeat(10, 0))
        np.testing.assert_array_equal(controls[20:], expected[10:-10])


def test_many_are_one_at_a_time(follow) -> None:
    states = np.stack([FLIGHT.at_pose(0.1 * i, -0.2 * i, 0.5 * i, -1.0) for i in range(4)])
    speeds = np.array([0.5, 1.0, 1.5, 2.0])
    references = np.stack([circle(TIMES, 2.0, speed) for speed in speeds])
    many = eqx.filter_jit(eqx.filter_vmap(PILOT, in_axes=(None, 0, 0, None)))(
        FLIGHT, jnp.asarray(states), jnp.asarray(references, jnp.float32), STEP
    )
    for index in range(4):
        one, _ = follow(references[index], states[index])
        np.testing.assert_allclose(many[index], one, atol=1e-3)


def test_another_gain_reference_step_or_mass_does_not_retrace(follow) -> None:
    first, _ = follow(held([1.0, 0.0, 0.0]))
    before = follow.traces
    model = Quadrotor(2.0, 9.0, 0.04, max_rate=6.0)
    pilot = QuadrotorFollower(5.0, 3.0, 6.0, 1.0, 0.5)
    second, _ = follow(circle(TIMES, 3.0, 1.0), follower=pilot, model=model, dt=jnp.float32(0.04))
    assert follow.traces == before
    assert not np.allclose(first, second)


def test_what_the_robot_is_away_from_the_first_row_is_no_velocity(follow, law) -> None:
    state = FLIGHT.at_pose(0.0, 0.0, 0.0)
    reference = np.array([0.0, 0.3, -0.2]) + np.outer(TIMES, [1.0, 0.5, 0.0])
    controls, _ = follow(reference, state)
    expected = law(state, [0.0, 0.3, -0.2], [1.0, 0.5, 0.0])
    np.testing.assert_allclose(controls[0], expected, rtol=1e-4)
    controls, _ = follow(reference[:1], state)
    np.testing.assert_allclose(controls[0], law(state, reference[0]), rtol=1e-4)


def reversal(speed, radius=1.5, length=2.0, rest=3.0):
    """Return where a robot is that drives forwards on a circle to the left, backwards on one to
    the right, and stands: poses in closed form, by steps of 0.1 s."""
    turned = speed / radius * np.arange(1, round(length / speed / 0.1) + 1) * 0.1
    first = np.column_stack([radius * np.sin(turned), radius * (1.0 - np.cos(turned)), turned])
    x, y, yaw = first[-1]
    angle = yaw + turned  # backwards on a circle to the right the nose turns left
    centre = np.array([x + radius * math.sin(yaw), y - radius * math.cos(yaw)])
    back = np.column_stack(
        [centre[0] - radius * np.sin(angle), centre[1] + radius * np.cos(angle), angle]
    )
    return np.concatenate([first, back, np.tile(back[-1], (round(rest / 0.1), 1))])


@pytest.mark.parametrize("model", STEERED.values(), ids=STEERED)
class TestSteered:
    def test_it_tracks_a_path_that_turns_back(self, model, follow) -> None:
        path = reversal(0.5)[:GROUND_STEPS]
        controls, states = follow(path[:, :2], model=model)
        away = distance(states, path[:, :2])
        # It begins at rest. At the cusp it has to brake and to turn its wheels round.
        assert away.max() < 0.3
        assert away[-1] < 0.12
        assert (controls >= np.asarray(model.control_min)).all()
        assert (controls <= np.asarray(model.control_max)).all()
        middle = round(2.0 / 0.5 / 0.1)
        assert (states[10 : middle - 5, 3] > 0.2).all()
        assert (states[middle + 15 : 2 * middle - 5, 3] < -0.2).all()
        # Its nose is where a car's is that has driven there backwards, and not where it drives to.
        assert np.abs(states[2 * middle - 5, 2] - path[2 * middle - 5, 2]) < 0.3

    def test_it_keeps_up(self, model, follow) -> None:
        along = np.outer(GROUND_TIMES, [0.8, 0.6])
        for sign, heading in ((1.0, math.atan2(0.6, 0.8)), (-1.0, math.atan2(-0.6, -0.8))):
            # Backwards at most at 1 m/s, which leaves nothing to catch up with.
            reference = (0.8 if sign < 0.0 else 1.0) * along
            state = model.at_pose(0.0, 0.0, heading)
            _, states = follow(reference, state, model=model)
            assert distance(states, reference)[GROUND_TIMES > 6.0].max() < 0.05
            assert (sign * states[5:, 3] > 0.0).all()
        reference = circle(GROUND_TIMES, 2.0, 1.0, height=False)
        _, states = follow(reference, model=model)
        assert distance(states, reference)[GROUND_TIMES > 5.0].max() < 0.2

    def test_the_world_may_turn_and_move(self, model, follow) -> None:
        reference = reversal(0.5)[:GROUND_STEPS, :2]
        controls, _ = follow(reference, model=model)
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        state = model.at_pose(3.0, -4.0, math.pi / 2)
        same, _ = follow(reference @ turn.T + [3.0, -4.0], state, model=model)
        np.testing.assert_allclose(same, controls, atol=0.02)


def test_the_inversion_of_a_differential_drive_is_its_law_in_closed_form(law) -> None:
    """a = (v_wanted - v) / response + drag v, and alpha likewise: the model is linear in both."""
    model, follower = DifferentialDrive(max_speed=9.0, max_turn_rate=9.0), TwistFollower()
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, y, yaw, v, omega = rng.uniform(-0.5, 0.5, 5)
        v, away, velocity = 1.0 + v, 0.05 * rng.normal(size=2), rng.normal(size=2)
        wanted = velocity + 1.2 * away  # too near for the gain to fall
        ahead = max(wanted @ [math.cos(yaw), math.sin(yaw)], 0.0)
        turn = math.atan2(wanted[1], wanted[0]) - yaw
        turn = (turn + math.pi) % math.tau - math.pi
        rate = 4.0 * turn * (wanted @ wanted) / (wanted @ wanted + 0.01)
        expected = [(ahead - v) / 0.2 + 0.1 * v, (rate - omega) / 0.2 + 0.1 * omega]
        low, high = np.asarray(model.control_min), np.asarray(model.control_max)
        found = law([x, y, yaw, v, omega], np.add(away, (x, y)), velocity, follower, model)
        np.testing.assert_allclose(found, np.clip(expected, low, high), atol=0.02)


def test_a_target_behind_is_backed_to_by_a_car_that_can(follow) -> None:
    model, target = STEERED["bicycle"], held([-2.0, 0.3], GROUND_STEPS)
    for reverses in (True, False):
        follower = TwistFollower(reverses=reverses)
        controls, states = follow(target, follower=follower, model=model)
        a, steering = controls[0]
        assert (a < 0.0) == reverses
        # Wheels to the left: backwards the tail swings to the left, forwards it comes round.
        assert steering > 0.1
        assert distance(states, target).min() < 0.1 if reverses else states[:, 3].min() >= 0.0


def test_a_robot_that_moves_sideways_does_so_while_it_turns(follow) -> None:
    _, states = follow(held([0.0, 1.0], GROUND_STEPS), model=OMNI)
    assert distance(states, held([0.0, 1.0], GROUND_STEPS))[-1] < 0.05
    assert states[5, 1] > 0.02
    assert np.abs(states[:15, 0]).max() < 0.3


class TestConstruction:
    def test_each_model_has_its_follower(self) -> None:
        assert type(follower_for(FLIGHT)) is QuadrotorFollower
        assert type(follower_for(DifferentialDrive())) is DifferentialDriveFollower
        assert type(follower_for(Unicycle())) is UnicycleFollower
        for model in (*STEERED.values(), OMNI):
            assert type(follower_for(model)) is TwistFollower
            assert follower_for(model).reverses
        assert not follower_for(Ackermann()).reverses
        with pytest.raises(
            ValueError,
            match=r"PointMass; accepted: a Quadrotor, or a model with x, y and yaw, without z",
        ):
            follower_for(PointMass(2))

    @pytest.mark.parametrize(
        ("follower", "accepted"),
        [
            (PILOT, "Quadrotor"),
            (UnicycleFollower(), "Unicycle"),
            (DifferentialDriveFollower(), "DifferentialDrive"),
            (TwistFollower(), "model with x, y and yaw, without z"),
        ],
    )
    def test_another_model_is_refused(self, follower, accepted) -> None:
        model = PointMass(2)
        with pytest.raises(ValueError, match=f"dynamics is a PointMass; accepted: a {accepted}"):
            follower(model, jnp.zeros(4), jnp.zeros((3, 2)), 0.1)

    @pytest.mark.parametrize("shape", [(0, 3), (4, 1), (4, 4)])
    def test_a_reference_is_made_of_positions(self, shape) -> None:
        with pytest.raises(ValueError, match=r"reference has shape .*accepted: \(T, 2\)"):
            PILOT(FLIGHT, FLIGHT.at_pose(0.0, 0.0, 0.0), jnp.zeros(shape), 0.1)

    def test_a_step_takes_time(self) -> None:
        with pytest.raises(ValueError, match=r"dt is 0.0; accepted: a finite number > 0.0"):
            PILOT(FLIGHT, FLIGHT.at_pose(0.0, 0.0, 0.0), jnp.zeros((4, 3)), 0.0)

    def test_a_quadrotor_s_target_has_a_height(self) -> None:
        with pytest.raises(ValueError, match=r"shapes \(2,\) and \(2,\); accepted: \(3,\)"):
            PILOT.control(FLIGHT, FLIGHT.at_pose(0.0, 0.0, 0.0), jnp.zeros(2), jnp.zeros(2))

    def test_a_law_of_one_s_own_is_a_method(self, follow) -> None:
        class Ahead(Follower):
            def control(self, dynamics, state, target, velocity):
                assert target.shape == velocity.shape == (2,)
                return jnp.stack([target[0], velocity[0]])

        controls, _ = follow(
            np.outer(GROUND_TIMES, [1.0, 0.0, 0.0]), follower=Ahead(), model=CARS["unicycle"]
        )
        # Where to be now and how fast, within the bounds.
        np.testing.assert_allclose(controls[:, 0], np.minimum(GROUND_TIMES - 0.1, 2.0), atol=1e-5)
        np.testing.assert_allclose(controls[:, 1], 1.0, rtol=1e-4)


HORIZON = 25


def planner(parameterisation, controls, std, fraction=0.5) -> MPPI:
    return MPPI(
        FLIGHT,
        10.0 * ReferenceCost(jnp.zeros((HORIZON + 1, 3)), STEP),
        horizon=HORIZON,
        num_samples=64,
        dt=STEP,
        weighting=Softmax(5.0),
        parameterisation=parameterisation,
        proposal=BiasedProposal(GaussianProposal(std), controls, fraction, likelihood_ratio=False),
    )


@pytest.mark.parametrize(
    ("parameterisation", "away"),
    [(Direct(), 1e-4), (Smooth(), 1e-4), (Knots(9), 0.2)],
    ids=["direct", "smooth", "knots"],
)
def test_a_proposal_samples_around_the_controls(parameterisation, away, follow) -> None:
    reference = circle(TIMES, 2.0, 1.5)
    controls, states = follow(reference)
    few = jnp.asarray(controls[:HORIZON])
    mppi = planner(parameterisation, few, [1e-6] * 4, fraction=1.0)
    state = FLIGHT.at_pose(0.0, 0.0, 0.0)
    _, _, info = eqx.filter_jit(mppi.step)(mppi.init(), state, key=jax.random.key(0))
    reached = flown(state, info.controls, 0.05)
    assert distance(reached, states[:HORIZON, :3]).max() < away


def test_few_samples_track_better_around_a_follower() -> None:
    hover = jnp.broadcast_to(FLIGHT.default_control, (HORIZON, 4))
    mppi = planner(Direct(), hover, [3.0, 1.0, 1.0, 1.0])

    @eqx.filter_jit
    def fly(mppi, pilot, is_followed, key):
        def advance(carry, index):
            x, state = carry
            times = STEP * (index.astype(jnp.float32) + jnp.arange(HORIZON + 1, dtype=jnp.float32))
            path = 2.0 * times[:, None] * jnp.asarray([1.0, 0.0, 0.0])
            controls = jnp.where(is_followed, pilot(FLIGHT, x, path[1:], STEP), hover)
            controller = eqx.tree_at(
                lambda c: (c.proposal.reference, c.cost.cost.reference), mppi, (controls, path)
            )
            control, state, _ = controller.step(state, x, key=jax.random.fold_in(key, index))
            x = FLIGHT.step(x, control, STEP)
            return (x, state), jnp.linalg.norm(x[:3] - path[1])

        start = (FLIGHT.at_pose(0.0, 0.0, 0.0), mppi.init())
        return jax.lax.scan(advance, start, jnp.arange(30))[1]

    for seed in range(3):
        key = jax.random.key(seed)
        followed, alone = (
            np.asarray(fly(mppi, PILOT, jnp.asarray(given), key)) for given in (True, False)
        )
        assert followed.mean() < 0.6 * alone.mean()
        assert followed[-10:].mean() < 0.1
