"""From a job to its answer, in whichever process that is."""

from pathlib import Path
from typing import Any

import jax

from jaxplore.study.workers.job import Job

MOST_MAPPINGS = 20_000
"""Pieces of memory that a process may map before compiled programs are forgotten: Linux gives it
65530, each program takes hundreds, and without any left the next compilation crashes."""


def answer_to(job: Job) -> Any:
    """Do a job and return its answer.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    _forget_programs()
    return job.run()


def _forget_programs() -> None:
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()  # type: ignore[no-untyped-call]
