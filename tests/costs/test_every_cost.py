"""What holds for every cost that reads no belief."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    ControlCost,
    ControlJerkCost,
    ControlRateCost,
    Cost,
    DiscObstacleCost,
    GoalCost,
    MovingObstacleCost,
    PathCost,
    QuadraticControlCost,
    ReferenceCost,
    State,
    StateBoundsCost,
    StateCost,
    WaypointCost,
)

RNG = np.random.default_rng(0)
# All goals, obstacles and paths lead through (0, 0): that is where gradients are delicate.
HERE = np.zeros(2)
PATH = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, 2.0]])
# Two of each kind in which every number differs.
PAIRS = {
    "goal": [GoalCost(HERE), GoalCost([1.0, 2.0], None, 2.0)],
    "saturated goal": [GoalCost(HERE, 2.0), GoalCost([1.0, 2.0], 3.0, 2.0)],
    "goal in space": [GoalCost([0.0, 0.0, 0.0]), GoalCost([1.0, 2.0, 3.0], None, 2.0)],
    "waypoint": [WaypointCost(HERE, 0.0), WaypointCost([1.0, 2.0], 3.0, 4.0, 5.0, 6.0)],
    "reference": [ReferenceCost(PATH, 0.1), ReferenceCost(PATH + 1.0, 0.2)],
    "path": [PathCost(PATH, 1.0, 1.0), PathCost(PATH + 1.0, 2.0, 3.0, 4.0)],
    "state": [
        StateCost({"yaw": 1.0, "x": 2.0}, angles=["yaw"]),
        StateCost({"x": 3.0, "yaw": 4.0}, {"x": 5.0, "yaw": 6.0}, ["yaw"], 7.0),
    ],
    "bounds": [
        StateBoundsCost({"x": 0.0}, {"x": 0.0, "z": -1.0}),
        StateBoundsCost({"x": -2.0}, {"z": 1.0, "x": 3.0}, {"x": 4.0, "z": 5.0}),
    ],
    "discs": [
        DiscObstacleCost([HERE, HERE], 0.5),
        DiscObstacleCost(np.ones((2, 2)), [1.0, 2.0], 3.0, 4.0, 5.0, 6.0),
    ],
    "moving": [
        MovingObstacleCost([HERE, HERE], np.zeros((2, 2))),
        MovingObstacleCost(
            np.ones((2, 2)),
            np.ones((2, 2)),
            [1.0, 2.0],
            covariance=[[3.0, 1.0], [1.0, 4.0]],
            growth=5.0,
        ),
    ],
    "effort": [ControlCost(), ControlCost()],
    "quadratic effort": [
        QuadraticControlCost([1.0, 1.0, 1.0], [0.0, 0.0, 0.0]),
        QuadraticControlCost([2.0, 3.0, 4.0], [1.0, 2.0, 3.0]),
    ],
    "rate": [ControlRateCost(1.0), ControlRateCost(2.0)],
    "jerk": [ControlJerkCost(1.0), ControlJerkCost(2.0)],
    "sum": [
        2.0 * GoalCost(HERE).named("a") + ControlCost(),
        3.0 * GoalCost([1.0, 2.0], None, 2.0).named("a") + ControlCost(),
    ],
}
every_cost = pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS.keys())


def total(cost: Cost, state: State, control, t, controls):
    """Return everything a cost may ask for."""
    return (
        cost.stage(state, control, t, None)
        + cost.terminal(state, None)
        + cost.sequence(controls, controls[0], jnp.asarray(0.1), state.dynamics)
    )


CONTROLS = jnp.asarray(RNG.normal(size=(4, 3)), jnp.float32)


@every_cost
def test_numbers_are_leaves_and_another_number_does_not_recompile(pair, drone) -> None:
    first, second = pair
    assert jax.tree.structure(first) == jax.tree.structure(second)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert isinstance(one, jax.Array)
        assert one.dtype == other.dtype == jnp.float32
        assert one.shape == other.shape
        assert not np.array_equal(one, other)
    traced = 0

    @jax.jit
    def price(cost, state):
        nonlocal traced
        traced += 1
        return total(cost, state, CONTROLS[0], jnp.asarray(0.1), CONTROLS)

    found = [price(cost, drone(x=0.7, y=-0.3, yaw=1.0, v=0.5)) for cost in pair]
    assert traced == 1
    assert len(jax.tree.leaves(first)) == 0 or found[0] != found[1]


@every_cost
def test_samples_on_the_last_axis_are_priced_one_by_one(pair, drone) -> None:
    cost, robot = pair[1], drone().dynamics
    states = jnp.asarray(2.0 * RNG.normal(size=(5, 6)), jnp.float32)
    controls = jnp.asarray(RNG.normal(size=(4, 3, 6)), jnp.float32)

    @jax.jit
    def price(values, controls):
        return total(cost, State(values, robot), controls[1], jnp.asarray(0.3), controls)

    together = jax.vmap(price, in_axes=-1)(states, controls)
    alone = [float(price(states[:, k], controls[:, :, k])) for k in range(6)]
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)


@every_cost
def test_gradients_are_finite_everywhere(pair, drone) -> None:
    cost, robot = pair[0], drone().dynamics

    @jax.jit
    def slopes(values, cost):
        def price(values, cost):
            return total(cost, State(values, robot), CONTROLS[0], jnp.asarray(0.1), CONTROLS)

        return jax.value_and_grad(price, (0, 1))(values, cost)

    far = ({"x": s * 1e6, "y": -1e6, "z": 1e6, "yaw": 1e4, "v": 1e3} for s in (1.0, -1.0))
    for where in ({}, {"x": 1e-20}, {"x": 1e-6, "y": 1e-6}, {"yaw": np.pi}, *far):
        for leaf in jax.tree.leaves(slopes(drone(**where).values, cost)):
            assert np.isfinite(leaf).all(), where


@every_cost
def test_the_same_cost_serves_another_model(pair, drone, shuffled) -> None:
    price = jax.jit(lambda cost, state: total(cost, state, CONTROLS[1], jnp.ones(()), CONTROLS))
    for cost in pair:
        values = [
            float(price(cost, make(x=0.7, y=-0.3, z=2.0, yaw=1.0, v=0.5)))
            for make in (drone, shuffled)
        ]
        assert values[0] == pytest.approx(values[1], rel=1e-6)
