"""Settings that accept some words, or MODULE:NAME: a class or a function of the user's own.

Such a name runs the code of its module. On the command line and in Python the user gives it. A
settings file may come from someone else, so `jaxplore.settings.sections.read_settings` refuses
names of code unless the user trusts the file.
"""

import os
import re
from collections.abc import Mapping
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from jaxplore._spelling import match_spelling

OWN = "MODULE:NAME"
"""How messages and the reference write such a name."""
SETTINGS = ("architecture", "robot.model")
"""The settings that accept one."""

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


def is_own(value: object) -> bool:
    """Check whether the value of a setting is MODULE:NAME."""
    return isinstance(value, str) and _NAME.fullmatch(value) is not None


class WordsOrOwn:
    """The type of a setting that accepts some words, for `typing.Annotated`."""

    def __init__(self, words: tuple[str, ...]) -> None:
        self.words = words

    def __get_pydantic_core_schema__(self, kind: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema with which pydantic checks a value."""
        return core_schema.no_info_after_validator_function(self._check, handler(kind))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the schema from which the reference is made."""
        return {**handler(schema), "enum": list(self.words), "code": OWN}

    def _check(self, value: str) -> str:
        value = match_spelling(value, self.words)
        if value not in self.words and not is_own(value):
            expected = ", ".join(map(repr, self.words))
            raise PydanticCustomError(
                "literal_error",
                "Input should be {expected} or {own}",
                {"expected": expected, "own": f"{OWN} of your own"},
            )
        return value


def check_trusted(entries: Mapping[str, Any], path: str | os.PathLike[str]) -> None:
    """Raise a `ValueError` if entries of a settings file name code."""
    for name in SETTINGS:
        value: Any = entries
        for part in name.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if is_own(value):
            raise ValueError(
                f"settings file {path} has the {name} {value}, whose code would run; accepted: "
                "with --trust, if you trust the file"
            )
