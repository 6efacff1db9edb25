"""The protocol of worker pools, for local processes and Ray clusters."""

import abc
import os
from typing import Any, NamedTuple

from jaxplore.study.workers.task import Task


class Event(NamedTuple):
    """A message from a worker, or the notice of its death with the reason in a few words.

    The result is None from a worker that is ready without a task. `death` is None while it lives.
    """

    worker: int
    result: Any = None
    death: str | None = None


class WorkerPool(abc.ABC):
    """A pool of workers, each of which runs one task at a time."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Greatest number of workers at a time."""

    @abc.abstractmethod
    def start(self, example: Task) -> None:
        """Start another worker, which reports when it is ready.

        It imports the modules of `example`, a task like those to come, and does not run it.
        """

    @abc.abstractmethod
    def ping(self, worker: int) -> None:
        """Check whether an idle worker is alive; it reports that it is ready."""

    @abc.abstractmethod
    def submit(self, worker: int, task: Task) -> None:
        """Send a task to an idle worker, which reports the result."""

    @abc.abstractmethod
    def wait(self) -> list[Event]:
        """Wait for messages of workers and return them."""

    @abc.abstractmethod
    def close(self) -> None:
        """End all workers, even during a task."""


def limit_threads(number: int) -> None:
    """Limit the threads of JAX in this process; call it before the first array is made.

    N processes that each use all processors would slow each other down. Results do not depend on
    the number, to the bit. Environment variables that are already set are kept.
    """
    # XLA uses this variable as the number of processors.
    os.environ.setdefault("NPROC", str(number))
    # By default one process allocates most of a GPU's memory.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def num_processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
