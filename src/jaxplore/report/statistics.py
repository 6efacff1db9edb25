"""Statistics over runs with several seeds: quartiles, and paired ratios and differences with
bootstrap intervals."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 4000
"""Resamples of a bootstrap."""
CONFIDENCE = 0.95
"""Share of the resamples that lie in the interval."""


class Quartiles(NamedTuple):
    """Lower quartile, median and upper quartile; infinite where too few runs have a value."""

    low: float
    median: float
    high: float


class Ratio(NamedTuple):
    """Ratio of two medians over the same seeds.

    Args:
        value: median of one over median of the other; NaN if both are infinite or the other is
            zero.
        low: lower end of its interval.
        high: upper end; infinite where too few runs have a value.
    """

    value: float
    low: float
    high: float


def quartiles(values: Sequence[float | None]) -> Quartiles:
    """Compute the quartiles of a quantity over runs.

    A run without a value counts as infinite, such as the time of a run that was never finished.
    Quartiles are not interpolated between a value and infinity.

    Args:
        values: one for each run; None for a run without a value.

    Raises:
        ValueError: no runs.
    """
    if not values:
        raise ValueError("values is empty; accepted: those of at least one run")
    numbers = np.sort([math.inf if value is None else value for value in values])
    # Interpolation beside an infinite value gives infinity or NaN, so it needs finite values only.
    low, median, high = np.percentile(numbers, [25, 50, 75], method="higher")
    if np.isfinite(numbers).all():
        low, median, high = np.percentile(numbers, [25, 50, 75])
    return Quartiles(float(low), float(median), float(high))


def paired_ratio(
    values: Mapping[int, float | None],
    reference: Mapping[int, float | None],
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Ratio | None:
    """Compute the ratio of two medians over the common seeds; None without any.

    The interval is that of the paired percentile bootstrap: seeds are drawn with replacement, the
    same for both, and the middle 95 % of the ratios are kept. A resample without a ratio (both
    medians infinite, or the reference zero) counts at both ends.

    Args:
        values: values by seed; None counts as infinite, such as the time of a run that was never
            finished.
        reference: values of the reference variant, likewise.
        resamples: number of resamples.
        seed: seed of the resamples; the same seed gives the same interval.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.
    """
    common = sorted(values.keys() & reference.keys())
    if not common:
        return None
    pairs = np.array(
        [[_number(values[each]), _number(reference[each])] for each in common], np.float64
    )
    ratios = _ratio(np.median(pairs[_draws(len(common), resamples, seed)], axis=1))
    low, high = _interval(
        np.where(np.isnan(ratios), 0.0, ratios), np.where(np.isnan(ratios), np.inf, ratios)
    )
    return Ratio(float(_ratio(np.median(pairs, axis=0))), low, high)


class Difference(NamedTuple):
    """Mean difference of a quantity over the same runs.

    Args:
        value: mean of the differences.
        low: lower end of its interval.
        high: upper end.
    """

    value: float
    low: float
    high: float


def paired_difference(
    before: Sequence[float],
    after: Sequence[float],
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Difference:
    """Compute the mean of `after - before`, run by run, with a 95 % interval.

    The interval is that of the paired percentile bootstrap. For a single run, or equal differences,
    both ends are the mean.

    Args:
        before: finite values, one for each run; at least one.
        after: the values of the same runs after the change.
        resamples: number of resamples.
        seed: seed of the resamples; the same seed gives the same interval.

    Raises:
        ValueError: no values, or not as many in both.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.
    """
    if not len(before) or len(before) != len(after):
        raise ValueError(
            f"before has {len(before)} values and after {len(after)}; accepted: as many, at least "
            "one"
        )
    differences = np.asarray(after, np.float64) - np.asarray(before, np.float64)
    mean = float(differences.mean())
    # Resampling equal differences would only add rounding errors.
    if np.ptp(differences) == 0.0:
        return Difference(mean, mean, mean)
    means = differences[_draws(len(differences), resamples, seed)].mean(axis=1)
    return Difference(mean, *_interval(means, means))


def _draws(number: int, resamples: int, seed: int) -> np.ndarray:
    """Draw indices (resamples, number) of runs with replacement."""
    return np.random.default_rng(seed).integers(number, size=(resamples, number))


def _interval(least: np.ndarray, most: np.ndarray) -> tuple[float, float]:
    """Return the lower end of the middle 95 % of `least`, and the upper end of that of `most`."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    # No interpolation: beside an infinite value it would give infinity or NaN.
    return (
        float(np.percentile(least, tail, method="lower")),
        float(np.percentile(most, 100.0 - tail, method="higher")),
    )


def _number(value: float | None) -> float:
    return math.inf if value is None else value


def _ratio(medians: np.ndarray) -> np.ndarray:
    """Divide the first of two medians (..., 2) by the second; NaN where there is no ratio."""
    ours, theirs = medians[..., 0], medians[..., 1]
    has_none = (np.isinf(ours) & np.isinf(theirs)) | (theirs == 0.0)
    return np.asarray(np.where(has_none, np.nan, ours / np.where(has_none, 1.0, theirs)))
