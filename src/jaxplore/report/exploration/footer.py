"""The footer of an exploration animation: numbers, the legend and the coverage curve."""

from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import CLOSED, CLOSED_SHARE, FREE, MOVER, TARGET, blend
from jaxplore.report.drawing.footer import draw_curve, draw_legend, fonts
from jaxplore.report.drawing.palette import (
    HEAT,
    HIDDEN_WALL,
    INK,
    LIDAR_RAY,
    MAX_HEAT,
    PALE,
    PAPER,
    PLAN,
    REFERENCE,
    STRONG,
    TRAIL,
    Colour,
)
from jaxplore.report.exploration.canvas import Canvas
from jaxplore.report.exploration.data import ExplorationFrame


def draw_footer(canvas: Canvas, frame: ExplorationFrame, image: Image.Image) -> None:
    """Draw time, coverage, distance, targets, the legend and the coverage curve.

    Args:
        canvas: canvas of the animation.
        frame: frame to draw.
        image: picture of the whole frame, whose lowest rows are drawn into.
    """
    time, coverage, _, path = canvas.progress
    top, step = canvas.map_size[1], min(frame.step, len(time) - 1)
    draw, large, small = ImageDraw.Draw(image), *fonts()
    # Instant 0 has the coverage after the first scan, but the first frame is drawn before it.
    percent = (
        100.0 * float(coverage[step]) if frame.step else 100.0 * canvas.recording.initial_coverage
    )
    targets = canvas.recording.targets
    # The third line needs room above it.
    first, second = (8, 38) if len(targets) else (14, 50)
    draw.text((16, top + first), f"{percent:.1f} %", INK, large)
    draw.text((100, top + first + 6), "covered", PALE, small)
    draw.text((16, top + second), f"{frame.time:.1f} s", INK, small)
    draw.text((100, top + second), f"{path[step]:.1f} m", INK, small)
    if len(targets):
        seen = canvas.recording.records.targets_seen
        # A frame is drawn before the step of its number: its last record is one step earlier.
        count = int(seen[min(frame.step, len(seen)) - 1]) if frame.step else 0
        draw.text((16, top + 59), f"targets {count} of {len(targets)}", INK, small)
    end = draw_legend(image, _legend(canvas))
    draw_curve(image, time, coverage, step, left=end, level=canvas.recording.target_coverage)


def _legend(canvas: Canvas) -> list[tuple[str, Colour]]:
    recording = canvas.recording
    entries: list[tuple[str, Colour]] = [
        ("plan", PLAN),
        ("rollouts", STRONG),
        ("trail", TRAIL),
        ("information", blend(HEAT, PAPER, MAX_HEAT)),
        ("lidar", LIDAR_RAY[:3]),
        ("unseen wall", HIDDEN_WALL),
    ]
    if recording.goal is not None:
        entries[4] = ("reference, goal", REFERENCE)
    if len(recording.targets):
        entries.append(("target", TARGET))
    if len(recording.mover_radii):
        entries.append(("mover", MOVER))
    if canvas.closed.any():
        entries.append(("untraversable", blend(CLOSED, FREE, CLOSED_SHARE)))
    return entries
