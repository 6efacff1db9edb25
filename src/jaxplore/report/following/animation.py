"""Animation of a path-following run."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import FREE, MISSED, MOVER, MOVER_EDGE, UNKNOWN, blend
from jaxplore.report.drawing.footer import EDGE, Entry, Footer
from jaxplore.report.drawing.palette import (
    FAINT,
    INK,
    PALE,
    PAPER,
    PLAN,
    ROBOT,
    STRONG,
    TRAIL,
    Colour,
    fit_palette,
)
from jaxplore.report.drawing.picture import (
    MIN_MAP_SIDE,
    MIN_WIDTH,
    SUPERSAMPLING,
    WIDTH,
    pairs,
)
from jaxplore.report.drawing.series import find_runs
from jaxplore.report.drawing.shapes import draw_body, draw_line, draw_rollouts
from jaxplore.report.following.data import PathData, PathFrame, lap_starts, num_laps, speeds
from jaxplore.report.following.plots import course_box, worst_steps

BEYOND = blend(UNKNOWN, FREE, 0.45)
"""Colour of the ground outside the corridor."""
LEAST_ROBOT, CLOSE_ROBOT, MAX_ZOOM = 3.0, 12.0, 10.0
"""Least size of a robot in a view of the whole course, below which the view follows it [pixels];
its size in that view; greatest magnification."""
CLOSE_RATIO = 0.625
"""Height of a view that follows the robot, as a multiple of its width."""
DASH = 6.0
"""Length of a dash of the path, and of a gap [pixels]."""


@dataclasses.dataclass(frozen=True)
class View:
    """The part of the ground that a frame shows.

    `corner` (2,) is its lower left one [m]. `scale` is the supersampled pixels per metre, and
    `unit` those per pixel of scale 1. `size` is the columns and rows of the supersampled map.
    """

    corner: np.ndarray
    scale: float
    unit: float
    size: tuple[int, int]

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Transform world points (..., 2) [m] to columns and rows of the supersampled map."""
        placed = (np.asarray(points, np.float64) - self.corner) * self.scale
        placed[..., 1] = self.size[1] - placed[..., 1]
        return np.asarray(np.clip(placed, -1e5, 1e5))

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return which points (..., 2) are in the picture or less than its size away from it."""
        extent = np.asarray(self.size) / self.scale
        inside = (points > self.corner - extent) & (points < self.corner + 2.0 * extent)
        return np.asarray(inside.all(axis=-1))


@dataclasses.dataclass(frozen=True)
class PathCanvas:
    """The parts of an animation that are the same in every frame.

    `zoom` is the scale of the picture, `scale` the supersampled pixels per metre, and `size` the
    number of columns and rows of the supersampled map. `low` and `high` (2,) are the corners of the
    whole course [m], `dashes` (D, 3, 2) the points of the path's dashes [m], and `contacts` the
    steps that were deepest in an obstacle. `course` is the ground, where the view stays the same.
    """

    recording: PathData
    zoom: float
    scale: float
    size: tuple[int, int]
    low: np.ndarray
    high: np.ndarray
    edges: np.ndarray
    dashes: np.ndarray
    speed: np.ndarray
    lap_starts: np.ndarray
    contacts: np.ndarray
    course: Image.Image | None

    def view(self, position: np.ndarray) -> View:
        """Return the view around a robot's position, clipped to the course."""
        extent = np.asarray(self.size) / self.scale
        corner = np.clip(
            position - 0.5 * extent, self.low, np.maximum(self.high - extent, self.low)
        )
        return View(corner, self.scale, SUPERSAMPLING * self.zoom, self.size)


def path_frame_image(
    recording: PathData, frame: PathFrame, *, side: int = WIDTH, scale: float = 1.0
) -> Image.Image:
    """Draw one frame of a path-following run, as in the animation.

    It shows the whole course, or, if the robot would be too small, a view that follows the robot.
    `side` is the longer side of the picture of the course at scale 1 [pixels].
    """
    return _draw(_make_canvas(recording, side, scale), frame)


def path_painter(recording: PathData, scale: float) -> Callable[[PathFrame], Image.Image]:
    """Return a function that draws the frames of a run; what they share is computed once."""
    return partial(_draw, _make_canvas(recording, WIDTH, scale))


