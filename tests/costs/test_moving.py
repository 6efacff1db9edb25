import itertools
import math
from types import SimpleNamespace

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, DifferentialDrive, DiscObstacleCost, MovingObstacleCost, State
from jaxplore.belief import Obstacles
from jaxplore.belief.belief import Belief
from jaxplore.control import rollout_costs
from jaxplore.geometry import Outlines
from jaxplore.geometry.footprint import Rectangle

pytestmark = pytest.mark.long

REACH = st.floats(-6, 6, width=32)
ANGLE = st.floats(-7, 7, width=32)
POINT = st.tuples(REACH, REACH)
TIME = st.floats(0, 3, width=32)


def rows(count: int, size: int = 2, bound: float = 5.0):
    return hnp.arrays(np.float32, (count, size), elements=st.floats(-bound, bound, width=32))


def numbers(count: int, low: float, high: float):
    return hnp.arrays(np.float32, count, elements=st.floats(low, high, width=32))


# Nearness to obstacles that are given


def nearness(positions, velocities, radii=0.0, **certainty) -> MovingObstacleCost:
    """Return the cost of being near discs, without one of contact."""
    discs = Obstacles(Outlines.discs(positions, radii), velocities, **certainty)
    return MovingObstacleCost(discs, collision=None)


def covariances(spread: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return (N, 2, 2) with standard deviations (N, 2) along axes that are turned by (N,)."""
    turned = [np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) for a in angle]
    return np.stack([q @ np.diag(s**2) @ q.T for q, s in zip(turned, spread, strict=True)])


@given(
    positions=rows(4, bound=3.0),
    velocities=rows(4, bound=2.0),
    radii=numbers(4, 0, 1),
    spread=hnp.arrays(np.float32, (4, 2), elements=st.floats(0.125, 2, width=32)),
    angle=numbers(4, -3, 3),
    growth=numbers(4, 0, 1),
    here=POINT,
    t=st.floats(0, 3, width=32),
)
def test_gaussians_go_on_straight_and_grow(
    positions, velocities, radii, spread, angle, growth, here, t, price, drone, shuffled
) -> None:
    covariance = covariances(spread.astype(np.float64), angle)
    expected = 0.0
    for n in range(4):
        extent = 0.3 + float(radii[n])
        s = covariance[n] + ((float(growth[n]) * t) ** 2 + extent**2) * np.eye(2)
        d = np.asarray(here, np.float64) - (positions[n] + velocities[n].astype(np.float64) * t)
        expected += math.exp(-0.5 * d @ np.linalg.solve(s, d))
    cost = nearness(positions, velocities, radii, covariance=covariance, growth=growth)
    for make in (drone, shuffled):
        found = price(cost, make(x=here[0], y=here[1], z=9.0, yaw=1.0), t)
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)


def test_it_is_what_an_exact_obstacle_costs_on_average_with_the_peak_at_one(price, drone) -> None:
    """Gauss-Hermite quadrature over where the obstacle is and how fast it goes."""
    position, velocity, t = np.array([1.0, -0.5]), np.array([0.4, 0.8]), 1.5
    covariance, growth, extent = np.array([[0.3, 0.1], [0.1, 0.2]]), 0.3, 0.3 + 0.4
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    weights = weights / weights.sum()
    root = np.linalg.cholesky(covariance)

    def average(here: np.ndarray) -> float:
        # The sum of the two independent normal errors along each axis, one axis after the other.
        total = 0.0
        spread = np.linalg.cholesky(root @ root.T + (growth * t) ** 2 * np.eye(2))
        for a, first in zip(nodes, weights, strict=True):
            for b, second in zip(nodes, weights, strict=True):
                there = position + velocity * t + spread @ np.array([a, b])
                square = ((here - there) ** 2).sum()
                total += first * second * math.exp(-0.5 * square / extent**2)
        return total

    cost = nearness([position], [velocity], 0.4, covariance=covariance, growth=growth)
    peak = average(position + velocity * t)
    for here in ((1.6, 0.7), (2.5, 0.2), (0.0, 0.0), (1.0, 2.5)):
        found = price(cost, drone(x=here[0], y=here[1]), t)
        assert found == pytest.approx(average(np.array(here)) / peak, rel=1e-3)


def test_one_number_is_for_all_and_a_deviation_is_a_covariance(price, drone) -> None:
    positions, velocities = np.array([[1.0, 0.0], [-1.0, 0.5]]), np.ones((2, 2))
    same = [
        nearness(positions, velocities, 0.2, std=0.5, growth=0.1),
        nearness(positions, velocities, [0.2, 0.2], std=[0.5, 0.5], growth=[0.1, 0.1]),
        nearness(positions, velocities, 0.2, covariance=0.25 * np.eye(2), growth=0.1),
    ]
    values = [price(cost, drone(x=0.3), 0.7) for cost in same]
    assert values[1:] == pytest.approx(values[:1] * 2, rel=1e-6)
    default = nearness(positions, velocities)
    explicit = nearness(positions, velocities, 0.0, std=0.0, growth=0.0)
    assert price(default, drone(), 0.7) == price(explicit, drone(), 0.7)


def test_the_peak_stays_one_and_the_reach_grows(price, drone) -> None:
    cost = nearness([[0.0, 0.0]], [[1.0, 0.0]], std=0.1, growth=0.5)
    for t in (0.0, 1.0, 5.0):
        assert price(cost, drone(x=t), t) == pytest.approx(1.0, abs=1e-5)
    beside = [price(cost, drone(x=t, y=1.0), t) for t in (0.0, 1.0, 5.0)]
    assert (np.diff(beside) > 0.05).all()


def test_contact_with_an_obstacle_known_exactly(price, drone) -> None:
    cost = nearness([[0.0, 0.0]], [[0.0, 0.0]], 0.4, std=1e-4, growth=0.0)
    assert price(cost, drone(x=0.3 + 0.4), 2.0) == pytest.approx(math.exp(-0.5), rel=1e-4)


def test_a_waiting_robot_is_passed_at_the_time_predicted(belief) -> None:
    robot, dt, steps = DifferentialDrive(radius=0.2), 0.1, 20
    cost = nearness([[-1.0, 0.1]], [[1.0, 0.0]], 0.3, std=0.1, growth=0.2)
    start, controls = jnp.zeros(5), jnp.zeros((steps, 2, 1))
    found = float(rollout_costs(robot, cost, start, controls, jnp.asarray(dt), belief)[0])
    expected = 0.0
    for t in dt * np.arange(1, steps + 1):
        variance = 0.1**2 + (0.2 * t) ** 2 + 0.5**2
        expected += math.exp(-0.5 * ((t - 1.0) ** 2 + 0.1**2) / variance)
    assert found == pytest.approx(expected, rel=1e-4)


@given(
    here=POINT,
    places=rows(3),
    velocities=rows(3, bound=2.0),
    yaw=ANGLE,
    angle=ANGLE,
    shift=POINT,
    t=st.floats(0, 2, width=32),
)
def test_where_the_world_is_does_not_matter(
    here, places, velocities, yaw, angle, shift, t, price, drone, moved
) -> None:
    def cost(angle: float, shift) -> float:
        x, y = moved(here, angle, shift)
        centres, moves = moved(places, angle, shift), moved(velocities, angle)
        covariance = covariances(np.array([[0.3, 1.0]]), np.array([0.4 + angle]))[0]
        state = drone(x=x, y=y, yaw=yaw + angle, v=1.0)
        return price(nearness(centres, moves, 0.4, covariance=covariance), state, t)

    assert cost(angle, shift) == pytest.approx(cost(0.0, (0.0, 0.0)), rel=1e-3, abs=1e-3)


def test_the_slope_at_the_centre_is_zero(slope, drone) -> None:
    cost = nearness([[0.0, 0.0]], [[0.0, 0.0]])
    np.testing.assert_array_equal(slope(cost, drone())[:3], 0.0)
    assert slope(cost, drone(x=0.2))[0] < -0.1


# Three discs of 0.5 m, 1.2 m apart in all, of which the rearmost is at the position.
CAR = Ackermann(min_speed=-2.0, footprint=Rectangle(1.5, 0.3, 0.8, num_discs=3))
LEVERS, RADIUS = (0.0, 0.6, 1.2), 0.5


def car(x: float, y: float, yaw: float, v: float = 0.0) -> State:
    return State(jnp.asarray([x, y, yaw, v, 0.1], jnp.float32), CAR)


def discs(here, yaw: float) -> np.ndarray:
    """Return the centres (3, 2) of the car's discs, double precision."""
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    return np.asarray(here, np.float64) + np.outer(LEVERS, ahead)


def gaussian(offsets: np.ndarray, covariance: np.ndarray) -> float:
    """Return the greatest of the Gaussians at offsets (C, 2), with the peak at one."""
    return max(math.exp(-0.5 * d @ np.linalg.solve(covariance, d)) for d in offsets)


@given(
    positions=rows(2, bound=3.0),
    velocities=rows(2, bound=2.0),
    radii=numbers(2, 0, 1),
    here=POINT,
    yaw=ANGLE,
    t=TIME,
)
def test_of_a_rectangle_the_disc_nearest_to_the_gaussian_counts(
    positions, velocities, radii, here, yaw, t, price
) -> None:
    covariance = np.array([[0.5, 0.2], [0.2, 0.3]])
    expected = 0.0
    for n in range(2):
        s = covariance + ((0.2 * t) ** 2 + (RADIUS + float(radii[n])) ** 2) * np.eye(2)
        there = positions[n] + velocities[n].astype(np.float64) * t
        expected += gaussian(discs(here, yaw) - there, s)
    cost = nearness(positions, velocities, radii, covariance=covariance, growth=0.2)
    assert price(cost, car(*here, yaw), t) == pytest.approx(expected, rel=1e-3, abs=1e-4)


def test_a_disc_pays_what_it_did_to_the_bit(drone) -> None:
    covariance = [[0.5, 0.2], [0.2, 0.3]]
    cost = nearness([[0.5, -0.5]], [[1.0, 0.3]], 0.4, covariance=covariance, growth=0.2)
    robot, disc = drone().dynamics, cost.obstacles

    def former(values, t):
        extent, drift = robot.radius + disc.outlines.radii, (disc.growth * t) * (disc.growth * t)
        a, b = disc.covariance[:, 0, 0] + drift + extent * extent, disc.covariance[:, 0, 1]
        c = disc.covariance[:, 1, 1] + drift + extent * extent
        scale = -0.5 / (a * c - b * b)
        x, y = values[:2] - (disc.centres + t * disc.velocities)[0]
        p, q, r = scale * c, -2.0 * scale * b, scale * a
        return jnp.zeros(()) + jnp.exp(p[0] * x * x + q[0] * x * y + r[0] * y * y)

    def stage(values, t):
        return cost.stage(State(values, robot), jnp.zeros(3), t, None)

    states = np.random.default_rng(0).uniform(-2, 2, (200, 5))
    many = jnp.asarray(states, jnp.float32), jnp.linspace(0.0, 2.0, 200)
    # One operation after the other: compiled, the two would round their sums differently.
    with jax.disable_jit():
        found, expected = (jax.vmap(form)(*many) for form in (stage, former))
    np.testing.assert_array_equal(found, expected)


MOVING = {"positions": np.zeros((2, 2)), "velocities": np.zeros((2, 2))}


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        ({"positions": np.zeros((2, 3))}, r"centres has shape \(2, 3\); acc"),
        ({"velocities": np.zeros((3, 2))}, r"velocities has shape \(3, 2\)"),
        ({"radii": -1.0}, "radii has a value -1.0; accepted"),
        ({"covariance": np.eye(3)}, r"covariance has shape \(3, 3\); accepted"),
        ({"covariance": -np.eye(2)}, "covariance is .*; accepted: symmetric"),
        ({"covariance": [[1.0, 0.5], [0.0, 1.0]]}, "accepted: symmetric and"),
        ({"covariance": np.eye(2), "std": 1.0}, "accepted: one of them"),
    ],
)
def test_bad_input_is_named(changes, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        nearness(**{**MOVING, **changes})


def test_traced_numbers_pass() -> None:
    made = jax.jit(lambda c: nearness(**MOVING, covariance=c))(-jnp.eye(2))
    assert float(made.obstacles.covariance[1, 0, 0]) == -1.0


# Nearness to obstacles of the belief, and contact


def tracked(positions, velocities, radii, std, is_known=None, growth: float = 0.2) -> Belief:
    """Return a belief of nothing but discs; of those that are not known nothing is checked."""
    place, velocity, size, spread = (
        jnp.asarray(a, jnp.float32) for a in (positions, velocities, radii, std)
    )
    discs = Obstacles.unseen(size, growth)
    discs = eqx.tree_at(
        lambda some: (some.outlines.corners, some.centres, some.velocities, some.covariance),
        discs,
        (place[:, None], place, velocity, spread[:, None, None] ** 2 * jnp.eye(2)),
    )
    known = np.ones(len(place), bool) if is_known is None else np.asarray(is_known)
    return Belief(obstacles=eqx.tree_at(lambda some: some.is_known, discs, jnp.asarray(known)))


@eqx.filter_jit
def _pay(cost, state, t, belief):
    return cost.stage(state, jnp.zeros(state.dynamics.control_size), t, belief)


def pay(cost, state: State, belief: Belief, t: float = 0.0) -> float:
    return float(_pay(cost, state, jnp.asarray(t, jnp.float32), belief))


@given(
    positions=rows(4, bound=3.0),
    velocities=rows(4, bound=2.0),
    radii=numbers(4, 0, 1),
    std=numbers(4, 0.125, 1),
    is_known=hnp.arrays(bool, 4),
    growth=st.floats(0, 1, width=32),
    here=POINT,
    yaw=ANGLE,
    v=st.floats(-2, 2, width=32),
    t=TIME,
)
def test_each_known_obstacle_costs_a_gaussian_and_contact(
    positions, velocities, radii, std, is_known, growth, here, yaw, v, t
) -> None:
    contact = RADIUS + 0.07 + 0.1 * abs(v)
    expected = 0.0
    for n in np.flatnonzero(is_known):
        there = positions[n] + velocities[n].astype(np.float64) * t
        away = discs(here, yaw) - there
        variance = float(std[n]) ** 2 + (growth * t) ** 2 + (RADIUS + float(radii[n])) ** 2
        gap = np.hypot(*away.T).min() - float(radii[n])
        expected += gaussian(away, variance * np.eye(2))
        expected += 3.0 * (max(contact - gap, 0.0) / 0.05) ** 2
    belief = tracked(positions, velocities, radii, std, is_known, growth)
    cost = MovingObstacleCost(margin=0.07, reaction_time=0.1, collision=3.0)
    found = pay(cost, car(*here, yaw, v), belief, t)
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_without_contact_it_is_the_cost_of_the_same_moving_obstacles(price, drone) -> None:
    positions, velocities = [[1.0, 0.0], [-1.0, 0.5]], [[0.5, 1.0], [0.0, -0.3]]
    belief = tracked(positions, velocities, [0.2, 0.4], [0.3, 0.1])
    given = nearness(positions, velocities, [0.2, 0.4], std=[0.3, 0.1], growth=0.2)
    for t, collision in itertools.product((0.0, 0.7, 2.0), (0.0, None)):
        found = pay(MovingObstacleCost(collision=collision), drone(x=0.3), belief, t)
        assert found == pytest.approx(price(given, drone(x=0.3), t), rel=1e-6)


def test_defaults(drone) -> None:
    # 0.3 m of radius, 0.1 m of margin, 0.05 s at 2 m/s: 5 cm too close once.
    belief = tracked([[0.0, 0.0]], [[0.0, 0.0]], [1.0], [0.2])
    far = math.exp(-0.5 * 1.45**2 / (0.2**2 + 1.3**2))
    assert pay(MovingObstacleCost(), drone(x=1.45, v=2.0), belief) == pytest.approx(
        far + 100.0, rel=1e-3
    )
    far = math.exp(-0.5 * 1.51**2 / (0.2**2 + 1.3**2))
    assert pay(MovingObstacleCost(), drone(x=1.51, v=2.0), belief) == pytest.approx(far, rel=1e-5)


def test_without_obstacles_it_costs_nothing(drone) -> None:
    for state in (drone(), car(0.0, 0.0, 1.0)):
        assert pay(MovingObstacleCost(), state, Belief(obstacles=Obstacles.unseen(()))) == 0.0
    unseen = Belief(obstacles=Obstacles.unseen([0.5, 0.5]))
    assert pay(MovingObstacleCost(), drone(), unseen) == 0.0


def test_what_was_never_seen_need_not_be_a_number(drone) -> None:
    positions, is_known = [[1.0, 0.0], [np.nan, np.inf]], [True, False]
    belief = tracked(positions, [[0.0, 0.0], [np.nan] * 2], [0.2, 0.2], [0.1, np.nan], is_known)
    alone = tracked(positions[:1], [[0.0, 0.0]], [0.2], [0.1])
    state = drone(x=0.4)
    cost = MovingObstacleCost()
    assert pay(cost, state, belief) == pytest.approx(pay(cost, state, alone), rel=1e-6)

    def along(values):
        return _pay(cost, State(values, state.dynamics), jnp.zeros(()), belief)

    for values in (state.values, jnp.asarray([1.0, 0.0, 0.0, 0.0, 0.0])):
        assert np.isfinite(jax.grad(along)(values)).all()


def test_a_robot_that_is_passed_pays_when_it_is_passed() -> None:
    # One that drives past it at 1 m/s, 0.6 m beside; both have a radius of 0.2 m.
    robot, dt, steps = DifferentialDrive(radius=0.2), 0.1, 20
    belief = tracked([[-1.0, 0.6]], [[1.0, 0.0]], [0.2], [0.1])
    cost = MovingObstacleCost(margin=0.3, collision=2.0)
    start, controls = jnp.zeros(5), jnp.zeros((steps, 2, 1))
    found = float(rollout_costs(robot, cost, start, controls, jnp.asarray(dt), belief)[0])
    expected = 0.0
    for t in dt * np.arange(1, steps + 1):
        away = math.hypot(t - 1.0, 0.6)
        variance = 0.1**2 + (0.2 * t) ** 2 + 0.4**2
        expected += math.exp(-0.5 * away**2 / variance)
        expected += 2.0 * (max(0.5 - (away - 0.2), 0.0) / 0.05) ** 2
    assert expected > 10.0
    assert found == pytest.approx(expected, rel=1e-3)


def test_another_number_does_not_recompile(drone) -> None:
    traces = []

    @eqx.filter_jit
    def price(cost, state, belief):
        traces.append("compiled")
        return cost.stage(state, jnp.zeros(3), jnp.zeros(()), belief)

    for shift in (0.0, 1.0):
        cost = MovingObstacleCost(
            margin=0.1 + shift, reaction_time=0.2 + shift, collision=3.0 + shift, caution=shift
        )
        belief = tracked([[shift, 0.0]], [[0.0, 0.0]], [shift], [0.1 + shift], [shift > 0.0])
        price(cost, drone(x=shift), belief)
    assert len(traces) == 1


@pytest.mark.parametrize(
    "name", ["nearness", "clearance", "collision", "margin", "reaction_time", "caution"]
)
def test_several_numbers_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} has shape .*; accepted: "):
        MovingObstacleCost(**{name: np.ones(2)})


