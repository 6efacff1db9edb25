"""Curves over time in the panel of a view."""

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.drawing.colours import SERIES
from jaxplore.view.history import Plot

if TYPE_CHECKING:
    import viser

SECONDS = 0.5
"""Least time between two updates of the curves [s]."""
HEIGHT = 190
"""Height of a figure [pixels]."""


class Curves:
    """The figures of a panel; a click on a name in the legend hides its curve."""

    def __init__(self, server: "viser.ViserServer", container: Any) -> None:
        self._server, self._container = server, container
        self._figures: dict[tuple[str, ...], Any] = {}
        self._at = -np.inf

    def is_due(self) -> bool:
        """Check whether the curves may be drawn again."""
        return time.monotonic() - self._at >= SECONDS

    def draw(self, plots: tuple[Plot, ...]) -> None:
        """Draw plots; one without two rows waits."""
        self._at = time.monotonic()
        for plot in plots:
            if len(plot.rows) < 2:
                continue
            data = tuple(np.ascontiguousarray(column) for column in plot.rows.T)
            key = (plot.title, *plot.names)
            if key in self._figures:
                self._figures[key].data = data
                continue
            series: list[Any] = [{"label": "time [s]"}]
            for i, name in enumerate(plot.names):
                series.append({"label": name, "stroke": SERIES[i % len(SERIES)], "width": 2})
            with self._container:
                self._figures[key] = self._server.gui.add_uplot(
                    data,
                    tuple(series),
                    title=plot.title,
                    scales={"x": {"time": False}},
                    height=HEIGHT,
                )

    def clear(self) -> None:
        """Remove all figures."""
        for figure in self._figures.values():
            figure.remove()
        self._figures.clear()
        self._at = -np.inf
