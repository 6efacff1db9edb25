"""The recording of an exploration of a volume, and its pictures."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing import colours
from jaxplore.report.drawing.film import FilmOptions, write_film
from jaxplore.report.drawing.footer import fonts
from jaxplore.report.drawing.palette import INK, PAPER, fit_palette
from jaxplore.report.drawing.series import find_runs
from jaxplore.report.exploration.localisation import ESTIMATE
from jaxplore.report.recording import Course, Recording
from jaxplore.report.volume.data import (
    FREE,
    OCCUPIED,
    VolumeData,
    VolumeFrame,
    VolumeMetrics,
    compute_volume_metrics,
)
from jaxplore.report.volume.space import (
    MOST_POINTS,
    SpacePicture,
    box_edges,
    height_colours,
    surface,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 640
"""Width of a frame [pixels]."""
GAP = 8
"""Height of the gap between the two slices [pixels]."""
WORDS = 22
"""Height of the words of parts below them [pixels]."""
BESIDE = 0.7
"""Distance from a slice through the robot beyond which its trail is pale [m]."""
TRAIL, PALE, PLAN = "#1f77b4", "#b9d3e6", "#d62728"
"""Colours of the trail, of its parts that are not near the slice, and of the plan."""
GOAL = "#e9a23b"
"""Colour of the goal."""
BOX = "#c0392b"
"""Colour of the edges of keep-out boxes."""


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class VolumeRecording(VolumeData, Recording):
    """A finished exploration of a volume. Its folder has `volume.png`, `slices.png`,
    `coverage.png`, `turntable.gif` and `exploration.gif`."""

    animation = "exploration.gif"

    def metrics(self, *, seed: int | None = None) -> VolumeMetrics:
        """Compute the metrics of the run."""
        return compute_volume_metrics(self, seed=seed)

    def course(self) -> Course:
        """Return what a comparison on several maps shows of the run, as seen from above.

        A column of voxels is known when the robot knows something solid in it: floor, wall or
        ceiling.
        """
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        path = np.concatenate([[0.0], np.cumsum(steps)])

        def find_columns(frame: VolumeFrame) -> np.ndarray:
            return frame.find_occupied(self.world.shape).any(axis=0)

        return Course(self.coverage, path, self.positions[None, :, :2], known=find_columns)

    def frame_image(self, frame: VolumeFrame, *, scale: float = 1.0) -> Image.Image:
        """Draw a level slice at the height of the robot, and below it a vertical one through it.

        The trail is pale where it is not near the slice: there it may pass behind a wall.
        """
        pixels = scale * WIDTH / self.world.shape[2]
        level = _slice_image(frame.level, pixels)
        upright = _slice_image(frame.upright, pixels)
        gap = round(scale * GAP)
        size = level.width, level.height + gap + upright.height
        words = [each.footer(self, frame) for each in self.parts.values()]
        said, below = ", ".join(filter(None, words)), round(scale * WORDS)
        picture = Image.new("RGB", (size[0], size[1] + (below if said else 0)), "white")
        picture.paste(level, (0, 0))
        picture.paste(upright, (0, level.height + gap))
        draw = ImageDraw.Draw(picture)
        points = (self.positions[: frame.step + 1] - self.origin) / self.resolution * pixels
        trail = [(x, level.height - y) for x, y, _ in points.tolist()]
        side = [(x, size[1] - z) for x, _, z in points.tolist()]
        plan = (frame.plan[:, :2] - self.origin[:2]) / self.resolution * pixels
        radius = self.robot_radius / self.resolution * pixels
        width = max(1, round(2 * scale))
        is_near = np.abs(points - points[-1]) <= BESIDE / self.resolution * pixels
        for line, axis in ((trail, 2), (side, 1)):
            draw.line(line, fill=PALE, width=width)
            for part in find_runs(is_near[:, axis]):
                draw.line(line[part], fill=TRAIL, width=width)
        if len(plan) > 1:
            ahead = [(x, level.height - y) for x, y in plan.tolist()]
            draw.line(ahead, fill=PLAN, width=width)
        for mover in frame.movers:
            x, y = ((mover[:2] - self.origin[:2]) / self.resolution * pixels).tolist()
            across = float(mover[2]) / self.resolution * pixels
            edges = (x - across, level.height - y - across, x + across, level.height - y + across)
            draw.ellipse(edges, colours.MOVER, colours.MOVER_EDGE, width)
        for box in self.boxes:
            (x, y, z), (right, up, top) = (
                ((box[part] - self.origin) / self.resolution * pixels).tolist()
                for part in (slice(3), slice(3, 6))
            )
            here = points[-1]
            if z <= here[2] <= top:
                draw.rectangle((x, level.height - up, right, level.height - y), None, BOX, width)
            if y <= here[1] <= up:
                draw.rectangle((x, size[1] - top, right, size[1] - z), None, BOX, width)
        if self.goal is not None:
            x, y, z = ((self.goal - self.origin) / self.resolution * pixels).tolist()
            for here in ((x, level.height - y), (x, size[1] - z)):
                draw.regular_polygon((*here, 1.5 * radius), 4, 45, GOAL, GOAL)
        for x, y in (trail[-1], side[-1]):
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=PLAN, width=2)
        for mark, colour in self.marks(frame):
            x, y, z = ((mark - self.origin) / self.resolution * pixels).tolist()
            for across, up in ((x, level.height - y), (x, size[1] - z)):
                box = (across - radius, up - radius, across + radius, up + radius)
                draw.ellipse(box, colour, PAPER, width)
        if said:
            draw.text((0.25 * below, size[1] + 0.1 * below), said, INK, fonts(scale)[1])
        return picture

    def figures(self) -> dict[str, Callable[[], "Figure"]]:
        """Return functions that draw the figures, by file name without suffix."""
        return {
            "volume": partial(volume_figure, self),
            "slices": partial(slices_figure, self),
            "coverage": partial(coverage_figure, self),
            **self.part_figures(),
        }

    def files(self) -> dict[str, Callable[[Path], None]]:
        """Return the function that writes a film around what the robot found."""
        return {"turntable.gif": partial(write_turntable, self)}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the content of `arrays.npz`: plain arrays, no pickles.

        Each field of `VolumeRecord` and of the parts' records stands there under its name, one row
        per step; `time` (N + 1,) [s] and `positions` (N + 1, 3) [m] with z up belong to instants.
        """
        steps = {name: rows for name, rows in self.records._asdict().items() if rows is not None}
        return {
            **self.part_arrays(steps.pop("parts", {})),
            **{name: np.asarray(rows) for name, rows in steps.items()},
            "time": self.time,
            "control_period": np.asarray(self.control_period),
            "positions": self.positions,
            "world": self.world,
            "belief": self.belief,
            "observable": self.observable,
            "origin": self.origin,
            "resolution": np.asarray(self.resolution),
            "start": self.start,
            "state_names": np.asarray(self.state_names, np.str_),
            **({} if self.goal is None else {"goal": self.goal}),
            **({"boxes": self.boxes} if len(self.boxes) else {}),
        }


