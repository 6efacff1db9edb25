"""Animation of an exploration by a fleet: what the robots know together, and each in its colour."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.drawing.colours import (
    ALARM,
    FREE,
    SERIES,
    TARGET,
    UNKNOWN,
    belief_colours,
    blend,
)
from jaxplore.report.drawing.footer import EDGE, Entry, Footer, footer_height
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
from jaxplore.report.drawing.picture import MIN_MAP_SIDE, MIN_WIDTH, SUPERSAMPLING, WIDTH
from jaxplore.report.drawing.shapes import LEAST_RADIUS, draw_goal, draw_line, draw_targets
from jaxplore.report.exploration.anomalies import find_report_times, middles
from jaxplore.report.exploration.footer import draw_mission
from jaxplore.report.exploration.legend import mission_entries
from jaxplore.report.exploration.objects import draw_objects, mission_colours
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.exploration.window import Window
from jaxplore.report.fleet.data import FleetData, FleetFrame

MAX_RATIO = 1.1
"""Greatest height of the map, as a multiple of the picture's width."""
LINK = (70, 140, 60)
"""Colour of the line between two robots that hear each other."""
MOST_NAMED = 12
"""Greatest number of robots in the legend."""
WALL_LEVEL, UNSEEN = 166, 8
"""Level of a probability, of 255, from which a cell is drawn as a wall, and distance from the
middle level within which it is unknown."""


@dataclasses.dataclass(frozen=True)
class Canvas:
    """The parts of an animation that are the same in every frame.

    `size` is the columns and rows of the map in the picture, `left` its first column and `width`
    that of the picture [pixels]; `scale` is the supersampled pixels per metre, and `zoom` the scale
    of the picture. `cells` are the row and column of the cell that each pixel of the map shows, and
    `walls` the true walls of the window. `lengths` is the distance that all robots had driven [m]
    at each `time` [s].
    """

    data: FleetData
    window: Window
    size: tuple[int, int]
    left: int
    width: int
    scale: float
    zoom: float
    cells: tuple[np.ndarray, np.ndarray]
    walls: np.ndarray
    time: np.ndarray
    lengths: np.ndarray

    @property
    def unit(self) -> float:
        """Pixels of the supersampled map per pixel of scale 1."""
        return SUPERSAMPLING * self.zoom

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) [m] into columns and rows of the supersampled map."""
        placed = self.window.place(points) * self.scale
        placed[..., 1] = self.size[1] * SUPERSAMPLING - placed[..., 1]
        return np.asarray(np.clip(placed, -1e5, 1e5))


def robot_colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a robot, the same as in the figures."""
    code = SERIES[number % len(SERIES)]
    red, green, blue = (int(code[at : at + 2], 16) for at in (1, 3, 5))
    return red, green, blue


def painter(data: FleetData, scale: float) -> Callable[[FleetFrame], Image.Image]:
    """Return a function that draws the frames of a run; what they share is computed once."""
    return partial(_draw, _canvas(data, scale))


def frame_image(data: FleetData, frame: FleetFrame, scale: float) -> Image.Image:
    """Draw one frame of a run, as in the animation."""
    return _draw(_canvas(data, scale), frame)


def compute_palette(data: FleetData, pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute the palette that all frames share from some of them, with the robots' colours."""
    lines: list[Colour] = [robot_colour(i) for i in range(min(data.num_robots, len(SERIES)))]
    given: list[Colour] = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, LEVEL, INK, PALE, TRAIL, LINK]
    given += [*lines, *mission_colours(data), *([] if data.goal is None else [REFERENCE])]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    return fit_palette(given, pictures)


