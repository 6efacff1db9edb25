"""Figure of the idleness of a patrolled map."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.drawing.colours import OCCUPIED, SERIES, shade
from jaxplore.report.drawing.series import style_time
from jaxplore.report.exploration.map_axes import frame_map
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.mission_metrics import find_judged_start
from jaxplore.report.exploration.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT, CURVE_WIDTH = 3.4, 4.2
"""Height of the panels and width of the time curve [inch]; the map's width follows its shape."""


def idleness_figure(recording: MissionData) -> "Figure":
    """Draw a map of the time since each reachable cell was seen, and its mean and worst over time.

    Cells that were never seen count from the start. The shaded first half of the run is not part of
    the metrics. A rotated map is drawn along its own axes. The function has more than 60 lines
    because both panels share the figure's layout. A recording without idleness raises a
    `ValueError`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    if recording.idleness is None:
        raise ValueError("recording has no idleness; accepted: that of a robot that keeps watch")
    window = Window.around_reachable(recording)
    across = float(np.clip(HEIGHT * window.size[0] / window.size[1], 1.6, 1.8 * HEIGHT))
    figure = Figure(figsize=(across + 1.6 + CURVE_WIDTH, HEIGHT + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    place, curve = figure.subplots(1, 2, width_ratios=[across + 1.0, CURVE_WIDTH])

    time = np.arange(recording.num_steps + 1) * recording.control_period
    duration = max(float(time[-1]), recording.control_period)
    walls = window.crop(np.asarray(recording.world) > OCCUPIED_THRESHOLD, False)
    place.imshow(
        np.ma.masked_where(~walls, walls),
        cmap=ListedColormap([shade(OCCUPIED)]),
        extent=window.extent,
        origin="lower",
        interpolation="nearest",
    )
    idle = window.crop(np.asarray(recording.idleness, np.float64), 0.0)
    counts = window.crop(np.asarray(recording.reachable, bool), False)
    shown = place.imshow(
        # Cells that were never seen have an infinite idleness, which no colour scale can show.
        np.ma.masked_where(~counts, np.minimum(idle, duration)),
        cmap="YlOrRd",
        vmin=0.0,
        extent=window.extent,
        origin="lower",
        interpolation="nearest",
    )
    # Without a cell to show, the colour scale has no data for its upper end.
    if not counts.any():
        shown.set_clim(0.0, duration)
    ends = window.place(recording.last_positions) + window.corner
    for number, end in enumerate(ends):
        place.plot(
            *end,
            marker="s",
            color=SERIES[number % len(SERIES)],
            markersize=8.0,
            markeredgecolor="white",
            linestyle="none",
            label="robot" if len(ends) == 1 else f"robot {number + 1}",
        )
    place.set_title("at the end")
    frame_map(place, window)
    figure.colorbar(shown, ax=place, label="not seen for [s]", shrink=0.9, pad=0.02)

    records = recording.records
    for values, colour, label in (
        (records.worst_idleness, SERIES[1], "worst"),
        (records.mean_idleness, SERIES[0], "mean"),
    ):
        curve.plot(time, at_instants(values, 0.0), color=colour, linewidth=1.8, label=label)
    begin = find_judged_start(recording) * recording.control_period
    curve.axvspan(0.0, begin, color="0.2", alpha=0.07, linewidth=0.0, label="not counted")
    style_time(curve, duration)
    curve.set(ylabel="not seen for [s]", title="of the reachable cells")
    curve.set_ylim(bottom=0.0)
    # Outside, where it covers no curve.
    handles = [*place.get_legend_handles_labels()[0], *curve.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure
