import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    ControlCost,
    Cost,
    DifferentialDrive,
    Dynamics,
    GuidanceCost,
    InformationCost,
    ObstacleCost,
    State,
)
from jaxplore.information.belief import Belief
from jaxplore.information.field import InformationField
from jaxplore.information.guidance import GuidanceField
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid

FRAME = GridFrame(1.0)
ROWS, COLUMNS = np.mgrid[:9, :9].astype(np.float32)
# Linear fields: bilinear interpolation is exact, so every cost has a closed form.
BELIEF = Belief(
    grid=OccupancyGrid(np.zeros((9, 9)), 1.0),
    clearance=ScalarField(jnp.asarray(0.1 * (COLUMNS + 0.5)), FRAME, jnp.zeros(())),
    information=InformationField(
        sectors=jnp.asarray(np.stack([ROWS, 2 * ROWS])),
        cumulative=jnp.asarray(np.stack([0 * ROWS, ROWS, 3 * ROWS])),
        source=jnp.zeros((9, 9)),
        frame=FRAME,
        field_of_view=2 * math.pi,
        num_beams=10,
    ),
    guidance=GuidanceField(
        jnp.asarray(2.0 * COLUMNS - ROWS),
        jnp.stack([jnp.full((9, 9), 0.6), jnp.full((9, 9), 0.8)]),
        FRAME,
        jnp.asarray(1e4),
    ),
    dwell=jnp.zeros((9, 9)),
)
ROBOT = DifferentialDrive(radius=0.2, max_acceleration=2.0, max_angular_acceleration=4.0)


def at(x: float, y: float, yaw: float = 0.0, v: float = 0.0) -> State:
    return State(jnp.asarray([x, y, yaw, v, 0.0]), ROBOT)


def stage(cost: Cost, state: State, control: tuple[float, float] = (0.0, 0.0)) -> float:
    return float(cost.stage(state, jnp.asarray(control), jnp.asarray(0.1), BELIEF))


@pytest.mark.parametrize(("x", "v"), [(6.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.4, 0.0), (1.0, 1.0)])
def test_obstacle_cost(x: float, v: float) -> None:
    d, contact = 0.1 * x, 0.2 + 0.05 + 0.1 * v
    expected = max(0.5 - d, 0.0) ** 2 / 0.25
    if d < contact:
        expected += 7.0 * ((contact - d) / 0.05) ** 2
    cost = ObstacleCost(clearance=0.5, collision=7.0, margin=0.05, reaction_time=0.1)
    assert stage(cost, at(x, 4.0, v=v)) == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_obstacle_cost_rises_into_the_obstacle_and_off_the_map() -> None:
    cost = ObstacleCost()
    values = [stage(cost, at(x, 4.0)) for x in (3.0, 2.0, 1.0, 0.6, -1.0)]
    assert (np.diff(values) > 0).all()


def test_information_cost_is_per_beam() -> None:
    assert stage(InformationCost(), at(4.0, 3.5)) == pytest.approx(-3 * 3.0 / 10)
    assert stage(InformationCost(), at(-4.0, 3.5)) == 0.0


def test_guidance_cost_is_the_cost_to_go_and_of_facing_elsewhere() -> None:
    for yaw in (0.0, 1.0, math.pi, -2.0):
        facing = 0.6 * math.cos(yaw) + 0.8 * math.sin(yaw)
        expected = 2.0 * 3.5 - 2.5 + 0.5 * (1.0 - facing)
        found = stage(GuidanceCost(turning=0.5), at(4.0, 3.0, yaw))
        assert found == pytest.approx(expected, abs=1e-4)


def test_control_cost_is_relative_to_the_bounds() -> None:
    assert stage(ControlCost(), at(1.0, 1.0), (1.0, -4.0)) == pytest.approx(0.25 + 1.0)


class Terminal(Cost):
    def stage(self, state, control, t, belief):
        return t

    def terminal(self, state, belief):
        return state.position[0]


def test_weights_and_sums() -> None:
    cost = 2.0 * ControlCost() + Terminal() * 3.0 + 0.5 * (Terminal() + ControlCost())
    state = at(4.0, 1.0)
    assert stage(cost, state, (2.0, 0.0)) == pytest.approx(2.0 + 0.3 + 0.5 * (0.1 + 1.0))
    assert float(cost.terminal(state, BELIEF)) == pytest.approx(3 * 4.0 + 0.5 * 4.0)
    assert [name for name, _ in cost.terms()] == [
        "ControlCost",
        "Terminal",
        "Terminal",
        "ControlCost",
    ]
    total = sum(stage(term, state, (2.0, 0.0)) for _, term in cost.terms())
    assert total == pytest.approx(stage(cost, state, (2.0, 0.0)))


def test_a_weight_is_a_leaf() -> None:
    traced = 0

    @jax.jit
    def price(cost: Cost) -> jax.Array:
        nonlocal traced
        traced += 1
        return cost.stage(at(4.0, 1.0), jnp.ones(2), jnp.asarray(0.1), BELIEF)

    for weight in (1.0, 2.0, 3.0):
        price(weight * ControlCost() + ObstacleCost(clearance=weight))
    assert traced == 1


class Sled(Dynamics):
    """Names and order of its own: costs must not care."""

    state_names: ClassVar[tuple[str, ...]] = ("heave", "north", "east", "surge")
    control_names: ClassVar[tuple[str, ...]] = ("push",)
    control_min: jax.Array = eqx.field(default_factory=lambda: -jnp.ones(1))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.ones(1))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.2))

    def step(self, state, control, dt):
        return state

    def position(self, state):
        return jnp.stack([state[2], state[1]])

    def heading(self, state):
        return jnp.zeros(())

    def speed(self, state):
        return state[3]


@pytest.mark.parametrize("cost", [ObstacleCost(), InformationCost(), GuidanceCost()])
def test_the_same_cost_serves_another_model(cost: Cost) -> None:
    sled = State(jnp.asarray([9.0, 3.0, 4.0, 0.7]), Sled())
    expected = stage(cost, at(4.0, 3.0, v=0.7))
    found = cost.stage(sled, jnp.zeros(1), jnp.asarray(0.1), BELIEF)
    assert float(found) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("cost", "argument", "value"),
    [
        (ObstacleCost, "clearance", 0.0),
        (ObstacleCost, "collision", -1.0),
        (ObstacleCost, "margin", -0.1),
        (ObstacleCost, "reaction_time", math.nan),
        (GuidanceCost, "turning", -0.1),
    ],
)
def test_bad_input_is_named(cost: type, argument: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{argument} is .*accepted"):
        cost(**{argument: value})
    with pytest.raises(ValueError, match="weight is"):
        math.inf * ControlCost()
