import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from jaxplore.report.statistics import (
    paired_difference,
    paired_ratio,
    quartiles,
    tail_mean,
)


def test_quartiles_of_what_is_there() -> None:
    assert quartiles([4.0, 1.0, 2.0, 3.0, 5.0]) == (2.0, 3.0, 4.0)
    assert quartiles([1.0, 2.0]) == (1.25, 1.5, 1.75)
    assert quartiles([7.0]) == (7.0, 7.0, 7.0)
    with pytest.raises(ValueError, match="values is empty"):
        quartiles([])


def test_runs_that_never_got_there_are_late_and_mixed_with_nothing() -> None:
    assert quartiles([None, 1.0, 2.0, 3.0]) == (2.0, 3.0, math.inf)
    assert quartiles([None, None, 1.0]) == (math.inf, math.inf, math.inf)


@given(st.lists(st.floats(0.1, 100.0), min_size=1, max_size=12))
def test_quartiles_are_numpys(values: list[float]) -> None:
    np.testing.assert_allclose(quartiles(values), np.quantile(values, [0.25, 0.5, 0.75]))


def every_draw(pairs: list[tuple[float, float]]) -> list[float]:
    """Return the ratios of medians of all samples with replacement, in order."""
    ratios = []
    for draw in itertools.product(pairs, repeat=len(pairs)):
        ours, theirs = (sorted(values) for values in zip(*draw, strict=True))
        ratios.append(ours[len(ours) // 2] / theirs[len(theirs) // 2])
    return sorted(ratios)


def test_the_interval_is_that_of_all_draws() -> None:
    pairs = [(3.0, 4.0), (5.0, 4.5), (2.0, 6.0), (9.0, 7.0), (4.0, 5.0)]
    ratios = every_draw(pairs)
    assert len(ratios) == 3125
    low, high = ratios[int(0.025 * 3125)], ratios[int(0.975 * 3125)]
    # Only where the ends lie on a step of the distribution does a sample find the same ones.
    assert ratios[int(0.02 * 3125)] == ratios[int(0.03 * 3125)]
    assert ratios[int(0.97 * 3125)] == ratios[int(0.98 * 3125)]
    ours, theirs = (dict(enumerate(values)) for values in zip(*pairs, strict=True))
    found = paired_ratio(ours, theirs, resamples=20_000)
    assert found == (4.0 / 5.0, low, high)
    assert paired_ratio(ours, theirs, resamples=20_000) == found


def test_it_is_paired() -> None:
    ours = {seed: float(2 * seed) for seed in range(1, 21)}
    theirs = {seed: float(seed) for seed in range(1, 21)}
    assert paired_ratio(ours, theirs) == (2.0, 2.0, 2.0)
    shuffled = dict(zip(theirs, reversed(theirs.values()), strict=True))
    found = paired_ratio(ours, shuffled)
    assert found is not None
    assert found.value == 2.0
    assert found.low < 1.8 < 2.2 < found.high


def test_only_seeds_that_both_have_count() -> None:
    assert paired_ratio({1: 2.0, 2: 2.0, 3: 99.0}, {1: 4.0, 2: 4.0, 4: 1.0}) == (0.5, 0.5, 0.5)
    assert paired_ratio({1: 2.0}, {2: 2.0}) is None
    assert paired_ratio({}, {}) is None


def test_a_run_that_never_got_there_leaves_the_interval_open() -> None:
    theirs = dict.fromkeys(range(5), 10.0)
    ours = {**dict.fromkeys(range(5), 20.0), 0: None}
    found = paired_ratio(ours, theirs)
    assert found == (2.0, 2.0, math.inf)
    turned = paired_ratio(theirs, ours)
    assert turned == (0.5, 0.0, 0.5)
    nothing = paired_ratio(dict.fromkeys(range(3)), dict.fromkeys(range(3)))
    assert nothing is not None
    assert math.isnan(nothing.value)
    assert nothing[1:] == (0.0, math.inf)
    zero = paired_ratio({0: 1.0}, {0: 0.0})
    assert zero is not None
    assert math.isnan(zero.value)


def test_a_difference_has_the_interval_of_all_draws() -> None:
    before, after = [3.0, 5.0, 2.0, 9.0, 4.0], [1.0, 6.0, 1.5, 5.0, 4.0]
    differences = np.subtract(after, before)
    means = sorted(float(np.mean(draw)) for draw in itertools.product(differences, repeat=5))
    found = paired_difference(before, after, resamples=20_000)
    assert found.value == pytest.approx(differences.mean())
    assert found.low == pytest.approx(means[int(0.025 * 3125)], abs=0.11)
    assert found.high == pytest.approx(means[int(0.975 * 3125)], abs=0.11)
    assert paired_difference(before, after, resamples=20_000) == found


def test_a_difference_without_spread_is_certain() -> None:
    assert paired_difference([1.0], [3.0]) == (2.0, 2.0, 2.0)
    assert paired_difference([1.0, 2.0], [2.0, 3.0]) == (1.0, 1.0, 1.0)
    for before, after in (([], []), ([1.0], [1.0, 2.0])):
        with pytest.raises(ValueError, match="accepted: as many, at least one"):
            paired_difference(before, after)


def test_the_difference_of_tails_is_scipys_bootstrap() -> None:
    rng = np.random.default_rng(2)
    before = rng.exponential(2.0, 40)
    after = before - 0.5 + rng.normal(0.0, 0.3, 40)
    found = paired_difference(before.tolist(), after.tolist(), level=0.8, resamples=20_000)
    # A fifth of 40 values is 8 of them.
    worst = [float(np.sort(some)[-8:].mean()) for some in (before, after)]
    assert found.value == pytest.approx(worst[1] - worst[0])

    def difference(first, second, axis=-1):
        return tail_mean(np.moveaxis(second, axis, -1), 0.8) - tail_mean(
            np.moveaxis(first, axis, -1), 0.8
        )

    theirs = stats.bootstrap(
        (before, after),
        difference,
        paired=True,
        vectorized=True,
        n_resamples=20_000,
        method="percentile",
        rng=3,
    ).confidence_interval
    assert found.low == pytest.approx(theirs.low, abs=0.03)
    assert found.high == pytest.approx(theirs.high, abs=0.03)
    with pytest.raises(ValueError, match=r"^level is 1.0; accepted: a number in \[0, 1\)"):
        tail_mean(before, 1.0)
