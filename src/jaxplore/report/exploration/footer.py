"""The footer of an exploration animation: numbers, a curve and the legend."""

import numpy as np
from PIL import Image

from jaxplore.report.coverage_levels import at_instants
from jaxplore.report.drawing.footer import EDGE, Footer
from jaxplore.report.drawing.picture import SUPERSAMPLING
from jaxplore.report.exploration.canvas import Canvas
from jaxplore.report.exploration.data import ExplorationFrame
from jaxplore.report.exploration.mission import MissionData, MissionFrame
from jaxplore.report.exploration.progress import is_known_map


def draw_footer(canvas: Canvas, frame: ExplorationFrame, image: Image.Image) -> None:
    """Draw the main number and its curve, time, distance, targets, scale bar and legend.

    They are drawn into the lowest rows of `image`, the picture of the whole frame.
    """
    time, _, _, path = canvas.progress
    step = min(frame.step, len(time) - 1)
    footer = Footer(image, canvas.zoom, canvas.legend)
    _draw_judged(canvas, frame, footer, step)
    footer.text(EDGE, 38, f"{frame.time:.1f} s")
    footer.text(84, 38, f"{path[step]:.1f} m")
    targets = len(canvas.recording.targets)
    if targets:
        footer.text(EDGE, 56, f"targets {int(np.sum(frame.is_found))} of {targets}")
    draw_part_words(canvas.recording, frame, footer)
    footer.scale_bar(canvas.scale / SUPERSAMPLING)
    footer.legend()


def _draw_judged(canvas: Canvas, frame: ExplorationFrame, footer: Footer, step: int) -> None:
    """Draw the quantity by which the task is judged: its value now and its curve.

    It is the coverage. If the map was known in advance, it is the number of targets found, without
    targets the headline of a part, and without one the distance driven.
    """
    recording = canvas.recording
    time, coverage, _, path = canvas.progress
    if is_known_map(recording):
        draw_mission(recording, frame, footer, time, path, step)
        return
    # Instant 0 has the coverage after the first scan, but the first frame is drawn before it.
    share = float(coverage[step]) if frame.step else recording.initial_coverage
    footer.headline(f"{100.0 * share:.1f} %", "covered")
    footer.curve(time, coverage, step, level=recording.target_coverage)


def draw_mission(
    recording: MissionData,
    frame: MissionFrame,
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
    if len(recording.targets):
        values = at_instants(recording.records.targets_seen, 0.0)
        footer.headline(f"{int(np.sum(frame.is_found))}", "targets found")
        most = float(len(recording.targets))
    elif headline is not None:
        footer.headline(headline.text, headline.label)
        values, most = headline.values, float(np.max(headline.values))
    else:
        values, most = path, float(path[-1])
        footer.headline(f"{values[step]:.1f} m", "driven")
    footer.curve(time, values / max(most, 1e-6), step)


def draw_part_words(recording: MissionData, frame: MissionFrame, footer: Footer) -> None:
    """Draw what parts say of a frame, beside the number of targets."""
    words = [each.footer(recording, frame) for each in recording.parts.values()]
    said = ", ".join(each for each in words if each)
    if said:
        footer.text(EDGE + (110 if len(recording.targets) else 0), 56, said)
