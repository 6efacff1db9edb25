"""Animation of runs before and after a search, side by side."""

import tempfile
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from PIL import Image

from jaxplore.report.drawing.film import (
    GIF,
    FilmOptions,
    add_caption,
    describe_speed,
    evenly_chosen,
    write_film,
)
from jaxplore.report.recording import Recording
from jaxplore.simulation.run import NUM_TRAJECTORIES
from jaxplore.study.experiments import record_alone
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.space import Candidate

FRAMES = 120
_GAP = 12
"""Gap between the pictures [pixels of scale 1]."""


def before_and_after(
    episodes: SettingsEpisodes,
    scenario: str,
    candidates: Mapping[str, Candidate],
    seed: int,
    options: FilmOptions,
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes | None:
    """Run a scenario with several candidates and one seed, and return a GIF of all runs.

    It is None if the user stopped it. Candidates are by title, from left to right. `on_progress` is
    called with the share that is done, 0 to 1.
    """
    recordings = {}
    for title, candidate in candidates.items():
        experiment = episodes.experiment(scenario, candidate, seed)
        try:
            recordings[title] = record_alone(experiment, num_trajectories=NUM_TRAJECTORIES)
        except KeyboardInterrupt:
            return None
    return side_by_side(recordings, options, on_progress)


def side_by_side(
    recordings: Mapping[str, Recording],
    options: FilmOptions,
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes:
    """Return a GIF of several runs side by side, at the same simulated time, by title from left to
    right. A finished run keeps its last frame. The last caption has the speed of the film."""
    runs = list(recordings.values())
    instants = [[frame.time for frame in each.frames] for each in runs]
    shown = evenly_chosen(sorted(set().union(*instants)), min(FRAMES, options.max_frames))
    speed = describe_speed(options.speed(shown, GIF))
    painters = [each.painter(options.scale) for each in runs]
    told = [*[""] * (len(runs) - 1), speed]

    def draw(time: float) -> Image.Image:
        frames = [
            each.frames[bisect_right(times, time) - 1]
            for each, times in zip(runs, instants, strict=True)
        ]
        pictures = [
            add_caption(paint(frame), options.scale, title, right)
            for paint, frame, title, right in zip(painters, frames, recordings, told, strict=True)
        ]
        return _join_pictures(pictures, round(_GAP * options.scale))

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"film{GIF}"
        # Fitted by frequency alone, a palette would lose the colours of thin lines.
        write_film(file, shown, draw, runs[-1].palette, options, on_progress)
        return file.read_bytes()


def _join_pictures(pictures: Sequence[Image.Image], gap: int) -> Image.Image:
    """Return pictures side by side, aligned at the top."""
    width = sum(each.width + gap for each in pictures) - gap
    picture, left = Image.new("RGB", (width, max(each.height for each in pictures)), "white"), 0
    for each in pictures:
        picture.paste(each, (left, 0))
        left += each.width + gap
    return picture
