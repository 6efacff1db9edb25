"""Decorators that add options to a command."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

type Decorator = Callable[[Any], Any]


def add_options(*options: Decorator) -> Decorator:
    """Return a decorator that adds options to a command, which lists them in this order."""

    def add(command: Any) -> Any:
        # Click lists options in the reverse order of their addition.
        for option in reversed(options):
            command = option(command)
        return command

    return add


def path_option(*names: str, metavar: str, text: str) -> Decorator:
    """Return an option with the path of a file or of a folder."""
    return click.option(*names, type=click.Path(path_type=Path), metavar=metavar, help=text)


TRUST = click.option(
    "--trust",
    is_flag=True,
    help="Import what settings files name as MODULE:NAME, which runs its code.",
)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace an existing run folder.")
