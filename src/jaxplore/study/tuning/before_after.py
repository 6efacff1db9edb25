"""Animation of runs before and after a search, side by side."""

import io
from bisect import bisect_right
from collections.abc import Callable, Sequence

from PIL import Image

from jaxplore.report.drawing.gif import evenly_chosen, save_gif
from jaxplore.report.recording import Recording
from jaxplore.simulation.run import NUM_TRAJECTORIES
from jaxplore.study.experiments import record_alone
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.space import Candidate

FRAMES, COLOURS = 120, 128
_GAP = 12
"""Gap between the pictures [pixels]."""


def before_and_after(
    episodes: SettingsEpisodes,
    scenario: str,
    candidates: Sequence[Candidate],
    seed: int,
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes | None:
    """Run a scenario with several candidates and one seed, and return a GIF of all runs.

    Args:
        episodes: episodes whose parameters are searched.
        scenario: name of the scenario.
        candidates: candidates to draw, from left to right.
        seed: seed of the runs.
        on_progress: called with the share that is done, 0 to 1.

    Returns:
        The GIF; None if the user stopped it.
    """
    recordings = []
    for candidate in candidates:
        experiment = episodes.experiment(scenario, candidate, seed)
        try:
            recordings.append(record_alone(experiment, num_trajectories=NUM_TRAJECTORIES))
        except KeyboardInterrupt:
            return None
    return side_by_side(recordings, on_progress)


def side_by_side(
    recordings: Sequence[Recording],
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes:
    """Return a GIF of several runs side by side, at the same simulated time.

    A finished run keeps its last frame while the others continue.

    Args:
        recordings: recordings of the runs, from left to right.
        on_progress: called with the share that is done, 0 to 1.
    """
    instants = [[frame.time for frame in each.frames] for each in recordings]
    shown = evenly_chosen(sorted(set().union(*instants)), FRAMES)
    pictures = []
    for done, time in enumerate(shown):
        frames = [
            each.frame_image(each.frames[bisect_right(times, time) - 1])
            for each, times in zip(recordings, instants, strict=True)
        ]
        pictures.append(_beside(frames))
        on_progress((done + 1) / len(shown))
    palette = pictures[-1].quantize(colors=COLOURS)
    file = io.BytesIO()
    save_gif(file, [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures])
    return file.getvalue()


def _beside(pictures: Sequence[Image.Image]) -> Image.Image:
    height = max(each.height for each in pictures)
    scaled = [each.resize((round(each.width * height / each.height), height)) for each in pictures]
    width = sum(each.width + _GAP for each in scaled) - _GAP
    picture, left = Image.new("RGB", (width, height), "white"), 0
    for each in scaled:
        picture.paste(each, (left, 0))
        left += each.width + _GAP
    return picture
