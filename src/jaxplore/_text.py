"""Texts from outside: names, values and messages of parsers, short and without control characters.

Messages quote them by `short_repr`, `printable_path` and `error_reason`. The command line prints
everything through `printable`, and its errors through `one_line`.
"""

import re
import reprlib
from pathlib import Path

_SHORT = reprlib.Repr(maxlevel=2, maxstring=80, maxother=80, maxlong=80)
_LONGEST_WORD, _LONGEST_LINE = 300, 500
"""Longest word and longest line of an error [characters]."""


def short_repr(value: object) -> str:
    """Return a short text of any value, for messages."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # an integer with more digits than Python prints
        return f"a {type(value).__name__} that is too long to print"


def printable(text: str) -> str:
    r"""Return a text for a terminal, whose characters that do not print are escaped.

    A terminal obeys control characters: they move the cursor, recolour or hide what follows. A byte
    of a file name that is not UTF-8 becomes `\xNN`. Line breaks stay.
    """
    if text.replace("\n", "").isprintable():
        return text
    return "".join(each if each == "\n" or each.isprintable() else _escape(each) for each in text)


def _escape(character: str) -> str:
    code = ord(character)
    # Python stands a byte that it cannot decode for a character from U+DC80 to U+DCFF.
    if 0xDC80 <= code <= 0xDCFF:
        code -= 0xDC00
    width, letter = (2, "x") if code <= 0xFF else (4, "u") if code <= 0xFFFF else (8, "U")
    return f"\\{letter}{code:0{width}x}"


def one_line(text: str) -> str:
    """Return a message in one printable line, in which long words and a long middle are cut."""
    # What is escaped is longer, so that comes first.
    line = printable(" ".join(text.split()))
    line = re.sub(rf"\S{{{_LONGEST_WORD + 1},}}", lambda word: _cut(word[0], _LONGEST_WORD), line)
    return _cut(line, _LONGEST_LINE)


def _cut(text: str, longest: int) -> str:
    # The end stays too: it says what is accepted.
    if len(text) <= longest:
        return text
    return f"{text[: longest * 2 // 3]}...{text[-(longest // 3) + 3 :]}"


def printable_path(path: Path) -> str:
    """Return a path for messages, with unprintable characters escaped."""
    return str(path) if str(path).isprintable() else repr(str(path))


def error_reason(error: BaseException) -> str:
    """Return the reason of an error in one short line, for messages."""
    from PIL import UnidentifiedImageError  # slow to import, and few need it

    if isinstance(error, UnidentifiedImageError):  # its text is only the repr of the open file
        return "it is none of these"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = " ".join(text.split())
    return _SHORT.repr(line)[1:-1] if len(line) > 200 else line or type(error).__name__
