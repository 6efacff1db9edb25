"""Options of the runner: one process, several processes, or a Ray cluster."""

from typing import TYPE_CHECKING, Any

import click

from jaxplore._limits import MOST_AT_ONCE
from jaxplore.cli._memory import check_count

if TYPE_CHECKING:
    from jaxplore.study.runner import Runner

RUNNER = ("workers", "ray", "address")
"""Names of these options."""


def runner_options(command: Any) -> Any:
    """Add the options of a runner."""
    # Click lists options in the reverse order of their addition.
    for option in (
        click.option("--address", metavar="HOST:PORT", help="Join a Ray cluster."),
        click.option("--ray", is_flag=True, help="Start a local Ray cluster."),
        click.option(
            "--workers",
            type=int,
            help="Number of processes, or of Ray workers.  [default: 1; all of Ray's]",
        ),
    ):
        command = option(command)
    return command


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
