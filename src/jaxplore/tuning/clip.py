"""A run before and a run after a search, beside each other."""

import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from jaxplore.report.gif import save_gif
from jaxplore.runs import PathRun, Run, follow_path, simulate
from jaxplore.simulation.path_scenario import PathScenario
from jaxplore.tuning.runs import SettingsEpisodes
from jaxplore.tuning.space import Candidate

FRAMES, COLOURS = 120, 128
_GAP = 12
"""Between the two [pixels]."""


def before_and_after(
    episodes: SettingsEpisodes, scenario: str, before: Candidate, after: Candidate, seed: int
) -> bytes | None:
    """Run a scenario with two candidates and one seed, and return a GIF of both.

    Args:
        episodes: what the candidates are values of.
        scenario: its name.
        before: shown on the left.
        after: on the right.
        seed: of everything random.

    Returns:
        None if the user stopped it.
    """
    clips: list[Path] = []
    durations: list[float] = []
    with tempfile.TemporaryDirectory(prefix="jaxplore-") as temporary:
        for label, candidate in (("before", before), ("after", after)):
            built = episodes.kind.build(episodes.entries(scenario, candidate, seed))
            run: Run | PathRun
            if isinstance(built.scenario, PathScenario):
                run = follow_path(built.controller, built.scenario, built.num_steps, key=built.key)
            else:
                run = simulate(built.controller, built.scenario, built.num_steps, key=built.key)
            if run.metrics.is_interrupted:
                return None
            run.save(Path(temporary) / label, progress=True)
            clips += sorted((Path(temporary) / label).glob("*.gif"))
            durations.append(run.metrics.duration)
        return side_by_side(clips, durations)


def side_by_side(clips: list[Path], durations: list[float]) -> bytes:
    """Return an animation of runs beside each other, at the same simulated time.

    Args:
        clips: an animation of each run, its frames evenly spread over it.
        durations: of the runs [s].
    """
    read = [_frames(path) for path in clips]
    height = max(frames[0].height for frames in read)
    scaled = [
        [each.resize((round(each.width * height / each.height), height)) for each in frames]
        for frames in read
    ]
    width = sum(frames[0].width + _GAP for frames in scaled) - _GAP
    lengths = [max(duration, 1e-9) for duration in durations]
    pictures = []
    for time in np.linspace(0.0, max(lengths), FRAMES):
        picture = Image.new("RGB", (width, height), "white")
        left = 0
        for frames, length in zip(scaled, lengths, strict=True):
            share = min(time / length, 1.0)
            picture.paste(frames[round(share * (len(frames) - 1))], (left, 0))
            left += frames[0].width + _GAP
        pictures.append(picture)
    palette = pictures[-1].quantize(colors=COLOURS)
    file = io.BytesIO()
    save_gif(file, [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures])
    return file.getvalue()


def _frames(path: Path) -> list[Image.Image]:
    with Image.open(path) as clip:
        frames = []
        for index in range(getattr(clip, "n_frames", 1)):
            clip.seek(index)
            frames.append(clip.convert("RGB"))
    return frames
