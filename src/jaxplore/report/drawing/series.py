"""Curves over time that several figures share."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jax.typing import ArrayLike

from jaxplore.report.drawing.colours import SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis


def find_runs(mask: np.ndarray) -> list[slice]:
    """Return the slices of successive true entries of a mask (N,)."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [slice(begin, end) for begin, end in changes.reshape(-1, 2).tolist()]


def running_mean(rows: ArrayLike, width: int) -> np.ndarray:
    """Compute the moving average (N, ...) over `width` rows around each row, fewer at the ends.

    The width is at least 1; an even one reaches one row further back. Values that are not finite
    are left out; a window without finite values has the mean NaN.
    """
    values = np.asarray(rows, np.float64)
    is_finite = np.isfinite(values)
    count = len(values)
    first = np.maximum(np.arange(count) - width // 2, 0)
    end = np.minimum(np.arange(count) - width // 2 + width, count)

    def sums(each: np.ndarray) -> np.ndarray:
        # Differences of a running sum cost the same for any width.
        until = np.concatenate([np.zeros((1, *each.shape[1:])), np.cumsum(each, axis=0)])
        return np.asarray(until[end] - until[first])

    # Values that are not finite count neither in the sum nor in the number.
    total, number = sums(np.where(is_finite, values, 0.0)), sums(is_finite.astype(np.float64))
    return np.where(number > 0.0, total / np.maximum(number, 1.0), np.nan)


def line_style(number: int) -> dict[str, Any]:
    """Return the colour and the line style of curve `number`, from 0; many stay distinct."""
    # After the last colour the line style changes.
    turn, place = divmod(number, len(SERIES))
    return {"color": SERIES[place], "linestyle": ("-", "--", ":", "-.")[turn % 4]}


def style_time(axes: "Axes", duration: float) -> None:
    """Format a time axis from 0 to the duration [s], with a faint grid."""
    axes.set(xlim=(0.0, duration), xlabel="time [s]")
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)


def style_count(axis: "Axis", most: int = 8) -> None:
    """Put the ticks of an axis at whole numbers, with at most `most` intervals between them."""
    from matplotlib.ticker import MaxNLocator

    # With fewer than one whole number in view, Matplotlib would fall back to fractions.
    axis.set_major_locator(MaxNLocator(most, integer=True, min_n_ticks=1))
