"""The option with the greatest memory of runs, and the check before anything is allocated."""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from jaxplore.settings.node import NodeSettings
    from jaxplore.settings.sections import RunSettings

GIGABYTE = 1e9
"""Bytes in the unit of the option."""

memory_option = click.option(
    "--memory-limit",
    type=float,
    metavar="GB",
    help="Memory that the command may need; what needs more by its estimate is refused before it "
    "starts.  [default: 80 % of what is free]",
)


def memory_limit(options: dict[str, Any]) -> float:
    """Take the option from all options, and return the limit [bytes]."""
    given = options.pop("memory_limit")
    if given is None:
        # Imported here, so that the help needs no JAX.
        from jaxplore.tasks.memory_limit import default_limit

        return default_limit()
    if not (math.isfinite(given) and given > 0.0):
        raise ValueError(f"--memory-limit is {given}; accepted: a number > 0 [GB]")
    return float(given) * GIGABYTE


def check_memory(
    runs: "Iterable[RunSettings]",
    limit: float,
    *,
    node: "NodeSettings | None" = None,
    num_runs: int = 1,
    batch: int = 1,
    must_be_readable: bool = True,
) -> None:
    """Check that each of several runs fits into a memory of `limit` [bytes].

    Without `node` they are simulations. Each of `num_runs` processes has `batch` runs in one
    program. Unless `must_be_readable`, a run whose map cannot be read is not checked.
    """
    from jaxplore.tasks.exploration.memory import estimate_exploration
    from jaxplore.tasks.memory import check_needs
    from jaxplore.tasks.registry import kind_of

    for settings in runs:
        try:
            if node is None:
                parts = kind_of(settings).needs(settings, limit)
            else:
                parts = estimate_exploration(settings, node=node)  # type: ignore[arg-type]
        except ValueError:
            if must_be_readable:
                raise
            continue
        check_needs(parts, limit, num_runs=num_runs, batch=batch)


def check_count(name: str, value: int, most: int) -> None:
    """Check that a number of things that a command makes or runs is from 1 to `most`."""
    if value < 1:
        raise ValueError(f"{name} is {value}; accepted: a whole number >= 1")
    if value > most:
        raise ValueError(f"{name} is {value}; accepted: a whole number <= {most}")
