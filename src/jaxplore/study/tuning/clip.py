"""A run before and a run after a search, beside each other."""

import io
from bisect import bisect_right
from collections.abc import Callable, Sequence

from PIL import Image

from jaxplore.report.drawing.gif import evenly_chosen, save_gif
from jaxplore.report.recording import Recording
from jaxplore.simulation.run import record_run
from jaxplore.study.tuning.runs import SettingsEpisodes
from jaxplore.study.tuning.space import Candidate

FRAMES, COLOURS = 120, 128
_GAP = 12
"""Between the two [pixels]."""


def before_and_after(
    episodes: SettingsEpisodes,
    scenario: str,
    candidates: Sequence[Candidate],
    seed: int,
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes | None:
    """Run a scenario with each of some candidates and one seed, and return a GIF of all.

    Args:
        episodes: what the candidates are values of.
        scenario: its name.
        candidates: from left to right.
        seed: of everything random.
        on_progress: called with the share that is done, 0 to 1.

    Returns:
        None if the user stopped it.
    """
    recordings: list[Recording] = []
    for candidate in candidates:
        built = episodes.kind.build(episodes.entries(scenario, candidate, seed))
        recording = record_run(built.controller, built.scenario, built.num_steps, key=built.key)
        if recording.is_interrupted:
            return None
        recordings.append(recording)
    return side_by_side(recordings, on_progress)


def side_by_side(
    recordings: Sequence[Recording],
    on_progress: Callable[[float], None] = lambda _: None,
) -> bytes:
    """Return an animation of runs beside each other, at the same simulated time.

    A run that is over rests while the others go on.

    Args:
        recordings: of the runs, from left to right.
        on_progress: called with the share that is done, 0 to 1.
    """
    instants = [[frame.time for frame in each.frames] for each in recordings]
    shown = evenly_chosen(sorted(set().union(*instants)), FRAMES)
    pictures = []
    for done, time in enumerate(shown):
        looks = [
            _look(each, bisect_right(times, time) - 1)
            for each, times in zip(recordings, instants, strict=True)
        ]
        pictures.append(_beside(looks))
        on_progress((done + 1) / len(shown))
    palette = pictures[-1].quantize(colors=COLOURS)
    file = io.BytesIO()
    save_gif(file, [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures])
    return file.getvalue()


def _look(recording: Recording, index: int) -> Image.Image:
    return recording.frame_image(recording.frames[index])


def _beside(looks: Sequence[Image.Image]) -> Image.Image:
    height = max(each.height for each in looks)
    scaled = [each.resize((round(each.width * height / each.height), height)) for each in looks]
    width = sum(each.width + _GAP for each in scaled) - _GAP
    picture, left = Image.new("RGB", (width, height), "white"), 0
    for each in scaled:
        picture.paste(each, (left, 0))
        left += each.width + _GAP
    return picture
