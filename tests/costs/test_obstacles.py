import math

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, Cost, DiscObstacleCost, Dynamics, ObstacleCost, State
from jaxplore.geometry.footprint import Rectangle

REACH = st.floats(-6, 6, width=32)
ANGLE = st.floats(-7, 7, width=32)
POINT = st.tuples(REACH, REACH)


SETTINGS = {"clearance": 0.5, "collision": 7.0, "margin": 0.05, "reaction_time": 0.1}


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
    disc = DiscObstacleCost([[x + 2.0 + 0.1 * x, 4.0]], 2.0, **SETTINGS)
    assert stage(disc, state) == pytest.approx(stage(ObstacleCost(**SETTINGS), state), rel=1e-3)


def test_discs_have_the_defaults_of_the_map() -> None:
    disc, obstacle = DiscObstacleCost([[0.0, 0.0]], 1.0), ObstacleCost()
    for name in ("clearance", "collision", "margin", "reaction_time"):
        assert float(getattr(disc, name)) == float(getattr(obstacle, name))


def test_deeper_inside_a_disc_costs_more_up_to_its_centre(price, drone) -> None:
    cost = DiscObstacleCost([[0.0, 0.0]], 2.0)
    values = [price(cost, drone(x=x)) for x in (2.6, 2.2, 1.5, 0.5, 0.0)]
    assert (np.diff(values) > 0).all()


def test_a_position_that_is_not_finite_has_no_price(price, drone) -> None:
    cost = DiscObstacleCost([[0.0, 0.0], [3.0, 1.0]], 1.0)
    assert np.isnan(price(cost, drone(x=np.nan, v=1.0)))


@given(here=POINT, places=rows(3), yaw=ANGLE, angle=ANGLE, shift=POINT)
def test_where_the_world_is_does_not_matter(
    here, places, yaw, angle, shift, price, drone, moved
) -> None:
    def cost(angle: float, shift) -> float:
        x, y = moved(here, angle, shift)
        centres = moved(places, angle, shift)
        state = drone(x=x, y=y, yaw=yaw + angle, v=1.0)
        return price(DiscObstacleCost(centres, 0.3, 4.0, collision=0.01), state)

    assert cost(angle, shift) == pytest.approx(cost(0.0, (0.0, 0.0)), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    "cost",
    [
        DiscObstacleCost([[0.0, 0.0], [0.0, 0.0]], 0.5),
        DiscObstacleCost([[0.0, 0.0, 0.0]], 0.5),
    ],
)
def test_the_slope_at_the_centre_is_zero(cost: Cost, slope, drone) -> None:
    np.testing.assert_array_equal(slope(cost, drone())[:3], 0.0)
    assert slope(cost, drone(x=0.2))[0] < -0.1


# Footprints

# Three discs of 0.5 m, 1.2 m apart in all, of which the middle one is off the position.
CAR = Ackermann(min_speed=-2.0, footprint=Rectangle(1.5, 0.3, 0.8, num_discs=3))
LEVERS, RADIUS = (0.0, 0.6, 1.2), 0.5


def car(x: float, y: float, yaw: float, v: float) -> State:
    return State(jnp.asarray([x, y, yaw, v, 0.1], jnp.float32), CAR)


def penalty(distance: float, v: float) -> float:
    """The docstring's formula at `SETTINGS`."""
    near = max(0.5 - distance, 0.0) / 0.5
    deep = max(RADIUS + 0.05 + 0.1 * abs(v) - distance, 0.0) / 0.05
    return near**2 + 7.0 * deep**2


@given(
    x=st.floats(2, 7, width=32),
    y=st.floats(2, 7, width=32),
    yaw=ANGLE,
    v=st.floats(-2, 2, width=32),
)
def test_of_a_rectangle_the_disc_nearest_to_the_map_s_obstacles_counts(
    x, y, yaw, v, evaluate
) -> None:
    # The belief's clearance is a tenth of x.
    distance = min(0.1 * (x + lever * math.cos(yaw)) for lever in LEVERS)
    found = evaluate(ObstacleCost(**SETTINGS), car(x, y, yaw, v))
    assert found == pytest.approx(penalty(distance, v), rel=1e-3, abs=1e-3)


@given(
    centres=rows(3),
    radii=numbers(3, 0, 2),
    here=POINT,
    yaw=ANGLE,
    v=st.floats(-2, 2, width=32),
)
def test_of_a_rectangle_the_disc_nearest_to_an_obstacle_counts(
    centres, radii, here, yaw, v, price
) -> None:
    ends = [(here[0] + lever * math.cos(yaw), here[1] + lever * math.sin(yaw)) for lever in LEVERS]
    distance = min(
        math.dist(centre, end) - radius
        for centre, radius in zip(centres, radii, strict=True)
        for end in ends
    )
    found = price(DiscObstacleCost(centres, radii, **SETTINGS), car(*here, yaw, v))
    assert found == pytest.approx(penalty(distance, v), rel=1e-3, abs=1e-2)


