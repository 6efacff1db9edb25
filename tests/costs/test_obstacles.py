import math

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import (
    Cost,
    DifferentialDrive,
    DiscObstacleCost,
    MovingObstacleCost,
    ObstacleCost,
    rollout_costs,
)

REACH = st.floats(-6, 6, width=32)
ANGLE = st.floats(-7, 7, width=32)
POINT = st.tuples(REACH, REACH)


def rows(count: int, size: int = 2, bound: float = 5.0):
    return hnp.arrays(np.float32, (count, size), elements=st.floats(-bound, bound, width=32))


def numbers(count: int, low: float, high: float):
    return hnp.arrays(np.float32, count, elements=st.floats(low, high, width=32))


# ObstacleCost


@pytest.mark.parametrize(("x", "v"), [(6.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.4, 0.0), (1.0, 1.0)])
def test_obstacle_cost(x: float, v: float, stage, at) -> None:
    d, contact = 0.1 * x, 0.2 + 0.05 + 0.1 * v
    expected = max(0.5 - d, 0.0) ** 2 / 0.25
    if d < contact:
        expected += 7.0 * ((contact - d) / 0.05) ** 2
    cost = ObstacleCost(clearance=0.5, collision=7.0, margin=0.05, reaction_time=0.1)
    assert stage(cost, at(x, 4.0, v=v)) == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_obstacle_cost_rises_into_the_obstacle_and_off_the_map(stage, at) -> None:
    cost = ObstacleCost()
    values = [stage(cost, at(x, 4.0)) for x in (3.0, 2.0, 1.0, 0.6, -1.0)]
    assert (np.diff(values) > 0).all()


def test_the_same_cost_serves_another_model(stage, at, sled, belief) -> None:
    cost = ObstacleCost()
    expected = stage(cost, at(4.0, 3.0, v=0.7))
    found = cost.stage(sled(4.0, 3.0, 0.7), jnp.zeros(1), jnp.asarray(0.1), belief)
    assert float(found) == pytest.approx(expected)


# DiscObstacleCost


@given(centres=rows(5), radii=numbers(5, 0, 2), here=POINT, v=st.floats(-2, 2, width=32))
def test_the_nearest_disc_counts(centres, radii, here, v, price, drone) -> None:
    distance = min(
        math.dist(centre, here) - radius for centre, radius in zip(centres, radii, strict=True)
    )
    near = max(0.9 - distance, 0.0) / 0.9
    depth = max(0.3 + 0.05 + 0.1 * abs(v) - distance, 0.0) / 0.05
    cost = DiscObstacleCost(centres, radii, 0.9, 7.0, 0.05, 0.1)
    found = price(cost, drone(x=here[0], y=here[1], z=3.0, v=v))
    assert found == pytest.approx(near**2 + 7.0 * depth**2, rel=1e-4, abs=1e-2)


def test_spheres_are_compared_with_z(price, drone, shuffled) -> None:
    centre, here = np.array([[1.0, 2.0, -3.0]]), {"x": 3.0, "y": -1.0, "z": 3.0}
    cost = DiscObstacleCost(centre, 6.5, clearance=2.0, collision=0.0)
    for make in (drone, shuffled):
        assert price(cost, make(**here)) == pytest.approx((1.5 / 2.0) ** 2)


@pytest.mark.parametrize(("x", "v"), [(6.0, 0.0), (4.0, 2.0), (2.4, 0.0), (1.0, 1.0)])
def test_a_disc_costs_what_the_same_obstacle_on_the_map_does(x, v, stage, at) -> None:
    # The belief's clearance is 0.1 x: that of a disc whose surface is so far ahead.
    state = at(x, 4.0, v=v)
    settings = {"clearance": 0.5, "collision": 7.0, "margin": 0.05, "reaction_time": 0.1}
    disc = DiscObstacleCost([[x + 2.0 + 0.1 * x, 4.0]], 2.0, **settings)
    assert stage(disc, state) == pytest.approx(stage(ObstacleCost(**settings), state), rel=1e-3)


