"""Portfolios: members against controllers of their own, what they say against NumPy, and faults."""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    BiasedProposal,
    ControlCost,
    Cost,
    DifferentialDrive,
    DiscObstacleCost,
    Elite,
    GaussianProposal,
    GoalCost,
    Knots,
    Portfolio,
    Smooth,
)
from jaxplore.control import rollout, rollout_objectives
from jaxplore.costs.heading_for import RegionCost
from jaxplore.planning import SafeFusion, WeightedVote, diversity
from jaxplore.planning.portfolio.member_controllers import FLOOR

pytestmark = pytest.mark.long

ROBOT, DT, HORIZON, SAMPLES = DifferentialDrive(max_speed=1.0), 0.1, 8, 32
HALF_RANGE = np.asarray(ROBOT.control_max, np.float64)
HARD = DiscObstacleCost([[1.0, 0.1]], 0.1, clearance=0.25, collision=2.0)
GOAL, EFFORT = GoalCost([3.0, 1.0], terminal_weight=2.0), ControlCost()
OBJECTIVES: dict[str, Any] = {
    "goal": GOAL,
    "effort": EFFORT,
    "room": DiscObstacleCost([[1.0, -0.5], [1.0, 1.0]], 0.2, clearance=1.5, collision=0.0),
}
WEIGHTS = {"bold": {"goal": 0.8, "effort": 0.2}, "careful": {"goal": 0.2, "room": 0.8}}
START = jnp.asarray([0.0, 0.0, 0.1, 0.8, 0.0])
KEY = jax.random.key(3)


def template(**changes: Any) -> MPPI:
    given = {"horizon": HORIZON, "num_samples": SAMPLES, "dt": DT, "temperature": 0.5}
    return MPPI(ROBOT, HARD, **{**given, "noise_std": [0.5, 1.0], **changes})


def portfolio(objectives=OBJECTIVES, weights=WEIGHTS, mppi: MPPI | None = None, **changes: Any):
    return Portfolio(template() if mppi is None else mppi, objectives, weights, **changes)


@eqx.filter_jit
def compiled_step(controller, state, belief, key):
    return controller.step(state, START, belief, key=key)


def step(controller, state, belief=None, key=KEY):
    """Step; the compiled function takes no defaults, each pattern of which it would compile."""
    return compiled_step(controller, state, belief, key)


@eqx.filter_jit
def priced(member: MPPI, costs, state, belief=None, key=KEY):
    """Return the sampled controls of a member and what each cost makes of them, (O, K)."""
    sampled = member.sample(state, key=key)
    given = (ROBOT, costs, START, sampled.controls, member.dt, belief)
    return sampled.controls, rollout_objectives(*given, applied=state.applied)


def of_member(states: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], states)


def assert_alike(found: Any, expected: Any, tolerance: float = 1e-4) -> None:
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)


# Members are controllers


@pytest.mark.parametrize(
    "parameterisation", [None, Smooth(), Knots(4)], ids=["direct", "smooth", "knots"]
)
def test_a_portfolio_of_one_is_that_controller(parameterisation) -> None:
    mppi = template(parameterisation=parameterisation)
    given = {"mppi": mppi, "names": ["only"], "is_normalised": False, "fusion": "best-only"}
    one = portfolio({"goal": GOAL}, [[1.0]], **given)
    alone = eqx.tree_at(lambda c: c.cost, mppi, 1.0 * GOAL.with_name("goal") + HARD)
    assert_alike(one.single("only"), alone, 0.0)
    state, other = one.init(), alone.init()
    for seed in range(3):
        control, state, info = step(one, state, key=jax.random.key(seed))
        expected, other, said = step(alone, other, key=jax.random.key(seed))
        assert_alike(control, expected)
        assert_alike(info._replace(members=None), said, 1e-3)
        assert_alike(of_member(state.members, 0), other)
        assert info.members.shares.tolist() == [1.0]


