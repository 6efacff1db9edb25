"""Films of a run: animated GIFs whose frames share one palette, and MP4 videos."""

import base64
import dataclasses
import itertools
import subprocess
from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image, ImageDraw

from jaxplore import _checks
from jaxplore._optional import import_optional
from jaxplore.report.drawing.footer import fonts
from jaxplore.report.drawing.palette import INK, PAPER
from jaxplore.report.folder import whole_file

FPS, SCALE = 10.0, 1.0
"""Frames per second of playback, and size of the picture, by default."""
MIN_FPS, MAX_FPS, MAX_GIF_FPS, SCALES = 0.1, 120.0, 50.0, (0.5, 4.0)
"""Least rate, as a GIF cannot show a frame for minutes. Greatest rate of a video, and of a GIF, as
browsers slow faster ones down. Range of the scale."""
LAST_SECONDS = 3.0
"""Time for which a GIF shows its last frame before it starts again [s]."""
LOOKS = 6
"""Number of frames from which the shared palette is computed."""
CAPTION = 24
"""Height of the caption [pixels of a picture of scale 1]."""
QUALITY = 18
"""Constant rate factor of H.264; at 18 a loss is hardly visible."""
GIF, MP4 = ".gif", ".mp4"


class Timed(Protocol):
    """A frame of a run."""

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FilmOptions:
    """How a film is drawn and played.

    A film of F frames that are T simulated seconds apart plays `T * fps` times as fast as the run.
    The film says so in its caption.

    Args:
        fps: frames per second of playback, 0.1 to 120, in a GIF up to 50. A GIF shows each frame
            for whole hundredths of a second, so it plays at the nearest such rate.
        scale: factor on the size of the picture, from 0.5 to 4. Lines and texts are drawn at that
            size and stay sharp.
        max_frames: greatest number of frames, evenly chosen, the first and the last one among
            them. A run records at most 121.

    Raises:
        ValueError: a number that is not accepted.
    """

    fps: int | float = FPS
    scale: int | float = SCALE
    max_frames: int = 240

    def __post_init__(self) -> None:
        fps = _checks.number("fps", self.fps, at_least=MIN_FPS, at_most=MAX_FPS)
        scale = _checks.number("scale", self.scale, at_least=SCALES[0], at_most=SCALES[1])
        object.__setattr__(self, "fps", fps)
        object.__setattr__(self, "scale", scale)
        _checks.positive_int("max_frames", self.max_frames)

    def frame_seconds(self, suffix: str) -> float:
        """Return the time for which a frame is shown [s].

        Args:
            suffix: suffix of the file, ".gif" or ".mp4".
        """
        return round(100.0 / self.fps) / 100.0 if suffix == GIF else 1.0 / self.fps

    def speed(self, times: Sequence[float], suffix: str) -> float | None:
        """Return how many times as fast as the run a film plays; None of a single frame.

        Args:
            times: simulated times of the frames [s].
            suffix: suffix of the file.
        """
        if len(times) < 2:
            return None
        return (times[-1] - times[0]) / (len(times) - 1) / self.frame_seconds(suffix)


@dataclasses.dataclass(frozen=True)
class Film:
    """A film that was drawn. A notebook shows it.

    Args:
        data: content of its file.
        suffix: suffix of such a file, ".gif" or ".mp4".
    """

    data: bytes = dataclasses.field(repr=False)
    suffix: str

    def _repr_html_(self) -> str:
        code = base64.b64encode(self.data).decode()
        if self.suffix == GIF:
            return f'<img alt="film of the run" src="data:image/gif;base64,{code}">'
        return f'<video controls loop src="data:video/mp4;base64,{code}"></video>'