def test_a_car_pays_for_what_is_beside_its_front(evaluate) -> None:
    # The rear axle is far from the wall at x = 0 either way; the front is not.
    cost = ObstacleCost(clearance=0.5, collision=0.0)
    away, towards = (evaluate(cost, car(5.0, 4.0, yaw, 0.0)) for yaw in (0.0, math.pi))
    assert away == 0.0
    assert towards == pytest.approx((0.12 / 0.5) ** 2, rel=1e-4)


def test_the_slope_by_the_heading_turns_it_away(evaluate, belief) -> None:
    cost = ObstacleCost(clearance=0.5, collision=0.0)

    @jax.jit
    def slope(yaw):
        state = State(jnp.stack([jnp.asarray(4.0), jnp.asarray(4.0), yaw, *jnp.zeros(2)]), CAR)
        return cost.stage(state, jnp.zeros(2), jnp.zeros(()), belief)

    at, step = 2.0, 1e-2
    found = float(jax.grad(slope)(jnp.asarray(at)))
    difference = (float(slope(jnp.asarray(at + step))) - float(slope(jnp.asarray(at - step)))) / (
        2 * step
    )
    assert found == pytest.approx(difference, rel=1e-2)
    assert found > 0.05


@pytest.fixture(scope="module")
def evaluate(belief):
    """Return what evaluates a stage cost on the belief; compiled once per kind of cost."""

    @eqx.filter_jit
    def stage(cost, state):
        return cost.stage(state, jnp.zeros(2), jnp.asarray(0.1), belief)

    return lambda cost, state: float(stage(cost, state))


class Blind(Dynamics):
    """A disc without a heading."""

    state_names = ("x", "y", "v")
    control_names = ("push",)
    control_min: jax.Array = eqx.field(default_factory=lambda: -jnp.ones(1))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.ones(1))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.3, jnp.float32))

    def step(self, state, control, dt):
        return state


def former(cost, state, distance):
    """What a robot that is one disc has always paid, operation by operation."""
    contact = state.dynamics.radius + cost.margin + cost.reaction_time * jnp.abs(state.speed)
    near = jnp.maximum(cost.clearance - distance, 0.0) / cost.clearance
    depth = jnp.maximum(contact - distance, 0.0) / 0.05
    return near * near + cost.collision * depth * depth


def former_map(cost, state, belief):
    return former(cost, state, belief.clearance(state.position))


def former_disc(cost, state, belief):
    x, y = (a - b for a, b in zip(state.position, cost.centres[0], strict=True))
    square = jnp.zeros(()) + x * x + y * y
    is_zero = square <= 0.0
    length = jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))
    return former(cost, state, length - cost.radii[0])


@pytest.mark.parametrize(
    ("cost", "was"),
    [
        (ObstacleCost(**SETTINGS), former_map),
        (DiscObstacleCost([[4.0, 4.0]], 1.0, **SETTINGS), former_disc),
    ],
)
def test_a_disc_pays_what_it_did_to_the_bit_and_needs_no_heading(cost, was, belief) -> None:
    robot = Blind()

    def price(form):
        def one(values):
            return form(State(values, robot))

        return jax.jit(jax.vmap(one))

    states = np.random.default_rng(0).uniform([1, 1, -2], [7, 7, 2], (300, 3))
    states = jnp.asarray(states, jnp.float32)
    found = price(lambda state: cost.stage(state, jnp.zeros(1), jnp.zeros(()), belief))(states)
    expected = price(lambda state: was(cost, state, belief))(states)
    np.testing.assert_array_equal(found, expected)
    assert (np.asarray(found) > 0.0).sum() > 50


def test_of_a_disc_the_map_is_read_as_it_was(belief) -> None:
    """The same program, not only the same numbers."""
    cost = ObstacleCost()

    def program(form) -> str:
        def run(values, robot):
            return form(State(values, robot))

        return str(jax.make_jaxpr(run)(jnp.zeros(3), Blind()))

    control, t = jnp.zeros(1), jnp.zeros(())
    found = program(lambda state: cost.stage(state, control, t, belief))
    assert found == program(lambda state: former_map(cost, state, belief))


DISCS = {"centres": np.zeros((2, 2)), "radii": 1.0}


@pytest.mark.parametrize(
    ("cost", "changes", "culprit"),
    [
        (DiscObstacleCost, {"centres": np.zeros(2)}, r"centres has shape \(2,\); accepted: \(N, 2"),
        (DiscObstacleCost, {"centres": np.zeros((1, 4))}, r"centres has shape \(1, 4\); accepted"),
        (
            DiscObstacleCost,
            {"radii": np.ones(3)},
            r"radii has shape \(3,\); .*: one number or \(2,",
        ),
    ],
)
def test_bad_input_is_named(cost: type, changes, culprit: str) -> None:
    base = {ObstacleCost: {}, DiscObstacleCost: DISCS}[cost]
    with pytest.raises(ValueError, match=culprit):
        cost(**{**base, **changes})
