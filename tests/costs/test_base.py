import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import ControlCost, ControlRateCost, Cost, GoalCost, ObstacleCost
from jaxplore.control import rollout


class Terminal(Cost):
    def stage(self, state, control, t, belief):
        return t

    def terminal(self, state, belief):
        return state.position[0]

    def sequence(self, controls, applied, dt, dynamics):
        return dt * jnp.sum(controls) + jnp.sum(applied)


def sequence(cost: Cost, robot) -> float:
    controls = jnp.asarray([[1.0, 2.0], [3.0, 4.0]])
    return float(cost.sequence(controls, jnp.asarray([5.0, 6.0]), jnp.asarray(0.5), robot))


def test_weights_and_sums(stage, at, belief) -> None:
    cost = 2.0 * ControlCost() + Terminal() * 3.0 + 0.5 * (Terminal() + ControlCost())
    state = at(4.0, 1.0)
    assert stage(cost, state, (2.0, 0.0)) == pytest.approx(2.0 + 0.3 + 0.5 * (0.1 + 1.0))
    assert float(cost.terminal(state, belief)) == pytest.approx(3 * 4.0 + 0.5 * 4.0)
    assert sequence(cost, state.dynamics) == pytest.approx(3.5 * (0.5 * 10.0 + 11.0))
    assert [name for name, _ in cost.terms()] == [
        "ControlCost",
        "Terminal",
        "Terminal",
        "ControlCost",
    ]
    total = sum(stage(term, state, (2.0, 0.0)) for _, term in cost.terms())
    assert total == pytest.approx(stage(cost, state, (2.0, 0.0)))


def test_a_cost_has_neither_terminal_nor_sequence_unless_it_says_so(at, belief) -> None:
    state = at(4.0, 1.0)
    assert float(ControlCost().terminal(state, belief)) == 0.0
    assert sequence(ControlCost(), state.dynamics) == 0.0


def test_a_weight_is_a_leaf(at, belief) -> None:
    traced = 0

    @jax.jit
    def price(cost: Cost) -> jax.Array:
        nonlocal traced
        traced += 1
        return cost.stage(at(4.0, 1.0), jnp.ones(2), jnp.asarray(0.1), belief)

    for weight in (1.0, 2.0, 3.0):
        price(weight * ControlCost() + ObstacleCost(clearance=weight))
    assert traced == 1


def test_names_tell_terms_of_one_class_apart(stage, at, belief) -> None:
    left, right = GoalCost([0.0, 0.0]), GoalCost([4.0, 0.0])
    cost = 2.0 * left.with_name("left") + (3.0 * right).with_name("right") + right
    assert [name for name, _ in cost.terms()] == ["left", "right", "GoalCost"]
    state = at(1.0, 0.0)
    assert stage(cost, state) == pytest.approx(2.0 + 9.0 + 3.0)
    for (_, term), expected in zip(cost.terms(), (2.0, 9.0, 3.0), strict=True):
        assert stage(term, state) == pytest.approx(expected)


def test_a_named_cost_pays_the_same_and_a_named_sum_is_one_term(stage, at, belief) -> None:
    inner = 2.0 * Terminal() + ControlCost() + ControlRateCost()
    cost, state = inner.with_name("all"), at(4.0, 1.0)
    (only,) = cost.terms()
    assert only[0] == "all"
    for found in (cost, only[1]):
        assert stage(found, state, (1.0, 2.0)) == stage(inner, state, (1.0, 2.0)) > 0
        assert float(found.terminal(state, belief)) == float(inner.terminal(state, belief)) > 0
        assert sequence(found, state.dynamics) == sequence(inner, state.dynamics) > 0


def test_a_named_weight_is_a_leaf_and_the_name_is_not() -> None:
    first, second = ((w * ControlCost()).with_name("effort") for w in (1.0, 2.0))
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert [float(leaf) for leaf in jax.tree.leaves(second)] == [2.0]
    assert jax.tree.structure(first) != jax.tree.structure((1.0 * ControlCost()).with_name("other"))


def test_a_rollout_lists_terms_by_their_names(at, belief) -> None:
    state = at(0.0, 0.0, v=1.0)
    cost = GoalCost([9.0, 0.0]).with_name("far") + GoalCost([1.0, 0.0]).with_name("near")
    controls = jnp.zeros((4, 2))
    found = rollout(state.dynamics, cost, state.values, controls, jnp.asarray(0.1), belief)
    xs = np.asarray(found.states[1:, 0], np.float64)
    assert set(found.terms) == {"far", "near"}
    assert float(found.terms["far"]) == pytest.approx((9.0 - xs).sum(), rel=1e-5)
    assert float(found.terms["near"]) == pytest.approx((1.0 - xs).sum(), rel=1e-5)


@pytest.mark.parametrize("name", ["", "  "])
def test_a_bad_name_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"name is '.*'; accepted: a text that is not empty"):
        ControlCost().with_name(name)


def test_a_bad_weight_is_refused() -> None:
    with pytest.raises(ValueError, match="weight is inf; accepted"):
        math.inf * ControlCost()
