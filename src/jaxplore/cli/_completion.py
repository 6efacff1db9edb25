"""Names that a shell completes: scenarios, settings and their values.

Click writes the scripts for shells: `_JAXPLORE_COMPLETE=bash_source jaxplore`.
"""

from collections.abc import Callable, Iterable

import click
from click.shell_completion import CompletionItem

from jaxplore.cli._known import load_known

type Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def complete_map(
    _context: click.Context, _argument: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete a map: names of scenarios, and files."""
    # The item of type file lets the shell complete files. Bash does so if no name fits.
    return [CompletionItem(incomplete, type="file"), *_complete(load_known().places, incomplete)]


def complete_assignment(
    _context: click.Context, _option: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete the name of a setting that gets a value, NAME=VALUE."""
    return _complete((f"{name}=" for name in load_known().settings), incomplete)


def complete_setting(
    _context: click.Context, _option: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete the name of a setting."""
    return _complete(load_known().settings, incomplete)


def complete_name(
    _context: click.Context, _argument: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete a name of `jaxplore settings`."""
    return _complete(load_known().names, incomplete)


def values_of(setting: str) -> Complete:
    """Return a function that completes the words that a setting accepts, of all kinds of tasks."""

    def complete(
        _context: click.Context, _option: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return _complete(load_known().words[setting], incomplete)

    return complete


def complete_architectures(
    _context: click.Context, _option: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Complete the last of several architectures, NAME,NAME."""
    done, comma, last = incomplete.rpartition(",")
    found = values_of("architecture")(_context, _option, last)
    return [CompletionItem(f"{done}{comma}{item.value}") for item in found]


def words(names: Iterable[str]) -> Complete:
    """Return a function that completes one of some words."""

    def complete(
        _context: click.Context, _option: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return _complete(names, incomplete)

    return complete


def _complete(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]
