"""Both spellings of names of several words, with hyphens and with underscores."""

from collections.abc import Iterable
from typing import Any


def match_spelling(value: Any, words: Iterable[str]) -> Any:
    """Return the word that differs from `value` in hyphens and underscores at most; else `value`.

    What is no string passes.
    """
    if not isinstance(value, str):
        return value
    plain = value.replace("_", "-")
    return next((word for word in words if word.replace("_", "-") == plain), value)