# Distance kept from outlines


def keeping(obstacles: Obstacles | None = None, **changes) -> MovingObstacleCost:
    """Return the cost of the distance from the nearest obstacle alone."""
    numbers = {"clearance": 0.4, "margin": 0.02, "caution": 1.0, **changes}
    return MovingObstacleCost(obstacles, nearness=None, nearest_only=True, **numbers)


SETTINGS = {"clearance": 0.5, "collision": 7.0, "margin": 0.05, "reaction_time": 0.1}
CENTRES = np.array([[1.0, 0.5], [-2.0, 1.0], [0.0, -3.0]])
RADII = [0.5, 0.3, 1.0]
VELOCITIES = np.array([[0.5, 0.0], [0.0, -1.0], [0.0, 0.0]])
SQUARE = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])


@given(
    here=POINT,
    t=st.floats(0, 3, width=32),
    v=st.floats(0, 2, width=32),
    caution=st.sampled_from([None, 1.0]),
)
def test_discs_cost_what_discs_cost_where_they_are_by_then(
    here, t, v, caution, price, drone
) -> None:
    moving = keeping(
        Obstacles(Outlines.discs(CENTRES, RADII), VELOCITIES), caution=caution, **SETTINGS
    )
    there = DiscObstacleCost(CENTRES + t * VELOCITIES, RADII, **SETTINGS)
    state = drone(x=here[0], y=here[1], v=v)
    assert price(moving, state, t) == pytest.approx(price(there, state), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("x", "y", "gap"), [(0.6, 1.5, 0.4), (1.5, 2.6, 0.6), (1.5, 1.75, -0.25), (0.7, 0.6, 0.5)]
)
def test_polygons_by_hand(x, y, gap, price, drone) -> None:
    cost = keeping(
        Obstacles(Outlines.polygons([SQUARE])),
        clearance=1.0,
        collision=7.0,
        margin=0.05,
        reaction_time=0.0,
    )
    too_close = float(drone().dynamics.radius) + 0.05
    expected = max(1.0 - gap, 0.0) ** 2 + 7.0 * (max(too_close - gap, 0.0) / 0.05) ** 2
    assert price(cost, drone(x=x, y=y)) == pytest.approx(expected, rel=1e-4)


