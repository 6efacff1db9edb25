"""Where the commands keep what they compile."""

import os
from typing import Any

import click
import jax

from jaxplore.compilation_cache import enable_compilation_cache

VARIABLE = "JAXPLORE_CACHE"
"""Environment variable: a folder for compiled programs, or off."""


def cache_option(command: Any) -> Any:
    """Add the option that keeps no compiled programs; without it they are kept."""
    return click.option(
        "--no-cache",
        is_flag=True,
        expose_value=False,
        callback=_open_cache,
        help=f"Keep no compiled programs and use none that are kept; so does {VARIABLE}=off.",
    )(command)


def _open_cache(_context: click.Context, _option: click.Parameter, is_off: bool) -> None:
    """Keep compiled programs, unless the user wants none kept, or has JAX keep them elsewhere.

    Raises:
        ValueError: a folder that was asked for and cannot be used.
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
            # Nobody asked for it: without it the command does the same, and starts slower.
            click.echo(f"jaxplore: no programs are kept: {error}", err=True)
