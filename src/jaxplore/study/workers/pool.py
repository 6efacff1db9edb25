"""Worker pools: what local processes and Ray clusters have in common."""

import abc
import os
from typing import Any, NamedTuple

from jaxplore.study.workers.task import Task


class Event(NamedTuple):
    """A message from a worker, or its end.

    Args:
        worker: number of the worker.
        result: result of the worker's task; None from a worker that is ready without a task.
        death: why the worker died, in a few words; None while it lives.
    """

    worker: int
    result: Any = None
    death: str | None = None


class WorkerPool(abc.ABC):
    """Workers, each of which runs one task at a time."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Most workers at a time."""

    @abc.abstractmethod
    def start(self, example: Task) -> None:
        """Start one more worker. It reports when it is ready.

        Args:
            example: a task like those to come. The worker imports what it needs and does not run
                it.
        """

    @abc.abstractmethod
    def ping(self, worker: int) -> None:
        """Ask an idle worker whether it is alive. It reports that it is ready."""

    @abc.abstractmethod
    def submit(self, worker: int, task: Task) -> None:
        """Send a task to an idle worker. It reports the result."""

    @abc.abstractmethod
    def wait(self) -> list[Event]:
        """Wait for the next messages of workers and return them."""

    @abc.abstractmethod
    def close(self) -> None:
        """End all workers, also in the middle of a task."""


def limit_threads(number: int) -> None:
    """Limit the threads of JAX in this process. To be called before the first array is made.

    N processes that each use all processors would wait for each other. Results are the same to the
    bit whatever the number is. Variables that are already set in the environment stay.
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
