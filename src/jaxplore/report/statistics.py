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
    """Ratio of two medians over the same seeds, with the ends of its interval.

    It is NaN if both medians are infinite or the second is zero. The upper end is infinite where
    too few runs have a value.
    """

    value: float
    low: float
    high: float


def quartiles(values: Sequence[float | None]) -> Quartiles:
    """Compute the quartiles of a quantity over runs, of which there is at least one.

    A run with None counts as infinite, such as the time of a run that was never finished. Quartiles
    are not interpolated between a value and infinity.
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
    """Compute the ratio of two medians over the common seeds; None without any. A value of None
    counts as infinite, such as the time of a run that was never finished.

    The interval is that of the paired percentile bootstrap: seeds are drawn with replacement, the
    same for both, and the middle 95 % of the ratios are kept. A resample without a ratio (both
    medians infinite, or the reference zero) counts at both ends.

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
    """Mean difference of a quantity over the same runs, with the ends of its interval."""

    value: float
    low: float
    high: float


def tail_mean(values: np.ndarray, level: float = 0.0) -> np.ndarray:
    """Compute the mean of the greatest values along the last axis, their conditional value at risk:

        CVaR = min_z z + mean_i (v_i - z)_+ / (1 - level)

    It is the mean of the greatest share `1 - level` of the values. A value on the edge of this
    share counts by the part that lies in it. Level 0 gives the mean of all. There is at least one
    value; an infinite one in the share gives infinity.

    Source: Rockafellar and Uryasev, "Optimization of conditional value-at-risk", 2000, eq. 4.
    """
    if not 0.0 <= level < 1.0:
        raise ValueError(f"level is {level!r}; accepted: a number in [0, 1)")
    number = values.shape[-1]
    # The i-th value in order stands for the shares from i / N to (i + 1) / N.
    ends = np.arange(number + 1) / number
    weights = np.diff(np.maximum(ends, level)) / (1.0 - level)
    # Infinity times a weight of zero would not be a number.
    counted = np.where(weights > 0.0, np.sort(values, axis=-1), 0.0)
    return np.asarray((counted * weights).sum(axis=-1))


def paired_difference(
    before: Sequence[float],
    after: Sequence[float],
    *,
    level: float = 0.0,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Difference:
    """Compute the mean of `after - before`, run by run, with a 95 % interval by the paired
    percentile bootstrap, see `paired_ratio`. With a level it is the difference of the tail means,
    see `tail_mean`. For a single run, or equal differences, both ends are the mean."""
    if not len(before) or len(before) != len(after):
        raise ValueError(
            f"before has {len(before)} values and after {len(after)}; accepted: as many, at least "
            "one"
        )
    first, second = np.asarray(before, np.float64), np.asarray(after, np.float64)
    differences = second - first
    mean = float(differences.mean())
    # Resampling equal differences would only add rounding errors.
    if np.ptp(differences) == 0.0:
        return Difference(mean, mean, mean)
    draws = _draws(len(differences), resamples, seed)
    if level == 0.0:
        means = differences[draws].mean(axis=1)
    else:
        mean = float(tail_mean(second, level) - tail_mean(first, level))
        means = tail_mean(second[draws], level) - tail_mean(first[draws], level)
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