TURNS = (0.0, 0.5 * np.pi, -0.5 * np.pi)
ROWS = np.array([[0.8, 0.2, 0.0, 0.5], [1.0, 1.0, 1.0, 0.5], [0.2, 0.0, 0.8, 0.5]])
HORIZONS = [0.8, 1.6, 1.0]
NUMBERS = {"temperatures": [0.1, 0.5, 1.0], "noise_scales": [1.0, 0.5, 1.5], "horizons": HORIZONS}


def differing(order=(0, 1, 2), **changes: Any) -> Portfolio:
    """Return a portfolio whose members differ in all they can; all of them compile once."""
    objectives = {**OBJECTIVES, "region": [RegionCost(TURNS[index]) for index in order]}
    numbers = {name: [values[index] for index in order] for name, values in NUMBERS.items()}
    return portfolio(objectives, ROWS[list(order)], **{**numbers, **changes})


def test_members_side_by_side_are_members_one_by_one(empty_belief) -> None:
    every = differing()
    state = every.init()
    for seed in range(3):
        key = jax.random.key(seed)
        _, after, info = step(every, state, empty_belief, key)
        for index, name in enumerate(every.member_names):
            alone = every.single(name, spread=jnp.maximum(after.spread, FLOOR))
            assert float(alone.dt) == pytest.approx(HORIZONS[index] / HORIZON)
            control, other, said = step(alone, of_member(state.members, index), empty_belief, key)
            assert_alike(info.members.controls[index], control, 2e-3)
            assert_alike(after.members.nominal[index], other.nominal, 2e-3)
            size = info.members.effective_sample_sizes[index]
            assert_alike(size, said.effective_sample_size, 1e-2)
        state = after


@pytest.mark.parametrize("times", [0.25, 0.5, 1.0, 2.0, 4.0])
def test_a_plan_holds_each_control_for_its_own_step(times: float) -> None:
    length = times * HORIZON * DT
    one = portfolio(OBJECTIVES, [[1.0, 1.0, 1.0]], horizons=[length], fusion="best-only")
    control, state, info = step(one, one.init())
    # Of several within a step it is the first, which is for now; nothing is planned beyond.
    rows = np.floor(np.arange(HORIZON) / times).astype(int)
    planned = np.concatenate([state.members.nominal[0], np.zeros((4 * HORIZON, 2))])
    assert_alike((control, info.controls), (planned[0], planned[rows]), 0.0)
    assert float(one.members.member(0).dt) * HORIZON == pytest.approx(length)
    assert float(one.members.member(0).control_period) == pytest.approx(DT)


def test_the_order_of_members_does_not_matter(empty_belief) -> None:
    order = (2, 0, 1)
    every, turned = differing(), differing(order)
    state, other = every.init(), turned.init()
    for seed in range(2):
        key = jax.random.key(seed)
        control, state, info = step(every, state, empty_belief, key)
        expected, other, said = step(turned, other, empty_belief, key)
        assert_alike(control, expected, 1e-3)
        permuted = (rows[jnp.asarray(order)] if rows.ndim else rows for rows in info.members)
        assert_alike(said.members, tuple(permuted), 5e-3)
        assert_alike(other.spread, state.spread, 1e-4)


# What they say


