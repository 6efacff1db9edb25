"""Cases of bad input, by category. Some are accepted; none may end in anything else than one line.

A case runs in an empty folder of its own, beside the folder of the valid files: see `places`.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from . import contents, kept, options, unusual
from .contents import Found

Prepare = Callable[[Path], None]


class Case(NamedTuple):
    """A call of the command line.

    Args:
        category: the kind of bad input.
        name: what is special about it.
        arguments: command-line arguments; `{base}` stands for the folder of the valid files.
        prepare: writes the files of the case into its folder.
    """

    category: str
    name: str
    arguments: Sequence[str]
    prepare: Prepare | None = None


CATEGORIES: Mapping[str, Callable[[], Found]] = {
    "untrusted text": contents.texts,
    "entries of files": contents.entries,
    "images": contents.images,
    "files that are no files": unusual.no_files,
    "sizes": unusual.sizes,
    "numbers without room": unusual.impossible,
    "coordinates": unusual.coordinates,
    "terminals": unusual.terminals,
    "kept data": kept.damages,
    "options": options.options,
    "settings by --set": options.assignments,
    "combinations": options.combinations,
}
"""Generators of the cases of each category: name, arguments, and what writes their files."""


IMPOSSIBLE = frozenset({"numbers without room"})
"""Categories of which no case may be accepted."""


def all_cases(category: str) -> list[Case]:
    """Return all cases of a category, in a fixed order."""
    return [Case(category, *found) for found in CATEGORIES[category]()]


def some_cases(category: str, number: int) -> list[Case]:
    """Return a number of cases of a category, spread evenly over it, or all if it has fewer."""
    found = all_cases(category)
    number = min(number, len(found))
    return [found[index * len(found) // number] for index in range(number)]