def test_an_obstacle_that_turns_takes_its_corners_with_it(drone) -> None:
    bar = Outlines.polygons([[[-2.0, -0.1], [2.0, -0.1], [2.0, 0.1], [-2.0, 0.1]]])
    turning = Obstacles(bar, None, np.pi / 2)
    cost = MovingObstacleCost()
    state = drone(x=0.0, y=2.5)
    now, later = (float(cost.distance(state, jnp.asarray(t), turning)) for t in (0.0, 1.0))
    assert now == pytest.approx(2.4)
    assert later == pytest.approx(0.5, abs=1e-5)
    assert float(cost.room(state, turning)) == pytest.approx(2.4 - float(state.dynamics.radius))


def test_what_is_uncertain_along_the_way_is_kept_free(drone) -> None:
    covariance = np.array([[0.09, 0.0], [0.0, 0.01]])
    obstacle = Obstacles(
        Outlines.discs([[0.0, 0.0]], 0.5), covariance=covariance, growth=0.2, velocities=[[0, 0]]
    )
    cost = MovingObstacleCost(caution=2.0)
    for x, y, variance in ((3.0, 0.0, 0.09), (0.0, 3.0, 0.01), (3.0, 3.0, 0.05)):
        expected = np.hypot(x, y) - 0.5 - 2.0 * np.sqrt(variance + 0.16)
        found = cost.distance(drone(x=x, y=y), jnp.asarray(2.0), obstacle)
        assert float(found) == pytest.approx(expected, rel=1e-5)


def test_every_disc_of_a_robot_counts() -> None:
    robot = Ackermann(footprint=Rectangle(2.0, 0.0, 0.5, num_discs=2))
    state = State(robot.at_pose(0.0, 0.0, 0.0), robot)
    obstacles = Obstacles(Outlines.discs([[1.5, 2.0]], 0.5))
    room = float(MovingObstacleCost().room(state, obstacles))
    assert room == pytest.approx(2.0 - 0.5 - float(robot.radius), rel=1e-5)


def test_obstacles_come_with_the_belief_too(drone) -> None:
    obstacles = Obstacles(Outlines.discs(CENTRES, RADII))
    own, read = keeping(obstacles), keeping()
    state, control, t = drone(x=0.3, y=0.2), jnp.zeros(3), jnp.zeros(())
    expected = own.stage(state, control, t, None)
    assert expected > 0.0
    for belief in (Belief(obstacles=obstacles), SimpleNamespace(obstacles=obstacles)):
        assert read.stage(state, control, t, belief) == expected
