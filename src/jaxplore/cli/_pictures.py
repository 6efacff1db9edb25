"""What a command draws, from the options of figures and films."""

from pathlib import Path
from typing import Any, NamedTuple

from jaxplore.report.drawing.figure import figure_formats
from jaxplore.report.drawing.film import FPS, SCALE, FilmOptions, check_film


class Pictures(NamedTuple):
    """What a command draws: animations, figures of some formats, and a further film, `video`.

    `film` says how films are played, and their size. `video` is None without that film.
    """

    animation: bool
    film: FilmOptions
    figures: tuple[str, ...]
    video: Path | None


def take_pictures(options: dict[str, Any], *, overwrite: bool = False) -> Pictures:
    """Remove the options of figures and films from all options, and check them.

    A video that exists is refused unless `overwrite`.
    """
    animation, video = options.pop("animation"), options.pop("video", None)
    fps, scale = options.pop("fps"), options.pop("film_scale")
    for name, value in (("--fps", fps), ("--film-scale", scale)):
        if value is not None and not animation and video is None:
            raise ValueError(f"{name} is {value:g} beside --no-animation; accepted: with a film")
    film = FilmOptions(fps=FPS if fps is None else fps, scale=SCALE if scale is None else scale)
    if animation:
        check_film("animation.gif", film)
    if video is not None:
        check_film(video, film, name="--video")
        if video.exists() and not overwrite:
            raise ValueError(f"--video is {str(video)!r}, which exists; accepted: a new file, or "
                             "--overwrite")  # fmt: skip
    return Pictures(animation, film, figure_formats(options.pop("figures")), video)
