"""The cache of compiled programs of the commands."""

import os
from typing import Any

import click
import jax

from jaxplore.compilation_cache import enable_compilation_cache

VARIABLE = "JAXPLORE_CACHE"
"""Environment variable with the folder of the cache, or off."""


def cache_option(command: Any) -> Any:
    """Add the option that turns the cache of compiled programs off."""
    return click.option(
        "--no-cache",
        is_flag=True,
        expose_value=False,
        callback=_open_cache,
        help=f"Do not use the cache of compiled programs; the same as {VARIABLE}=off.",
    )(command)


def _open_cache(_context: click.Context, _option: click.Parameter, is_off: bool) -> None:
    """Enable the cache, unless it is turned off or JAX's own cache is configured.

    Raises:
        ValueError: a folder that the user has chosen cannot be used.
    """
    given = os.environ.get(VARIABLE, "")
    if is_off or given.lower() == "off":
        return
    if given:
        enable_compilation_cache(given)
    elif jax.config.jax_compilation_cache_dir is None:
        try:
            enable_compilation_cache()
        except ValueError as error:
            # The default folder is optional: without it the command only starts slower.
            click.echo(f"jaxplore: no cache of compiled programs: {error}", err=True)
