"""Fusions against numbers by hand, whoever comes first, whatever is not finite, and in worlds."""

import itertools
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Ackermann, DifferentialDrive, State, Unicycle
from jaxplore.planning import (
    FUSIONS,
    ROLES,
    Average,
    BestOnly,
    Candidates,
    ContextRule,
    Contextual,
    Fused,
    Fusion,
    InformationDensity,
    Median,
    SafeFusion,
    Situation,
    TrustWeighted,
    WeightedVote,
    fuse_actions,
    fusion_by_name,
)
from jaxplore.planning.portfolio.fusion import select_member

ROBOT = DifferentialDrive(radius=0.25)
CONTROLS = np.array(
    [[[0.1, -0.2], [0.3, 0.4]], [[0.5, 0.6], [-0.7, 0.8]], [[-0.9, 0.2], [0.2, -0.3]]], np.float32
)
COSTS, UNCERTAINTIES = np.array([1.3, 1.1, 1.2]), np.array([0.2, 0.4, 0.1])


class Told(eqx.Module):
    """Information that is the same everywhere."""

    value: Any
    num_beams: int = eqx.field(static=True, default=8)

    def __call__(self, position, heading):
        return self.value


class Known(eqx.Module):
    """What a contextual fusion reads: information, and room, which may end at a wall."""

    information: Told
    room: Any = None
    wall: Any = None

    def clearance(self, position):
        return self.room if self.wall is None else self.wall - position[0]


def of(controls, costs, hazards=None, uncertainties=None) -> Candidates:
    """Return candidates, by default safe and equally sure."""
    number = len(costs)
    hazards = np.zeros(number) if hazards is None else hazards
    uncertainties = np.full(number, 0.1) if uncertainties is None else uncertainties
    given = (controls, costs, hazards, uncertainties)
    return Candidates(*(jnp.asarray(values, jnp.float32) for values in given))


def evaluate(controls):
    """Return a cost and a hazard of sequences that depend on nothing else."""
    level = jnp.mean(controls, axis=(1, 2))
    return jnp.sum(controls * controls, axis=(1, 2)), jnp.maximum(level, 0.0)


def surely(cost: float, hazard: float):
    """Return an evaluation that says this of everything."""
    return lambda controls: tuple(jnp.full(len(controls), value) for value in (cost, hazard))


def here(x: float = 0.0, room: float = 5.0, told: float = 0.0, how=evaluate) -> Situation:
    state = State(jnp.zeros(5).at[0].set(x), ROBOT)
    return Situation(state, Known(Told(jnp.asarray(told)), jnp.asarray(room)), how)


@eqx.filter_jit
def fuse(fusion: Fusion, candidates: Candidates) -> Fused:
    return fusion(fusion.init(), candidates, here())[0]


def check(found: Fused, controls, shares, tolerance: float = 1e-6) -> None:
    np.testing.assert_allclose(found.controls, controls, atol=tolerance)
    np.testing.assert_allclose(found.shares, shares, atol=tolerance)
    assert not bool(found.is_replaced)


# By hand


