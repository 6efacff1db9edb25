"""The results of a benchmark as one page that needs nothing else: tables, curves and paths."""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxplore.benchmark.rows import Row
from jaxplore.benchmark.table import NEEDED, failures, map_tables
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.colours import OUTLINE, SERIES, belief_colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = (
    *NEEDED,
    "curve_time",
    "curve_coverage",
    "duration",
    "positions_x",
    "positions_y",
    "time_limit",
)
"""Columns of the results that the page is made from."""
CURVE_POINTS = 200
DOTS_PER_INCH = 110
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #2b303a; max-width: 76em; margin: 2em auto;
  padding: 0 1em; }
h1, h2 { font-weight: 600; } h2 { margin-top: 2.5em; border-top: 1px solid #d8dbe0;
  padding-top: 1em; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; vertical-align: top; padding: .35em .9em; white-space: pre-line; }
th { font-weight: 600; border-bottom: 2px solid #2b303a; }
td { border-bottom: 1px solid #e4e6ea; } th:first-child, td:first-child { text-align: left; }
td:first-child { font-weight: 600; }
.wide { overflow-x: auto; } img { max-width: 100%; margin-top: 1em; }
.failed { color: #b3263f; }
"""


def page(results: Sequence[Row], maps: Mapping[str, OccupancyGrid], title: str) -> str:
    """Return an HTML page that loads nothing: pictures are in it.

    For each map a table as `map_tables` makes it, coverage over time (median and quartiles over
    seeds), and the path of each explorer's first seed.

    Args:
        results: rows with the columns `SHOWN`.
        maps: by name; one that is missing has no pictures of paths.
        title: of the page.
    """
    told = html.escape(title)
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{told}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style></head><body><h1>{told}</h1>",
        "<p>Medians [quartiles] over seeds; below them the ratio to nearest-frontier's median and "
        "the interval that holds 95 % of it, bootstrapped over paired seeds. A run that does not "
        "get somewhere is infinitely late.</p>",
    ]
    for line in failures(results):
        parts.append(f'<p class="failed">{html.escape(line)}</p>')
    for table in map_tables(results):
        runs = [row for row in results if row["map"] == table.map and row["error"] is None]
        parts.append(f"<h2>{html.escape(table.map)}</h2>")
        parts.append(_table(table.rows))
        parts.append(_picture(curves_figure(runs), f"Coverage over time on {table.map}"))
        if table.map in maps:
            drawn = paths_figure(runs, maps[table.map])
            parts.append(_picture(drawn, f"Paths of the first seeds on {table.map}"))
    return "\n".join([*parts, "</body></html>", ""])


def curves_figure(runs: Sequence[Row]) -> "Figure":
    """Return coverage over time by explorer: medians, and bands between the quartiles.

    A run that has ended keeps its last value.

    Args:
        runs: rows of one map.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    longest = max((row["duration"] for row in runs), default=1.0)
    time = np.linspace(0.0, max(longest, 1e-3), CURVE_POINTS)
    for number, (name, own) in enumerate(_by_explorer(runs).items()):
        curves = [np.interp(time, row["curve_time"], row["curve_coverage"]) for row in own]
        low, median, high = np.percentile(100.0 * np.asarray(curves), [25, 50, 75], axis=0)
        colour, style = SERIES[number % len(SERIES)], ("-", "--", ":")[number // len(SERIES) % 3]
        axes.fill_between(time, low, high, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(time, median, color=colour, linestyle=style, linewidth=1.7, label=name)
    axes.set(xlim=(0.0, time[-1]), ylim=(0.0, 104.0), xlabel="time [s]", ylabel="coverage [%]")
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def paths_figure(runs: Sequence[Row], grid: OccupancyGrid) -> "Figure":
    """Return the path of each explorer's first seed on the true map.

    A map that is turned is drawn along its own axes.

    Args:
        runs: rows of one map.
        grid: the map.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    first = {name: own[0] for name, own in _by_explorer(runs).items()}
    columns = min(4, max(len(first), 1))
    rows = -(-len(first) // columns)
    levels = np.round(255.0 * np.asarray(grid.probability)).astype(np.uint8)
    height, width = levels.shape
    tall = min(max(height / width, 0.4), 1.8)
    figure = Figure(figsize=(2.6 * columns, (2.6 * tall + 0.35) * rows), layout="constrained")
    FigureCanvasAgg(figure)
    x0, y0, yaw = np.asarray(grid.frame.origin, np.float64)
    cos, sin = np.cos(yaw), np.sin(yaw)
    for number, (name, row) in enumerate(first.items()):
        axes = figure.add_subplot(rows, columns, number + 1)
        axes.imshow(belief_colours()[levels], origin="lower", interpolation="nearest")
        x = np.asarray(row["positions_x"]) - x0
        y = np.asarray(row["positions_y"]) - y0
        # Pixels have their centres at whole numbers.
        across = (cos * x + sin * y) / grid.resolution - 0.5
        along = (cos * y - sin * x) / grid.resolution - 0.5
        axes.plot(across, along, color=OUTLINE, linewidth=1.2)
        axes.plot(across[:1], along[:1], "o", color="#2a9d5c", markersize=4)
        axes.plot(across[-1:], along[-1:], "s", color="#e07a1f", markersize=4)
        axes.set_title(name, fontsize=9)
        axes.set_axis_off()
    return figure


def _by_explorer(runs: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the runs of each explorer, the first seed first."""
    ordered = sorted(runs, key=lambda row: (row["explorer"], row["seed"]))
    grouped: dict[str, list[Row]] = {}
    for row in ordered:
        grouped.setdefault(row["explorer"], []).append(row)
    return grouped


def _table(rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Sequence[str], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{html.escape(cell)}</{kind}>" for cell in cells) + "</tr>"

    header, *others = rows
    body = "".join(line(row, "td") for row in others)
    return f'<div class="wide"><table>{line(header, "th")}{body}</table></div>'


def _picture(figure: "Figure", alternative: str) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=DOTS_PER_INCH)
    told = base64.b64encode(data.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(alternative)}" src="data:image/png;base64,{told}">'
