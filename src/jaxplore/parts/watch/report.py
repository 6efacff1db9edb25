"""Metrics and figure of the idleness of a patrolled map."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from jaxplore._types import Scalar
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.parts.watch.robot import IdlenessMap
from jaxplore.report._numbers import finite, finite_mean, text
from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.drawing.colours import OCCUPIED, SERIES, shade
from jaxplore.report.drawing.series import style_time
from jaxplore.report.exploration.map_axes import frame_map
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column, Curve
from jaxplore.report.part import Headline, PartMetrics, PartReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT, CURVE_WIDTH = 3.4, 4.2
"""Height of the panels and width of the time curve [inch]; the map's width follows its shape."""


class WatchRecord(NamedTuple):
    """How long ago the reachable cells were seen; a cell that never was counts from the start.

    Args:
        mean_idleness: mean over the cells [s].
        worst_idleness: the greatest of these times [s].
    """

    mean_idleness: Scalar
    worst_idleness: Scalar


@dataclasses.dataclass(frozen=True, kw_only=True)
class WatchMetrics(PartMetrics):
    """Metrics of a patrol.

    Args:
        mean_idleness: time since each reachable cell was last seen, mean over the cells and the
            second half of the run [s]: the first half is needed to see everything once. None
            without a step.
        worst_idleness: the greatest of these times in the second half [s].
        is_patrol: whether the run is judged by them: a search is judged by what it is about.
    """

    mean_idleness: float | None
    worst_idleness: float | None
    is_patrol: bool

    columns = (
        Column.quartiles(
            "mean_idleness", "idle mean [s]", applies=lambda spread: math.isfinite(spread[0])
        ),
        Column.quartiles(
            "worst_idleness", "idle worst [s]", applies=lambda spread: math.isfinite(spread[0])
        ),
    )
    plotted = (Curve("idleness", "mean idleness [s]", applies=lambda each: each.is_patrol),)

    def rows(self) -> list[tuple[str, str]]:
        """Return the idleness of a patrol."""
        if not self.is_patrol or self.mean_idleness is None:
            return []
        both = f"{self.mean_idleness:.1f} s, {text(self.worst_idleness, 1)} s at worst"
        return [("idleness", f"{both}, in the second half")]


@dataclasses.dataclass(frozen=True)
class WatchReport(PartReport):
    """Idleness of a map at the end of a run.

    Args:
        idleness: (H, W) time since each cell was last seen [s]; infinite if it never was.
        is_patrol: whether the run is judged by it.
    """

    name: ClassVar[str] = IdlenessMap.name
    record_type: ClassVar[type | None] = WatchRecord

    idleness: np.ndarray
    is_patrol: bool

    def metrics(self, run: MissionData) -> WatchMetrics:
        """Compute the mean over time of the mean idleness, and the worst, in the second half."""
        mean, worst = None, None
        if run.num_steps:
            record, begin = run.records.parts[self.name], find_judged_start(run)
            mean = finite_mean(record.mean_idleness[begin:])
            worst = finite(np.max(np.asarray(record.worst_idleness[begin:], np.float64)))
        return WatchMetrics(mean_idleness=mean, worst_idleness=worst, is_patrol=self.is_patrol)

    def series(self, run: MissionData) -> dict[str, np.ndarray]:
        """Return the mean idleness at each instant [s]."""
        return {"idleness": at_instants(run.records.parts[self.name].mean_idleness, 0.0)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the idleness."""
        return {"idleness": self.idleness}

    def figures(self, run: MissionData) -> dict[str, Callable[[], "Figure"]]:
        """Return the figure of a patrol."""
        return {"idleness": partial(idleness_figure, run, self)} if self.is_patrol else {}

    def headline(self, run: MissionData, step: int) -> Headline | None:
        """Return the mean idleness of a patrol."""
        if not self.is_patrol:
            return None
        values = self.series(run)["idleness"]
        return Headline(f"{values[step]:.1f} s", "mean idleness", values)


def find_judged_start(run: MissionData) -> int:
    """Return the first step of the second half of a run, N // 2."""
    return run.num_steps // 2


def idleness_figure(recording: MissionData, report: WatchReport) -> "Figure":
    """Draw a map of the time since each reachable cell was seen, and its mean and worst over time.

    Cells that were never seen count from the start. The shaded first half of the run is not part of
    the metrics. A rotated map is drawn along its own axes. The function has more than 60 lines
    because both panels share the figure's layout.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

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
    idle = window.crop(np.asarray(report.idleness, np.float64), 0.0)
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

    records = recording.records.parts[report.name]
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
