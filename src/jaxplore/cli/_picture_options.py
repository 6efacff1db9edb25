"""Options of figures and films, the same for all commands that draw."""

import click

from jaxplore.cli._decorators import Decorator, add_options, path_option
from jaxplore.cli._known import load_known


def picture_options(animation: str, *, video: bool = False) -> Decorator:
    """Return a decorator that adds the options of figures and films.

    `animation` is the help of `--animation`.
    """
    options = [
        click.option("--animation/--no-animation", default=True, help=animation),
        click.option(
            "--fps",
            type=float,
            help="Frames per second of playback; the film shows how many times as fast as the run "
            f"it plays.  [default: {load_known().fps:g}]",
        ),
        click.option(
            "--film-scale",
            type=float,
            help=f"Factor on the size of films, 0.5 to 4.  [default: {load_known().film_scale:g}]",
        ),
        click.option(
            "--figures",
            default=load_known().figures[0],
            show_default=True,
            metavar="FORMAT,FORMAT",
            help=f"Formats of figures: {', '.join(load_known().figures)}.",
        ),
    ]
    if video:
        film = "Also write the film as an MP4 video (needs imageio-ffmpeg)."
        options.append(path_option("--video", metavar="FILE.mp4", text=film))

    return add_options(*options)
