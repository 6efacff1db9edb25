"""Options of the runner: one process, several processes, or a Ray cluster."""

from typing import TYPE_CHECKING, Any

import click

from jaxplore._limits import MOST_AT_ONCE
from jaxplore.cli._decorators import add_options
from jaxplore.cli._memory import check_count

if TYPE_CHECKING:
    from jaxplore.study.runner import Runner

RUNNER = ("workers", "ray", "address")
"""Names of these options."""


runner_options = add_options(
    click.option(
        "--workers",
        type=int,
        help="Number of processes, or of Ray workers.  [default: 1; all of Ray's]",
    ),
    click.option("--ray", is_flag=True, help="Start a local Ray cluster."),
    click.option("--address", metavar="HOST:PORT", help="Join a Ray cluster."),
)


def make_runner(given: dict[str, Any]) -> "Runner":
    """Make the runner that the options describe."""
    workers, on_ray, address = given["workers"], given["ray"], given["address"]
    if workers is not None:
        check_count("--workers", workers, MOST_AT_ONCE)
    if workers is None and not on_ray and address is None:
        workers = 1
    # Imported here, so that the help needs no JAX.
    from jaxplore.study.runner import Runner

    return Runner(workers, address, on_ray=on_ray)
