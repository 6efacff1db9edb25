import dataclasses
import math

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Ackermann, DifferentialDrive, MovingObstacleCost, ObstacleCost, State
from jaxplore.belief import Obstacles
from jaxplore.belief.belief import Belief
from jaxplore.costs import CollisionCost
from jaxplore.geometry.footprint import Rectangle
from jaxplore.maps.field import ScalarField

pytestmark = pytest.mark.long

DISC = DifferentialDrive(radius=0.2)
# Two discs of 0.25 m: half of 0.6 m ahead is 0.3 m, and 0.15 and 0.2 make 0.25.
CAR = Ackermann(min_speed=-2.0, footprint=Rectangle(0.5, 0.1, 0.4, num_discs=2))
ROBOTS = {"disc": (DISC, (0.0,), 0.2), "rectangle": (CAR, (0.05, 0.35), 0.25)}
every_robot = pytest.mark.parametrize("name", ROBOTS)

WHERE = st.tuples(st.floats(1.5, 7.5, width=32), st.floats(1.5, 7.5, width=32))
ANGLE = st.floats(-4, 4, width=32)
SPEED = st.floats(-2, 2, width=32)
TIME = st.floats(0, 3, width=32)


def rows(count: int, low: float, high: float):
    return hnp.arrays(np.float32, (count, 2), elements=st.floats(low, high, width=32))


def numbers(count: int, low: float, high: float):
    return hnp.arrays(np.float32, count, elements=st.floats(low, high, width=32))


def clearance_at(points: np.ndarray) -> np.ndarray:
    """Return the clearance of the belief below: bilinear on each side of x = 4.5 m."""
    return 0.2 * np.abs(points[:, 0] - 4.5) + 0.02 * points[:, 1]


@pytest.fixture(scope="module")
def between(belief) -> Belief:
    """The belief of the fixtures with a valley of clearance, lowest along x = 4.5 m."""
    y, x = np.mgrid[:9, :9].astype(np.float64) + 0.5
    values = clearance_at(np.stack([x.ravel(), y.ravel()], axis=-1)).reshape(9, 9)
    field = ScalarField(jnp.asarray(values, jnp.float32), belief.grid.frame, jnp.zeros(()))
    return dataclasses.replace(belief, clearance=field)


def tracks(positions, velocities, radii, std, is_known, growth=0.2, age=0.0) -> Obstacles:
    """Return discs as a tracker knows them; of those that are not known nothing is checked."""
    place, velocity, spread = (jnp.asarray(a, jnp.float32) for a in (positions, velocities, std))
    covariance = spread[:, None, None] ** 2 * jnp.eye(2)
    ages, known = jnp.full(len(place), age, jnp.float32), jnp.asarray(np.asarray(is_known, bool))
    return eqx.tree_at(
        lambda some: (
            some.outlines.corners,
            some.centres,
            some.velocities,
            some.covariance,
            some.age,
            some.is_known,
        ),
        Obstacles.unseen(radii, growth),
        (
            place[:, None],
            place,
            velocity,
            covariance,
            ages,
            known,
        ),
    )


NOBODY = tracks(np.zeros((3, 2)), np.zeros((3, 2)), np.ones(3), np.ones(3), np.zeros(3))


@eqx.filter_jit
def _price(cost, state, t, belief):
    return cost.stage(state, jnp.zeros(state.dynamics.control_size), t, belief)


def price(cost, state: State, belief: Belief, t: float = 0.0) -> float:
    return float(_price(cost, state, jnp.asarray(t, jnp.float32), belief))


def state_of(name: str, here, yaw: float, v: float) -> State:
    return State(jnp.asarray([*here, yaw, v, 0.1], jnp.float32), ROBOTS[name][0])


def centres(name: str, here, yaw: float) -> np.ndarray:
    """Return the centres (C, 2) of the robot's discs, double precision."""
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    return np.asarray(here, np.float64) + np.outer(ROBOTS[name][1], ahead)


def squared_depth(distance: float, too_close: float) -> float:
    return (max(too_close - distance, 0.0) / 0.05) ** 2


