"""Risks, and the disturbed rollouts that they are the costs of."""

import math
from collections.abc import Callable
from fractions import Fraction
from typing import ClassVar

import equinox as eqx
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

from jaxplore import (
    MPPI,
    ConditionalValueAtRisk,
    Cost,
    Dynamics,
    MovingObstacleCost,
    PointMass,
    State,
    StateNoise,
)
from jaxplore.belief import Obstacles
from jaxplore.belief.belief import Belief
from jaxplore.control import (
    ControlNoise,
    Entropic,
    MeanVariance,
    ModelEnsemble,
    Outcomes,
    Risk,
    UncertainObstacles,
    ValueAtRisk,
    WorstCase,
    rollout_costs,
)
from jaxplore.geometry import Outlines

pytestmark = pytest.mark.long

COUNTS = [1, 2, 7, 10]
LEVELS = [Fraction(n, 20) for n in range(1, 20)] + [Fraction(1, 3), Fraction(6, 7)]


@jax.jit
def cost_of(risk, totals, variation):
    return risk.costs(totals, variation)


def costs_of(risk: Risk, totals: np.ndarray) -> np.ndarray:
    """Of totals (M, K), without variation."""
    single = jnp.asarray(totals, jnp.float32)
    return np.asarray(cost_of(risk, single, jnp.zeros(totals.shape[1])), np.float64)


def outcomes_of(seed: int, count: int, scale: float = 1.0) -> np.ndarray:
    """Some of them equal."""
    rng = np.random.default_rng(seed)
    totals = scale * rng.normal(2.0, 3.0, (count, 4))
    totals[:, 1] = np.round(totals[:, 1] / scale) * scale
    totals[:, 2] = 3.0 * scale
    return totals.astype(np.float32).astype(np.float64)


def quantile(column: np.ndarray, level: Fraction) -> float:
    """The least outcome that a share `level` of them does not exceed, by trying all."""
    return min(x for x in column if Fraction(int((column <= x).sum()), len(column)) >= level)


def tail_mean(column: np.ndarray, level: Fraction) -> float:
    """Mean of the worst share 1 - level; the last outcome counts in part."""
    left, total = 1 - level, 0.0
    for value in sorted(column, reverse=True):
        share = min(left, Fraction(1, len(column)))
        total, left = total + float(share) * value, left - share
    return total / float(1 - level)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("level", LEVELS, ids=str)
def test_quantiles_and_tails_are_those_of_enumeration(count: int, level: Fraction) -> None:
    totals = outcomes_of(count, count)
    at_risk = costs_of(ValueAtRisk(float(level)), totals)
    np.testing.assert_allclose(at_risk, [quantile(column, level) for column in totals.T])
    conditional = costs_of(ConditionalValueAtRisk(float(level)), totals)
    expected = [tail_mean(column, level) for column in totals.T]
    np.testing.assert_allclose(conditional, expected, rtol=1e-5, atol=2e-5)


@hypothesis.given(
    seed=st.integers(0, 2**32 - 1),
    count=st.sampled_from(COUNTS),
    level=st.floats(0.01, 0.99),
    scale=st.sampled_from([1e-3, 1.0, 1e4]),
)
def test_risks_are_ordered(seed: int, count: int, level: float, scale: float) -> None:
    totals, slack = outcomes_of(seed, count, scale), 1e-4 * scale
    at_risk = costs_of(ValueAtRisk(level), totals)
    conditional = costs_of(ConditionalValueAtRisk(level), totals)
    worst, mean = costs_of(WorstCase(), totals), costs_of(MeanVariance(), totals)
    np.testing.assert_array_equal(worst, totals.max(axis=0))
    np.testing.assert_allclose(mean, totals.mean(axis=0), rtol=1e-5, atol=slack)
    assert (at_risk <= conditional + slack).all()
    assert (conditional <= worst + slack).all()
    assert (mean <= conditional + slack).all()
    more = costs_of(ConditionalValueAtRisk(min(level + 0.1, 0.995)), totals)
    assert (more >= conditional - slack).all()
    entropic = costs_of(Entropic(1.0 / scale), totals)
    assert (mean <= entropic + slack).all()
    assert (entropic <= worst + slack).all()


