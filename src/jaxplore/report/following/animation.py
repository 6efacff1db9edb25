"""Animation of a path-following run."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import FREE, MISSED, MOVER, MOVER_EDGE, UNKNOWN, blend
from jaxplore.report.drawing.footer import draw_curve, draw_legend, fonts
from jaxplore.report.drawing.gif import write_gif
from jaxplore.report.drawing.palette import (
    FAINT,
    INK,
    PALE,
    PAPER,
    PLAN,
    STRONG,
    TRAIL,
    Colour,
    fitted_palette,
)
from jaxplore.report.drawing.picture import FOOTER, MIN_MAP_SIDE, MIN_WIDTH, SUPERSAMPLING, pairs
from jaxplore.report.drawing.shapes import draw_body, draw_line, draw_rollouts
from jaxplore.report.following.data import PathData, PathFrame
from jaxplore.report.following.laps import lap_starts, num_laps, speeds
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

    Args:
        corner: (2,) lower left corner [m].
        scale: pixels of the final picture per metre.
        size: number of columns and rows.
    """

    corner: np.ndarray
    scale: float
    size: tuple[int, int]

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Transform world points (..., 2) [m] to columns and rows of the supersampled map."""
        placed = (np.asarray(points, np.float64) - self.corner) * self.scale * SUPERSAMPLING
        placed[..., 1] = self.size[1] * SUPERSAMPLING - placed[..., 1]
        return np.asarray(np.clip(placed, -1e5, 1e5))

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return which points (..., 2) are in the picture or less than its size away from it."""
        extent = np.asarray(self.size) / self.scale
        inside = (points > self.corner - extent) & (points < self.corner + 2.0 * extent)
        return np.asarray(inside.all(axis=-1))


@dataclasses.dataclass(frozen=True)
class PathCanvas:
    """The parts of an animation that are the same in every frame.

    `low` and `high` (2,) are the corners of the whole course [m], `dashes` (D, 3, 2) points of the
    path's [m], `contacts` the steps that were deepest in an obstacle; `course` is the ground, where
    the view stays the same.
    """

    recording: PathData
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

    @property
    def width(self) -> int:
        """Width of the picture [pixels]."""
        return max(MIN_WIDTH, self.size[0])

    def view(self, position: np.ndarray) -> View:
        """Return the view around a robot's position, clipped to the course."""
        extent = np.asarray(self.size) / self.scale
        corner = np.clip(
            position - 0.5 * extent, self.low, np.maximum(self.high - extent, self.low)
        )
        return View(corner, self.scale, self.size)


