"""Animation of an exploration by a fleet: what the robots know together, and each in its colour."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import (
    FREE,
    SERIES,
    TARGET,
    UNKNOWN,
    belief_colours,
    blend,
)
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import (
    HIDDEN_WALL,
    INK,
    LEVEL,
    PALE,
    PAPER,
    REFERENCE,
    TRAIL,
    Colour,
    fit_palette,
)
from jaxplore.report.drawing.picture import WIDTH
from jaxplore.report.drawing.shapes import LEAST_RADIUS, draw_goal, draw_line, draw_targets
from jaxplore.report.exploration.legend import mission_colours, mission_entries
from jaxplore.report.exploration.map_canvas import MapCanvas, make_map_canvas
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.fleet.data import FleetData, FleetFrame

LINK = (70, 140, 60)
"""Colour of the line between two robots that hear each other."""
MOST_NAMED = 12
"""Greatest number of robots in the legend."""
WALL_LEVEL, UNSEEN = 166, 8
"""Level of a probability, of 255, from which a cell is drawn as a wall, and distance from the
middle level within which it is unknown."""


def robot_colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a robot, the same as in the figures."""
    code = SERIES[number % len(SERIES)]
    red, green, blue = (int(code[at : at + 2], 16) for at in (1, 3, 5))
    return red, green, blue


def painter(data: FleetData, scale: float) -> Callable[[FleetFrame], Image.Image]:
    """Return a function that draws the frames of a run; what they share is computed once."""
    return partial(_draw, _canvas(data, scale), data)


def frame_image(data: FleetData, frame: FleetFrame, scale: float) -> Image.Image:
    """Draw one frame of a run, as in the animation."""
    return _draw(_canvas(data, scale), data, frame)


def compute_palette(data: FleetData, pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute the palette that all frames share from some of them, with the robots' colours."""
    lines: list[Colour] = [robot_colour(i) for i in range(min(data.num_robots, len(SERIES)))]
    given: list[Colour] = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, LEVEL, INK, PALE, TRAIL, LINK]
    given += [*lines, *mission_colours(data), *([] if data.goal is None else [REFERENCE])]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    return fit_palette(given, pictures)


def _canvas(data: FleetData, zoom: float) -> MapCanvas:
    return make_map_canvas(data, (data.time, data.coverage, data.lengths.sum(axis=0)), WIDTH, zoom)


def _draw(canvas: MapCanvas, data: FleetData, frame: FleetFrame) -> Image.Image:
    layers = partial(_draw_robots, canvas, data, frame)
    return canvas.draw(_ground(canvas, frame), layers, frame, _legend(data))


def _ground(canvas: MapCanvas, frame: FleetFrame) -> np.ndarray:
    """Draw what the robots know together, and unseen true walls; one pixel per pixel of the map."""
    level = canvas.window.crop(frame.probability, 128.0)
    is_unknown = np.abs(level.astype(int) - 128) < UNSEEN
    colours = belief_colours()[level]
    colours[is_unknown] = UNKNOWN
    colours[is_unknown & canvas.walls] = HIDDEN_WALL
    colours[level >= WALL_LEVEL] = belief_colours()[255]
    columns, rows = canvas.size
    cells = (
        ((np.arange(count) + 0.5) * shape / count).astype(int)
        for count, shape in zip((rows, columns), level.shape, strict=True)
    )
    return np.asarray(colours[np.ix_(*cells)])


def _draw_robots(
    canvas: MapCanvas, data: FleetData, frame: FleetFrame, draw: ImageDraw.ImageDraw
) -> None:
    """Draw the trails, the links, the plans and the robots, in this order."""
    for number, trail in enumerate(data.trails):
        draw_line(canvas, draw, trail[: frame.step + 1], robot_colour(number), 1.5)
    for i, j in np.argwhere(np.triu(frame.links)):
        draw_line(canvas, draw, frame.positions[[i, j]], LINK, 1.0)
    draw_targets(canvas, draw, data.targets, frame.is_found, TARGET)
    if data.goal is not None:
        draw_goal(canvas, draw, data.goal)
    for each in data.parts.values():
        each.draw(canvas, draw, data, frame)
    for number, plan in enumerate(frame.plans):
        draw_line(canvas, draw, plan, robot_colour(number), 3.0)
    bodies = zip(frame.positions, frame.headings, data.radii.tolist(), strict=True)
    for number, (place, heading, radius) in enumerate(bodies):
        if not np.isfinite([*place, heading]).all():
            continue
        reach = max(radius * canvas.scale, LEAST_RADIUS * canvas.unit)
        x, y = canvas.pixels(place).tolist()
        edge = round(1.2 * canvas.unit)
        draw.ellipse(
            (x - reach, y - reach, x + reach, y + reach), robot_colour(number), PAPER, edge
        )
        ahead = place + np.array([np.cos(heading), np.sin(heading)])
        along = canvas.pixels(ahead) - canvas.pixels(place)
        tip = np.array([x, y]) + 0.8 * reach * along / max(float(np.hypot(*along)), 1e-6)
        draw.line([(x, y), tuple(tip.tolist())], PAPER, round(1.8 * canvas.unit))


def _legend(data: FleetData) -> tuple[Entry, ...]:
    robots = [
        Entry(f"robot {i + 1}", robot_colour(i), "disc")
        for i in range(min(data.num_robots, MOST_NAMED))
    ]
    link = [Entry("radio", LINK, "line")] if data.num_robots > 1 else []
    hidden = [] if is_known_map(data) else [Entry("unseen wall", HIDDEN_WALL)]
    goal = [] if data.goal is None else [Entry("goal", REFERENCE, "disc")]
    return (*robots, *link, *goal, *mission_entries(data), *hidden, Entry("unknown", UNKNOWN))
