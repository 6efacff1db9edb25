"""Workers: what processes and machines have in common."""

import abc
import os
from typing import Any, NamedTuple

from jaxplore.study.workers.job import Job


class Event(NamedTuple):
    """Something that a worker reports.

    Args:
        worker: which.
        answer: to the job that it was given; None from one that had none and is ready.
        death: why it is no more, in a few words; None while it lives.
    """

    worker: int
    answer: Any = None
    death: str | None = None


class Crew(abc.ABC):
    """Workers, each of which does one job at a time."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """How many workers there are to be."""

    @abc.abstractmethod
    def start(self, example: Job) -> None:
        """Start one more worker, which reports when it is ready.

        Args:
            example: a job like those that it will be given: what they need is imported before. It
                is not done.
        """

    @abc.abstractmethod
    def ask(self, worker: int) -> None:
        """Ask a worker that has nothing to do whether it is there; it reports that it is ready."""

    @abc.abstractmethod
    def give(self, worker: int, job: Job) -> None:
        """Give a job to a worker that is ready; it reports the answer."""

    @abc.abstractmethod
    def wait(self) -> list[Event]:
        """Wait until some worker reports something, and return what."""

    @abc.abstractmethod
    def close(self) -> None:
        """End all workers, whatever they are doing."""


def limit_threads(number: int) -> None:
    """Let JAX compute on so many threads in this process; to be called before it makes an array.

    N processes of which each uses all processors would wait for each other. Results are the same
    to the bit whatever the number is. What the environment already says stays.
    """
    # XLA takes it for the number of processors.
    os.environ.setdefault("NPROC", str(number))
    # By default a process takes most of a GPU's memory to itself.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def num_processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
