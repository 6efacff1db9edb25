"""An animated GIF of a run: the map grows, the robot looks ahead and drives."""

import dataclasses
from collections.abc import Callable, Iterator
from os import PathLike

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.metrics import progress
from jaxplore.report.plots import FREE, UNKNOWN, Window, belief_colours, to_frame
from jaxplore.simulation.recording import Frame, Recording

Colour = tuple[int, int, int] | tuple[int, int, int, int]

FRAME_MILLISECONDS, LAST_MILLISECONDS = 90, 3000
NUM_COLOURS = 64
SUPERSAMPLING = 2
MIN_WIDTH, MIN_MAP_SIDE, MAX_RATIO = 320, 24, 1.1
"""Smallest picture and map [pixels]; the tallest map, as a multiple of the picture's width."""
FOOTER, NARROW = 84, 560
"""Height of the strip with numbers; below the second width its legend is left out [pixels]."""
NUM_RAYS = 45
HEAT_LEVELS, MAX_HEAT = 6, 0.75
"""Steps of the information's colour, few so that small changes cost no bytes; its opacity."""
STRONG_SHARE = 0.02
"""Rollouts of at least this share of the heaviest one's weight are drawn boldly."""

PAPER, INK, PALE = (255, 255, 255), (43, 48, 58), (125, 132, 143)
HIDDEN_WALL = (172, 178, 188)
HEAT = (255, 166, 33)
LIDAR_AREA, LIDAR_RAY = (42, 170, 150, 26), (42, 170, 150, 64)
TRAIL = (31, 111, 178)
FAINT, STRONG = (132, 94, 194, 70), (118, 56, 190, 235)
PLAN, ROBOT = (214, 40, 85), (214, 40, 85)
REFERENCE = (64, 145, 62)


@dataclasses.dataclass(frozen=True)
class _Canvas:
    """All that is the same in every frame of a recording.

    `scale` is in pixels per metre, `left` the map's first column; `corners` (4, R, C) are the
    nodes of the information field around each drawn cell and `shares` their bilinear weights;
    `brightest` [nat] is where the heat saturates.
    """

    recording: Recording
    window: Window
    width: int
    map_size: tuple[int, int]
    left: int
    scale: float
    sample: tuple[np.ndarray, np.ndarray]
    hidden_walls: np.ndarray
    corners: np.ndarray
    shares: np.ndarray
    brightest: float
    progress: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @property
    def height(self) -> int:
        return self.map_size[1] + FOOTER