def check_film(path: str | PathLike[str], options: FilmOptions, *, name: str = "film") -> Path:
    """Check before a long run whether a film can be written; return its path.

    `name` is that of the path in messages.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in (GIF, MP4):
        raise ValueError(f"{name} is {str(file)!r}; accepted: a file that ends in {GIF} or {MP4}")
    if not file.parent.is_dir():
        raise ValueError(f"{name} is {str(file)!r}; accepted: a file in a folder that exists")
    if suffix == GIF:
        _checks.number("fps of a GIF", options.fps, above=0.0, at_most=MAX_GIF_FPS)
    else:
        _ffmpeg()
    return file


def _ffmpeg() -> str:
    module = import_optional("imageio_ffmpeg", "video")
    try:
        return str(module.get_ffmpeg_exe())
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"ffmpeg cannot be run: {reason}; accepted: pip install imageio-ffmpeg"
        ) from None


def write_film[F](
    path: str | PathLike[str],
    frames: Sequence[F],
    draw: Callable[[F], Image.Image],
    palette: Callable[[Sequence[Image.Image]], Image.Image],
    options: FilmOptions,
    on_progress: Callable[[float], None],
) -> None:
    """Write a film of frames, at least one, completely or not at all: .gif or .mp4 by the suffix.

    A GIF loops, pauses on the last frame, and has the `palette` of some of its pictures. All
    pictures have one size. `on_progress` is called with the share that is done, 0 to 1.
    """
    file = check_film(path, options)
    seconds = options.frame_seconds(file.suffix.lower())

    def draw_frames() -> Iterable[Image.Image]:
        for done, frame in enumerate(frames):
            yield draw(frame)
            on_progress((done + 1) / len(frames))

    with whole_file(file, "film") as temporary:
        if file.suffix.lower() == GIF:
            # One palette must exist before the first frame is quantised, so a few are drawn twice.
            shared = palette([draw(frame) for frame in evenly_chosen(frames, LOOKS)])
            _save_gif(temporary, draw_frames(), shared, seconds)
        else:
            _save_mp4(temporary, draw_frames(), seconds)


def _save_gif(
    file: Path, pictures: Iterable[Image.Image], palette: Image.Image, seconds: float
) -> None:
    first, *others = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures)
    first.save(
        file,
        format="GIF",
        save_all=True,
        append_images=others,
        duration=[round(1000.0 * each) for each in [seconds] * len(others) + [LAST_SECONDS]],
        loop=0,
        disposal=1,
        optimize=True,
    )


def _save_mp4(file: Path, pictures: Iterable[Image.Image], seconds: float) -> None:
    evened = map(_even, pictures)
    first = next(evened)
    # Without the bit-exact flags the file holds the version of ffmpeg. The index comes first, so
    # that a browser plays the video while it loads.
    command = [
        *(_ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
        *("-s", f"{first.width}x{first.height}", "-r", repr(1.0 / seconds), "-i", "-"),
        *("-c:v", "libx264", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"),
        *("-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart"),
        *("-f", "mp4", str(file)),
    ]
    # In a session of its own ffmpeg does not get Ctrl-C, which ends it here. `imageio_ffmpeg` would
    # fork for that, which is not safe beside JAX's threads.
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            for picture in itertools.chain([first], evened):
                process.stdin.write(picture.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg tells the reason below
        except BaseException:
            process.kill()
            raise
        reason = " ".join(process.stderr.read().decode(errors="replace").split())
    if process.returncode:
        raise OSError(f"ffmpeg: {reason}")


def _even(picture: Image.Image) -> Image.Image:
    """Add a row or a column where needed: H.264 stores colours for two by two pixels."""
    size = (picture.width + picture.width % 2, picture.height + picture.height % 2)
    if size == picture.size:
        return picture
    larger = Image.new("RGB", size, PAPER)
    larger.paste(picture)
    return larger


def add_caption(image: Image.Image, scale: float, left: str, right: str) -> Image.Image:
    """Return a picture below a caption, such as its name and the speed of the film.

    The left text is in bold letters. Either text may be empty.
    """
    height = round(CAPTION * scale)
    whole = Image.new("RGB", (image.width, image.height + height), PAPER)
    whole.paste(image, (0, height))
    draw, (_, small) = ImageDraw.Draw(whole), fonts(scale)
    edge, middle = 12 * scale, 0.5 * height
    draw.text((edge, middle), left, INK, small, anchor="lm", stroke_width=0.25 * scale)
    draw.text((image.width - edge, middle), right, INK, small, anchor="rm")
    return whole


def describe_speed(speed: float | None) -> str:
    """Describe the speed of a film in words, such as "8 x real time"."""
    if speed is None or speed <= 0.0:
        return ""
    return f"{speed:.0f} x real time" if speed >= 9.95 else f"{speed:.2g} x real time"


def evenly_chosen[F](frames: Sequence[F], most: int) -> list[F]:
    """Choose at most `most` evenly spaced frames, the first and the last included.

    A single frame is the last one.
    """
    count = min(most, len(frames))
    # Counted from the end, so that a single frame is the last one.
    back = np.round(np.linspace(0, len(frames) - 1, count)).astype(int)[::-1]
    return [frames[len(frames) - 1 - index] for index in back]