def write_path_animation(
    recording: PathData,
    path: str | PathLike[str],
    *,
    max_frames: int = 240,
    side: int = 720,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a path-following run as an animated GIF that plays in browsers and in a README.

    It shows the whole course, or, if the robot would be too small, a view that follows the robot.

    Args:
        recording: recording of the run.
        path: path of the file.
        max_frames: greatest number of frames, evenly chosen, the first and the last one among them.
        side: the longer one of the course [pixels].
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: less than one frame, or a side below 320 pixels.
    """
    canvas = _make_canvas(recording, side)
    write_gif(
        path,
        recording.frames,
        partial(_draw, canvas),
        _palette,
        max_frames,
        on_progress,
    )


def path_frame_image(recording: PathData, frame: PathFrame, *, side: int = 720) -> Image.Image:
    """Draw one frame of a path-following run, as in the animation.

    Args:
        recording: recording of the run.
        frame: one of its frames.
        side: the longer one of the course [pixels].

    Raises:
        ValueError: a side below 320 pixels.
    """
    return _draw(_make_canvas(recording, side), frame)


def _make_canvas(recording: PathData, side: int) -> PathCanvas:
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
    size = (int(shown[0]), int(shown[1]))
    # Where nodes are less than a pixel apart, a subset is enough.
    nodes = len(recording.centre)
    stride = max(1, int(nodes / (scale * recording.length)))
    kept = np.unique(np.append(np.arange(0, nodes, stride), nodes - 1))
    canvas = PathCanvas(
        recording=recording,
        scale=scale,
        size=size,
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
    columns, rows = canvas.size
    image = Image.new("RGB", (canvas.width, rows + FOOTER), PAPER)
    image.paste(ground.reduce(SUPERSAMPLING), ((canvas.width - columns) // 2, 0))
    _draw_footer(canvas, frame, image)
    return image


def _draw_course(canvas: PathCanvas, view: View) -> Image.Image:
    """Draw the corridor and the path."""
    edges = canvas.edges
    # An infinite edge has no ground outside.
    is_bounded = len(edges) > 0 and bool(np.isfinite(edges).all())
    columns, rows = (SUPERSAMPLING * pixels for pixels in view.size)
    ground = Image.new("RGB", (columns, rows), BEYOND if is_bounded else FREE)
    draw = ImageDraw.Draw(ground)
    if len(edges):
        near = view.holds(edges)
        left, right = view.pixels(edges)
        for index in np.flatnonzero(near[:, :-1].any(axis=0)).tolist() if is_bounded else ():
            quad = [left[index], left[index + 1], right[index + 1], right[index]]
            draw.polygon(pairs(np.stack(quad)), FREE)
        for edge, is_near in zip(edges, near, strict=True):
            for piece in _runs(is_near & np.isfinite(edge).all(axis=1)):
                draw_line(view, draw, edge[piece], INK, 1.5)
    for dash in canvas.dashes[view.holds(canvas.dashes[:, 0])]:
        draw_line(view, draw, dash, PALE, 1.5)
    return ground


def _runs(mask: np.ndarray) -> list[slice]:
    """Return the slices of successive true entries of a mask (N,)."""
    padded = np.concatenate([[False], mask, [False]]).astype(int)
    changes = np.flatnonzero(np.diff(padded)).tolist()
    return [slice(begin, end) for begin, end in zip(changes[::2], changes[1::2], strict=True)]


def _draw_run(canvas: PathCanvas, view: View, frame: PathFrame, draw: ImageDraw.ImageDraw) -> None:
    """Draw the trail, the obstacles, the rollouts, the plan and the robot, in this order."""
    recording = canvas.recording
    trail = recording.positions[: frame.step + 1]
    draw_line(view, draw, trail, TRAIL, 1.5)
    is_out = np.asarray(recording.records.room[: frame.step]) < 0.0
    for piece in _runs(is_out):
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
                reach = (4.0 + 0.25 * thickness) * SUPERSAMPLING * arm
                ends = pairs(np.stack([middle - reach, middle + reach]))
                draw.line(ends, colour, round(thickness * SUPERSAMPLING))
    footprint, radius = recording.footprint, recording.robot_radius
    draw_body(view, draw, footprint, radius, frame.position, frame.heading)


def _draw_obstacle(
    view: View, draw: ImageDraw.ImageDraw, corners: np.ndarray, radius: float
) -> None:
    """Draw a polygon inflated by a radius [m], or a disc, with a bright edge."""
    if not np.isfinite(corners).all():
        return
    places = view.pixels(corners)
    edge = 1.5 * SUPERSAMPLING
    # A small obstacle keeps a visible size.
    reach = max(radius * view.scale * SUPERSAMPLING, edge if len(places) > 2 else 2.0 * edge)
    for colour, around in ((MOVER_EDGE, reach), (MOVER, reach - edge)):
        if around > 0.0:
            draw.line(pairs(np.concatenate([places, places[:1]])), colour, round(2.0 * around))
            for x, y in places.tolist():
                draw.ellipse((x - around, y - around, x + around, y + around), colour)
        if len(places) > 2:
            draw.polygon(pairs(places), colour)


def _draw_footer(canvas: PathCanvas, frame: PathFrame, image: Image.Image) -> None:
    """Draw speed, time, progress, the legend and the curve of the speed."""
    recording, laps = canvas.recording, num_laps(canvas.recording)
    top, step = image.height - FOOTER, min(frame.step, recording.num_steps)
    draw, (large, small) = ImageDraw.Draw(image), fonts()
    number = f"{canvas.speed[step]:.1f} m/s"
    draw.text((16, top + 14), number, INK, large)
    draw.text((24 + draw.textlength(number, large), top + 20), "speed", PALE, small)
    draw.text((88, top + 50), _progress(canvas, frame, step, laps), INK, small)
    draw.text((16, top + 50), f"{frame.time:.1f} s", INK, small)
    end = draw_legend(image, _legend(canvas))
    fastest = max(float(canvas.speed.max()), 1e-6)
    draw_curve(image, recording.time, canvas.speed / fastest, step, left=end)


def _progress(canvas: PathCanvas, frame: PathFrame, step: int, laps: int) -> str:
    if not laps:
        return f"{canvas.recording.progress[step]:.1f} m"
    done = int((canvas.lap_starts[1:] <= frame.time).sum())
    return f"lap {min(done + 1, laps)} of {laps}"


def _legend(canvas: PathCanvas) -> list[tuple[str, Colour]]:
    entries: list[tuple[str, Colour]] = [
        ("plan", PLAN),
        ("rollouts", STRONG),
        ("trail", TRAIL),
        ("path", PALE),
    ]
    if len(canvas.recording.obstacle_radii):
        entries.append(("obstacle", MOVER))
    if len(canvas.contacts) or (np.asarray(canvas.recording.records.room) < 0.0).any():
        entries.append(("violation", MISSED))
    return entries


def _palette(pictures: Sequence[Image.Image]) -> Image.Image:
    # Thin lines have few pixels, and a palette by frequency would lose their colours.
    lines = (PLAN, STRONG[:3], FAINT[:3], TRAIL, INK, PALE, MISSED)
    given: list[Colour] = [PAPER, FREE, BEYOND, MOVER_EDGE, *lines]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    return fitted_palette(given, pictures)
