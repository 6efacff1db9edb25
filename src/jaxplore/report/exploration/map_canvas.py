"""The picture of a map with layers on it, and a footer of numbers, a curve and the legend."""

import dataclasses
from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.drawing.footer import EDGE, Entry, Footer
from jaxplore.report.drawing.picture import MIN_MAP_SIDE, SUPERSAMPLING
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.exploration.window import Window
from jaxplore.report.part import Headline

MAX_RATIO = 1.1
"""Greatest height of the map, as a multiple of the picture's width."""

type Curves = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Instants [s], coverage, and the distance that all robots had driven [m]."""


@dataclasses.dataclass(frozen=True)
class MapCanvas:
    """What is the same in every frame of a run on a map; a `Surface`.

    `size` is the columns and rows of the map in the picture [pixels]; `scale` is the supersampled
    pixels per metre, and `zoom` the scale of the picture. `walls` are the window's true walls.
    """

    data: MissionData
    window: Window
    size: tuple[int, int]
    scale: float
    zoom: float
    walls: np.ndarray
    curves: Curves

    @property
    def unit(self) -> float:
        """Pixels of the supersampled map per pixel of scale 1."""
        return SUPERSAMPLING * self.zoom

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) [m] into columns and rows of the supersampled map."""
        placed = self.window.place(points) * self.scale
        placed[..., 1] = self.size[1] * SUPERSAMPLING - placed[..., 1]
        return np.asarray(np.clip(placed, -1e5, 1e5))

    def draw(
        self,
        ground: np.ndarray,
        layers: Callable[[ImageDraw.ImageDraw], None],
        frame: MissionFrame,
        legend: tuple[Entry, ...],
    ) -> Image.Image:
        """Draw a frame: the ground (R, C, 3), the layers on it, and the footer below."""
        columns, rows = self.size
        # Row 0 of a grid is at the bottom, row 0 of a picture at the top.
        enlarged = Image.fromarray(ground[::-1]).resize(
            (columns * SUPERSAMPLING, rows * SUPERSAMPLING), Image.Resampling.NEAREST
        )
        layers(ImageDraw.Draw(enlarged, "RGBA"))
        footer = Footer(enlarged, self.zoom, legend)
        _draw_footer(self, frame, footer)
        return footer.image


def make_map_canvas(data: MissionData, curves: Curves, width: int, zoom: float) -> MapCanvas:
    """Make the canvas of a run. The width is in pixels of scale 1; tall or small maps have less."""
    window = Window.around_reachable(data)
    size = np.asarray(window.size)
    scale = min(width / size[0], MAX_RATIO * width / size[1])
    columns, rows = (round(max(MIN_MAP_SIDE, round(float(side) * scale)) * zoom) for side in size)
    return MapCanvas(
        data,
        window,
        (columns, rows),
        scale * zoom * SUPERSAMPLING,
        zoom,
        window.crop(data.world, 0.5) > OCCUPIED_THRESHOLD,
        curves,
    )


def _draw_footer(canvas: MapCanvas, frame: MissionFrame, footer: Footer) -> None:
    """Draw the main number and its curve, time, distance, words of parts, scale bar and legend.

    The main number is the coverage. On a map that was known in advance, it is the headline of a
    part, and without one the distance driven.
    """
    data, (time, coverage, path) = canvas.data, canvas.curves
    step = min(frame.step, len(time) - 1)
    if is_known_map(data):
        _draw_mission(data, footer, time, path, step)
    else:
        # Instant 0 has the coverage after the first scan, but the first frame is drawn before it.
        share = float(coverage[step]) if frame.step else data.initial_coverage
        footer.headline(f"{100.0 * share:.1f} %", "covered")
        footer.curve(time, coverage, step, level=data.target_coverage)
    footer.text(EDGE, 38, f"{frame.time:.1f} s")
    footer.text(84, 38, f"{path[step]:.1f} m")
    words = [each.footer(data, frame) for each in data.parts.values()]
    said = ", ".join(each for each in words if each)
    if said:
        footer.text(EDGE, 56, said)
    footer.scale_bar(canvas.scale / SUPERSAMPLING)
    footer.legend()


def _draw_mission(
    recording: MissionData,
    footer: Footer,
    time: np.ndarray,
    path: np.ndarray,
    step: int,
) -> None:
    """Draw what a run on a known map is judged by.

    `time` [s] and `path`, the distance driven until then [m], have one value for each instant.
    """
    found = [each.headline(recording, step) for each in recording.parts.values()]
    headline = next((each for each in found if each is not None), None)
    if headline is None:
        headline = Headline(f"{path[step]:.1f} m", "driven", path)
    footer.headline(headline.text, headline.label)
    most = float(np.max(headline.values)) if headline.most is None else headline.most
    footer.curve(time, headline.values / max(most, 1e-6), step)
