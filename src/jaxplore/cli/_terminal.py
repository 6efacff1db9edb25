"""The place where the commands write to the terminal."""

from collections.abc import Callable
from typing import Any

import click

from jaxplore._text import one_line, printable


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text, whose characters that a terminal would obey are escaped."""
    click.echo(printable(text), err=err, nl=nl)


def warning_printer() -> Callable[..., None]:
    """Return a function that writes each warning once, as one line.

    Who gave a command has no use for a line of our code, nor for a warning of each time that a map
    is read. The name of the program stands before errors only. Its arguments are those of
    `warnings.showwarning`.
    """
    shown: set[str] = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        line = one_line(f"warning: {message}")
        if line not in shown:
            shown.add(line)
            say(line, err=True)

    return show