def test_spread_costs_uncertainty_and_diversity_in_numpy(empty_belief) -> None:
    every = differing(horizons=[HORIZON * DT] * 3, smoothing_time=0.5)
    state, spread = every.init(), np.zeros(4)
    common = (ROWS / ROWS.sum(axis=1, keepdims=True)).mean(axis=0)[:3]
    common /= common.sum()
    for seed in range(3):
        key = jax.random.key(seed)
        _, after, info = step(every, state, empty_belief, key)
        away, uncertainties = [], []
        weights = 3.0 * np.asarray(info.weights, np.float64).reshape(3, -1)
        for index, turn in enumerate(TURNS):
            costs = (HARD, *OBJECTIVES.values(), RegionCost(turn))
            member = of_member(state.members, index)
            sampled, paid = priced(every.members.member(index), costs, member, empty_belief, key)
            sampled, paid = np.asarray(sampled, np.float64), np.asarray(paid, np.float64)
            free = paid[1:, paid[0] == 0.0]
            assert 0 < free.shape[1] < SAMPLES
            away.append(np.abs(free - free.mean(axis=1, keepdims=True)))
            mean = sampled @ weights[index]
            variance = ((sampled - mean[:, :, None]) ** 2) @ weights[index]
            uncertainties.append(np.sqrt((variance / HALF_RANGE**2).mean()))
        now = np.concatenate(away, axis=1).mean(axis=1)
        spread = now if seed == 0 else spread + (1.0 - np.exp(-DT / 0.5)) * (now - spread)
        np.testing.assert_allclose(after.spread, spread, rtol=1e-4)
        said = info.members
        np.testing.assert_allclose(said.uncertainties, uncertainties, rtol=1e-3)
        np.testing.assert_allclose(
            said.effective_sample_sizes, 1.0 / (weights**2).sum(axis=1), rtol=1e-4
        )
        first = np.asarray(said.controls, np.float64) / HALF_RANGE
        pairs = itertools.combinations(first, 2)
        apart = [np.sqrt(((one - other) ** 2).mean()) for one, other in pairs]
        assert float(said.diversity) == pytest.approx(np.mean(apart), rel=1e-4)
        factors = common / np.maximum(spread[:3], FLOOR)
        judged = sum(
            (cost.with_name(name) for name, cost in OBJECTIVES.items()), HARD.with_name("hard")
        )
        for index in range(3):
            plan, applied = after.members.nominal[index], state.members.applied[index]
            terms = follow(judged, plan, applied).terms
            total = terms["hard"] + sum(factors * [float(terms[name]) for name in OBJECTIVES])
            assert float(said.costs[index]) == pytest.approx(float(total), rel=1e-3)
        state = after


@eqx.filter_jit
def follow(cost: Cost, controls, applied):
    return rollout(ROBOT, cost, START, controls, jnp.asarray(DT), applied=applied)


def test_diversity_of_controls_by_hand() -> None:
    assert float(diversity(jnp.ones((1, 2)))) == float(diversity(jnp.ones((4, 2)))) == 0.0
    found = diversity(jnp.asarray([[0.0, 0.0], [1.0, 1.0], [0.0, 2.0]]))
    # 1, sqrt(2) and 1: two components of a difference of sqrt(2), 2 and sqrt(2).
    assert float(found) == pytest.approx((2.0 + np.sqrt(2.0)) / 3.0)
    assert (jax.grad(diversity)(jnp.ones((3, 2))) == 0.0).all()


def test_the_unit_of_an_objective_does_not_matter() -> None:
    def run(factor: float, weights: Any, **changes: Any):
        every = portfolio({**OBJECTIVES, "goal": factor * GOAL}, weights, **changes)
        first, state, info = step(every, every.init())
        second, _, then = step(every, state, key=jax.random.key(1))
        return first, second, info.members, then.members

    rows = np.array([[7.0, 1.0, 2.0], [1.0, 0.0, 1.0]])
    expected = run(1.0, rows)
    assert_alike(run(1000.0, rows), expected, 2e-3)
    # Nor that of the weights.
    assert_alike(run(1.0, [[0.7, 0.1, 0.2], [0.5, 0.0, 0.5]]), expected, 1e-3)
    assert_alike(run(1.0, 5.0 * rows, common=[12.0, 1.0, 7.0]), expected, 1e-3)
    # As they are, units count.
    plain, other = (run(factor, rows, is_normalised=False) for factor in (1.0, 1000.0))
    assert (np.abs(plain[0] - other[0]) > 1e-2).any()


def test_a_step_leaves_what_was_given_out_and_repeats_itself() -> None:
    every = portfolio()
    control, state, info = step(every, every.init())
    np.testing.assert_array_equal(state.members.applied, np.tile(control, (2, 1)))
    np.testing.assert_array_equal(info.controls[0], control)
    assert_alike((info.members.shares.sum(), info.weights.sum()), (1.0, 1.0), 1e-5)
    assert info.weights.shape == info.costs.shape == (2 * SAMPLES,)
    assert_alike(step(every, every.init()), (control, state, info), 0.0)
    assert (step(every, every.init(), key=jax.random.key(4))[0] != control).any()
    with pytest.raises(ValueError, match="name is 'shy'; accepted: bold, careful"):
        every.single("shy")


