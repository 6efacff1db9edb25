"""Animation of an exploration run: the belief, the robot and its rollouts."""

from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER,
    MOVER_EDGE,
    TARGET,
    UNKNOWN,
    belief_colours,
    blend,
)
from jaxplore.report.drawing.gif import write_gif
from jaxplore.report.drawing.palette import (
    FAINT,
    HEAT,
    HEAT_LEVELS,
    HIDDEN_WALL,
    INK,
    LIDAR_AREA,
    LIDAR_RAY,
    MAX_HEAT,
    PALE,
    PAPER,
    PLAN,
    REFERENCE,
    STRONG,
    TRAIL,
    Colour,
    fitted_palette,
)
from jaxplore.report.drawing.picture import SUPERSAMPLING, pairs
from jaxplore.report.drawing.shapes import draw_body, draw_line, draw_rollouts
from jaxplore.report.exploration.canvas import Canvas, make_canvas
from jaxplore.report.exploration.data import ExplorationData, ExplorationFrame
from jaxplore.report.exploration.footer import draw_footer

NUM_RAYS = 45
STAR = 7.0
"""Radius of a target [pixels]."""


def write_animation(
    recording: ExplorationData,
    path: str | PathLike[str],
    *,
    max_frames: int = 120,
    width: int = 720,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a run as an animated GIF that plays in browsers and in a README.

    Args:
        recording: recording of the run.
        path: path of the file.
        max_frames: greatest number of frames, evenly chosen, the first and the last one among them.
        width: width of the picture [pixels]; less for tall or small maps.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: less than one frame, or a width below 320 pixels.
    """
    canvas = make_canvas(recording, width)
    write_gif(
        path,
        recording.frames,
        partial(_draw, canvas),
        partial(_shared_palette, recording),
        max_frames,
        on_progress,
    )


def frame_image(
    recording: ExplorationData, frame: ExplorationFrame, *, width: int = 720
) -> Image.Image:
    """Draw one frame of a run, as in the animation.

    Args:
        recording: recording of the run.
        frame: one of its frames.
        width: width of the picture [pixels]; less for tall or small maps.

    Raises:
        ValueError: a width below 320 pixels.
    """
    return _draw(make_canvas(recording, width), frame)


def _draw(canvas: Canvas, frame: ExplorationFrame) -> Image.Image:
    factor = SUPERSAMPLING
    columns, rows = canvas.map_size
    ground = _ground(canvas, frame).resize(
        (columns * factor, rows * factor), Image.Resampling.NEAREST
    )
    _draw_robot(canvas, frame, ImageDraw.Draw(ground, "RGBA"))
    image = Image.new("RGB", (canvas.width, canvas.height), PAPER)
    image.paste(ground.reduce(factor), (canvas.left, 0))
    draw_footer(canvas, frame, image)
    return image


def _ground(canvas: Canvas, frame: ExplorationFrame) -> Image.Image:
    """Draw the belief, unseen true walls, the information and untraversable ground.

    One pixel per cell.
    """
    drawn = np.ix_(*canvas.sample)
    level = canvas.window.crop(frame.probability, 128.0)[drawn]
    # Sixteen levels instead of 256 make a small file; the last one is drawn as fully occupied.
    colours = belief_colours()[level // 16 * 16 + (level >= 240) * 15].astype(np.float32)
    unknown = np.abs(level.astype(int) - 128) < 8
    colours[unknown] = belief_colours()[128]
    colours[unknown & canvas.hidden_walls] = HIDDEN_WALL
    information = _smooth(np.nan_to_num(frame.information)).ravel()[canvas.corners]
    heat = np.clip((information * canvas.shares).sum(0) / canvas.brightest, 0.0, 1.0)
    alpha = np.round(heat * HEAT_LEVELS) / HEAT_LEVELS * MAX_HEAT
    # Only known-free cells, those below a quarter of 255, can be entered to gain information.
    alpha = np.where(level < 64, alpha, 0.0)[..., None]
    colours += alpha * (np.asarray(HEAT, np.float32) - colours)
    closed = canvas.closed & (level < 192)
    colours[closed] += CLOSED_SHARE * (np.asarray(CLOSED, np.float32) - colours[closed])
    # Row 0 of a grid is at the bottom, row 0 of a picture at the top.
    return Image.fromarray(np.round(colours[::-1]).astype(np.uint8))


def _draw_robot(canvas: Canvas, frame: ExplorationFrame, draw: ImageDraw.ImageDraw) -> None:
    """Draw the scan, the trail, the rollouts, the plan and the robot, in this order."""
    recording = canvas.recording
    names = recording.state_names
    here = frame.state[[names.index("x"), names.index("y")]]

    line = partial(draw_line, canvas, draw)
    seen = frame.scan[np.isfinite(frame.scan).all(axis=-1)]
    if len(seen) > 1:
        draw.polygon(pairs(canvas.pixels(np.concatenate([here[None], seen]))), LIDAR_AREA)
    for end in seen[:: max(1, len(seen) // NUM_RAYS)]:
        line(np.stack([here, end]), LIDAR_RAY, 0.5)
    line(recording.positions[: frame.step + 1], TRAIL, 1.5)
    _draw_targets(canvas, draw)
    _draw_moving_obstacles(canvas, frame, draw)
    draw_rollouts(canvas, draw, frame.samples, frame.weights)
    if len(frame.reference) > 1:
        line(frame.reference, REFERENCE, 3.0)
    line(frame.plan, PLAN, 2.0)
    if recording.goal is not None:
        x, y = canvas.pixels(recording.goal)
        for size, colour in ((7.0, REFERENCE), (4.0, PAPER), (2.0, REFERENCE)):
            reach = size * SUPERSAMPLING
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), colour)
    footprint, radius = recording.footprint, recording.robot_radius
    draw_body(canvas, draw, footprint, radius, here, frame.heading)


def _draw_targets(canvas: Canvas, draw: ImageDraw.ImageDraw) -> None:
    spikes = np.arange(10)
    angles = np.pi * (spikes / 5.0 - 0.5)
    reach = STAR * SUPERSAMPLING * np.where(spikes % 2, 0.42, 1.0)
    star = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for middle in canvas.pixels(canvas.recording.targets):
        draw.polygon(pairs(middle + 1.35 * star), PAPER)
        draw.polygon(pairs(middle + star), TARGET)


def _draw_moving_obstacles(
    canvas: Canvas, frame: ExplorationFrame, draw: ImageDraw.ImageDraw
) -> None:
    radii = canvas.recording.mover_radii.tolist()
    for middle, radius in zip(frame.movers, radii, strict=True):
        if np.isfinite(middle).all():
            x, y = canvas.pixels(middle).tolist()
            reach = max(radius * canvas.scale, 3.0) * SUPERSAMPLING
            box = (x - reach, y - reach, x + reach, y + reach)
            draw.ellipse(box, MOVER, MOVER_EDGE, round(1.5 * SUPERSAMPLING))


def _smooth(values: np.ndarray) -> np.ndarray:
    """Average over three by three nodes: finer detail of the field looks like noise."""
    padded = np.pad(values, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9.0)


def _shared_palette(recording: ExplorationData, pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute the palette that all frames share.

    Thin lines have few pixels, and a palette by frequency would lose their colours. These are
    fixed, pure and blended with the background; the rest is computed from a few frames.

    Args:
        recording: recording of the run; elements that it does not have get no colour.
        pictures: some of the frames, all of one size.
    """
    lines = (PLAN, REFERENCE, STRONG[:3], FAINT[:3], TRAIL, LIDAR_RAY[:3])
    given: list[Colour] = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, INK, PALE, *lines]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    given += [blend(HEAT, FREE, k / HEAT_LEVELS * MAX_HEAT) for k in range(1, HEAT_LEVELS + 1)]
    if recording.traversable is not None:
        given += [blend(CLOSED, ground, CLOSED_SHARE) for ground in (FREE, UNKNOWN)]
    if len(recording.targets):
        given.append(TARGET)
    if len(recording.mover_radii):
        given.append(MOVER_EDGE)
    return fitted_palette(given, pictures)
