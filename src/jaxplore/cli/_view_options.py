"""Options of views in the browser."""

from typing import Any

import click

VIEW = ("view", "view_port", "host")
"""Names of the options of a live view; all are None when absent."""
HOST = "127.0.0.1"
"""Address of the own machine, where a view listens unless told otherwise."""

host_option = click.option(
    "--host",
    metavar="ADDRESS",
    help=f"Address where the page of the view is served.  [default: {HOST}, this machine only]",
)


def view_options(command: Any) -> Any:
    """Add the options of a live view."""
    # Click lists options in the reverse order of their addition.
    for option in (
        host_option,
        click.option(
            "--view-port", type=int, metavar="N", help="Port of the view.  [default: a free one]"
        ),
        click.option(
            "--view",
            is_flag=True,
            default=None,
            help="Show the run in the browser while it goes on, with sliders for its parameters "
            "(needs viser).",
        ),
    ):
        command = option(command)
    return command
