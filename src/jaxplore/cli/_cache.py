"""The cache of compiled programs of the commands."""

import functools
import os
from typing import Any

import click

from jaxplore.cli._terminal import say

VARIABLE = "JAXPLORE_CACHE"
"""Environment variable with the folder of the cache, or off."""


def cache_option(command: Any) -> Any:
    """Add the option that turns the cache of compiled programs off, and open it otherwise."""

    # The cache is opened when the command runs, not when options are read: that imports JAX.
    @functools.wraps(command)
    def with_cache(*, no_cache: bool, **options: Any) -> Any:
        if not no_cache:
            _open_cache()
        return command(**options)

    return click.option(
        "--no-cache",
        is_flag=True,
        help=f"Do not use the cache of compiled programs; the same as {VARIABLE}=off.",
    )(with_cache)


def _open_cache() -> None:
    """Enable the cache, unless it is turned off or JAX's own cache is configured.

    It raises a `ValueError` if a folder that the user has chosen cannot be used.
    """
    given = os.environ.get(VARIABLE, "")
    if given.lower() == "off":
        return
    import jax

    from jaxplore.compilation_cache import enable_compilation_cache

    if given:
        enable_compilation_cache(given)
    elif jax.config.jax_compilation_cache_dir is None:
        try:
            enable_compilation_cache()
        except ValueError as error:
            # The default folder is optional: without it the command only starts slower.
            say(f"jaxplore: no cache of compiled programs: {error}", err=True)