def weighted(votes) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the plans with these votes, and the shares."""
    shares = np.asarray(votes) / np.sum(votes)
    return np.einsum("n,ntu->tu", shares, CONTROLS.astype(np.float64)), shares


@pytest.mark.parametrize("temperature", [0.05, 0.1, 10.0])
def test_a_weighted_vote_is_the_softmax_of_the_costs(temperature: float) -> None:
    mean, shares = weighted(np.exp(-COSTS / temperature))
    check(fuse(WeightedVote(temperature), of(CONTROLS, COSTS)), mean, shares)
    # What all pay alike is no difference, but for its rounding.
    check(fuse(WeightedVote(temperature), of(CONTROLS, COSTS + 64.0)), mean, shares, 1e-3)


def test_best_only_is_the_cheapest() -> None:
    check(fuse(BestOnly(), of(CONTROLS, COSTS)), CONTROLS[1], [0.0, 1.0, 0.0])


def test_the_average() -> None:
    mean = [[-0.1, 0.2], [-0.2 / 3.0, 0.3]]
    check(fuse(Average(), of(CONTROLS, COSTS)), mean, [1 / 3] * 3)


def test_the_median_of_an_odd_and_an_even_number() -> None:
    check(fuse(Median(), of(CONTROLS, COSTS)), [[0.1, 0.2], [0.2, 0.4]], [1 / 3] * 3)
    four = np.concatenate([CONTROLS, [[[100.0, -100.0], [0.6, 0.0]]]])
    check(fuse(Median(), of(four, [0.0] * 4)), [[0.3, 0.0], [0.25, 0.2]], [0.25] * 4)


def test_trust_is_one_over_the_uncertainty() -> None:
    # 5, 2.5 and 10 of 17.5
    candidates = of(CONTROLS, COSTS, uncertainties=UNCERTAINTIES)
    check(fuse(TrustWeighted(), candidates), *weighted([2.0, 1.0, 4.0]), 1e-5)
    sure = of(CONTROLS, COSTS, uncertainties=[0.2, 0.0, 0.1])
    check(fuse(TrustWeighted(0.1), sure), *weighted([1 / 0.3, 1 / 0.1, 1 / 0.2]))


# By situation

NAMES = ("cautious", "scout", "exploiter", "explorer", "balanced")
CONTEXT = Contextual(
    NAMES, goal=[0.0, 0.0], near_goal=2.0, near_obstacle=0.5, rich_information=0.25, hysteresis=0.2
)
FIVE = of(np.arange(5.0)[:, None, None] * np.ones((5, 2, 2)), np.zeros(5))


@eqx.filter_jit
def walk(context: Contextual, xs, rooms, told):
    """Return whose plan is taken at each step of a walk."""

    def step(memory, row):
        fused, memory = context(memory, FIVE, here(*row))
        return memory, (fused.shares, fused.controls)

    return jax.lax.scan(step, context.init(), jnp.stack([xs, rooms, told], axis=1))[1]


def roles(xs=5.0, rooms=5.0, told=0.0, context: Contextual = CONTEXT, steps: int = 12) -> list[str]:
    """Return the roles along a walk; `rooms` is beyond the robot, `told` per beam."""
    number = max(np.size(values) for values in (xs, rooms, told))
    rows = [np.broadcast_to(np.asarray(a, np.float32), number) for a in (xs, rooms, told)]
    rows = [np.concatenate([row, np.repeat(row[-1:], steps - number)]) for row in rows]
    x, room, nat = (jnp.asarray(row) for row in rows)
    shares, controls = walk(context, x, room + 0.25, 8.0 * nat)
    chosen = np.argmax(shares, axis=1)
    assert (np.sort(shares, axis=1) == [0.0, 0.0, 0.0, 0.0, 1.0]).all()
    np.testing.assert_array_equal(controls[:, 0, 0], chosen)
    return [NAMES[index] for index in chosen[:number]]


def test_each_situation_has_its_role_and_the_first_that_holds_counts() -> None:
    for near, narrow, rich in itertools.product((False, True), repeat=3):
        expected = "exploiter" if near else "cautious" if narrow else "explorer" if rich else None
        found = roles(1.0 if near else 5.0, 0.1 if narrow else 5.0, 1.0 if rich else 0.0)
        assert found == [expected or "balanced"]


def test_thresholds_are_strict() -> None:
    assert roles(xs=[2.0, 1.999]) == ["balanced", "exploiter"]
    assert roles(rooms=[0.5, 0.499]) == ["balanced", "cautious"]
    assert roles(told=[0.25, 0.251]) == ["balanced", "explorer"]


@pytest.mark.parametrize(
    ("quantity", "role", "threshold", "factor"),
    [
        ("xs", "exploiter", 2.0, 1.2),
        ("rooms", "cautious", 0.5, 1.2),
        ("told", "explorer", 0.25, 1 / 1.2),
    ],
)
def test_a_situation_ends_only_beyond_the_band(quantity, role, threshold, factor) -> None:
    # In units of the band: 0 where it begins, 1 where it ends.
    band = np.array([2.0, 0.9, 0.1, -0.1, 0.5, 0.9, 0.1, 0.95, 1.1, 0.9, 0.1, -0.1])
    expected = [False] * 3 + [True] * 5 + [False] * 3 + [True]
    walked = threshold * (1.0 + band * (factor - 1.0))
    assert roles(**{quantity: walked}) == [role if one else "balanced" for one in expected]


@given(walked=hnp.arrays(np.int8, (12, 3), elements=st.integers(-3, 4)))
def test_a_walk_through_all_situations(walked) -> None:
    # As above: an odd number of quarters of the band, so never on one of its ends.
    band = 0.25 * (2.0 * walked.astype(np.float64) + 1.0)
    ends = np.array([1.2, 1.2, 1 / 1.2])
    quantity = np.array([2.0, 0.5, 0.25]) * (1.0 + band * (ends - 1.0))
    held, expected = np.zeros(3, bool), []
    for row in band:
        held = row < np.where(held, 1.0, 0.0)
        order = [*np.flatnonzero(held), 3]
        expected.append(("exploiter", "cautious", "explorer", "balanced")[order[0]])
    assert roles(*quantity.T) == expected


def test_without_a_goal_nothing_is_near_it() -> None:
    assert roles(0.0, context=Contextual(NAMES)) == ["balanced"]


def test_numbers_that_are_not_finite_are_no_situation() -> None:
    assert roles(np.nan, np.nan, np.nan) == ["balanced"]


def test_room_is_that_of_the_discs_which_cover_the_robot() -> None:
    # The rear axle of a car is far from the wall that its nose is about to touch.
    car = Ackermann()
    nose = float(car.footprint.offsets[-1] + car.footprint.radius)
    fusion = Contextual(goal=None, near_obstacle=0.3)
    for gap, near in ((0.2, True), (0.4, False)):
        belief = Known(Told(jnp.zeros(())), wall=jnp.asarray(nose + gap))
        situation = Situation(State(jnp.zeros(5), car), belief, evaluate)
        assert bool(fusion.situations(fusion.init(), situation)[1]) is near


# Whoever comes first

EVERY: dict[str, Fusion] = {
    "vote": WeightedVote(0.5),
    "best": BestOnly(),
    "average": Average(),
    "median": Median(),
    "trust": TrustWeighted(),
    "safe vote": SafeFusion(WeightedVote(0.5)),
    "safe average": SafeFusion(Average(), regret=0.5),
    "safe best": SafeFusion(BestOnly(), regret=0.0),
}
every = pytest.mark.parametrize("name", EVERY)
DIFFERENT = st.lists(st.integers(-40, 40), min_size=4, max_size=4, unique=True)


@every
@given(
    controls=hnp.arrays(np.float32, (4, 2, 2), elements=st.floats(-1, 1, width=16)),
    costs=DIFFERENT,
    hazards=DIFFERENT,
    uncertainties=hnp.arrays(np.float32, 4, elements=st.floats(0, 1, width=16)),
    order=st.permutations(range(4)),
)
def test_the_order_of_members_does_not_matter(
    name, controls, costs, hazards, uncertainties, order
) -> None:
    order = np.asarray(order)
    rows = (controls, np.array(costs) / 8, np.maximum(np.array(hazards), 0) / 8, uncertainties)
    found = fuse(EVERY[name], of(*rows))
    other = fuse(EVERY[name], of(*(row[order] for row in rows)))
    np.testing.assert_allclose(other.controls, found.controls, atol=2e-5)
    np.testing.assert_allclose(other.shares, np.asarray(found.shares)[order], atol=2e-5)
    assert bool(other.is_replaced) == bool(found.is_replaced)
    # Nobody does what is beyond what all members do.
    assert (found.controls <= controls.max(axis=0) + 1e-5).all()
    assert (found.controls >= controls.min(axis=0) - 1e-5).all()
    assert float(found.shares.sum()) == pytest.approx(1.0, abs=1e-5)
    assert (np.asarray(found.shares) >= 0.0).all()


# Whatever is not finite

bad = pytest.mark.parametrize("value", [np.nan, np.inf])


@every
@bad
@pytest.mark.parametrize("field", ["costs", "hazards", "uncertainties"])
def test_what_is_not_finite_stays_out_of_the_controls(name, field, value) -> None:
    candidates = of(CONTROLS, COSTS)
    for which in ([0], [1], [2], [0, 1, 2]):
        values = getattr(candidates, field).at[jnp.asarray(which)].set(value)
        found = fuse(EVERY[name], candidates._replace(**{field: values}))
        assert np.isfinite(found.controls).all()
        assert float(found.shares.sum()) == pytest.approx(1.0)


@bad
@pytest.mark.parametrize("fusion", [WeightedVote(0.5), BestOnly(), TrustWeighted()])
def test_a_member_whose_cost_is_not_finite_has_no_vote(fusion, value) -> None:
    for index in range(3):
        costs = COSTS.copy()
        costs[index] = value
        assert fuse(fusion, of(CONTROLS, costs)).shares[index] == 0.0
    found = fuse(TrustWeighted(), of(CONTROLS, COSTS, uncertainties=[0.1, value, 0.1]))
    np.testing.assert_allclose(found.shares, [0.5, 0.0, 0.5], atol=1e-6)


@every
@bad
@pytest.mark.parametrize("cost", [1.0, np.nan])
def test_a_plan_that_is_not_finite_stays_out_of_the_controls(name, value, cost) -> None:
    for index in range(3):
        controls, costs = CONTROLS.copy(), COSTS.copy()
        controls[index, 1, 0], costs[index] = value, cost
        found = fuse(EVERY[name], of(controls, costs))
        assert np.isfinite(found.controls).all()
        assert found.shares[index] == 0.0
        assert float(found.shares.sum()) == pytest.approx(1.0)
        others = np.delete(CONTROLS, index, axis=0)
        assert (found.controls <= others.max(axis=0) + 1e-6).all()
        assert (found.controls >= others.min(axis=0) - 1e-6).all()


def test_a_selected_plan_that_is_not_finite_is_replaced_by_the_cheapest_that_is() -> None:
    plans = np.stack([*CONTROLS, CONTROLS[0] / 2])
    plans[2] = np.nan
    costs = [4.0, 3.0, np.nan, 5.0]
    found = select_member(of(plans, costs), jnp.int32(2))
    check(found, CONTROLS[1], [0.0, 1.0, 0.0, 0.0])
    found = select_member(of(plans, [np.nan] * 4), jnp.int32(2))
    check(found, CONTROLS[0], [1.0, 0.0, 0.0, 0.0])


@bad
@pytest.mark.parametrize("field", ["costs", "hazards"])
def test_a_member_that_is_not_finite_replaces_nothing(field, value) -> None:
    for index in range(3):
        candidates = of(CONTROLS, COSTS)
        values = getattr(candidates, field).at[index].set(value)
        candidates = candidates._replace(**{field: values})
        left = [one for one in range(3) if one != index]
        best = min(left, key=lambda one: COSTS[one])
        found, _ = SafeFusion(Average())((), candidates, here(how=surely(0.0, 1.0)))
        assert bool(found.is_replaced)
        np.testing.assert_array_equal(found.shares, np.eye(3)[best])


# Safe


@pytest.mark.parametrize(
    ("costs", "hazards", "mixed", "regret", "expected"),
    [
        # (cost, hazard) of the mixture; the index of the member that replaces it, or none.
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], (1e3, 0.0), None, None),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], (0.0, 0.5), None, 0),
        ([1.0, 2.0, 3.0], [0.4, 0.0, 0.0], (0.0, 0.5), None, 1),
        ([1.0, 2.0, 3.0], [0.4, 0.3, 0.2], (0.0, 0.5), None, 2),
        ([1.0, 2.0, 3.0], [0.4, 0.3, 0.2], (0.0, 0.1), None, None),
        ([1.0, 2.0, 3.0], [0.4, 0.3, 0.2], (0.0, np.nan), None, 2),
        ([1.0, 2.0, 3.0], [0.4, 0.3, 0.2], (0.0, np.inf), None, 2),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], (1.4, 0.0), 0.5, None),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], (1.6, 0.0), 0.5, 0),
        ([1.0, 2.0, 3.0], [0.2, 0.0, 0.0], (2.4, 0.0), 0.5, None),
        ([1.0, 2.0, 3.0], [0.2, 0.0, 0.0], (2.6, 0.0), 0.5, 1),
        ([1.0, 2.0, 3.0], [0.2, 0.3, 0.4], (9.0, 0.0), 0.5, None),
        ([1.0, 2.0, 3.0], [0.2, 0.3, 0.4], (9.0, 0.1), 0.5, None),
        ([1.0, 2.0, 3.0], [0.2, 0.3, 0.4], (9.0, 0.2), 0.5, 0),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], (np.nan, 0.0), 0.5, 0),
    ],
)
def test_when_a_mixture_is_replaced(costs, hazards, mixed, regret, expected) -> None:
    fusion = SafeFusion(Average(), regret=regret)
    found, _ = fusion((), of(CONTROLS, costs, hazards), here(how=surely(*mixed)))
    assert bool(found.is_replaced) is (expected is not None)
    shares = np.full(3, 1 / 3) if expected is None else np.eye(3)[expected]
    controls = CONTROLS.mean(axis=0) if expected is None else CONTROLS[expected]
    np.testing.assert_allclose(found.shares, shares, atol=1e-6)
    np.testing.assert_allclose(found.controls, controls, atol=1e-6)


def test_what_safe_fusion_holds_is_that_of_the_fusion_within() -> None:
    fusion = SafeFusion(CONTEXT)
    found, memory = fusion(fusion.init(), FIVE, here(x=1.0, how=surely(0.0, 0.0)))
    np.testing.assert_array_equal(memory, [True, False, False])
    np.testing.assert_array_equal(found.shares, np.eye(5)[NAMES.index("exploiter")])


# Names


def test_every_name_makes_its_fusion() -> None:
    for name, kind in FUSIONS.items():
        fusion = fusion_by_name(name)
        assert isinstance(fusion, kind)
        fusion.check(ROLES)


def test_a_contextual_fusion_needs_its_roles() -> None:
    for role in ROLES:
        names = tuple(name for name in ROLES if name != role)
        with pytest.raises(ValueError, match=f"without '{role}'; accepted: names that include"):
            Contextual(names)
    Contextual(NAMES).check(NAMES)
    for names in (ROLES[::-1], ROLES[:3], NAMES):
        for fusion in (Contextual(), SafeFusion(Contextual())):
            with pytest.raises(ValueError, match="accepted for this contextual fusion"):
                fusion.check(names)


def test_a_goal_of_one_number_is_refused() -> None:
    with pytest.raises(ValueError, match="goal"):
        Contextual(goal=[1.0])


# Names and rules of one's own


class NearWall(ContextRule):
    """Holds within a distance of the wall, and until it is twice as far away."""

    least: jax.Array

    def __call__(self, situation, held):
        room = situation.belief.clearance(situation.state.position)
        return room < self.least * jnp.where(held, 2.0, 1.0)


OWN = ("search", "patrol", "warehouse")


def told_to(context: Contextual, memory, **situation) -> tuple[str, Any]:
    number = len(OWN)
    plans = of(np.arange(number, dtype=float)[:, None, None], np.zeros(number))
    fused, memory = context(memory, plans, here(**situation))
    return OWN[int(fused.controls[0, 0])], memory


def test_roles_of_one_s_own_names() -> None:
    context = Contextual(OWN, roles={"explorer": "search", "balanced": "warehouse"})
    memory = context.init()
    assert memory.shape == (1,)
    assert told_to(context, memory, told=9e9)[0] == "search"
    # Nobody is cautious, so that an obstacle changes nothing.
    assert told_to(context, memory, room=0.0)[0] == "warehouse"


def test_rules_of_one_s_own_come_first_and_remember() -> None:
    roles = {"explorer": "search", "balanced": "warehouse"}
    context = Contextual(OWN, roles=roles, rules={"patrol": NearWall(jnp.asarray(1.0))})
    memory, chosen = context.init(), []
    for room in (5.0, 1.5, 0.9, 1.5, 2.5):
        name, memory = told_to(context, memory, room=room, told=9e9)
        chosen.append(name)
    assert chosen == ["search", "search", "patrol", "patrol", "search"]
    context.check(OWN)
    with pytest.raises(ValueError, match="those it was made for"):
        context.check(OWN[::-1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"roles": {"balanced": "nobody"}}, r"roles\['balanced'\] is 'nobody'; accepted: search"),
        ({"roles": {"balanced": "search", "boss": "search"}}, "roles has 'boss'; accepted: expl"),
        (
            {"roles": {"balanced": "search"}, "rules": {"x": NearWall(jnp.ones(()))}},
            "rules has 'x'; accepted: search",
        ),
    ],
)
def test_bad_roles_and_rules_are_named(arguments, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Contextual(OWN, **arguments)


# Plain actions

ACTIONS = np.array([[1.0, -0.5], [0.2, 0.4], [0.6, 0.1]])
PRICES, DOUBTS = np.array([0.3, 0.1, 0.2]), np.array([0.5, 0.1, 0.2])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("weighted_vote", np.exp(-PRICES / 0.1) @ ACTIONS / np.exp(-PRICES / 0.1).sum()),
        ("best_only", ACTIONS[1]),
        ("average", ACTIONS.mean(axis=0)),
        ("median", np.median(ACTIONS, axis=0)),
        ("trust_weighted", (1 / DOUBTS) @ ACTIONS / (1 / DOUBTS).sum()),
    ],
)
def test_plain_actions_are_fused_by_name_in_both_spellings(name: str, expected) -> None:
    for spelling in (name, name.replace("_", "-")):
        found = fuse_actions(ACTIONS, PRICES, spelling, uncertainties=DOUBTS)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)


def test_a_temperature_and_a_situation_of_plain_actions() -> None:
    votes = np.exp(-PRICES / 2.0)
    found = fuse_actions(ACTIONS, PRICES, temperature=2.0)
    np.testing.assert_allclose(found, votes @ ACTIONS / votes.sum(), rtol=1e-5)
    context = Contextual(OWN, roles={"cautious": "patrol", "balanced": "search"})
    found = fuse_actions(ACTIONS, PRICES, context, situation=here(room=0.0))
    np.testing.assert_allclose(found, ACTIONS[1], rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"costs": PRICES[:2]}, r"costs is an array of shape \(2,\); accepted: \(3,\)"),
        ({"actions": ACTIONS[0]}, "actions has shape"),
        ({"fusion": "average", "temperature": 1.0}, "temperature is 1.0 beside the fusion Average"),
        ({"fusion": "trust-weighted"}, "uncertainties is None; accepted: 3 numbers"),
        ({"fusion": "safe"}, "situation is None; accepted: a Situation, for SafeFusion"),
    ],
)
def test_bad_plain_actions_are_named(arguments, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fuse_actions(**{"actions": ACTIONS, "costs": PRICES, **arguments})


# Information density


class East:
    """A field in which a scan tells more the further east it is."""

    num_beams = 4

    def __call__(self, position, heading):
        return 4.0 * position[0]


def test_the_plan_into_the_densest_region_is_selected_and_kept() -> None:
    """A robot that keeps its speed of 1 m/s, 0 or a little more or less."""
    robot = Unicycle(max_speed=2.0)
    plans = np.zeros((3, 10, 2))
    plans[:, :, 0] = [[0.0], [1.0], [1.1]]
    situation = Situation(
        State(jnp.zeros(3), robot), SimpleNamespace(information=East()), evaluate, jnp.asarray(0.1)
    )
    fusion, candidates = InformationDensity(0.2), of(plans, np.zeros(3))
    # The mean of x over the steps: v dt (1 + ... + 10) / 10.
    np.testing.assert_allclose(
        fusion.densities(candidates, situation), [0.0, 0.55, 0.605], rtol=1e-5, atol=1e-6
    )
    first, memory = fusion(fusion.init(), candidates, situation)
    np.testing.assert_array_equal(first.shares, [0.0, 0.0, 1.0])
    # The second one had it before: a tenth more is no reason to change.
    kept, _ = fusion(jnp.asarray(1, jnp.int32), candidates, situation)
    np.testing.assert_array_equal(kept.shares, [0.0, 1.0, 0.0])
    unsafe = of(plans, np.zeros(3), hazards=np.array([0.0, 1.0, np.nan]))
    safe, _ = fusion(memory, unsafe, situation)
    np.testing.assert_array_equal(safe.shares, [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="dt of the situation is None"):
        fusion(memory, candidates, situation._replace(dt=None))
