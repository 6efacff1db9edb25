"""The assignment of clusters to tracks, against SciPy's."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from jaxplore.belief.tracks import FORBIDDEN, UNASSIGNED, assign

compiled = jax.jit(assign)


@pytest.mark.parametrize("shape", [(5, 7), (7, 4), (6, 6)])
@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]))
def test_as_many_as_possible_at_the_least_cost(shape, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.0, 12.0, shape).astype(np.float32)
    is_allowed = rng.random(shape) < share
    found = np.asarray(compiled(cost, is_allowed))
    rows = np.flatnonzero(found != UNASSIGNED)
    assert is_allowed[rows, found[rows]].all()
    assert len(set(found[rows])) == len(rows)
    i, j = linear_sum_assignment(np.where(is_allowed, cost.astype(np.float64), FORBIDDEN))
    best = is_allowed[i, j]
    assert len(rows) == best.sum()
    assert cost[rows, found[rows]].sum() == pytest.approx(cost[i, j][best].sum(), abs=0.05)