@every_robot
@settings(max_examples=30)
@given(
    here=WHERE,
    yaw=ANGLE,
    v=SPEED,
    t=TIME,
    positions=rows(3, 0, 8),
    velocities=rows(3, -1, 1),
    radii=numbers(3, 0, 1),
    std=numbers(3, 0, 1),
    is_known=hnp.arrays(bool, 3),
)
def test_it_is_how_deep_the_discs_are_in_map_and_movers(
    name, here, yaw, v, t, positions, velocities, radii, std, is_known, between
) -> None:
    middles = centres(name, here, yaw)
    too_close = ROBOTS[name][2] + 0.07 + 0.3 * abs(v)
    expected = squared_depth(clearance_at(middles).min(), too_close)
    for n in np.flatnonzero(is_known):
        there = positions[n] + velocities[n].astype(np.float64) * t
        gap = np.hypot(*(middles - there).T).min() - float(radii[n])
        spread = math.hypot(float(std[n]), 0.2 * (0.5 + t))
        expected += squared_depth(gap, too_close + 1.5 * spread)
    seen = tracks(positions, velocities, radii, std, is_known, age=0.5)
    belief = dataclasses.replace(between, obstacles=seen)
    cost = CollisionCost(margin=0.07, reaction_time=0.3, caution=1.5, reach=0.0)
    found = price(cost, state_of(name, here, yaw, v), belief, t)
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-2)


@every_robot
def test_it_is_the_hard_parts_of_the_costs_that_have_them(name, between) -> None:
    rng = np.random.default_rng(0)
    ours = CollisionCost(margin=0.05, reaction_time=0.1, caution=0.0, reach=0.0)
    numbers = {"margin": 0.05, "reaction_time": 0.1}
    static = ObstacleCost(clearance=1e-6, collision=1.0, **numbers)
    tracked = [MovingObstacleCost(collision=c, **numbers) for c in (1.0, 0.0)]
    paid = []
    for _ in range(40):
        places, moves = rng.uniform(2.0, 7.0, (3, 2)), rng.uniform(-1.0, 1.0, (3, 2))
        seen = tracks(places, moves, rng.uniform(0, 1, 3), rng.uniform(0.1, 1, 3), [1, 1, 0])
        belief = dataclasses.replace(between, obstacles=seen)
        state = state_of(name, rng.uniform(2.0, 7.0, 2), rng.uniform(-3, 3), rng.uniform(-1, 1))
        of_map = price(static, state, belief)
        of_movers = price(tracked[0], state, belief, 0.7) - price(tracked[1], state, belief, 0.7)
        paid.append((of_map > 0.0, of_movers > 1.0))
        found = price(ours, state, belief, 0.7)
        assert found == pytest.approx(of_map + of_movers, rel=1e-4, abs=1e-3)
    assert 0 < np.sum(paid, axis=0).min() < np.sum(paid, axis=0).max() < 40


def test_caution_keeps_free_what_an_obstacle_may_take(between) -> None:
    # On an open map: 0.2 m of radius and 0.3 m of theirs; known to 0.1 m, 3 s ago to 0.4 m/s.
    open_map = dataclasses.replace(between, clearance=ScalarField(
        jnp.full((9, 9), 9.0), between.grid.frame, jnp.zeros(())
    ))  # fmt: skip
    seen = tracks([[4.0, 4.0]] * 3, np.zeros((3, 2)), [0.3] * 3, [0.3] * 3, [1, 0, 0], 0.4, 1.0)
    belief = dataclasses.replace(open_map, obstacles=seen)
    for caution in (0.0, 1.0, 2.0):
        cost = CollisionCost(0.0, 0.0, caution)
        # One second ago and for none more, the deviation is hypot(0.3, 0.4) m.
        edge = 4.0 + 0.2 + 0.3 + 0.5 * caution
        clear = price(cost, state_of("disc", (edge + 0.001, 4.0), 1.0, 1.0), belief)
        deep = price(cost, state_of("disc", (edge - 0.05, 4.0), 1.0, 1.0), belief)
        assert clear == 0.0
        assert deep == pytest.approx(1.0, rel=1e-3)


@every_robot
def test_without_tracks_or_known_ones_only_the_map_counts(name, between) -> None:
    unseen = tracks(np.full((3, 2), np.nan), np.zeros((3, 2)), np.ones(3), [np.nan] * 3, [0, 0, 0])
    for here in ((4.5, 2.0), (3.0, 3.0), (7.4, 7.4)):
        state = state_of(name, here, 0.5, 0.3)
        prices = [
            price(CollisionCost(), state, dataclasses.replace(between, obstacles=each))
            for each in (None, NOBODY, unseen)
        ]
        assert prices[0] == prices[1] == prices[2]
    assert price(CollisionCost(), state_of(name, (4.5, 2.0), 0.0, 0.0), between) > 0.0
    assert price(CollisionCost(), state_of(name, (7.4, 7.4), 0.0, 0.0), between) == 0.0


