"""Contouring, lag, progress and corridors, on every kind of model."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import (
    MPPI,
    Ackermann,
    KinematicBicycle,
    Quadrotor,
    Rectangle,
    State,
    Unicycle,
    mpcc,
)
from jaxplore.belief.belief import Belief
from jaxplore.costs import extract
from jaxplore.costs.path_following import (
    ContouringCost,
    CorridorCost,
    LagCost,
    ProgressCost,
    StopCost,
)
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.curves import line_path, path_through

S_CURVE = [(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)]
PATH = path_through(S_CURVE)
ROBOTS = {"unicycle": Unicycle(), "bicycle": KinematicBicycle(), "quadrotor": Quadrotor()}
BICYCLE = Augmented(ROBOTS["bicycle"], PathParameter.along(PATH, 15.0))
NOTHING = jnp.zeros(())


@eqx.filter_jit
def price(cost, state: State, control=None):
    control = jnp.zeros(state.dynamics.control_size) if control is None else control
    return cost.stage(state, control, NOTHING, None)


@eqx.filter_jit
def stop_price(cost, state: State, belief):
    return cost.stage(state, jnp.zeros(state.dynamics.control_size), NOTHING, belief)


point_at = eqx.filter_jit(lambda phi: PATH.at(phi))
clearances = eqx.filter_jit(CorridorCost.clearances)
ALONG = PathParameter.along(PATH, 15.0)


def at(robot, x: float, y: float, phi: float, yaw: float = 0.0) -> State:
    """Return a robot at a pose and an arc length."""
    return put(Augmented(robot, ALONG), x, y, phi, yaw)


def put(model: Augmented, x: float, y: float, phi: float, yaw: float) -> State:
    return State(model.at_pose(x, y, yaw).at[-1].set(phi), model)


def by_hand(x: float, y: float, phi: float) -> tuple[float, float]:
    """Return the errors by the formulas of the design notes, double precision."""
    point = point_at(jnp.asarray(phi, jnp.float32))
    theta, dx, dy = float(point.heading), x - float(point.x), y - float(point.y)
    return (
        np.sin(theta) * dx - np.cos(theta) * dy,
        -np.cos(theta) * dx - np.sin(theta) * dy,
    )


@pytest.mark.parametrize("name", ROBOTS)
@given(
    st.floats(-5, 55, width=32),
    st.floats(-9, 9, width=32),
    st.floats(0, 56, width=32),
)
def test_errors_are_those_of_the_formulas_on_every_model(name: str, x, y, phi) -> None:
    state, (contouring, lag) = at(ROBOTS[name], x, y, phi), by_hand(x, y, phi)
    np.testing.assert_allclose(
        price(ContouringCost(PATH), state), contouring**2, rtol=1e-3, atol=1e-3
    )
    np.testing.assert_allclose(price(LagCost(PATH), state), lag**2, rtol=1e-3, atol=1e-3)


def test_a_model_without_progress_gives_its_own_extractors() -> None:
    # A unicycle that is to be at 12 m of the path, measured half a metre ahead of its centre.
    def nose(state: State):
        yaw = state.heading
        return state.position + 0.5 * jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])

    cost = ContouringCost(PATH, position=nose, parameter=lambda state: jnp.asarray(12.0))
    state = State(jnp.asarray([11.0, 0.5, 0.3]), Unicycle())
    expected = by_hand(11.0 + 0.5 * np.cos(0.3), 0.5 + 0.5 * np.sin(0.3), 12.0)[0]
    np.testing.assert_allclose(price(cost, state), expected**2, rtol=1e-3)


def test_extractors_read_the_part_they_are_for() -> None:
    state = at(ROBOTS["bicycle"], 3.0, 1.0, 4.0, 0.2)
    alone = State(state.values[:-1], ROBOTS["bicycle"])
    assert extract.from_physical(extract.heading)(state) == state.heading
    assert extract.from_physical(extract.speed)(alone) == extract.speed(state)
    assert extract.from_virtual(extract.component("phi"))(state) == 4.0
    np.testing.assert_array_equal(extract.from_physical(extract.position)(alone), [3.0, 1.0])
    through = ContouringCost(
        PATH,
        position=extract.from_physical(extract.position),
        parameter=extract.from_virtual(extract.component("phi")),
    )
    assert price(through, state) == price(ContouringCost(PATH), state)
    with pytest.raises(ValueError, match="dynamics is KinematicBicycle, which has no virtual part"):
        extract.from_virtual(extract.component("phi"))(alone)


STILL = path_through(S_CURVE, half_widths=[2.0, 1.0])


@given(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), st.floats(-3, 3))
def test_the_world_s_origin_and_axes_do_not_matter(shift, turn: float) -> None:
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = path_through(np.asarray(S_CURVE) @ matrix.T + shift, half_widths=[2.0, 1.0])
    where = np.array([21.0, 3.6])
    there = matrix @ where + shift
    states = (
        at(ROBOTS["bicycle"], *where, 23.0, 0.4),
        at(ROBOTS["bicycle"], *there, 23.0, 0.4 + turn),
    )
    for cost in (ContouringCost, LagCost, CorridorCost):
        prices = [
            price(cost(path), state) for path, state in zip((STILL, moved), states, strict=True)
        ]
        np.testing.assert_allclose(prices[1], prices[0], rtol=1e-2, atol=2e-3)


def test_progress_is_paid_by_the_rate_that_is_applied() -> None:
    state = at(ROBOTS["bicycle"], 0.0, 0.0, 0.0)
    assert price(ProgressCost(), state, jnp.asarray([1.0, 0.1, 7.0])) == -7.0
    with pytest.raises(ValueError, match="rate is 'phi_rate', no control of KinematicBicycle"):
        price(ProgressCost(), State(state.values[:-1], ROBOTS["bicycle"]))


@given(x=st.floats(30.0, 60.0), y=st.floats(-2.0, 2.0), v=st.floats(0.0, 10.0))
def test_a_stop_attracts_and_what_is_overrun_is_paid(x: float, y: float, v: float) -> None:
    """On a straight line of 50 m; half of 2 m/s^2 brake in v^2 / 2 m."""
    line = line_path([0, 0], [50, 0])
    robot = Augmented(
        KinematicBicycle(max_speed=15.0, max_acceleration=2.0), PathParameter(15.0, 50.0)
    )
    phi, yaw = min(x, 50.0), 0.3
    state = State(jnp.asarray([x, y, yaw, v, phi], jnp.float32), robot)
    for stop in (50.0, 40.0):
        to_go = max(stop - phi, math.hypot(x - stop, y))
        expected = min(to_go, 1.0) + 2.0 * max(v * v / 2.0 - to_go, 0.0)
        expected += 2.0 * max(phi - stop, 0.0)
        belief = None if stop == 50.0 else Belief(path_stop=jnp.asarray(stop))
        found = float(stop_price(StopCost(line, faces=False), state, belief))
        assert found == pytest.approx(expected, rel=2e-3, abs=2e-3)
    facing = float(stop_price(StopCost(line), state, belief)) - found
    assert facing == pytest.approx(0.5 * (1.0 - math.cos(yaw)), rel=1e-2, abs=1e-3)
    # A heading at the end counts more the nearer that is, and the path less, also before a cusp.
    away = max(50.0 - phi, math.hypot(x - 50.0, y))
    near = math.exp(-((away / 0.4) ** 2))
    for faces in (True, False):
        turned = float(stop_price(StopCost(line, faces, -1.0), state, belief)) - found
        expected = near * 1.3 / math.pi + (1.0 - near) * facing * faces
        assert turned == pytest.approx(expected, rel=1e-2, abs=2e-3)


def test_a_closed_path_has_no_end_to_stop_at() -> None:
    ring = path_through([(0, 0), (4, 0), (4, 4)], is_closed=True)
    with pytest.raises(ValueError, match="path is closed; accepted: an open path"):
        StopCost(ring)
    with pytest.raises(ValueError, match=r"end_heading is 0\.3 for a closed path; accepted: None"):
        mpcc(ROBOTS["bicycle"], ring, end_heading=0.3, horizon=4, num_samples=8)


def test_the_objects_that_plan_measure() -> None:
    states = jnp.stack([at(ROBOTS["bicycle"], x, 0.3, x).values for x in (1.0, 5.0, 9.0)])
    expected = np.array([by_hand(x, 0.3, x) for x in (1.0, 5.0, 9.0)])
    np.testing.assert_allclose(
        ContouringCost(PATH).errors(states, BICYCLE), expected[:, 0], atol=1e-4
    )
    np.testing.assert_allclose(LagCost(PATH).errors(states, BICYCLE), expected[:, 1], atol=1e-4)


NARROWING = line_path([0, 0], [10, 0], half_widths=[[1.0, 2.0], [2.0, 2.0]])
CAR = Augmented(
    Ackermann(footprint=Rectangle(0.5, 0.1, 0.4, num_discs=2)), PathParameter.along(NARROWING, 3.0)
)


@given(st.floats(-3, 3, width=32), st.floats(0, 10, width=32), st.floats(-3, 3, width=32))
def test_room_is_left_by_the_nearest_disc(y: float, x: float, yaw: float) -> None:
    state = put(CAR, x, y, x, yaw)
    sides = y + np.array([0.05, 0.35]) * np.sin(yaw)
    room = min((1.0 + 0.1 * x - sides).min(), (2.0 + sides).min()) - 0.25
    cost = CorridorCost(NARROWING, margin=0.1, scale=0.2)
    np.testing.assert_allclose(clearances(cost, state.values[None], CAR)[0], room, atol=1e-4)
    np.testing.assert_allclose(
        price(cost, state), (max(0.1 - room, 0.0) / 0.2) ** 2, rtol=1e-2, atol=1e-3
    )


def test_gradients_are_finite() -> None:
    path = path_through(S_CURVE, half_widths=[1.0, 1.0])
    total = ContouringCost(path) + LagCost(path) + CorridorCost(path) + ProgressCost()

    def paid(values):
        return total.stage(State(values, BICYCLE), jnp.zeros(3), NOTHING, None)

    slope = jax.jit(jax.grad(paid))
    for where in (
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [20.0, 9.0, 1.0, 2.0, 20.0],
        [60.0, 0.0, 0.0, 1.0, 56.4],
    ):
        assert np.isfinite(slope(jnp.asarray(where))).all()


def test_another_path_of_as_many_nodes_does_not_recompile() -> None:
    traces = 0

    @eqx.filter_jit
    def look(cost, state):
        nonlocal traces
        traces += 1
        return cost.stage(state, jnp.zeros(3), NOTHING, None)

    for end in (5.0, 8.0):
        look(
            2.0 * ContouringCost(line_path([0, 0], [end, 0]))
            + LagCost(line_path([0, 0], [end, 1])),
            at(ROBOTS["bicycle"], 1.0, 0.0, end),
        )
    assert traces == 1


@pytest.mark.parametrize(
    ("look", "message"),
    [
        (
            lambda: price(
                ContouringCost(PATH, position=lambda s: s.heading), at(Unicycle(), 0.0, 0.0, 0.0)
            ),
            r"position returns shape \(\); accepted: \(2,\), 2 numbers",
        ),
        (
            lambda: price(
                LagCost(PATH, parameter=lambda s: s.position), at(Unicycle(), 0.0, 0.0, 0.0)
            ),
            r"parameter returns shape \(2,\); accepted: \(\), one number",
        ),
        (
            lambda: price(LagCost(PATH), State(jnp.zeros(3), Unicycle())),
            "Unicycle has no state component 'phi'",
        ),
        (
            lambda: MPPI(
                Augmented(Unicycle(), PathParameter(1.0, end=3.0)),
                LagCost(line_path([0, 0], [5, 0])),
                temperature=1.0,
                noise_std=[1.0, 1.0, 1.0],
            ),
            "path is 5 m long, beyond the bound of its PathParameter; accepted: at most 3 m",
        ),
        (lambda: extract.component(""), "name is ''; accepted"),
        (lambda: CorridorCost(PATH), "path has no half_widths; accepted"),
        (lambda: CorridorCost(PATH, margin=-1.0), "path has no half_widths"),
        (
            lambda: CorridorCost(line_path([0, 0], [1, 0], half_widths=[0.2, 0.3])).check(
                KinematicBicycle(radius=0.3)
            ),
            "path is 0.5 m wide where it is narrowest; accepted: 0.6 m or more, for Kinem",
        ),
    ],
)
def test_bad_input(look, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        look()
