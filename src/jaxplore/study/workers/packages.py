"""Packages that only some need: looked up when they are first used."""

import importlib
from typing import Any


def package(name: str, extra: str) -> Any:
    """Return a package or one of its modules.

    Args:
        name: of the module.
        extra: of jaxplore's optional dependencies that brings it.

    Raises:
        ValueError: it is not installed; says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != name.partition(".")[0]:
            raise
        raise ValueError(
            f"{name.partition('.')[0]} is not installed; accepted: pip install 'jaxplore[{extra}]'"
        ) from None
