"""What tests of controllers share."""

from collections.abc import Iterator

import jaxtyping
import pytest


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Turn the run-time types of the tests off.

    Users do not have them: where bad input is to be named, they would raise first. And where a
    closed loop or a derivative is compiled, most of the time is tracing, of which half are types
    that other tests check in the same functions.
    """
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)
