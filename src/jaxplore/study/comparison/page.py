"""The results of a comparison as one self-contained HTML page with tables, curves and replays."""

import base64
import html
import importlib.resources
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.drawing.colours import OUTLINE, UNKNOWN, belief_colours
from jaxplore.report.drawing.figure import figure_bytes
from jaxplore.report.drawing.series import line_style
from jaxplore.report.table import to_html
from jaxplore.study.comparison.replay import decode_cells
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.table import NEEDED, find_reference, list_failures, map_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = (
    *NEEDED,
    "curve_time",
    "curve_coverage",
    "duration",
    "positions_x",
    "positions_y",
    "seen_time",
    "seen",
    "settings",
    "time_limit",
)
"""Columns of the results that the page needs."""
Part = tuple[slice, slice]
"""Slices of the rows and columns of a part of a map."""

RIM = 2
"""Number of unknown cells that are drawn around the known part of a map."""
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
td { border-bottom: 1px solid #e4e6ea; white-space: pre; }
th:first-child, td:first-child { text-align: left; }
td:first-child { font-weight: 600; }
.wide { overflow-x: auto; } img { max-width: 100%; margin-top: 1em; }
.failed { color: #b3263f; }
.runs { display: flex; flex-wrap: wrap; gap: 1em; margin-top: 1em; } .runs figure { margin: 0; }
.runs button { border: 1px solid #d8dbe0; border-radius: 4px; background: none; padding: 2px;
  cursor: pointer; display: block; }
.runs button:hover, .runs button:focus { border-color: #1f6fb2; }
.runs img { margin: 0; display: block; } figcaption { font-size: .85em; text-align: center; }
dialog { border: 1px solid #d8dbe0; border-radius: 6px; max-width: 95vw; }
dialog canvas { max-width: 100%; max-height: 75vh; display: block; margin: auto; }
dialog h3 { margin: 0 0 .5em; font-weight: 600; } dialog form { display: flex; gap: 1em;
  align-items: center; margin-top: .5em; } dialog input { flex: 1; }
"""
NO_DATUMS: Mapping[str, Datum] = MappingProxyType({})
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""Content security policy: the page loads nothing."""
DIALOG = """<dialog id="replay"><h3 data-part="title"></h3><canvas data-part="map"></canvas>
<form method="dialog"><button type="button" data-part="toggle">Play</button>
<input type="range" min="0" value="0" step="any" aria-label="time" data-part="time">
<span data-part="told"></span><button>Close</button></form></dialog>"""


def page(
    results: Sequence[Row],
    maps: Mapping[str, OccupancyGrid],
    title: str,
    datums: Mapping[str, Datum] = NO_DATUMS,
) -> str:
    """Make an HTML page with embedded pictures.

    For each map it shows the table of `map_tables`, coverage over time (median and quartiles over
    seeds), and the path of each variant's first seed. A click on a path replays the run, with the
    robot and its map.

    The results need the columns `SHOWN`. Maps are by name, as the runs used them; a missing one has
    no paths. Datums, by the name of the map, are the points to which the grids of maps far from the
    origin are relative.
    """
    results = _relative(results, datums)
    told = html.escape(title)
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{told}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        f"<style>{STYLE}</style></head><body><h1>{told}</h1>",
        "<p>Medians [quartiles] over seeds; below them the ratio to the median of "
        f"{html.escape(find_reference(results))} and the interval that holds 95 % of it, "
        "bootstrapped over paired seeds. A run that does not get somewhere is infinitely late.</p>",
    ]
    for line in list_failures(results):
        parts.append(f'<p class="failed">{html.escape(line)}</p>')
    replays: list[dict[str, Any]] = []
    parts_shown = {name: find_known_part(grid) for name, grid in maps.items()}
    for table in map_tables(results):
        runs = _rows_to_draw(results, table.map)
        parts.append(f"<h2>{html.escape(table.map)}</h2>")
        parts.append(f'<div class="wide">{to_html(table.rows)}</div>')
        parts.append(_picture(curves_figure(runs), f"Coverage over time on {table.map}"))
        if table.map in maps:
            grid, part = maps[table.map], parts_shown[table.map]
            parts.append('<div class="runs">')
            for name, own in _by_variant(runs).items():
                drawn = _picture(path_figure(own[0], grid, part), f"Path of {name} on {table.map}")
                # A run on another version of the map has a path and no replay.
                seen = decode_cells(own[0]["seen"], grid.shape)
                if seen is not None:
                    drawn = (
                        f'<button type="button" data-run="{len(replays)}" title="Replay">{drawn}'
                        "</button>"
                    )
                    replays.append(_replay(own[0], grid, part, seen))
                caption = f"{html.escape(name)}, seed {own[0]['seed']}"
                parts.append(f"<figure>{drawn}<figcaption>{caption}</figcaption></figure>")
            parts.append("</div>")
    if replays:
        parts.append(DIALOG)
        pictures = {
            name: _colour(maps[name], parts_shown[name])
            for name in sorted({each["map"] for each in replays})
        }
        parts.append(_script(replays, pictures))
    return "\n".join([*parts, "</body></html>", ""])


def page_figures(
    results: Sequence[Row],
    maps: Mapping[str, OccupancyGrid],
    datums: Mapping[str, Datum] = NO_DATUMS,
) -> Iterator[tuple[str, "Figure"]]:
    """Yield the figures of the `page` with names: the curves of each map, and each path."""
    results = _relative(results, datums)
    for table in map_tables(results):
        runs = _rows_to_draw(results, table.map)
        yield f"{table.map}-curves", curves_figure(runs)
        if table.map in maps:
            grid = maps[table.map]
            part = find_known_part(grid)
            for name, own in _by_variant(runs).items():
                yield f"{table.map}-{name}-path", path_figure(own[0], grid, part)


def _rows_to_draw(results: Sequence[Row], name: str) -> list[Row]:
    """Return the rows of a map's runs that have something to draw."""
    return [
        row
        for row in results
        if row["map"] == name and row["error"] is None and row["curve_time"] is not None
    ]


def _relative(results: Sequence[Row], datums: Mapping[str, Datum]) -> list[Row]:
    """Return rows whose positions are relative to the datums of their maps."""
    found = []
    for row in results:
        datum = datums.get(row["map"], ORIGIN)
        if datum and row["error"] is None and row["positions_x"] is not None:
            x, y = (np.asarray(row[f"positions_{axis}"]) for axis in "xy")
            row = {**row, "positions_x": x - datum.x, "positions_y": y - datum.y}
        found.append(row)
    return found


def curves_figure(runs: Sequence[Row]) -> "Figure":
    """Draw coverage over time for each variant on a map: medians, and bands between the quartiles.

    A run that has ended keeps its last value. The time axis ends when three quarters of the runs
    have ended, because a random walk would compress all others.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    most = np.percentile([row["duration"] for row in runs], 75, method="higher") if runs else 1.0
    time = np.linspace(0.0, max(float(most), 1e-3), CURVE_POINTS)
    for number, (name, own) in enumerate(_by_variant(runs).items()):
        curves = [np.interp(time, row["curve_time"], row["curve_coverage"]) for row in own]
        low, median, high = np.percentile(100.0 * np.asarray(curves), [25, 50, 75], axis=0)
        style = line_style(number)
        axes.fill_between(time, low, high, color=style["color"], alpha=0.15, linewidth=0.0)
        axes.plot(time, median, **style, linewidth=1.7, label=name)
    axes.set(xlim=(0.0, time[-1]), ylim=(0.0, 104.0), xlabel="time [s]", ylabel="coverage [%]")
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def find_known_part(grid: OccupancyGrid) -> Part:
    """Return the rows and columns of the known part of a map, with a rim of two cells."""
    is_known = np.asarray(grid.is_free | grid.is_occupied)
    rows, columns = (
        _around(np.flatnonzero(is_known.any(axis=axis)), size)
        for axis, size in zip((1, 0), grid.shape, strict=True)
    )
    return rows, columns


def _around(places: np.ndarray, size: int) -> slice:
    if not len(places):
        return slice(0, size)
    return slice(max(0, int(places[0]) - RIM), min(size, int(places[-1]) + 1 + RIM))


def path_figure(row: Row, grid: OccupancyGrid, part: Part) -> "Figure":
    """Draw the path of a run on a part of the true map; a rotated map along its own axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    coloured = _colour(grid, part)
    height, width, _ = coloured.shape
    # The height is limited, so that the picture of a long corridor is neither flat nor tall.
    tall = min(max(height / width, 0.4), 1.8)
    figure = Figure(figsize=(2.6, 2.6 * tall), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(coloured, origin="lower", interpolation="nearest")
    # Matplotlib centres pixels at whole numbers.
    ways = np.stack(_in_cells(row, grid, part), axis=-1) - 0.5
    for number, (across, along) in enumerate(np.moveaxis(ways, -1, 1)):
        axes.plot(across, along, color=_ink(number, len(ways)), linewidth=1.2)
        axes.plot(across[:1], along[:1], "o", color="#2a9d5c", markersize=4)
        axes.plot(across[-1:], along[-1:], "s", color="#e07a1f", markersize=4)
    axes.set_axis_off()
    return figure


def _ink(number: int, robots: int) -> str:
    """Return the colour of the way of a robot; those of a fleet differ."""
    return OUTLINE if robots == 1 else str(line_style(number)["color"])


def _colour(grid: OccupancyGrid, part: Part) -> np.ndarray:
    colours: np.ndarray = belief_colours()[
        np.round(255.0 * np.asarray(grid.probability)[part]).astype(np.uint8)
    ]
    return colours


def _in_cells(row: Row, grid: OccupancyGrid, part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Return the ways (R, K) of the robots of a run in a part of a map, columns and rows [cells].

    A row has the positions of one robot after the other, K at the instants of its curves.
    """
    x0, y0, yaw = np.asarray(grid.frame.origin, np.float64)
    cos, sin = np.cos(yaw), np.sin(yaw)
    instants = len(row["curve_time"])
    x, y = (
        (np.asarray(row[f"positions_{axis}"]) - origin).reshape(-1, instants)
        for axis, origin in (("x", x0), ("y", y0))
    )
    across, along = (
        (cos * x + sin * y) / grid.resolution,
        (cos * y - sin * x) / grid.resolution,
    )
    rows, columns = part
    return across - columns.start, along - rows.start


def _replay(row: Row, grid: OccupancyGrid, part: Part, seen: np.ndarray) -> dict[str, Any]:
    """Return the data of a run for the page's player, in pixels from the upper left."""
    across, along = _in_cells(row, grid, part)
    # A picture has its first row at the top, a map at the bottom.
    seen = seen[part][::-1]
    radius = json.loads(row["settings"])["robot"]["radius"]
    return {
        "map": row["map"],
        "title": f"{row['explorer']} on {row['map']}, seed {row['seed']}",
        "time": row["curve_time"],
        "coverage": np.round(row["curve_coverage"], 4).tolist(),
        "across": np.round(across, 2).tolist(),
        "down": np.round(len(seen) - along, 2).tolist(),
        "inks": [_ink(number, len(across)) for number in range(len(across))],
        "radius": radius / grid.resolution,
        "seen_time": row["seen_time"] or [0.0],
        "seen": _png(seen),
    }


def _script(replays: Sequence[dict[str, Any]], maps: Mapping[str, np.ndarray]) -> str:
    """Return the scripts of the page: the data of the replays, and the player."""
    pictures = {name: _png(coloured[::-1]) for name, coloured in maps.items()}
    data = {"unknown": list(UNKNOWN), "maps": pictures, "runs": list(replays)}
    # Escaped, so that no name of a map or variant can end the script element.
    told = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    code = (importlib.resources.files("jaxplore.study.comparison") / "page.js").read_text("utf-8")
    return f'<script type="application/json" id="runs">{told}</script>\n<script>{code}</script>'


def _by_variant(runs: Sequence[Row]) -> dict[str, list[Row]]:
    """Group runs by variant, in the order of seeds."""
    ordered = sorted(runs, key=lambda row: (row["explorer"], row["seed"]))
    grouped: dict[str, list[Row]] = {}
    for row in ordered:
        grouped.setdefault(row["explorer"], []).append(row)
    return grouped


def _picture(figure: "Figure", alternative: str) -> str:
    data = figure_bytes(figure, dpi=DOTS_PER_INCH)
    return f'<img alt="{html.escape(alternative)}" src="{_url(data)}">'


def _png(picture: np.ndarray) -> str:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG", optimize=True)
    return _url(file.getvalue())


def _url(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode('ascii')}"