def _slice_image(states: np.ndarray, pixels: float) -> Image.Image:
    """Draw a slice whose first row is the lowest."""
    pixels_of = np.array([colours.UNKNOWN, colours.FREE, colours.OCCUPIED], np.uint8)
    image = Image.fromarray(pixels_of[states[::-1]])
    rows, columns = states.shape
    return image.resize((round(columns * pixels), round(rows * pixels)), Image.Resampling.NEAREST)


def volume_figure(data: VolumeData) -> "Figure":
    """Draw what the robot found in space, and its path.

    Of the occupied voxels those are drawn whose upper or side neighbour is known to be free; the
    ceiling is left out.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5))
    axes = figure.add_subplot(projection="3d")
    x, y, z = surface_points(data).T
    axes.scatter(x, y, z, c=z, cmap="viridis", s=4.0, alpha=0.6, linewidths=0.0)
    path = data.positions
    axes.plot(*path.T, color=PLAN, linewidth=1.5)
    axes.scatter(*path[0], color=PLAN, marker="o", s=20)
    for box in data.boxes:
        for edge in box_edges(box):
            axes.plot(*edge.T, color=BOX, linewidth=1.2)
    if data.goal is not None:
        axes.scatter(*data.goal, color=GOAL, marker="*", s=120, label="goal", depthshade=False)
    for part in data.parts.values():
        part.add_to_space(axes, data.frames[-1])
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper left", frameon=False)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    size = np.array(data.world.shape[::-1]) * data.resolution
    axes.set_zticks(data.origin[2] + np.array([0.0, 0.5, 1.0]) * size[2])
    axes.set_box_aspect(size, zoom=1.25)
    axes.view_init(elev=50.0, azim=-65.0)
    return figure


def surface_points(data: VolumeData, most: int = MOST_POINTS) -> np.ndarray:
    """Return the middles (N, 3) of at most so many voxels of the surface that was found [m]."""
    voxels = surface(data.belief == OCCUPIED, data.belief == FREE, most)
    return np.asarray(data.origin + (voxels[:, ::-1] + 0.5) * data.resolution)


MOST_TURNED = 200_000
"""Greatest number of voxels of a turn: where some are missing, walls have stripes."""
TURNS = 48
"""Pictures of a turn."""


def write_turntable(data: VolumeData, path: Path) -> None:
    """Write a film around what the robot found, and its path."""
    points, size = (
        surface_points(data, MOST_TURNED),
        np.array(data.world.shape[::-1]) * data.resolution,
    )
    low, high = data.origin, data.origin + size
    shades = height_colours(points[:, 2], low[2], high[2])
    picture = SpacePicture(low, high, WIDTH)

    def draw(azimuth: float) -> Image.Image:
        edges = [edge for box in data.boxes for edge in box_edges(box)]
        places = data.resolution, data.positions, azimuth
        marks = data.marks(data.frames[-1])
        return picture.draw(points, shades, *places, goal=data.goal, edges=edges, marks=marks)

    angles = [math.radians(60.0) + 2.0 * math.pi * turn / TURNS for turn in range(TURNS)]
    options = FilmOptions(fps=12.5)
    palette = partial(fit_palette, ())
    write_film(path, angles, draw, palette, options, lambda _: None)


def slices_figure(data: VolumeData) -> "Figure":
    """Draw level slices of the map at a quarter, a half and three quarters of its height.

    The path is pale where another slice is nearer to it: there it may pass above or below a wall.
    Of a robot that found its pose all slices show the estimated way and that of its odometry.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    depth, height, width = data.world.shape
    layers = sorted({depth // 4, depth // 2, 3 * depth // 4})
    each = 0.6 + 6.0 * height / width
    figure = Figure(figsize=(7.0, 0.4 + each * len(layers)))
    left, low = data.origin[:2]
    extent = (left, left + width * data.resolution, low, low + height * data.resolution)
    path, heights = data.positions, data.origin[2] + (np.array(layers) + 0.5) * data.resolution
    nearest = np.abs(path[:, 2:] - heights).argmin(axis=1)
    for number, (layer, z) in enumerate(zip(layers, heights, strict=True), start=1):
        axes = figure.add_subplot(len(layers), 1, number)
        image = np.asarray(_slice_image(data.belief[layer], 1.0))
        axes.imshow(image, extent=extent)
        axes.plot(path[:, 0], path[:, 1], color=TRAIL, linewidth=0.8, alpha=0.25)
        near = np.where((nearest == number - 1)[:, None], path[:, :2], np.nan)
        axes.plot(near[:, 0], near[:, 1], color=TRAIL, linewidth=1.2, label="true way")
        for poses, style, label in data.estimates:
            axes.plot(*poses[:, :2].T, style, color=ESTIMATE, linewidth=1.0, label=label)
        if data.estimates and number == 1:
            axes.legend(fontsize=7, loc="upper right")
        for box in data.boxes:
            if box[2] <= z <= box[5]:
                corner, size = box[:2], box[3:5] - box[:2]
                patch = Rectangle(corner, *size, fill=False, hatch="///", edgecolor=BOX, alpha=0.6)
                axes.add_patch(patch)
        if data.goal is not None and np.abs(heights - data.goal[2]).argmin() == number - 1:
            axes.plot(*data.goal[:2], marker="*", color=GOAL, markersize=10)
        for place, colour in data.marks(data.frames[-1]):
            if np.abs(heights - place[2]).argmin() == number - 1:
                axes.plot(*place[:2], marker="o", color=colours.shade(colour[:3]), markersize=9)
        axes.set_title(f"z = {z:.2f} m", fontsize=9)
        axes.set_ylabel("y [m]")
    axes.set_xlabel("x [m]")
    figure.tight_layout()
    return figure


def coverage_figure(data: VolumeData) -> "Figure":
    """Draw the share of the observable volume that is known, over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.5))
    axes = figure.add_subplot()
    axes.plot(data.time, 100.0 * data.coverage, color=TRAIL)
    axes.axhline(100.0 * data.target_coverage, color="0.6", linestyle="--", linewidth=1.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("volume known [%]")
    axes.set_ylim(0.0, 101.0)
    figure.tight_layout()
    return figure
