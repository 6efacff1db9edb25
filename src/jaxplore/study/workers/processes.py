"""A worker pool of processes on this machine."""

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from jaxplore._signals import block_in_children
from jaxplore.study.workers.pool import Event, WorkerPool, limit_threads, num_processors
from jaxplore.study.workers.task import Task, run_task

_END_TIMEOUT = 10.0
"""Time that a process has to end after its connection is closed [s]."""


class ProcessPool(WorkerPool):
    """A pool of spawned processes. Forked ones would inherit JAX's threads and locks."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._threads = max(1, num_processors() // number)
        self._started = 0
        self._workers: dict[int, tuple[Connection, SpawnProcess]] = {}

    @property
    def size(self) -> int:
        """Greatest number of workers at a time."""
        return self._number

    def start(self, example: Task) -> None:
        """Start another process."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        # The example is sent as bytes: unpickling makes arrays, and the worker must limit its
        # threads before.
        arguments = (theirs, self._threads, pickle.dumps(example))
        process = context.Process(target=_serve, args=arguments, daemon=True)
        # The resource tracker is started first: its start would undo the block below.
        resource_tracker.ensure_running()
        with block_in_children():
            process.start()
        # Now only the child holds its end of the connection, so its death closes ours.
        theirs.close()
        self._workers[self._started] = (ours, process)
        self._started += 1

    def ping(self, worker: int) -> None:
        """Check whether a process is alive."""
        self._send(worker, None)

    def submit(self, worker: int, task: Task) -> None:
        """Send a task."""
        self._send(worker, task)

    def _send(self, worker: int, task: Task | None) -> None:
        # A dead worker is reported by `wait`.
        with contextlib.suppress(OSError):
            self._workers[worker][0].send(task)

    def wait(self) -> list[Event]:
        """Wait for messages or the end of processes."""
        by_end = {ours: worker for worker, (ours, _) in self._workers.items()}
        return [self._event(by_end[ours], ours) for ours in connection.wait(list(by_end))]  # type: ignore[index, arg-type]

    def _event(self, worker: int, ours: Connection) -> Event:
        try:
            return Event(worker, ours.recv())
        except (EOFError, OSError):
            _, process = self._workers.pop(worker)
            return Event(worker, death=_end(ours, process, _END_TIMEOUT))

    def close(self) -> None:
        """Kill all processes. Only their present tasks are lost."""
        while self._workers:
            _, (ours, process) = self._workers.popitem()
            _end(ours, process, 0.0)


def _end(ours: Connection, process: SpawnProcess, timeout: float) -> str:
    """Wait for a process to end, kill it after a timeout, and return the reason of its end."""
    process.join(timeout)
    if process.exitcode is None:
        process.kill()
        process.join()
    code = process.exitcode
    ours.close()
    process.close()
    assert code is not None
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _serve(theirs: Connection, threads: int, example: bytes) -> None:
    """Run tasks until the connection is closed: the main function of a worker process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_threads(threads)
    # Unpickling imports the modules that the tasks need.
    pickle.loads(example)
    # The parent has closed the connection or is gone.
    with contextlib.suppress(EOFError, BrokenPipeError):
        theirs.send(None)
        while True:
            task = theirs.recv()
            theirs.send(None if task is None else run_task(task))


def _end_with_parent() -> None:
    """End this process when its parent has ended, even during a task."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        # In a thread `sys.exit` would end the thread only.
        os._exit(1)