def test_discs_have_the_defaults_of_the_map() -> None:
    disc, obstacle = DiscObstacleCost([[0.0, 0.0]], 1.0), ObstacleCost()
    for name in ("clearance", "collision", "margin", "reaction_time"):
        assert float(getattr(disc, name)) == float(getattr(obstacle, name))


def test_deeper_inside_a_disc_costs_more_up_to_its_centre(price, drone) -> None:
    cost = DiscObstacleCost([[0.0, 0.0]], 2.0)
    values = [price(cost, drone(x=x)) for x in (2.6, 2.2, 1.5, 0.5, 0.0)]
    assert (np.diff(values) > 0).all()


# MovingObstacleCost


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
    cost = MovingObstacleCost(positions, velocities, radii, covariance=covariance, growth=growth)
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

    cost = MovingObstacleCost([position], [velocity], 0.4, covariance=covariance, growth=growth)
    peak = average(position + velocity * t)
    for here in ((1.6, 0.7), (2.5, 0.2), (0.0, 0.0), (1.0, 2.5)):
        found = price(cost, drone(x=here[0], y=here[1]), t)
        assert found == pytest.approx(average(np.array(here)) / peak, rel=1e-3)


def test_one_number_is_for_all_and_a_deviation_is_a_covariance(price, drone) -> None:
    positions, velocities = np.array([[1.0, 0.0], [-1.0, 0.5]]), np.ones((2, 2))
    same = [
        MovingObstacleCost(positions, velocities, 0.2, std=0.5, growth=0.1),
        MovingObstacleCost(positions, velocities, [0.2, 0.2], std=[0.5, 0.5], growth=[0.1, 0.1]),
        MovingObstacleCost(positions, velocities, 0.2, covariance=0.25 * np.eye(2), growth=0.1),
    ]
    values = [price(cost, drone(x=0.3), 0.7) for cost in same]
    assert values[1:] == pytest.approx(values[:1] * 2, rel=1e-6)
    default = MovingObstacleCost(positions, velocities)
    explicit = MovingObstacleCost(positions, velocities, 0.0, 0.2, growth=0.2)
    assert price(default, drone(), 0.7) == price(explicit, drone(), 0.7)


def test_the_peak_stays_one_and_the_reach_grows(price, drone) -> None:
    cost = MovingObstacleCost([[0.0, 0.0]], [[1.0, 0.0]], std=0.1, growth=0.5)
    for t in (0.0, 1.0, 5.0):
        assert price(cost, drone(x=t), t) == pytest.approx(1.0, abs=1e-5)
    beside = [price(cost, drone(x=t, y=1.0), t) for t in (0.0, 1.0, 5.0)]
    assert (np.diff(beside) > 0.05).all()


def test_contact_with_an_obstacle_known_exactly(price, drone) -> None:
    cost = MovingObstacleCost([[0.0, 0.0]], [[0.0, 0.0]], 0.4, std=1e-4, growth=0.0)
    assert price(cost, drone(x=0.3 + 0.4), 2.0) == pytest.approx(math.exp(-0.5), rel=1e-4)


def test_a_waiting_robot_is_passed_at_the_time_predicted(belief) -> None:
    robot, dt, steps = DifferentialDrive(radius=0.2), 0.1, 20
    cost = MovingObstacleCost([[-1.0, 0.1]], [[1.0, 0.0]], 0.3, std=0.1, growth=0.2)
    start, controls = jnp.zeros(5), jnp.zeros((steps, 2, 1))
    found = float(rollout_costs(robot, cost, start, controls, jnp.asarray(dt), belief)[0])
    expected = 0.0
    for t in dt * np.arange(1, steps + 1):
        variance = 0.1**2 + (0.2 * t) ** 2 + 0.5**2
        expected += math.exp(-0.5 * ((t - 1.0) ** 2 + 0.1**2) / variance)
    assert found == pytest.approx(expected, rel=1e-4)


