"""What runs with several seeds say: quartiles, and ratios with the doubt that is left."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 4000
"""Draws of a bootstrap."""
CONFIDENCE = 0.95
"""Share of the bootstrap's draws that lie in its interval."""


class Quartiles(NamedTuple):
    """Lower quartile, median and upper quartile; infinite where too few runs have a value."""

    low: float
    median: float
    high: float


class Ratio(NamedTuple):
    """How two explorers compare.

    Args:
        value: median of one over median of the other; not a number where there is none, because
            both are infinite or the other's is zero.
        low: lower end of its interval.
        high: upper end; infinite where too few runs have a value.
    """

    value: float
    low: float
    high: float


def quartiles(values: Sequence[float | None]) -> Quartiles:
    """Return the quartiles of some runs' values.

    A run without a value never got there: it counts as infinitely late, and nothing is interpolated
    between a value and infinity.

    Raises:
        ValueError: no runs.
    """
    if not values:
        raise ValueError("values is empty; accepted: those of at least one run")
    numbers = np.sort([math.inf if value is None else value for value in values])
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
    """Return the ratio of two medians over the seeds that both have; None if there are none.

    The interval is the percentile bootstrap's: seeds are drawn with replacement as often as there
    are any, the same for both, and the middle 95 % of the ratios are kept. A draw without a ratio
    (both medians infinite, or the reference's zero) counts at both ends.

    Args:
        values: by seed; None for a run that never got there, infinitely late.
        reference: likewise, of the explorer that is compared with.
        resamples: how many draws.
        seed: of the draws; the same gives the same interval.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.
    """
    common = sorted(values.keys() & reference.keys())
    if not common:
        return None
    pairs = np.array(
        [[_number(values[each]), _number(reference[each])] for each in common], np.float64
    )
    drawn = np.random.default_rng(seed).integers(len(common), size=(resamples, len(common)))
    ratios = _ratio(np.median(pairs[drawn], axis=1))
    tail = 50.0 * (1.0 - CONFIDENCE)
    least, most = (
        np.where(np.isnan(ratios), 0.0, ratios),
        np.where(np.isnan(ratios), np.inf, ratios),
    )
    # Nothing is interpolated: next to infinity that would be infinite, or no number.
    return Ratio(
        float(_ratio(np.median(pairs, axis=0))),
        float(np.percentile(least, tail, method="lower")),
        float(np.percentile(most, 100.0 - tail, method="higher")),
    )


def _number(value: float | None) -> float:
    return math.inf if value is None else value


def _ratio(medians: np.ndarray) -> np.ndarray:
    """Return the first (..., 2) over the second, NaN where there is no ratio."""
    ours, theirs = medians[..., 0], medians[..., 1]
    has_none = (np.isinf(ours) & np.isinf(theirs)) | (theirs == 0.0)
    return np.asarray(np.where(has_none, np.nan, ours / np.where(has_none, 1.0, theirs)))