def test_steps_in_a_scan_are_steps_in_a_loop() -> None:
    every, keys = portfolio(), jax.random.split(KEY, 4)

    def advance(state, key):
        return every.step(state, START, key=key)[1::-1]

    state = every.init()
    last, controls = jax.lax.scan(advance, state, keys)
    for key, expected in zip(keys, controls, strict=True):
        control, state, _ = step(every, state, key=key)
        assert_alike(control, expected, 2e-3)
    assert_alike(last, state, 2e-3)


def test_inspect_shows_the_plan_of_the_step(empty_belief) -> None:
    every = differing()
    _, state, _ = step(every, every.init(), empty_belief)
    inspect = eqx.filter_jit(Portfolio.inspect)
    look = inspect(every, state, START, empty_belief, key=KEY, num_trajectories=12)
    _, _, info = step(every, state, empty_belief)
    assert_alike(look.nominal.controls, info.controls)
    assert_alike(look.nominal.states[-1], follow(HARD, info.controls, None).states[-1])
    assert set(look.nominal.terms) == {*OBJECTIVES, "DiscObstacleCost"}
    assert_alike(sum(look.best.terms.values()), info.members.costs.min(), 1e-3)
    assert look.samples.shape == (*look.weights.shape, HORIZON + 1, 5) == (12, HORIZON + 1, 5)
    # Those of each member, four of 32 at even distances, as other code prices its samples.
    for index, rows in enumerate(np.split(np.arange(12), 3)):
        costs = (HARD, *OBJECTIVES.values(), RegionCost(TURNS[index]))
        member = every.members.member(index), costs, of_member(state.members, index)
        paid = np.asarray(priced(*member, empty_belief)[1])[:, [0, 10, 21, 31]]
        for name, own in zip(("DiscObstacleCost", *OBJECTIVES), paid, strict=False):
            shown = np.asarray(look.sample_terms[name])[rows]
            # Objectives are weighted: their factors are the same for all.
            factor = 1.0 if name == "DiscObstacleCost" else shown.sum() / max(own.sum(), 1e-9)
            np.testing.assert_allclose(shown, factor * own, rtol=1e-4, atol=1e-4)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(look))


def test_numbers_do_not_retrace_and_another_member_does() -> None:
    traces = []

    @eqx.filter_jit
    def count(every, state):
        traces.append(len(every.member_names))
        return every.step(state, START, None, key=KEY)[0]

    rows, numbers = np.eye(3) + 0.1, np.array([0.1, 0.2, 0.3])
    for factor in (1.0, 2.0):
        given = {"temperatures": factor * numbers, "noise_scales": numbers**factor}
        fusion = SafeFusion(WeightedVote(factor), regret=factor, tolerated=factor)
        every = portfolio(OBJECTIVES, rows**factor, fusion=fusion, smoothing_time=factor, **given)
        count(every, every.init())
    two = portfolio(OBJECTIVES, rows[:2])
    count.lower(two, two.init())
    assert traces == [3, 2]


# What is not finite


class Spoilt(Cost):
    """A value for rollouts that get farther to the left than `limit`; 0 for the others."""

    limit: jax.Array
    value: jax.Array

    def stage(self, state, control, t, belief):
        return jnp.where(state["y"] > self.limit, self.value, 0.0)


def spoilt(limits, value: float = np.nan, **changes: Any) -> Portfolio:
    costs = [Spoilt(jnp.asarray(limit), jnp.asarray(value)) for limit in limits]
    return portfolio({**OBJECTIVES, "odd": costs}, np.ones((3, 4)), **changes)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("limits", "finite"),
    [([0.05] * 3, [1, 1, 1]), ([-9.0] * 3, [0, 0, 0]), ([-9.0, 9.0, 9.0], [0, 1, 1])],
    ids=["some rollouts", "all", "all of one member"],
)
def test_an_objective_that_is_not_finite(limits, finite, value) -> None:
    every = spoilt(limits, value)
    control, state, info = step(every, every.init())
    said = info.members
    assert bool(info.is_finite) is any(finite)
    assert (np.asarray(said.effective_sample_sizes) > 0.0).tolist() == [one > 0 for one in finite]
    rest = (control, state.members, state.spread, said.controls, said.costs, said.shares)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(rest))
    # It goes on as soon as there are numbers again.
    assert bool(step(spoilt([9.0] * 3), state)[2].is_finite)