def test_level_0_is_the_mean() -> None:
    totals = outcomes_of(0, 7)
    np.testing.assert_allclose(
        costs_of(ConditionalValueAtRisk(0.0), totals), totals.mean(axis=0), rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("theta", [-5.0, -0.5, 0.01, 0.3, 2.0, 40.0])
def test_entropic_risk_is_the_formula(theta: float) -> None:
    totals = outcomes_of(3, 10)
    expected = (scipy.special.logsumexp(theta * totals, axis=0) - math.log(10)) / theta
    np.testing.assert_allclose(costs_of(Entropic(theta), totals), expected, rtol=1e-4, atol=1e-4)


def test_entropic_risk_is_between_the_best_and_the_worst_case() -> None:
    totals = outcomes_of(3, 10)
    for theta, limit in ((3e3, totals.max(axis=0)), (-3e3, totals.min(axis=0))):
        np.testing.assert_allclose(costs_of(Entropic(theta), totals), limit, atol=2e-3)
    mean = totals.mean(axis=0)
    np.testing.assert_allclose(costs_of(Entropic(1e-3), totals), mean, atol=0.02)
    assert np.isfinite(costs_of(Entropic(50.0), 1e5 * totals)).all()


@pytest.mark.parametrize("theta", [1e-5, -1e-6, 1e-7])
def test_entropic_risk_is_the_mean_for_small_theta(theta: float) -> None:
    totals = outcomes_of(3, 10)
    mean = totals.mean(axis=0)
    np.testing.assert_allclose(costs_of(Entropic(theta), totals), mean, rtol=1e-3)


together = eqx.filter_jit(rollout_costs)


class Rolling(Dynamics):
    """Depends on time and on a parameter, and is not linear."""

    state_names: ClassVar[tuple[str, ...]] = ("x", "v")
    control_names: ClassVar[tuple[str, ...]] = ("a",)
    gain: jax.Array
    control_min: jax.Array = eqx.field(default_factory=lambda: -jnp.ones(1))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.ones(1))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.2))

    def step(self, state, control, dt):
        raise AssertionError("a model with a step_at of its own")

    def step_at(self, state, control, t, dt):
        x, v = state
        (a,) = control
        return jnp.stack([x + dt * v, v + dt * (self.gain * a - jnp.sin(x) + t)])


class Line(Cost):
    """Depends on time, control and state, and on all controls."""

    limit: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(jnp.inf))

    def stage(self, state, control, t, belief):
        paid = (state["x"] - 1.0) ** 2 * (1.0 + t) + 0.1 * control[0] ** 2
        return jnp.where(state["x"] > self.limit, jnp.nan, paid)

    def terminal(self, state, belief):
        return 3.0 * jnp.abs(state["v"])

    def sequence(self, controls, applied, dt, dynamics):
        return jnp.sum(jnp.diff(controls[:, 0], prepend=applied) ** 2)


class Only(Risk):
    """The cost of one outcome, to look at each of them."""

    index: jax.Array

    def costs(self, totals, variation):
        return totals[self.index]


HORIZON, OUTCOMES, DT = 6, 4, 0.2
START, APPLIED = np.array([0.1, -0.3], np.float32), np.array([0.25], np.float32)
ROBOT = Rolling(jnp.asarray(1.3))
GAINS = [0.5, 1.0, 1.5, 2.5]
DISTURBANCES = {
    "state": StateNoise([0.4, 0.9]),
    "control": ControlNoise([0.8]),
    "ensemble": ModelEnsemble(*(Rolling(jnp.asarray(gain)) for gain in GAINS)),
}
disturbed = pytest.mark.parametrize("name", DISTURBANCES)


