"""Import of optional dependencies at their first use."""

import importlib
from typing import Any


def import_optional(name: str, extra: str) -> Any:
    """Import an optional package or module; without it a `ValueError` says how to get `extra`."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        # If an installed package lacks one of its own modules, its error is passed on.
        if error.name is None or error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        raise is_missing(name, extra) from None


def is_missing(name: str, extra: str) -> ValueError:
    """Return the error of an optional package that is not installed, with the command for it."""
    return ValueError(
        f"{name.partition('.')[0]} is not installed; accepted: pip install '.[{extra}]' in a "
        "clone of jaxplore"
    )
