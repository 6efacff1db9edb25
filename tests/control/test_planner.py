"""A planner without memory."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.compat.batch import rollout_batch
from jaxplore.compat.planner import Planner
from jaxplore.control.rollout import rollout_costs

T, K = 8, 32
MPPI = jx.MPPI(
    jx.KinematicBicycle(),
    jx.GoalCost([3.0, 1.0], terminal_weight=2.0) + 0.1 * jx.ControlRateCost(),
    horizon=T,
    num_samples=K,
    dt=0.1,
    noise_std=[0.5, 0.2],
)
PLANNER = Planner(MPPI)
STATE = jnp.asarray([0.0, 0.0, 0.2, 0.5])
NOMINAL = jnp.tile(jnp.asarray([0.4, 0.1]), (T, 1))
KEY = jax.random.key(0)


step = eqx.filter_jit(jx.MPPI.step)
costs_of, batch_of = eqx.filter_jit(rollout_costs), eqx.filter_jit(rollout_batch)


def plan(temperature: float = 1.0, **changes):
    given = {"nominal_input": NOMINAL, "initial_state": STATE, "key": KEY, **changes}
    return PLANNER.step(temperature=temperature, **given)


def test_it_is_the_step_of_its_mppi() -> None:
    mppi = eqx.tree_at(lambda parts: parts.weighting.temperature, MPPI, jnp.asarray(0.7))
    control, _, info = step(mppi, mppi.init(NOMINAL), STATE, key=KEY, shift=False)
    planned = plan(0.7)
    np.testing.assert_allclose(planned.optimal, info.controls, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(planned.optimal[0], control, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(planned.info.costs, info.costs, rtol=1e-5)
    assert planned.batch is None


def test_all_weight_on_one_sample_returns_that_sample() -> None:
    planned = plan(1e-9, return_batch=True)
    best = int(np.argmin(planned.info.costs))
    assert planned.info.weights[best] == 1.0
    np.testing.assert_allclose(planned.optimal, planned.batch.controls[:, :, best], rtol=1e-6)


def test_the_nominal_is_shifted_and_padded() -> None:
    planned = plan()
    np.testing.assert_array_equal(planned.nominal[:-1], planned.optimal[1:])
    np.testing.assert_array_equal(planned.nominal[-1], MPPI.dynamics.default_control)
    np.testing.assert_array_equal(PLANNER.initial_nominal, np.zeros((T, 2)))


def test_a_batch_adds_up_to_the_costs_and_holds_the_states() -> None:
    planned = plan(return_batch=True)
    states, controls, costs = planned.batch
    assert (states.shape, controls.shape, costs.shape) == ((T, 4, K), (T, 2, K), (T, K))
    np.testing.assert_allclose(costs.sum(axis=0), planned.info.costs, rtol=1e-4)
    here = STATE
    for t in range(T):
        here = MPPI.dynamics.step(here, controls[t, :, 3], MPPI.dt)
        np.testing.assert_allclose(states[t, :, 3], here, rtol=1e-4, atol=1e-5)
        goal = float(np.hypot(here[0] - 3.0, here[1] - 1.0))
        if t == 2:  # neither the first, nor the last, which hold more
            np.testing.assert_allclose(costs[t, 3], goal, rtol=1e-4)


def test_what_was_applied_before_counts_for_changes() -> None:
    planned = [plan(applied=applied, return_batch=True) for applied in ([0.0, 0.0], [0.9, 0.3])]
    assert not np.allclose(planned[0].info.costs, planned[1].info.costs)
    controls = planned[1].batch.controls
    parts = (MPPI.dynamics, MPPI.cost, STATE, controls, MPPI.dt)
    applied = jnp.asarray([0.9, 0.3])
    np.testing.assert_allclose(costs_of(*parts, applied=applied), planned[1].info.costs, rtol=1e-4)
    again = batch_of(*parts, applied=applied)
    np.testing.assert_allclose(again.costs, planned[1].batch.costs, rtol=1e-4, atol=1e-6)


class Counting(jx.Cost):
    """A cost that counts how often it is traced."""

    traces = 0

    def stage(self, state, control, t, belief):
        """Return the distance from the origin."""
        Counting.traces += 1
        return jnp.sum(state.position * state.position)


def test_the_temperature_the_state_and_the_nominal_do_not_recompile() -> None:
    model = jx.KinematicBicycle()
    planner = Planner(
        jx.MPPI(model, Counting(), horizon=T, num_samples=4, dt=0.1, noise_std=[0.5, 0.2])
    )
    counts = []
    for temperature in (0.5, 2.0, np.float32(3.0), jnp.asarray(4.0)):
        planner.step(
            temperature=temperature,
            nominal_input=NOMINAL * float(temperature),
            initial_state=STATE + float(temperature),
            key=KEY,
        )
        counts.append(Counting.traces)
    assert counts[0] == counts[-1] > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"temperature": 0.0}, "temperature is 0.0; accepted: a finite number > 0.0"),
        ({"nominal_input": NOMINAL[:-1]}, r"nominal_input has shape \(7, 2\); accepted: \(8, 2\)"),
        ({"temperature": np.ones(2)}, "temperature is .*; accepted: a finite number > 0.0"),
        ({"nominal_input": np.array([["left"]])}, "nominal_input is .*; accepted: numbers"),
        ({"initial_state": STATE[:-1]}, r"initial_state has shape \(3,\); accepted: \(4,\)"),
        ({"applied": [0.0]}, r"applied has shape \(1,\); accepted: \(2,\)"),
    ],
)
def test_bad_input(changes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plan(**changes)


def test_a_weighting_without_a_temperature_is_refused() -> None:
    with pytest.raises(ValueError, match="weighting is Elite; accepted: Softmax"):
        Planner(
            jx.MPPI(
                MPPI.dynamics,
                MPPI.cost,
                horizon=T,
                num_samples=K,
                noise_std=[0.5, 0.2],
                weighting=jx.Elite(0.1),
            )
        )