def write_animation(
    recording: Recording,
    path: str | PathLike[str],
    *,
    max_frames: int = 120,
    width: int = 720,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a run as an animated GIF that plays in browsers and in a README.

    Args:
        recording: of the run.
        path: of the file.
        max_frames: at most; evenly chosen, the first and the last one among them.
        width: of the picture [pixels]; tall or small maps get less.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: less than one frame, or a width below 320 pixels.
    """
    if max_frames < 1:
        raise ValueError(f"max_frames is {max_frames!r}; accepted: a whole number >= 1")
    canvas = _canvas(recording, width)
    frames = _chosen(recording.frames, max_frames)
    palette = _palette(canvas, frames)

    def pictures() -> Iterator[Image.Image]:
        for done, frame in enumerate(frames):
            yield _draw(canvas, frame).quantize(palette=palette, dither=Image.Dither.NONE)
            on_progress((done + 1) / len(frames))

    first, *others = pictures()
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=others,
        duration=[FRAME_MILLISECONDS] * len(others) + [LAST_MILLISECONDS],
        loop=0,
        disposal=1,
        optimize=True,
    )


def frame_image(recording: Recording, frame: Frame, *, width: int = 720) -> Image.Image:
    """Return one look at a run, as it is drawn in the animation.

    Args:
        recording: of the run.
        frame: one of its frames.
        width: of the picture [pixels]; tall or small maps get less.

    Raises:
        ValueError: a width below 320 pixels.
    """
    return _draw(_canvas(recording, width), frame)


def _chosen(frames: tuple[Frame, ...], most: int) -> list[Frame]:
    count = min(most, len(frames))
    # Counted from the end, so that a single frame is the last one.
    back = np.round(np.linspace(0, len(frames) - 1, count)).astype(int)[::-1]
    return [frames[len(frames) - 1 - index] for index in back]


def _canvas(recording: Recording, width: int) -> _Canvas:
    if width < MIN_WIDTH:
        raise ValueError(f"width is {width!r}; accepted: a whole number >= {MIN_WIDTH}")
    window = Window.around_reachable(recording)
    size = np.asarray(window.size)
    scale = min(width / size[0], MAX_RATIO * width / size[1])
    columns, rows = (max(MIN_MAP_SIDE, round(float(side) * scale)) for side in size)
    total = max(MIN_WIDTH, columns)
    # Cells smaller than the pixels they are drawn with need not all be coloured.
    cells = [
        (np.arange(count) + 0.5) * window.shape[axis] / count
        for axis, count in (
            (axis, min(window.shape[axis], SUPERSAMPLING * (rows, columns)[axis]))
            for axis in (0, 1)
        )
    ]
    sample = (cells[0].astype(int), cells[1].astype(int))
    corners, shares = _field_stencil(recording, window, sample)
    drawn = np.ix_(*sample)
    return _Canvas(
        recording=recording,
        window=window,
        width=total,
        map_size=(columns, rows),
        left=(total - columns) // 2,
        scale=scale,
        sample=sample,
        hidden_walls=(window.crop(recording.world, 0.5) > OCCUPIED_THRESHOLD)[drawn],
        corners=corners,
        shares=shares,
        brightest=_brightest(recording.frames),
        progress=progress(recording),
    )


def _field_stencil(
    recording: Recording, window: Window, sample: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each drawn cell the flat indices of four nodes and their bilinear weights."""
    nodes = recording.frames[0].information.shape
    y, x = (
        (index + first + 0.5) * window.resolution
        for index, first in zip(sample, window.first, strict=True)
    )
    yaw = float(recording.origin[2])
    cos, sin = np.cos(yaw), np.sin(yaw)
    world = np.stack(
        [
            cos * x[None, :] - sin * y[:, None] + float(recording.origin[0]),
            sin * x[None, :] + cos * y[:, None] + float(recording.origin[1]),
        ],
        axis=-1,
    )
    spot = to_frame(world, recording.field_origin)[..., ::-1] / recording.field_resolution - 0.5
    spot = np.clip(spot, 0.0, np.asarray(nodes) - 1.0)
    lower = np.floor(spot).astype(int)
    upper = np.minimum(lower + 1, np.asarray(nodes) - 1)
    share = spot - lower
    corners, shares = [], []
    for down in (False, True):
        for right in (False, True):
            row = (upper if down else lower)[..., 0]
            column = (upper if right else lower)[..., 1]
            corners.append(row * nodes[1] + column)
            across = share[..., 1] if right else 1.0 - share[..., 1]
            shares.append((share[..., 0] if down else 1.0 - share[..., 0]) * across)
    return np.stack(corners), np.stack(shares).astype(np.float32)


def _brightest(frames: tuple[Frame, ...]) -> float:
    """Return a level of information that few nodes exceed in any frame [nat]."""
    highs = [np.percentile(np.nan_to_num(frame.information), 98) for frame in frames]
    return max(float(np.median(highs)), 1e-6)


def _draw(canvas: _Canvas, frame: Frame) -> Image.Image:
    factor = SUPERSAMPLING
    columns, rows = canvas.map_size
    ground = _ground(canvas, frame).resize(
        (columns * factor, rows * factor), Image.Resampling.NEAREST
    )
    _draw_robot(canvas, frame, ImageDraw.Draw(ground, "RGBA"))
    image = Image.new("RGB", (canvas.width, canvas.height), PAPER)
    image.paste(ground.reduce(factor), (canvas.left, 0))
    _draw_footer(canvas, frame, image)
    return image


def _ground(canvas: _Canvas, frame: Frame) -> Image.Image:
    """Return the belief, the true walls yet to be seen and the information, a pixel per cell."""
    drawn = np.ix_(*canvas.sample)
    level = canvas.window.crop(frame.probability, 128.0)[drawn]
    colours = belief_colours()[level // 16 * 16 + (level >= 240) * 15].astype(np.float32)
    unknown = np.abs(level.astype(int) - 128) < 8
    colours[unknown] = belief_colours()[128]
    colours[unknown & canvas.hidden_walls] = HIDDEN_WALL
    information = _smooth(np.nan_to_num(frame.information)).ravel()[canvas.corners]
    heat = np.clip((information * canvas.shares).sum(0) / canvas.brightest, 0.0, 1.0)
    alpha = np.round(heat * HEAT_LEVELS) / HEAT_LEVELS * MAX_HEAT
    alpha = np.where(level < 64, alpha, 0.0)[..., None]
    colours += alpha * (np.asarray(HEAT, np.float32) - colours)
    # Row 0 is at the bottom.
    return Image.fromarray(np.round(colours[::-1]).astype(np.uint8))


def _draw_robot(canvas: _Canvas, frame: Frame, draw: ImageDraw.ImageDraw) -> None:
    """Draw, from the ground up, what it sees, where it was, what it weighs up, and itself."""
    recording = canvas.recording
    names = recording.state_names
    here = frame.state[[names.index("x"), names.index("y")]]

    def pixels(points: np.ndarray) -> np.ndarray:
        placed = canvas.window.place(points) * canvas.scale * SUPERSAMPLING
        placed[..., 1] = canvas.map_size[1] * SUPERSAMPLING - placed[..., 1]
        return np.clip(placed, -1e4, 1e4)

    def line(points: np.ndarray, colour: Colour, thickness: float) -> None:
        whole = points[np.isfinite(points).all(axis=-1)]
        if len(whole) > 1:
            draw.line(_pairs(pixels(whole)), colour, round(thickness * SUPERSAMPLING), "curve")

    seen = frame.scan[np.isfinite(frame.scan).all(axis=-1)]
    if len(seen) > 1:
        draw.polygon(_pairs(pixels(np.concatenate([here[None], seen]))), LIDAR_AREA)
    for end in seen[:: max(1, len(seen) // NUM_RAYS)]:
        line(np.stack([here, end]), LIDAR_RAY, 0.5)
    line(recording.positions[: frame.step + 1], TRAIL, 1.5)
    weights = np.nan_to_num(frame.weights)
    bold = STRONG_SHARE * weights.max(initial=0.0)
    for index in np.argsort(weights):
        is_strong = weights[index] > 0.0 and weights[index] >= bold
        line(frame.samples[index], STRONG if is_strong else FAINT, 1.5 if is_strong else 1.0)
    if len(frame.reference) > 1:
        line(frame.reference, REFERENCE, 3.0)
    line(frame.plan, PLAN, 2.0)
    if recording.goal is not None:
        x, y = pixels(recording.goal)
        for size, colour in ((7.0, REFERENCE), (4.0, PAPER), (2.0, REFERENCE)):
            reach = size * SUPERSAMPLING
            draw.ellipse((x - reach, y - reach, x + reach, y + reach), colour)
    x, y = pixels(here)
    radius = max(recording.robot_radius * canvas.scale, 6.5) * SUPERSAMPLING
    box = (x - radius, y - radius, x + radius, y + radius)
    draw.ellipse(box, ROBOT, PAPER, round(1.2 * SUPERSAMPLING))
    if np.isfinite(frame.heading):
        angle = frame.heading - float(recording.origin[2])
        ahead = np.array([np.cos(angle), -np.sin(angle)])
        aside = np.array([ahead[1], -ahead[0]])
        middle = np.array([x, y])
        tips = [middle + 0.72 * radius * ahead]
        tips += [middle + radius * (-0.35 * ahead + side * 0.5 * aside) for side in (-1.0, 1.0)]
        draw.polygon(_pairs(np.stack(tips)), PAPER)


def _draw_footer(canvas: _Canvas, frame: Frame, image: Image.Image) -> None:
    """Draw the strip with time, coverage, distance, the legend and the coverage curve."""
    time, coverage, _, path = canvas.progress
    top, step = canvas.map_size[1], min(frame.step, len(time) - 1)
    draw = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(size=21), ImageFont.load_default(size=13)
    percent = (
        100.0 * float(coverage[step]) if frame.step else 100.0 * canvas.recording.initial_coverage
    )
    draw.text((16, top + 14), f"{percent:.1f} %", INK, large)
    draw.text((100, top + 20), "covered", PALE, small)
    draw.text((16, top + 50), f"{frame.time:.1f} s", INK, small)
    draw.text((100, top + 50), f"{path[step]:.1f} m", INK, small)
    if canvas.width >= NARROW:
        entries: list[tuple[str, Colour]] = [
            ("plan", PLAN),
            ("rollouts", STRONG),
            ("trail", TRAIL),
            ("information", _blend(HEAT, PAPER, MAX_HEAT)),
            ("lidar", LIDAR_RAY[:3]),
            ("unseen wall", HIDDEN_WALL),
        ]
        if canvas.recording.goal is not None:
            entries[4] = ("reference, goal", REFERENCE)
        for index, (name, colour) in enumerate(entries):
            x, y = 190 + 108 * (index // 2), top + 20 + 30 * (index % 2)
            draw.rounded_rectangle((x, y + 2, x + 16, y + 11), 3, colour)
            draw.text((x + 22, y - 1), name, INK, small)
    _draw_curve(canvas, step, image)


def _draw_curve(canvas: _Canvas, step: int, image: Image.Image) -> None:
    """Draw the coverage until now into the lower right corner."""
    time, coverage, *_ = canvas.progress
    width = 190 if canvas.width >= NARROW else canvas.width - 180
    height = FOOTER - 24
    factor = 2 * SUPERSAMPLING
    box = Image.new("RGB", (width * factor, height * factor), PAPER)
    draw = ImageDraw.Draw(box)
    duration = max(float(time[-1]), canvas.recording.control_period)

    def spots(seconds: np.ndarray, share: np.ndarray) -> list[tuple[float, float]]:
        x = 4 + (width - 8) * seconds / duration
        y = height - 4 - (height - 8) * share
        return _pairs(np.stack([x, y], axis=-1) * factor)

    ends = np.array([0.0, duration])
    draw.line(spots(ends, np.zeros(2)), PALE, factor)
    draw.line(spots(ends, np.full(2, canvas.recording.target_coverage)), HIDDEN_WALL, factor)
    kept = np.unique(np.linspace(0, step, min(step + 1, 4 * width)).round().astype(int))
    curve = spots(time[kept], coverage[kept])
    if len(curve) > 1:
        draw.line(curve, TRAIL, 2 * factor, "curve")
    x, y = curve[-1]
    draw.ellipse((x - 3 * factor, y - 3 * factor, x + 3 * factor, y + 3 * factor), TRAIL)
    image.paste(box.reduce(factor), (canvas.width - width - 12, canvas.map_size[1] + 12))


def _palette(canvas: _Canvas, frames: list[Frame]) -> Image.Image:
    """Return the colours that all frames share.

    Thin lines are few pixels, which a choice by frequency would sacrifice: their colours are given,
    pure and as they fade into the ground; the rest is found from a few frames side by side.
    """
    lines = (PLAN, REFERENCE, STRONG[:3], FAINT[:3], TRAIL, LIDAR_RAY[:3])
    given = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, INK, PALE, *lines]
    given += [_blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    given += [_blend(HEAT, FREE, k / HEAT_LEVELS * MAX_HEAT) for k in range(1, HEAT_LEVELS + 1)]
    looks = [_draw(canvas, frame) for frame in _chosen(tuple(frames), 6)]
    sheet = Image.new("RGB", (canvas.width, canvas.height * len(looks)))
    for index, look in enumerate(looks):
        sheet.paste(look, (0, index * canvas.height))
    # One entry stays free: it stands for "as before".
    found = sheet.quantize(NUM_COLOURS - 1 - len(given), dither=Image.Dither.NONE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([channel for colour in given for channel in colour] + (found or []))
    return palette


def _blend(colour: tuple[int, ...], ground: tuple[int, ...], share: float) -> tuple[int, int, int]:
    red, green, blue = (
        round(share * over + (1.0 - share) * under)
        for over, under in zip(colour[:3], ground, strict=True)
    )
    return red, green, blue


def _smooth(values: np.ndarray) -> np.ndarray:
    """Return means over three by three nodes: the field's finest grain is noise to the eye."""
    padded = np.pad(values, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9.0)


def _pairs(points: np.ndarray) -> list[tuple[float, float]]:
    return [(x, y) for x, y in points.tolist()]
