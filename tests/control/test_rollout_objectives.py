"""Several costs from one rollout: the same as each alone, and as NumPy has it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    ControlCost,
    ControlRateCost,
    Cost,
    DifferentialDrive,
    DiscObstacleCost,
    Dynamics,
    GoalCost,
    PointMass,
    Unicycle,
    WaypointCost,
)
from jaxplore.control import rollout_costs, rollout_objectives
from jaxplore.costs import ControlJerkCost

pytestmark = pytest.mark.long

HORIZON, DT = 8, jnp.asarray(0.1)
OBJECTIVES = (
    GoalCost([3.0, 1.0], terminal_weight=4.0),
    ControlCost(),
    2.0 * ControlRateCost() + ControlJerkCost(include_applied=False),
    WaypointCost([1.0, 0.5], terminal_weight=2.0).with_name("waypoint"),
    DiscObstacleCost([[1.0, 0.0], [0.5, 1.0]], 0.3),
)

objectives = eqx.filter_jit(rollout_objectives)
alone = eqx.filter_jit(rollout_costs)


def sequences(model: Dynamics, number: int, seed: int = 0) -> np.ndarray:
    """Return random controls (T, nu, K) within the bounds."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(model.control_min), np.asarray(model.control_max)
    shares = rng.uniform(size=(HORIZON, number, model.control_size))
    return np.moveaxis(low + shares * (high - low), 1, 2).astype(np.float32)


def start(model: Dynamics, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 0.5, model.state_size).astype(np.float32)


# 256 samples are computed on a few lanes more.
@pytest.mark.parametrize(
    ("model", "number"),
    [(Unicycle(), 256), (PointMass(), 1)],
    ids=lambda value: type(value).__name__ if isinstance(value, Dynamics) else str(value),
)
def test_each_objective_is_that_of_a_rollout_of_its_own(model: Dynamics, number: int) -> None:
    controls, initial = jnp.asarray(sequences(model, number)), jnp.asarray(start(model))
    applied = 0.5 * model.control_max
    found = objectives(model, OBJECTIVES, initial, controls, DT, applied=applied)
    assert found.shape == (len(OBJECTIVES), number)
    for row, cost in zip(np.asarray(found), OBJECTIVES, strict=True):
        expected = alone(model, cost, initial, controls, DT, applied=applied)
        np.testing.assert_allclose(row, expected, rtol=2e-5, atol=1e-5)


def test_every_rollout_may_start_elsewhere() -> None:
    model, rng = Unicycle(), np.random.default_rng(3)
    initial = jnp.asarray(rng.uniform(-1.0, 1.0, (3, 20)).astype(np.float32))
    controls = jnp.asarray(sequences(model, 20))
    found = objectives(model, OBJECTIVES, initial, controls, DT)
    for row, cost in zip(np.asarray(found), OBJECTIVES, strict=True):
        np.testing.assert_allclose(
            row, alone(model, cost, initial, controls, DT), rtol=2e-5, atol=1e-5
        )


def test_the_order_of_objectives_is_that_of_the_rows() -> None:
    model = DifferentialDrive()
    controls, initial = jnp.asarray(sequences(model, 20)), jnp.asarray(start(model))
    found = objectives(model, OBJECTIVES, initial, controls, DT)
    turned = objectives(model, OBJECTIVES[::-1], initial, controls, DT)
    np.testing.assert_allclose(found, turned[::-1], rtol=1e-5, atol=1e-6)
    assert objectives(model, OBJECTIVES[:1], initial, controls, DT).shape == (1, 20)


def test_goal_effort_and_rate_of_a_differential_drive_in_numpy() -> None:
    model = DifferentialDrive(max_speed=1.0)
    controls, initial = sequences(model, 6), np.array([0.2, -0.1, 0.4, 0.6, -0.3], np.float32)
    applied = np.array([0.3, -0.5], np.float32)
    expected = np.zeros((3, 6))
    high, drag, dt = np.asarray(model.control_max, np.float64), 0.1, 0.1
    for k in range(6):
        x, y, yaw, v, omega = initial.astype(np.float64)
        before = applied.astype(np.float64)
        for a, alpha in controls[:, :, k].astype(np.float64):
            x, y = x + dt * v * np.cos(yaw), y + dt * v * np.sin(yaw)
            yaw = yaw + dt * omega
            v = np.clip(v + dt * (a - drag * v), 0.0, 1.0)
            omega = np.clip(omega + dt * (alpha - drag * omega), -2.0, 2.0)
            control = np.array([a, alpha])
            expected[0, k] += np.hypot(x - 3.0, y - 1.0)
            expected[1, k] += ((control / high) ** 2).sum()
            expected[2, k] += (((control - before) / (2.0 * high)) ** 2).sum()
            before = control
        expected[0, k] += 4.0 * np.hypot(x - 3.0, y - 1.0)
    some = (OBJECTIVES[0], ControlCost(), ControlRateCost())
    found = objectives(
        model, some, jnp.asarray(initial), jnp.asarray(controls), DT, applied=jnp.asarray(applied)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-4)


class Faulty(Cost):
    """Returns a vector where a number is expected."""

    method: str = eqx.field(static=True)

    def stage(self, state, control, t, belief):
        return control if self.method == "stage" else jnp.zeros(())

    def terminal(self, state, belief):
        return state.values if self.method == "terminal" else jnp.zeros(())

    def sequence(self, controls, applied, dt, dynamics):
        return controls[0] if self.method == "sequence" else jnp.zeros(())


@pytest.mark.parametrize("method", ["stage", "terminal", "sequence"])
def test_an_objective_of_another_shape_is_named(method: str) -> None:
    model = DifferentialDrive()
    given = (jnp.asarray(start(model)), jnp.asarray(sequences(model, 6)), DT)
    for cost, name in ((Faulty(method), "Faulty"), (Faulty(method).with_name("odd"), "odd")):
        with pytest.raises(ValueError, match=rf"{method} of {name} returns shape .*; accepted: \("):
            rollout_objectives(model, (OBJECTIVES[0], cost), *given)


def test_a_model_of_another_shape_is_named() -> None:
    class Half(Unicycle):
        def step_at(self, state, control, t, dt):
            return state[:2]

    model = Half()
    given = (jnp.zeros(3), jnp.asarray(sequences(model, 6)), DT)
    with pytest.raises(ValueError, match=r"step of Half returns shape \(2,\); accepted: \(3,\)"):
        rollout_objectives(model, OBJECTIVES[:2], *given)