def _make_canvas(recording: PathData, side: int, zoom: float) -> PathCanvas:
    if side < MIN_WIDTH:
        raise ValueError(f"side is {side!r}; accepted: a whole number >= {MIN_WIDTH}")
    low, high = course_box(recording)
    scale = side / float((high - low).max())
    thickness = 2.0 * recording.robot_radius
    follows = 0.0 < thickness * scale < LEAST_ROBOT
    most = np.array([side, side])
    if follows:
        scale = min(CLOSE_ROBOT / thickness, MAX_ZOOM * scale)
        most = np.array([side, round(CLOSE_RATIO * side)])
    shown = np.clip(np.round((high - low) * scale).astype(int), MIN_MAP_SIDE, most)
    columns, rows = (SUPERSAMPLING * round(float(pixels) * zoom) for pixels in shown)
    # Where nodes are less than a pixel apart, a subset is enough.
    nodes = len(recording.centre)
    stride = max(1, int(nodes / (scale * recording.length)))
    kept = np.unique(np.append(np.arange(0, nodes, stride), nodes - 1))
    canvas = PathCanvas(
        recording=recording,
        zoom=zoom,
        scale=scale * zoom * SUPERSAMPLING,
        size=(columns, rows),
        low=low,
        high=high,
        edges=recording.edges[:, kept].astype(np.float64),
        dashes=_dashes(recording, DASH / scale),
        speed=speeds(recording),
        lap_starts=lap_starts(recording),
        contacts=worst_steps(recording.records.gap),
        course=None,
    )
    if follows:
        return canvas
    return dataclasses.replace(canvas, course=_draw_course(canvas, canvas.view(low)))


def _dashes(recording: PathData, length: float) -> np.ndarray:
    """Return the dashes (D, 3, 2) of the path, each of a length [m]."""
    nodes = np.linspace(0.0, recording.length, len(recording.centre))
    begins = np.arange(0.0, recording.length, 2.0 * length)
    # A dash has a point in its middle, so that it bends with the path.
    along = begins[:, None] + length * np.array([0.0, 0.5, 1.0])
    along = np.minimum(along, recording.length)
    axes = [np.interp(along, nodes, axis) for axis in recording.centre.T.astype(np.float64)]
    return np.stack(axes, axis=-1)


def _draw(canvas: PathCanvas, frame: PathFrame) -> Image.Image:
    view = canvas.view(frame.position)
    # The run is drawn into the ground, so each frame needs a copy.
    ground = canvas.course.copy() if canvas.course else _draw_course(canvas, view)
    _draw_run(canvas, view, frame, ImageDraw.Draw(ground, "RGBA"))
    footer = Footer(ground, canvas.zoom, _legend(canvas))
    _draw_footer(canvas, frame, footer)
    return footer.image


def _draw_course(canvas: PathCanvas, view: View) -> Image.Image:
    edges = canvas.edges
    # An infinite edge has no ground outside.
    is_bounded = len(edges) > 0 and bool(np.isfinite(edges).all())
    ground = Image.new("RGB", view.size, BEYOND if is_bounded else FREE)
    draw = ImageDraw.Draw(ground)
    if len(edges):
        near = view.holds(edges)
        left, right = view.pixels(edges)
        for index in np.flatnonzero(near[:, :-1].any(axis=0)).tolist() if is_bounded else ():
            quad = [left[index], left[index + 1], right[index + 1], right[index]]
            draw.polygon(pairs(np.stack(quad)), FREE)
        for edge, is_near in zip(edges, near, strict=True):
            for piece in find_runs(is_near & np.isfinite(edge).all(axis=1)):
                draw_line(view, draw, edge[piece], INK, 1.5)
    for dash in canvas.dashes[view.holds(canvas.dashes[:, 0])]:
        draw_line(view, draw, dash, PALE, 1.5)
    return ground


