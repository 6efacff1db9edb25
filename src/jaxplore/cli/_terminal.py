"""The place where the commands write to the terminal."""

import click

from jaxplore._text import printable


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text, whose characters that a terminal would obey are escaped.

    Args:
        text: the text.
        err: whether it goes to standard error.
        nl: whether a line break follows.
    """
    click.echo(printable(text), err=err, nl=nl)