# Both


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
    def costs(angle: float, shift) -> list[float]:
        x, y = moved(here, angle, shift)
        centres, moves = moved(places, angle, shift), moved(velocities, angle)
        covariance = covariances(np.array([[0.3, 1.0]]), np.array([0.4 + angle]))[0]
        state = drone(x=x, y=y, yaw=yaw + angle, v=1.0)
        return [
            price(cost, state, t)
            for cost in (
                DiscObstacleCost(centres, 0.3, 4.0, collision=0.01),
                MovingObstacleCost(centres, moves, 0.4, covariance=covariance),
            )
        ]

    assert costs(angle, shift) == pytest.approx(costs(0.0, (0.0, 0.0)), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    "cost",
    [
        DiscObstacleCost([[0.0, 0.0], [0.0, 0.0]], 0.5),
        DiscObstacleCost([[0.0, 0.0, 0.0]], 0.5),
        MovingObstacleCost([[0.0, 0.0]], [[0.0, 0.0]]),
    ],
)
def test_the_slope_at_the_centre_is_zero(cost: Cost, slope, drone) -> None:
    np.testing.assert_array_equal(slope(cost, drone())[:3], 0.0)
    assert slope(cost, drone(x=0.2))[0] < -0.1


MOVING = {"positions": np.zeros((2, 2)), "velocities": np.zeros((2, 2))}
DISCS = {"centres": np.zeros((2, 2)), "radii": 1.0}


@pytest.mark.parametrize(
    ("cost", "changes", "culprit"),
    [
        (ObstacleCost, {"clearance": 0.0}, "clearance is 0.0; accepted"),
        (ObstacleCost, {"collision": -1.0}, "collision is -1.0; accepted"),
        (ObstacleCost, {"margin": -0.1}, "margin is -0.1; accepted"),
        (ObstacleCost, {"reaction_time": math.nan}, "reaction_time is nan; accepted"),
        (DiscObstacleCost, {"centres": np.zeros(2)}, r"centres has shape \(2,\); accepted: \(N, 2"),
        (DiscObstacleCost, {"centres": np.zeros((0, 2))}, r"centres has shape \(0, 2\); accepted"),
        (DiscObstacleCost, {"centres": np.full((2, 2), np.nan)}, "centres has a value nan; acc"),
        (DiscObstacleCost, {"radii": -1.0}, "radii has a value -1.0; accepted: .* >= 0.0"),
        (
            DiscObstacleCost,
            {"radii": np.ones(3)},
            r"radii has shape \(3,\); .*: one number or \(2,",
        ),
        (DiscObstacleCost, {"clearance": 0.0}, "clearance is 0.0; accepted"),
        (DiscObstacleCost, {"collision": -1.0}, "collision is -1.0; accepted"),
        (DiscObstacleCost, {"margin": -0.1}, "margin is -0.1; accepted"),
        (DiscObstacleCost, {"reaction_time": -0.1}, "reaction_time is -0.1; accepted"),
        (MovingObstacleCost, {"positions": np.zeros((2, 3))}, r"positions has shape \(2, 3\); acc"),
        (MovingObstacleCost, {"velocities": np.zeros((3, 2))}, r"velocities has shape \(3, 2\)"),
        (MovingObstacleCost, {"radii": -1.0}, "radii has a value -1.0; accepted"),
        (MovingObstacleCost, {"std": 0.0}, "std has a value 0.0; accepted: finite numbers > 0.0"),
        (MovingObstacleCost, {"growth": -1.0}, "growth has a value -1.0; accepted"),
        (MovingObstacleCost, {"covariance": np.eye(3)}, r"covariance has shape \(3, 3\); accepted"),
        (MovingObstacleCost, {"covariance": -np.eye(2)}, "covariance is .*; accepted: symmetric"),
        (MovingObstacleCost, {"covariance": [[1.0, 0.5], [0.0, 1.0]]}, "accepted: symmetric and"),
        (MovingObstacleCost, {"covariance": np.eye(2), "std": 1.0}, "accepted: one of them"),
    ],
)
def test_bad_input_is_named(cost: type, changes, culprit: str) -> None:
    base = {ObstacleCost: {}, DiscObstacleCost: DISCS, MovingObstacleCost: MOVING}[cost]
    with pytest.raises(ValueError, match=culprit):
        cost(**{**base, **changes})


def test_traced_numbers_pass() -> None:
    made = jax.jit(lambda c: MovingObstacleCost(**MOVING, covariance=c))(-jnp.eye(2))
    assert float(made.covariance[1, 0, 0]) == -1.0
