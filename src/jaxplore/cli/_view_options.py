"""Options of views in the browser."""

import click

from jaxplore.cli._decorators import add_options

VIEW = ("view", "view_port", "host")
"""Names of the options of a live view; all are None when absent."""
HOST = "127.0.0.1"
"""Address of the own machine, where a view listens unless told otherwise."""

host_option = click.option(
    "--host",
    metavar="ADDRESS",
    help=f"Address where the page of the view is served.  [default: {HOST}, this machine only]",
)


view_options = add_options(
    click.option(
        "--view",
        is_flag=True,
        default=None,
        help="Show the run in the browser while it goes on, with sliders for its parameters "
        "(needs viser).",
    ),
    click.option(
        "--view-port", type=int, metavar="N", help="Port of the view.  [default: a free one]"
    ),
    host_option,
)
