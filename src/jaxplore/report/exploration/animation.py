"""Animation of an exploration run: the belief, the robot and its rollouts."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER,
    MOVER_EDGE,
    UNKNOWN,
    belief_colours,
    blend,
)
from jaxplore.report.drawing.palette import (
    FAINT,
    HEAT,
    HEAT_LEVELS,
    HIDDEN_WALL,
    INK,
    LEVEL,
    LIDAR_AREA,
    LIDAR_RAY,
    MAX_HEAT,
    PALE,
    PAPER,
    PLAN,
    REFERENCE,
    ROBOT,
    STRONG,
    TRAIL,
    Colour,
    fit_palette,
)
from jaxplore.report.drawing.picture import WIDTH, pairs
from jaxplore.report.drawing.shapes import (
    draw_body,
    draw_goal,
    draw_line,
    draw_rollouts,
)
from jaxplore.report.exploration.canvas import Canvas, make_canvas
from jaxplore.report.exploration.data import TEAM, ExplorationData, ExplorationFrame
from jaxplore.report.exploration.legend import mission_colours
from jaxplore.report.exploration.map_canvas import MapCanvas
from jaxplore.report.exploration.team import robot_colour

NUM_RAYS = 45
DASH = 7.0
"""Length of a dash of the reference, and of a gap [pixels of scale 1]."""
WALL_LEVEL = 240
"""Level of a probability, of 255, from which a cell is drawn as a wall."""


def frame_image(
    recording: ExplorationData,
    frame: ExplorationFrame,
    *,
    width: int = WIDTH,
    scale: float = 1.0,
) -> Image.Image:
    """Draw one frame of a run, as in the animation.

    The width is that at scale 1 [pixels], at least 320; tall or small maps have less.
    """
    return _draw(make_canvas(recording, width, scale), frame)


def painter(recording: ExplorationData, scale: float) -> Callable[[ExplorationFrame], Image.Image]:
    """Return a function that draws the frames of a run; what they share is computed once."""
    return partial(_draw, make_canvas(recording, WIDTH, scale))


def _draw(canvas: Canvas, frame: ExplorationFrame) -> Image.Image:
    layers = partial(_draw_robot, canvas.map, canvas.recording, frame)
    return canvas.map.draw(_ground(canvas, frame), layers, frame, canvas.legend)


def _ground(canvas: Canvas, frame: ExplorationFrame) -> np.ndarray:
    """Draw the belief, unseen true walls, the information and untraversable ground.

    One pixel per cell.
    """
    drawn = np.ix_(*canvas.sample)
    level = canvas.map.window.crop(frame.probability, 128.0)
    is_hidden = canvas.any_in_blocks(canvas.map.walls & _is_unknown(level))
    is_wall = canvas.any_in_blocks(level >= WALL_LEVEL)
    level = level[drawn]
    # Sixteen levels instead of 256 make a small file; the last one is drawn as fully occupied.
    colours = belief_colours()[level // 16 * 16 + (level >= WALL_LEVEL) * 15].astype(np.float32)
    colours[_is_unknown(level)] = belief_colours()[128]
    if frame.information.size:
        information = _smooth(np.nan_to_num(frame.information)).ravel()[canvas.corners]
        heat = np.clip((information * canvas.shares).sum(0) / canvas.brightest, 0.0, 1.0)
        alpha = np.round(heat * HEAT_LEVELS) / HEAT_LEVELS * MAX_HEAT
        # Only known-free cells, those below a quarter of 255, can be entered to gain information.
        alpha = np.where(level < 64, alpha, 0.0)[..., None]
        colours += alpha * (np.asarray(HEAT, np.float32) - colours)
    closed = canvas.closed & (level < 192)
    colours[closed] += CLOSED_SHARE * (np.asarray(CLOSED, np.float32) - colours[closed])
    # Walls come last: where several cells share a pixel, a wall of one cell must not be lost.
    colours[is_hidden] = HIDDEN_WALL
    colours[is_wall] = belief_colours()[255]
    return np.asarray(np.round(colours).astype(np.uint8))


def _is_unknown(level: np.ndarray) -> np.ndarray:
    """Return which cells have a probability of about 1/2, given in 256 levels."""
    return np.asarray(np.abs(level.astype(int) - 128) < 8)


def _draw_robot(
    canvas: MapCanvas,
    recording: ExplorationData,
    frame: ExplorationFrame,
    draw: ImageDraw.ImageDraw,
) -> None:
    """Draw the scan, the trails, the rollouts, the plans and the robots, in this order.

    Of several robots each has its colour.
    """
    places, robots = recording.places(frame), recording.robots
    colours: list[tuple[Colour, Colour, Colour]] = [(TRAIL, PLAN, ROBOT)]
    if TEAM in recording.parts:
        colours = [(robot_colour(each.number),) * 3 for each in robots]
    line = partial(draw_line, canvas, draw)
    seen = frame.scan[np.isfinite(frame.scan).all(axis=-1)]
    if len(seen) > 1:
        draw.polygon(pairs(canvas.pixels(np.concatenate([places[:1], seen]))), LIDAR_AREA)
    for end in seen[:: max(1, len(seen) // NUM_RAYS)]:
        line(np.stack([places[0], end]), LIDAR_RAY, 0.5)
    for each, (colour, *_) in zip(robots, colours, strict=True):
        for piece in each.ways(frame.step):
            line(piece, colour, 1.5)
    for part in recording.parts.values():
        part.draw(canvas, draw, recording, frame)
    _draw_moving_obstacles(canvas, recording.mover_radii, frame, draw)
    _draw_tracks(canvas, frame, draw)
    draw_rollouts(canvas, draw, frame.samples, frame.weights)
    if len(frame.reference) > 1:
        _draw_dashes(canvas, draw, frame.reference)
    for plan, (_, colour, _) in zip(frame.plans, colours, strict=True):
        line(plan, colour, 2.0 if colour == PLAN else 3.0)  # in the colour of the trail: wider
    if recording.goal is not None:
        draw_goal(canvas, draw, recording.goal)
    headings = frame.headings.tolist()
    for each, here, heading, (*_, colour) in zip(robots, places, headings, colours, strict=True):
        # A robot whose state is lost is nowhere.
        if np.isfinite(here).all():
            draw_body(canvas, draw, each.footprint, each.radius, here, heading, colour)


def _draw_moving_obstacles(
    canvas: MapCanvas, radii: np.ndarray, frame: ExplorationFrame, draw: ImageDraw.ImageDraw
) -> None:
    for middle, radius in zip(frame.movers, radii.tolist(), strict=True):
        if np.isfinite(middle).all():
            x, y = canvas.pixels(middle).tolist()
            reach = max(radius * canvas.scale, 3.0 * canvas.unit)
            box = (x - reach, y - reach, x + reach, y + reach)
            draw.ellipse(box, MOVER, MOVER_EDGE, round(1.5 * canvas.unit))


def _draw_tracks(canvas: MapCanvas, frame: ExplorationFrame, draw: ImageDraw.ImageDraw) -> None:
    """Draw a ring around what the robot tracks, and a line to where it would be in a second."""
    reach = max(0.4 * canvas.scale, 5.0 * canvas.unit)
    for way in frame.tracks:
        if np.isfinite(way).all():
            (x, y), ahead = (canvas.pixels(place).tolist() for place in way)
            width = round(1.5 * canvas.unit)
            draw.line((x, y, *ahead), MOVER_EDGE, width)
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), None, MOVER_EDGE, width)


def _draw_dashes(canvas: MapCanvas, draw: ImageDraw.ImageDraw, points: np.ndarray) -> None:
    """Draw the reference (R, 2) [m] dashed: another colour than the plan's is not enough."""
    places = points[np.isfinite(points).all(axis=-1)].astype(np.float64)
    lengths = np.hypot(*np.diff(places, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    dash = DASH * canvas.unit / canvas.scale
    for begin in np.arange(0.0, along[-1], 2.0 * dash):
        some = begin + dash * np.array([0.0, 0.5, 1.0])
        piece = np.stack([np.interp(some, along, axis) for axis in places.T], axis=-1)
        draw_line(canvas, draw, piece, REFERENCE, 3.0)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Average over three by three nodes: finer detail of the field looks like noise."""
    padded = np.pad(values, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9.0)


def compute_palette(recording: ExplorationData, pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute the palette that all frames share from a few pictures, all of one size.

    Thin lines have few pixels, and a palette by frequency would lose their colours: they are fixed,
    pure and blended with the background, as far as the recording has them.
    """
    lines: tuple[Colour, ...] = (PLAN, REFERENCE, STRONG[:3], FAINT[:3], TRAIL, LIDAR_RAY[:3])
    given: list[Colour] = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, LEVEL, INK, PALE, *lines]
    if TEAM in recording.parts:
        lines += tuple(recording.parts[TEAM].colours())
        # Of the many colours of robots one would be the nearest to a wall that is hardly known.
        given += [tuple(colour) for colour in belief_colours()[176:255:16].tolist()]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    given += [blend(HEAT, FREE, k / HEAT_LEVELS * MAX_HEAT) for k in range(1, HEAT_LEVELS + 1)]
    if recording.traversable is not None:
        given += [blend(CLOSED, ground, CLOSED_SHARE) for ground in (FREE, UNKNOWN)]
    given += mission_colours(recording)
    if len(recording.mover_radii):
        given.append(MOVER_EDGE)
    return fit_palette(given, pictures)
