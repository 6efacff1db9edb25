"""Optional dependencies, imported when they are first used."""

import importlib
from typing import Any


def import_optional(name: str, extra: str) -> Any:
    """Import an optional package or one of its modules.

    Args:
        name: name of the module.
        extra: name of jaxplore's extra that installs it.

    Raises:
        ValueError: the package is not installed; says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        # A module that an installed package misses is another problem than a missing package.
        if error.name is None or error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        raise ValueError(
            f"{name.partition('.')[0]} is not installed; accepted: pip install 'jaxplore[{extra}]'"
        ) from None
