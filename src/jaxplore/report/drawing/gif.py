"""Animated GIFs whose frames share one palette."""

import io
from collections.abc import Callable, Sequence
from os import PathLike

import numpy as np
from PIL import Image

FRAME_MILLISECONDS, LAST_MILLISECONDS = 90, 3000
LOOKS = 6
"""Number of frames from which the shared palette is computed."""


def write_gif[F](
    path: str | PathLike[str],
    frames: Sequence[F],
    draw: Callable[[F], Image.Image],
    colours: Callable[[Sequence[Image.Image]], Image.Image],
    max_frames: int,
    on_progress: Callable[[float], None],
) -> None:
    """Write an animated GIF of frames. It loops, and pauses on the last frame.

    Args:
        path: path of the file.
        frames: frames to draw, at least one.
        draw: function that draws a frame; all pictures have the same size.
        colours: function that computes a palette from some of the pictures.
        max_frames: greatest number of frames, evenly chosen, the first and the last one among them.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: less than one frame.
    """
    if max_frames < 1:
        raise ValueError(f"max_frames is {max_frames!r}; accepted: a whole number >= 1")
    # One palette must exist before the first frame is quantised, so a few frames are drawn twice.
    chosen = evenly_chosen(frames, max_frames)
    palette = colours([draw(frame) for frame in evenly_chosen(chosen, LOOKS)])
    pictures = []
    for done, frame in enumerate(chosen):
        pictures.append(draw(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        on_progress((done + 1) / len(chosen))
    save_gif(path, pictures)


def save_gif(file: str | PathLike[str] | io.BytesIO, pictures: Sequence[Image.Image]) -> None:
    """Write pictures of one palette as an animated GIF. It loops, and pauses on the last picture.

    Args:
        file: path of the file, or a binary stream.
        pictures: pictures of one palette, at least one.
    """
    first, *others = pictures
    first.save(
        file,
        format="GIF",
        save_all=True,
        append_images=others,
        duration=[FRAME_MILLISECONDS] * len(others) + [LAST_MILLISECONDS],
        loop=0,
        disposal=1,
        optimize=True,
    )


def evenly_chosen[F](frames: Sequence[F], most: int) -> list[F]:
    """Choose at most `most` evenly spaced frames, the first and the last included.

    A single frame is the last one.
    """
    count = min(most, len(frames))
    # Counted from the end, so that a single frame is the last one.
    back = np.round(np.linspace(0, len(frames) - 1, count)).astype(int)[::-1]
    return [frames[len(frames) - 1 - index] for index in back]