def test_a_member_without_a_rollout_is_not_the_surest() -> None:
    every = spoilt([-9.0, 9.0, 9.0], fusion="trust-weighted")
    shares = step(every, every.init())[2].members.shares
    assert shares[0] <= min(shares[1:])


def test_an_objective_beyond_all_numbers_is_forgotten() -> None:
    every = spoilt([-9.0] * 3, 1e37)
    state = step(every, every.init())[1]
    for _ in range(2):
        _, state, info = step(spoilt([0.05] * 3, 1.0), state)
        assert bool(info.is_finite)
        assert np.isfinite(state.spread).all()


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_where_every_rollout_collides_the_collision_counts(unit: float) -> None:
    hard = DiscObstacleCost([[1.0, 0.0]], 0.9, clearance=0.01, collision=10.0 / HORIZON)
    mppi = eqx.tree_at(lambda c: c.cost, template(), hard)
    every = portfolio({"goal": unit * GoalCost([3.0, 0.0])}, [[1.0]], mppi)
    info = step(every, every.init())[2]
    _, (paid,) = priced(every.members.member(0), (hard,), of_member(every.init().members, 0))
    # Nobody knows yet what the goal varies; the rollouts that count are those least deep.
    assert float(paid.min()) > 0.0
    assert float(info.weights @ paid) < float(np.quantile(paid, 0.25))


# Arguments


def own(*costs: Any) -> dict[str, Any]:
    return {"objectives": {**OBJECTIVES, "own": costs}, "weights": np.ones((3, 4))}


ELITE = template(temperature=None, weighting=Elite(0.2))
BLENDED = template(noise_std=None, proposal=GaussianProposal(noise_covariance=np.eye(2)))
BIASED = BiasedProposal(GaussianProposal([0.5, 1.0]), np.zeros((HORIZON, 2)))
MIXED_NOISE = template(noise_std=None, proposal=BIASED)
BAD: list[tuple[dict[str, Any], str]] = [
    ({"objectives": {}}, r"objectives is empty"),
    ({"weights": [[1.0, 1.0]]}, r"weights has shape \(1, 2\); accepted: \(N, 3\)"),
    ({"weights": [[1.0, 1.0, 1.0], [0.0] * 3]}, r"each row a weight that is not 0"),
    ({"weights": {"a": {"speed": 1.0}}}, r"objective is 'speed'; accepted: goal, effort, room"),
    ({"weights": np.ones((2, 3)), "names": ["a", "a"]}, r"accepted: 2 different names"),
    ({"names": ["a", "b"]}, r"names is .* beside weights by name"),
    ({"common": {"speed": 1.0}}, r"objective is 'speed'; accepted: goal, effort, room"),
    ({**own(GOAL, GOAL, GOAL), "common": {"own": 1.0}}, r"common is .* differs between members"),
    ({"fusion": "mean"}, r"fusion is 'mean'; accepted: weighted-vote"),
    ({"fusion": "contextual"}, r"accepted for this contextual fusion"),
    ({"temperatures": [1.0] * 3}, r"temperatures"),
    (own(GOAL, GOAL), r"objectives\['own'\] has 2 entries; accepted: a cost, or one for each"),
    (own(GOAL, GOAL, EFFORT), r"objectives\['own'\] has costs of different kinds"),
    (own(GOAL, GOAL, GoalCost([1.0, 2.0, 3.0])), r"objectives\['own'\]"),
    ({"mppi": ELITE, "temperatures": [1.0] * 2}, r"temperatures .* Elite; accepted: .* Softmax"),
    ({"mppi": BLENDED, "noise_scales": [1.0] * 2}, r"beside GaussianProposal; accepted: with a"),
    ({"mppi": MIXED_NOISE, "noise_scales": [1.0] * 2}, r"beside BiasedProposal; accepted: with"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_bad_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        portfolio(**arguments)
