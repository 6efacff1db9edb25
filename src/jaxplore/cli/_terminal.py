"""The place where the commands write to the terminal."""

from typing import Any

import click

from jaxplore._text import one_line, printable


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text, whose characters that a terminal would obey are escaped.

    Args:
        text: the text.
        err: whether it goes to standard error.
        nl: whether a line break follows.
    """
    click.echo(printable(text), err=err, nl=nl)


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Write a warning as one line: who gave a command has no use for a line of our code.

    The name of the program stands before errors only.

    Args:
        message: the warning; the other arguments are those of `warnings.showwarning`.
    """
    say(one_line(f"warning: {message}"), err=True)
