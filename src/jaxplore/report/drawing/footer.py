"""The strip below an animated map: numbers, the legend and the coverage curve."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxplore.report.drawing.colours import CLOSED, CLOSED_SHARE, FREE, MOVER, TARGET, blend
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
from jaxplore.report.exploration.canvas import FOOTER, SUPERSAMPLING, Canvas, pairs
from jaxplore.simulation.recording import Frame

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

LEGEND, COLUMN, CURVE, LEAST_CURVE = 190, 108, 190, 120
"""Where the legend begins, the width of its columns, that of the curve beside it, and the least one
that leaves room for the legend [pixels]."""


def draw_footer(canvas: Canvas, frame: Frame, image: Image.Image) -> None:
    """Draw time, coverage, distance, targets, the legend and the coverage curve.

    Args:
        canvas: of the animation.
        frame: what is shown.
        image: of the whole frame; its lowest rows are drawn into.
    """
    time, coverage, _, path = canvas.progress
    top, step = canvas.map_size[1], min(frame.step, len(time) - 1)
    draw, large, small = ImageDraw.Draw(image), *fonts()
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
        count = int(seen[min(frame.step, len(seen)) - 1]) if frame.step else 0
        draw.text((16, top + 59), f"targets {count} of {len(targets)}", INK, small)
    end = draw_legend(image, _legend(canvas))
    draw_curve(image, time, coverage, step, left=end, level=canvas.recording.target_coverage)


def fonts() -> tuple[Font, Font]:
    """Return the large and the small font."""
    return ImageFont.load_default(size=21), ImageFont.load_default(size=13)


def draw_legend(image: Image.Image, entries: Sequence[tuple[str, Colour]]) -> int:
    """Draw names and their colours into the middle of a strip that is wide enough; return where it
    ends [pixels].

    Args:
        image: of the whole frame.
        entries: nine at most.
    """
    # Two lines of three; more entries move together.
    lines, above, apart = (2, 20, 30) if len(entries) <= 6 else (3, 11, 23)
    end = LEGEND + COLUMN * -(-len(entries) // lines)
    if image.width - end < LEAST_CURVE:
        return LEGEND - 22
    draw, (_, small) = ImageDraw.Draw(image), fonts()
    top = image.height - FOOTER
    for index, (name, colour) in enumerate(entries):
        x, y = LEGEND + COLUMN * (index // lines), top + above + apart * (index % lines)
        draw.rounded_rectangle((x, y + 2, x + 16, y + 11), 3, colour)
        draw.text((x + 22, y - 1), name, INK, small)
    return end


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


def draw_curve(
    image: Image.Image,
    time: np.ndarray,
    shares: np.ndarray,
    step: int,
    *,
    left: int,
    level: float | None = None,
) -> None:
    """Draw a curve until now into the lower right corner.

    Args:
        image: of the whole frame.
        time: (N,) of the whole run [s].
        shares: (N,) of the curve's height, 0 to 1.
        step: index of now.
        left: where the strip is free from [pixels].
        level: a share that a line marks.
    """
    width = min(CURVE, image.width - 12 - left)
    height = FOOTER - 24
    factor = 2 * SUPERSAMPLING
    box = Image.new("RGB", (width * factor, height * factor), PAPER)
    draw = ImageDraw.Draw(box)
    duration = float(time[-1]) or 1.0

    def spots(seconds: np.ndarray, share: np.ndarray) -> list[tuple[float, float]]:
        x = 4 + (width - 8) * seconds / duration
        y = height - 4 - (height - 8) * share
        return pairs(np.stack([x, y], axis=-1) * factor)

    ends = np.array([0.0, duration])
    draw.line(spots(ends, np.zeros(2)), PALE, factor)
    if level is not None:
        draw.line(spots(ends, np.full(2, level)), HIDDEN_WALL, factor)
    kept = np.unique(np.linspace(0, step, min(step + 1, 4 * width)).round().astype(int))
    curve = spots(time[kept], shares[kept])
    if len(curve) > 1:
        draw.line(curve, TRAIL, 2 * factor, "curve")
    x, y = curve[-1]
    draw.ellipse((x - 3 * factor, y - 3 * factor, x + 3 * factor, y + 3 * factor), TRAIL)
    image.paste(box.reduce(factor), (image.width - width - 12, image.height - FOOTER + 12))