def _canvas(data: FleetData, zoom: float) -> Canvas:
    window = Window.around_reachable(data)
    size = np.asarray(window.size)
    scale = min(WIDTH / size[0], MAX_RATIO * WIDTH / size[1])
    columns, rows = (round(max(MIN_MAP_SIDE, round(float(side) * scale)) * zoom) for side in size)
    width = max(round(MIN_WIDTH * zoom), columns)
    down, across = (
        ((np.arange(count) + 0.5) * window.shape[axis] / count).astype(int)
        for axis, count in ((0, rows), (1, columns))
    )
    walls = window.crop(data.world, 0.5) > OCCUPIED_THRESHOLD
    return Canvas(
        data,
        window,
        (columns, rows),
        (width - columns) // 2,
        width,
        scale * zoom * SUPERSAMPLING,
        zoom,
        (down, across),
        walls,
        data.time,
        data.lengths.sum(axis=0),
    )


def _draw(canvas: Canvas, frame: FleetFrame) -> Image.Image:
    columns, rows = canvas.size
    ground = _ground(canvas, frame).resize(
        (columns * SUPERSAMPLING, rows * SUPERSAMPLING), Image.Resampling.NEAREST
    )
    _draw_robots(canvas, frame, ImageDraw.Draw(ground, "RGBA"))
    legend = _legend(canvas.data)
    footer = round(footer_height(canvas.width / canvas.zoom, len(legend)) * canvas.zoom)
    image = Image.new("RGB", (canvas.width, rows + footer), PAPER)
    image.paste(ground.reduce(SUPERSAMPLING), (canvas.left, 0))
    _draw_footer(canvas, frame, image, legend)
    return image


def _ground(canvas: Canvas, frame: FleetFrame) -> Image.Image:
    """Draw what the robots know together, and unseen true walls; one pixel per pixel of the map."""
    level = canvas.window.crop(frame.probability, 128.0)
    is_unknown = np.abs(level.astype(int) - 128) < UNSEEN
    colours = belief_colours()[level]
    colours[is_unknown] = UNKNOWN
    colours[is_unknown & canvas.walls] = HIDDEN_WALL
    colours[level >= WALL_LEVEL] = belief_colours()[255]
    # Row 0 of a grid is at the bottom, row 0 of a picture at the top.
    return Image.fromarray(colours[np.ix_(*canvas.cells)][::-1])


def _draw_robots(canvas: Canvas, frame: FleetFrame, draw: ImageDraw.ImageDraw) -> None:
    """Draw the trails, the links, the plans and the robots, in this order."""
    data = canvas.data
    for number, trail in enumerate(data.trails):
        draw_line(canvas, draw, trail[: frame.step + 1], robot_colour(number), 1.5)
    for i, j in np.argwhere(np.triu(frame.links)):
        draw_line(canvas, draw, frame.positions[[i, j]], LINK, 1.0)
    draw_targets(canvas, draw, data.targets, frame.is_found, TARGET)
    if data.goal is not None:
        draw_goal(canvas, draw, data.goal)
    if data.objects is not None:
        draw_objects(canvas, draw, data.objects, frame)
    if data.anomalies is not None:
        is_reported = find_report_times(data.anomalies) <= frame.time
        draw_targets(canvas, draw, middles(data.anomalies), is_reported, ALARM)
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


def _draw_footer(
    canvas: Canvas, frame: FleetFrame, image: Image.Image, legend: tuple[Entry, ...]
) -> None:
    data, step = canvas.data, min(frame.step, len(canvas.time) - 1)
    footer = Footer(image, canvas.zoom, legend)
    if is_known_map(data):
        draw_mission(data, frame, footer, canvas.time, canvas.lengths, step)
    else:
        share = float(data.coverage[step]) if frame.step else data.initial_coverage
        footer.headline(f"{100.0 * share:.1f} %", "covered")
        footer.curve(canvas.time, data.coverage, step, level=data.target_coverage)
    footer.text(EDGE, 38, f"{frame.time:.1f} s")
    footer.text(84, 38, f"{canvas.lengths[step]:.1f} m")
    if len(data.targets):
        footer.text(EDGE, 56, f"targets {int(np.sum(frame.is_found))} of {len(data.targets)}")
    footer.scale_bar(canvas.scale / SUPERSAMPLING)
    footer.legend()