@eqx.filter_jit
def rolled_out(controls, outcomes, cost=Line()):  # noqa: B008
    return rollout_costs(
        ROBOT,
        cost,
        jnp.asarray(START),
        controls,
        jnp.asarray(DT),
        applied=jnp.asarray(APPLIED),
        outcomes=outcomes,
    )


def draw(name: str, risk: Risk, seed: int = 0) -> Outcomes:
    key = jax.random.key(seed)
    return Outcomes.draw(DISTURBANCES[name], risk, ROBOT, HORIZON, OUTCOMES, key=key)


def controls_for(samples: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (HORIZON, 1, samples)).astype(np.float32)


def by_hand(name: str, drawn, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stage costs (T, M, K), terminal costs (M, K) and costs of the sequences (K,), in double."""
    samples = controls.shape[-1]
    drawn = None if name == "ensemble" else np.asarray(drawn, np.float64)
    paid, last = np.zeros((HORIZON, OUTCOMES, samples)), np.zeros((OUTCOMES, samples))
    for m, k in np.ndindex(OUTCOMES, samples):
        x, v = START.astype(float)
        gain = GAINS[m] if name == "ensemble" else 1.3
        for t in range(HORIZON):
            a = float(controls[t, 0, k])
            followed = np.clip(a + 0.8 * drawn[t, m, 0], -1, 1) if name == "control" else a
            x, v = x + DT * v, v + DT * (gain * followed - math.sin(x) + t * DT)
            if name == "state":
                x, v = np.array([x, v]) + math.sqrt(DT) * np.array([0.4, 0.9]) * drawn[t, m]
            paid[t, m, k] = (x - 1.0) ** 2 * (1.0 + (t + 1) * DT) + 0.1 * a**2
        last[m, k] = 3.0 * abs(v)
    changes = np.diff(controls[:, 0].astype(float), axis=0, prepend=APPLIED[0])
    return paid, last, (changes**2).sum(axis=0)


@disturbed
def test_each_outcome_is_a_rollout_of_its_own(name: str) -> None:
    """All samples meet the same M draws, and the M outcomes differ."""
    samples = 256  # Computed on more: see `_lanes`.
    controls = controls_for(samples)
    outcomes = draw(name, Only(jnp.asarray(0)))
    checked = slice(250, None)
    paid, last, sequence = by_hand(name, outcomes.drawn, controls[:, :, checked])
    expected = paid.sum(axis=0) + last + sequence
    for m in range(OUTCOMES):
        chosen = outcomes._replace(risk=Only(jnp.asarray(m)))
        actual = rolled_out(jnp.asarray(controls), chosen)
        assert actual.shape == (samples,)
        np.testing.assert_allclose(actual[checked], expected[m], rtol=2e-5)
        for other in range(m):
            assert (np.abs(expected[m] - expected[other]) > 1e-3).all()


RISKS = {
    "mean": MeanVariance(),
    "variance": MeanVariance(2.0, 0.8),
    "undiscounted": MeanVariance(0.5, 1.0),
    "worst": WorstCase(),
    "tail": ConditionalValueAtRisk(0.6),
}


def mean_and_variance(paid, last, weight: float, discount: float) -> np.ndarray:
    """With loops."""
    expected = (paid.sum(axis=0) + last).sum(axis=0) / OUTCOMES
    for t, k in np.ndindex(HORIZON, paid.shape[-1]):
        mean = sum(paid[t, :, k]) / OUTCOMES
        squares = sum((value - mean) ** 2 for value in paid[t, :, k])
        expected[k] += weight * discount**t * squares / (OUTCOMES - 1)
    return expected


@pytest.mark.parametrize(
    ("name", "risk"),
    [*(("state", risk) for risk in RISKS), ("control", "variance"), ("ensemble", "variance")],
)
def test_the_risk_is_that_of_the_outcomes(name: str, risk: str) -> None:
    controls = controls_for(5)
    outcomes = draw(name, RISKS[risk], seed=1)
    paid, last, sequence = by_hand(name, outcomes.drawn, controls)
    totals = paid.sum(axis=0) + last
    settings = {"mean": (0.0, 0.95), "variance": (2.0, 0.8), "undiscounted": (0.5, 1.0)}
    if risk in settings:
        expected = mean_and_variance(paid, last, *settings[risk])
    elif risk == "worst":
        expected = totals.max(axis=0)
    else:
        expected = np.array([tail_mean(column, Fraction(3, 5)) for column in totals.T])
    actual = rolled_out(jnp.asarray(controls), outcomes)
    np.testing.assert_allclose(actual, expected + sequence, rtol=3e-5)


def test_discount_0_counts_the_first_step_only() -> None:
    controls = controls_for(5)
    outcomes = draw("state", MeanVariance(0.5, 0.0), seed=1)
    paid, last, sequence = by_hand("state", outcomes.drawn, controls)
    actual = rolled_out(jnp.asarray(controls), outcomes)
    expected = mean_and_variance(paid, last, 0.5, 0.0) + sequence
    np.testing.assert_allclose(actual, expected, rtol=3e-5)


def test_one_outcome_has_no_variance() -> None:
    controls = jnp.asarray(controls_for(5))
    costs = [
        rolled_out(
            controls,
            Outcomes.draw(StateNoise([0.1, 0.1]), risk, ROBOT, HORIZON, 1, key=jax.random.key(0)),
        )
        for risk in (MeanVariance(100.0), MeanVariance(0.0), WorstCase())
    ]
    np.testing.assert_array_equal(costs[0], costs[1])
    np.testing.assert_array_equal(costs[0], costs[2])


@pytest.mark.parametrize(
    "disturbance", [StateNoise([0.0, 0.0]), ControlNoise([0.0])], ids=["state", "control"]
)
def test_without_a_spread_it_is_the_model(disturbance) -> None:
    controls = jnp.asarray(controls_for(5))
    plain = rolled_out(controls, None)
    outcomes = Outcomes.draw(
        disturbance, MeanVariance(3.0), ROBOT, HORIZON, OUTCOMES, key=jax.random.key(0)
    )
    np.testing.assert_allclose(rolled_out(controls, outcomes), plain, rtol=1e-5)


@pytest.mark.parametrize("name", ["state", "control"])
def test_draws_are_standard_normal_and_differ_between_keys(name: str) -> None:
    size = 2 if name == "state" else 1
    part = DISTURBANCES[name]
    one, other = (
        np.asarray(part.draw(ROBOT, 50, 200, key=jax.random.key(seed)), np.float64)
        for seed in (0, 1)
    )
    assert one.shape == (50, 200, size)
    assert one.mean() == pytest.approx(0.0, abs=5 / math.sqrt(one.size))
    assert one.var() == pytest.approx(1.0, abs=5 * math.sqrt(2 / one.size))
    limit = 5 / math.sqrt(one.size)
    assert abs((one * other).mean()) < limit
    assert abs((one[1:] * one[:-1]).mean()) < limit
    assert abs((one[:, 1:] * one[:, :-1]).mean()) < limit


def test_one_outcome_that_is_not_finite_makes_the_sample_infinite() -> None:
    controls = np.broadcast_to(np.linspace(-1, 1, 9, dtype=np.float32), (HORIZON, 1, 9))
    limit = 1.1
    for risk in (WorstCase(), MeanVariance(1.0), ValueAtRisk(0.5), Entropic(0.1)):
        outcomes = draw("ensemble", risk)
        actual = np.asarray(rolled_out(jnp.asarray(controls), outcomes, Line(jnp.asarray(limit))))
        free = np.asarray(rolled_out(jnp.asarray(controls), outcomes))
        beyond = np.zeros((OUTCOMES, 9), bool)
        for m, k in np.ndindex(OUTCOMES, 9):
            x, v = START.astype(float)
            for t in range(HORIZON):
                a = float(controls[t, 0, k])
                x, v = x + DT * v, v + DT * (GAINS[m] * a - math.sin(x) + t * DT)
                beyond[m, k] |= x > limit
        bad = beyond.any(axis=0)
        assert bad.any()
        assert (~beyond.all(axis=0) & bad).any()
        assert (~bad).any()
        assert (actual[bad] == np.inf).all()
        np.testing.assert_allclose(actual[~bad], free[~bad], rtol=1e-6)


def test_identical_sequences_cost_the_same() -> None:
    controls = jnp.broadcast_to(jnp.asarray(controls_for(1)), (HORIZON, 1, 256))
    for name in DISTURBANCES:
        actual = np.asarray(rolled_out(controls, draw(name, MeanVariance(1.0))))
        np.testing.assert_allclose(actual, actual[0], rtol=1e-6)
        again = rolled_out(controls, draw(name, MeanVariance(1.0), seed=3))
        assert (np.abs(again - actual) > 1e-3).all() or name == "ensemble"


class Bent(Rolling):
    """With a leaf that is no array, as models have that are learned."""

    bend: Callable = jnp.tanh

    def step_at(self, state, control, t, dt):
        return jnp.stack([state[0], self.bend(self.gain * control[0])])


def test_models_of_an_ensemble_may_have_leaves_that_are_no_arrays() -> None:
    models = [Bent(jnp.asarray(gain)) for gain in (0.5, 2.0)]
    controls = jnp.asarray(controls_for(3))
    outcomes = Outcomes.draw(
        ModelEnsemble(*models), Only(jnp.asarray(1)), models[0], HORIZON, 2, key=jax.random.key(0)
    )
    zero = jnp.zeros(())
    expected = together(models[1], Line(), jnp.asarray(START), controls, zero + DT)
    actual = together(models[0], Line(), jnp.asarray(START), controls, zero + DT, outcomes=outcomes)
    np.testing.assert_allclose(actual, expected, rtol=1e-5)
    with pytest.raises(ValueError, match="accepted: one or more models of one class"):
        ModelEnsemble(models[0], Bent(jnp.asarray(1.0), bend=jnp.sin))


def controller(**settings) -> MPPI:
    return MPPI(PointMass(2), Line(), temperature=1.0, noise_std=[1.0, 1.0], **settings)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Entropic(0.0), r"theta is 0.0; accepted: a finite number other than 0"),
        (lambda: ControlNoise(0.3), r"std is 0.3; accepted: a vector of numbers >= 0"),
        (
            lambda: controller(disturbance=StateNoise([0.1])),
            r"std has shape \(1,\); accepted: \(4,\) for PointMass",
        ),
        (
            lambda: controller(disturbance=ControlNoise([0.1] * 3)),
            r"std has shape \(3,\); accepted: \(2,\) for PointMass",
        ),
        (
            lambda: controller(disturbance=ModelEnsemble(PointMass(2)), num_outcomes=2),
            r"num_outcomes is 2; accepted: 1, one per model of the ensemble",
        ),
        (lambda: ModelEnsemble(), r"models have 0 structures; accepted: one or more models"),
        (
            lambda: ModelEnsemble(PointMass(2), PointMass(3)),
            r"models have 2 structures; accepted: one or more models of one class",
        ),
        (
            lambda: ModelEnsemble(PointMass(2), PointMass(2, max_speed=1.0)),
            r"models have 2 structures; accepted",
        ),
    ],
)
def test_bad_input_is_named(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


# Obstacles that may go elsewhere


OBSTACLES = Belief(
    obstacles=Obstacles(
        Outlines.discs([[1.5, 0.2], [0.5, 1.0]], 0.3),
        [[-0.5, 0.0], [0.0, -0.4]],
        [0.3, 0.0],
        std=0.2,
        growth=0.3,
        turn_growth=0.2,
    )
)


NOISE = StateNoise([0.2, 0.2, 0.1, 0.1])


@eqx.filter_jit
def stages(cost, model, noise, initial, controls, dt, keys, draws, belief):
    """Return the stage costs (T,) of one sequence in one outcome."""

    def advance(state, inputs):
        t, control, key, draw = inputs
        if noise is None:
            state = model.step(state, control, dt)
        else:
            state = noise.step_at(model, state, control, dt * t, dt, draw)
        known = Belief(obstacles=belief.obstacles.sample(key))
        return state, cost.stage(State(state, model), control, dt * (t + 1.0), known)

    inputs = (jnp.arange(len(controls), dtype=jnp.float32), controls, keys, draws)
    return jax.lax.scan(advance, initial, inputs)[1]


@pytest.mark.parametrize(
    ("risk", "robot"),
    [(MeanVariance(2.0), None), (ConditionalValueAtRisk(0.7), NOISE)],
)
def test_each_outcome_meets_the_obstacles_drawn_for_it(risk: Risk, robot) -> None:
    """Against each outcome on its own, with the obstacles of its draw as what is believed."""
    model, dt, count = PointMass(), jnp.asarray(0.1), 5
    cost = MovingObstacleCost(nearness=None, clearance=1.0, margin=0.02, nearest_only=True)
    uncertain = UncertainObstacles(robot)
    controls = jnp.asarray(np.random.default_rng(0).normal(size=(8, 2, 3)), jnp.float32)
    initial = jnp.asarray([0.0, 0.0, 1.0, 0.0])
    outcomes = Outcomes.draw(uncertain, risk, model, 8, count, key=jax.random.key(3))

    keys, draws = outcomes.drawn

    def of(m: int):
        return keys[:, m], draws[:, m] if robot else ()

    alone = np.array(
        [
            [
                stages(cost, model, robot, initial, controls[..., k], dt, *of(m), OBSTACLES)
                for k in range(3)
            ]
            for m in range(count)
        ]
    )
    assert alone.sum() > 0.0
    assert np.ptp(alone.sum(-1), axis=0).min() > 0.0
    variation = np.zeros(3)
    if isinstance(risk, MeanVariance):
        discounts = 0.95 ** np.arange(8)
        variation = (discounts[:, None] * np.var(alone, axis=0, ddof=1).T).sum(axis=0)
    expected = cost_of(risk, jnp.asarray(alone.sum(-1)), jnp.asarray(variation, jnp.float32))
    found = together(model, cost, initial, controls, dt, OBSTACLES, outcomes=outcomes)
    np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_an_averse_robot_keeps_more_room_from_what_is_uncertain() -> None:
    """The cheaper of two ways past an obstacle depends on the measure of risk."""
    model, dt = PointMass(), jnp.asarray(0.1)
    obstacle = Belief(obstacles=Obstacles(Outlines.discs([[1.0, 0.0]], 0.3), std=0.25))
    cost = MovingObstacleCost(nearness=None, clearance=0.05, collision=1.0, margin=0.02)
    near, far = 0.75, 1.05
    starts = jnp.asarray([[0.0, 0.0], [near, far], [2.0, 2.0], [0.0, 0.0]])
    effort = jnp.asarray([0.0, 0.25])

    def prices(risk: Risk):
        outcomes = Outcomes.draw(UncertainObstacles(), risk, model, 10, 200, key=jax.random.key(0))
        paid = together(model, cost, starts, jnp.zeros((10, 2, 2)), dt, obstacle, outcomes=outcomes)
        return np.asarray(paid + effort)

    median, tail = prices(ValueAtRisk(0.5)), prices(ConditionalValueAtRisk(0.95))
    assert median[0] < median[1]
    assert tail[0] > tail[1]