def test_defaults(between) -> None:
    # 0.2 m of radius, 2 cm, and 0.05 s at 2 m/s: 32 cm; at y = 5 m the map leaves 10 cm.
    state = state_of("disc", (4.5, 5.0), 0.0, 2.0)
    assert price(CollisionCost(), state, between) == pytest.approx((0.22 / 0.05) ** 2, rel=1e-4)
    numbers = [float(leaf) for leaf in jax.tree.leaves(CollisionCost())]
    assert numbers == pytest.approx([0.02, 0.05, 1.0, 0.1])


@every_robot
def test_slopes_are_finite_at_the_centre_of_an_obstacle_and_off_the_map(name, between) -> None:
    seen = tracks([[4.0, 4.0], [np.nan, 0.0], [0.0, 0.0]], np.zeros((3, 2)), *[np.ones(3)] * 2,
                  [1, 0, 0])  # fmt: skip
    belief = dataclasses.replace(between, obstacles=seen)
    robot = ROBOTS[name][0]

    @jax.jit
    def slope(values):
        def along(values):
            state = State(values, robot)
            return CollisionCost().stage(state, jnp.zeros(2), jnp.zeros(()), belief)

        return jax.grad(along)(values)

    for here in ((4.0, 4.0), (3.95, 4.0), (3.65, 4.0), (-1e6, 1e6), (0.0, 0.0)):
        assert np.isfinite(slope(jnp.asarray([*here, 0.0, 0.0, 0.0]))).all(), here


@every_robot
@settings(max_examples=30)
@given(
    here=WHERE,
    yaw=ANGLE,
    v=SPEED,
    t=TIME,
    positions=rows(3, 0, 8),
    velocities=rows(3, -1, 1),
    radii=numbers(3, 0, 1),
    is_known=hnp.arrays(bool, 3),
)
def test_to_be_where_an_obstacle_could_be_costs_a_little(
    name, here, yaw, v, t, positions, velocities, radii, is_known, between
) -> None:
    too_close = ROBOTS[name][2] + 0.07 + 0.3 * abs(v)
    expected = 0.0
    for n in np.flatnonzero(is_known):
        from_now = np.hypot(*(centres(name, here, yaw) - positions[n]).T).min() - float(radii[n])
        reached = t * np.hypot(*velocities[n].astype(np.float64))
        expected += 0.5 * max(too_close + reached - from_now, 0.0) ** 2
    seen = tracks(positions, velocities, radii, np.zeros(3), is_known)
    belief, state = dataclasses.replace(between, obstacles=seen), state_of(name, here, yaw, v)
    with_it, without = (
        price(CollisionCost(0.07, 0.3, 0.0, reach), state, belief, t) for reach in (0.5, 0.0)
    )
    # A difference of what may be thousands.
    assert with_it - without == pytest.approx(expected, rel=1e-3, abs=1e-2)


def test_one_that_goes_away_could_come_back(between) -> None:
    open_map = ScalarField(jnp.full((9, 9), 9.0), between.grid.frame, jnp.zeros(()))
    seen = tracks([[4.0, 4.0]] * 3, [[1.0, 0.0]] * 3, [0.3] * 3, [0.0] * 3, [1, 0, 0])
    belief = dataclasses.replace(between, clearance=open_map, obstacles=seen)
    state = state_of("disc", (3.0, 4.0), 0.0, 0.0)
    paid = {t: price(CollisionCost(), state, belief, t) for t in (0.0, 0.4, 1.0)}
    # 1 m apart, less 0.3 m of it and 0.22 m of the robot: 0.48 m are free.
    assert paid[0.0] == paid[0.4] == 0.0
    assert paid[1.0] == pytest.approx(0.1 * 0.52**2, rel=1e-3)


@pytest.mark.parametrize("name", ["margin", "reaction_time", "caution", "reach"])
def test_several_numbers_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} has shape .*; accepted: "):
        CollisionCost(**{name: np.ones(2)})
