"""Figure of the contributions of a controller's members."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.report.drawing.colours import SERIES
from jaxplore.report.drawing.series import running_mean, style_time
from jaxplore.report.exploration.data import ExplorationData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMOOTHING = 1.0
"""Time over which the members' numbers are averaged [s]."""
MAX_POINTS = 2000
"""Points of a curve."""


def members_figure(recording: ExplorationData) -> "Figure":
    """Draw the members' shares in the control, their diversity (the mean distance between two
    members' controls) and their sample sizes over time, all as means over a second. A recording of
    a controller without members raises a `ValueError`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    members = recording.records.members
    if members is None:
        raise ValueError(
            "recording has no members; accepted: that of a controller that holds several"
        )
    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1.5, 1.0, 1.2])
    width = max(1, round(SMOOTHING / recording.control_period))
    stride = max(1, -(-recording.num_steps // MAX_POINTS))
    time = recording.control_period * np.arange(recording.num_steps)[::stride]
    shares, diversity, sizes = (
        running_mean(rows, width)[::stride]
        for rows in (members.shares, members.diversity, members.effective_sample_sizes)
    )
    colours = [SERIES[k % len(SERIES)] for k in range(len(recording.member_names))]
    panels[0].stackplot(
        time,
        100.0 * np.nan_to_num(shares.T),
        labels=recording.member_names,
        colors=colours,
        alpha=0.85,
        linewidth=0.0,
    )
    panels[0].set(ylim=(0.0, 100.0), ylabel="share of\nthe control [%]")
    panels[1].plot(time, diversity, color="0.25", linewidth=1.4)
    panels[1].set_ylabel("diversity\n[half ranges]")
    panels[1].set_ylim(bottom=0.0)
    # A sample size is at least 1, or 0 without a finite rollout, which has no logarithm.
    drawn = np.where(sizes > 0.0, sizes, np.nan)
    for column, colour in zip(drawn.T, colours, strict=True):
        panels[2].plot(time, column, color=colour, linewidth=1.4)
    panels[2].set_yscale("log")
    top = float(np.nanmax(drawn)) if np.isfinite(drawn).any() else 1.0
    panels[2].set(ylim=(0.8, max(10.0, 1.5 * top)), ylabel="effective\nsamples")
    duration = max(recording.num_steps, 1) * recording.control_period
    for panel in panels:
        style_time(panel, duration)
        panel.label_outer()
    figure.align_ylabels(panels)
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=min(len(recording.member_names), 5),
        frameon=False,
        fontsize=9,
    )
    figure.suptitle(f"members, means over {SMOOTHING:g} s", fontsize=11)
    return figure