def _draw_run(canvas: PathCanvas, view: View, frame: PathFrame, draw: ImageDraw.ImageDraw) -> None:
    """Draw the trail, the obstacles, the rollouts, the plan and the robot, in this order."""
    recording = canvas.recording
    trail = recording.positions[: frame.step + 1]
    draw_line(view, draw, trail, TRAIL, 1.5)
    is_out = np.asarray(recording.records.room[: frame.step]) < 0.0
    for piece in find_runs(is_out):
        draw_line(view, draw, trail[piece.start : piece.stop + 1], MISSED, 4.0)
    for corners, radius in zip(frame.corners, recording.obstacle_radii.tolist(), strict=True):
        _draw_obstacle(view, draw, corners, radius)
    draw_rollouts(view, draw, frame.samples, frame.weights)
    draw_line(view, draw, frame.plan, PLAN, 2.0)
    for step in canvas.contacts[canvas.contacts < frame.step].tolist():
        middle = view.pixels(recording.positions[step + 1])
        # The white cross below is a rim that keeps the mark visible on the trail.
        for thickness, colour in ((4.5, PAPER), (2.5, MISSED)):
            for arm in (np.array([1.0, 1.0]), np.array([1.0, -1.0])):
                reach = (4.0 + 0.25 * thickness) * view.unit * arm
                ends = pairs(np.stack([middle - reach, middle + reach]))
                draw.line(ends, colour, round(thickness * view.unit))
    footprint, radius = recording.footprint, recording.robot_radius
    draw_body(view, draw, footprint, radius, frame.position, frame.heading)


def _draw_obstacle(
    view: View, draw: ImageDraw.ImageDraw, corners: np.ndarray, radius: float
) -> None:
    """Draw a polygon inflated by a radius [m], or a disc, with a bright edge."""
    if not np.isfinite(corners).all():
        return
    places = view.pixels(corners)
    edge = 1.5 * view.unit
    # A small obstacle keeps a visible size.
    reach = max(radius * view.scale, edge if len(places) > 2 else 2.0 * edge)
    for colour, around in ((MOVER_EDGE, reach), (MOVER, reach - edge)):
        if around > 0.0:
            draw.line(pairs(np.concatenate([places, places[:1]])), colour, round(2.0 * around))
            for x, y in places.tolist():
                draw.ellipse((x - around, y - around, x + around, y + around), colour)
        if len(places) > 2:
            draw.polygon(pairs(places), colour)


def _draw_footer(canvas: PathCanvas, frame: PathFrame, footer: Footer) -> None:
    recording, laps = canvas.recording, num_laps(canvas.recording)
    step = min(frame.step, recording.num_steps)
    footer.headline(f"{canvas.speed[step]:.1f} m/s", "speed")
    footer.text(88, 42, _progress(canvas, frame, step, laps))
    footer.text(EDGE, 42, f"{frame.time:.1f} s")
    footer.scale_bar(canvas.scale / SUPERSAMPLING)
    footer.legend()
    fastest = max(float(canvas.speed.max()), 1e-6)
    footer.curve(recording.time, canvas.speed / fastest, step)


def _progress(canvas: PathCanvas, frame: PathFrame, step: int, laps: int) -> str:
    if not laps:
        return f"{canvas.recording.progress[step]:.1f} m"
    done = int((canvas.lap_starts[1:] <= frame.time).sum())
    return f"lap {min(done + 1, laps)} of {laps}"


def _legend(canvas: PathCanvas) -> tuple[Entry, ...]:
    recording = canvas.recording
    room, frames = np.asarray(recording.records.room), recording.frames
    entries = (
        (Entry("robot", ROBOT, "disc"), True),
        (Entry("trail", TRAIL, "line"), recording.num_steps > 0),
        (Entry("plan", PLAN, "line"), any(len(each.plan) for each in frames)),
        (
            Entry("rollouts", STRONG[:3], "line"),
            any(len(each.samples) for each in frames),
        ),
        (Entry("path", PALE, "dashes"), True),
        (Entry("corridor", INK, "line"), len(recording.edges) > 0),
        (Entry("obstacle", MOVER, "disc", MOVER_EDGE), len(recording.obstacle_radii) > 0),
        (Entry("out of corridor", MISSED, "bar"), bool((room < 0.0).any())),
        (Entry("contact", MISSED, "cross"), len(canvas.contacts) > 0),
    )
    return tuple(entry for entry, is_drawn in entries if is_drawn)


def path_palette(pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute the palette that all frames share."""
    # Thin lines have few pixels, and a palette by frequency would lose their colours.
    lines = (PLAN, STRONG[:3], FAINT[:3], TRAIL, INK, PALE, MISSED)
    given: list[Colour] = [PAPER, FREE, BEYOND, MOVER_EDGE, *lines]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    return fit_palette(given, pictures)
