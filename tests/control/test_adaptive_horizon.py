"""A horizon that each step chooses anew."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.control import (
    AdaptiveHorizon,
    ControlNoise,
    HorizonByClearance,
    HorizonByInformation,
    HorizonBySpeed,
)
from jaxplore.control.knots import Knots
from jaxplore.costs.base import Cost
from jaxplore.tasks.registry import build, make_settings

ROBOT = jx.DifferentialDrive(drag=0.1)
KEY, LONG = jax.random.key(0), 12
START = jnp.asarray([0.2, 0.1, 0.3, 0.6, 0.2])


class Reach(Cost):
    """Distance to a place, with an end and a sequence of its own."""

    def stage(self, state, control, t, belief):
        x, y = state.position
        return jnp.hypot(x - 3.0, y - 1.0) + t

    def terminal(self, state, belief):
        return 2.0 * state.speed

    def sequence(self, controls, applied, dt, dynamics):
        return 0.1 * jnp.sum(controls**2)


class Table:
    """Information of a field with 10 beams."""

    num_beams = 10

    def __call__(self, position, heading):
        return 5.0 * position[0]


def mppi(horizon: int = LONG, **parts) -> jx.MPPI:
    """Return MPPI with few samples."""
    given = {"horizon": horizon, "num_samples": 32, "temperature": 0.3, "noise_std": [0.5, 1.0]}
    return jx.MPPI(ROBOT, 1.0 * Reach(), **(given | parts))


@eqx.filter_jit
def step(controller, state, observation=START, belief=None):
    return controller.step(state, observation, belief, key=KEY)


def test_the_whole_horizon_is_that_of_mppi_to_the_bit() -> None:
    plain = mppi()
    adaptive = AdaptiveHorizon(plain, HorizonBySpeed(0.0, 0.5), 3)
    assert int(adaptive.steps(START)) == LONG
    for mine, theirs in zip(
        jax.tree.leaves(step(adaptive, adaptive.init())),
        jax.tree.leaves(step(plain, plain.init())),
        strict=True,
    ):
        np.testing.assert_array_equal(mine, theirs)


def test_it_shows_its_plan() -> None:
    adaptive = AdaptiveHorizon(mppi(), HorizonBySpeed(0.0, 1.2), 4)
    plan = eqx.filter_jit(adaptive.inspect)(adaptive.init(), START, key=KEY, num_trajectories=4)
    assert plan.samples.shape == (4, LONG + 1, 5)
    # Beyond the horizon no sample is perturbed, so that all have the default control, zero.
    at_end = np.asarray(plan.samples[:, 9:, 3])
    np.testing.assert_allclose(at_end[:, 1:], at_end[:, :-1] * (1.0 - 0.05 * 0.1), rtol=1e-5)


def test_a_short_horizon_costs_what_its_rollouts_cost_in_numpy() -> None:
    plain = mppi()
    adaptive = AdaptiveHorizon(plain, HorizonBySpeed(0.0, 1.2), 4)
    steps = int(adaptive.steps(START))
    assert steps == round(4 + 0.5 * (LONG - 4))
    sampled = plain.sample(plain.init(), key=KEY)
    expected = []
    for controls in np.moveaxis(np.asarray(sampled.controls, np.float64), -1, 0):
        x, y, yaw, v, omega = np.asarray(START, np.float64)
        total = 0.0
        for number in range(steps):
            a, alpha = controls[number]
            x, y, yaw = x + 0.05 * v * np.cos(yaw), y + 0.05 * v * np.sin(yaw), yaw + 0.05 * omega
            v = np.clip(v + 0.05 * (a - 0.1 * v), 0.0, 1.0)
            omega = np.clip(omega + 0.05 * (alpha - 0.1 * omega), -2.0, 2.0)
            total += np.hypot(x - 3.0, y - 1.0) + 0.05 * (number + 1)
        # Beyond the horizon the controls are those of the plan, zeros at the start.
        within = 0.1 * np.sum(controls[:steps] ** 2)
        expected.append(total * LONG / steps + 2.0 * v + within)
    _, after, info = step(adaptive, adaptive.init())
    np.testing.assert_allclose(info.costs, expected, rtol=1e-5)
    np.testing.assert_array_equal(after.nominal[steps:], 0.0)
    assert np.abs(after.nominal[:steps]).min() > 0.0


def test_another_horizon_compiles_nothing() -> None:
    controller = AdaptiveHorizon(mppi(), HorizonBySpeed(0.0, 1.0), 2)
    state = controller.init()
    for _ in range(2):  # the first state is of weaker types than the later ones
        _, state, _ = step(controller, state, START)
    before = step._cached._cache_size()
    lengths = set()
    speeds = (0.0, 0.5, 1.0)
    for speed in speeds:
        observation = np.array(START)
        observation[3] = speed
        observation = jnp.asarray(observation)
        lengths.add(int(controller.steps(observation)))
        _, state, info = step(controller, state, observation)
        assert bool(info.is_finite)
    assert lengths == {2, 7, 12}
    assert step._cached._cache_size() == before
    # Under vmap every robot has its own horizon.
    rows = np.tile(START, (3, 1))
    rows[:, 3] = speeds
    many = jax.jit(jax.vmap(lambda x: controller.step(controller.init(), x, key=KEY)[2].costs))
    for row, costs in zip(rows, np.asarray(many(rows)), strict=True):
        alone = step(controller, controller.init(), jnp.asarray(row))[2].costs
        np.testing.assert_allclose(costs, alone, rtol=1e-5)


def test_it_holds_for_other_parts_of_mppi() -> None:
    plain = mppi(
        parameterisation=Knots(4),
        disturbance=ControlNoise([0.1, 0.1]),
        num_outcomes=3,
        risk=jx.ConditionalValueAtRisk(0.5),
    )
    whole = AdaptiveHorizon(plain, HorizonBySpeed(0.0, 0.5), 3)
    np.testing.assert_allclose(
        step(whole, whole.init())[2].costs, step(plain, plain.init())[2].costs, rtol=1e-5
    )
    short = AdaptiveHorizon(plain, HorizonBySpeed(5.0, 6.0), 3)
    assert int(short.steps(START)) == 3
    assert bool(step(short, short.init())[2].is_finite)


def test_rules_read_speed_clearance_and_information() -> None:
    # Any object with the parts of a belief will do: 0.1 m of clearance and 5 nat per metre of x.
    belief = SimpleNamespace(
        clearance=lambda position: 0.1 * position[0],
        information=Table(),
    )
    near, far = (jnp.asarray([x, 2.0, 0.0, 0.0, 0.0]) for x in (3.0, 7.0))
    clear = AdaptiveHorizon(mppi(), HorizonByClearance(0.2, 0.6), 4)
    known = AdaptiveHorizon(mppi(), HorizonByInformation(2.5, 0.5), 4)
    assert int(clear.steps(near, belief)) == 4 + round(0.25 * 8)
    assert int(clear.steps(far, belief)) == LONG
    assert int(known.steps(near, belief)) == 4 + round(0.5 * 8)
    assert int(known.steps(far, belief)) == 4
    nowhere = jnp.full(5, jnp.nan)
    assert int(clear.steps(nowhere, belief)) == LONG
    with pytest.raises(ValueError, match=r"^belief is None, and a cost reads its clearance"):
        clear.steps(near, None)


def test_settings_choose_a_rule() -> None:
    entries = {"path": "track", "adaptive_horizon": {"rule": "speed", "min_horizon": 10}}
    controller = build(make_settings(entries)).controller
    assert isinstance(controller, AdaptiveHorizon)
    assert isinstance(controller.rule, HorizonBySpeed)
    assert float(controller.min_horizon) == 10.0
    entries["latency"] = 0.1
    assert isinstance(build(make_settings(entries)).controller, jx.LatencyCompensation)
    for given, said in (
        ({"min_horizon": 60}, r"setting adaptive_horizon.min_horizon is 60; accepted: at most the"),
        ({"at_shortest": 1.0, "at_longest": 1.0}, r"at_longest is 1.0; accepted: another number"),
    ):
        with pytest.raises(ValueError, match=rf"^{said}"):
            build(make_settings({"path": "track", "adaptive_horizon": {"rule": "speed"} | given}))
    portfolio = {
        "map": "office",
        "architecture": "portfolio",
        "adaptive_horizon": {"rule": "speed"},
    }
    with pytest.raises(
        ValueError, match=r"^setting adaptive_horizon.rule is 'speed' for Portfolio"
    ):
        build(make_settings(portfolio))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((8, 5), r"min_horizon is 8; accepted: at most max_horizon, 5"),
        ((2, 13), r"max_horizon is 13; accepted: at most the horizon of the controller, 12"),
    ],
)
def test_a_horizon_that_is_impossible_is_refused(given, said) -> None:
    with pytest.raises(ValueError, match=rf"^{said}$"):
        AdaptiveHorizon(mppi(), HorizonBySpeed(), *given)
