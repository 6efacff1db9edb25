"""Workers that are processes on this machine."""

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Iterator
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from jaxplore.study.workers.answer import answer_to
from jaxplore.study.workers.crew import Crew, Event, limit_threads, num_processors
from jaxplore.study.workers.job import Job

_PATIENCE = 10.0
"""Time for a process to end after its last word [s]."""


class Processes(Crew):
    """Processes that are started afresh: a fork would share JAX's threads and locks.

    Args:
        number: of processes.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._threads = max(1, num_processors() // number)
        self._started = 0
        self._workers: dict[int, tuple[Connection, SpawnProcess]] = {}

    @property
    def size(self) -> int:
        """How many workers there are to be."""
        return self._number

    def start(self, example: Job) -> None:
        """Start one more process."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        # Packed: no array is made of it before the number of threads is set.
        arguments = (theirs, self._threads, pickle.dumps(example))
        process = context.Process(target=_serve, args=arguments, daemon=True)
        with _interrupts_held():
            process.start()
        # Only the process itself holds its end now: when it dies, ours says so.
        theirs.close()
        self._workers[self._started] = (ours, process)
        self._started += 1

    def ask(self, worker: int) -> None:
        """Ask a process whether it is there."""
        self._send(worker, None)

    def give(self, worker: int, job: Job) -> None:
        """Send a job."""
        self._send(worker, job)

    def _send(self, worker: int, job: Job | None) -> None:
        # That nobody is there any more is for `wait` to find out.
        with contextlib.suppress(OSError):
            self._workers[worker][0].send(job)

    def wait(self) -> list[Event]:
        """Wait for a word, or the end, of some process."""
        by_end = {ours: worker for worker, (ours, _) in self._workers.items()}
        return [self._event(by_end[ours], ours) for ours in connection.wait(list(by_end))]  # type: ignore[index, arg-type]

    def _event(self, worker: int, ours: Connection) -> Event:
        try:
            return Event(worker, ours.recv())
        except (EOFError, OSError):
            _, process = self._workers.pop(worker)
            return Event(worker, death=_end(ours, process, _PATIENCE))

    def close(self) -> None:
        """Kill all processes: they hold nothing that would be lost but their jobs."""
        while self._workers:
            _, (ours, process) = self._workers.popitem()
            _end(ours, process, 0.0)


def _end(ours: Connection, process: SpawnProcess, patience: float) -> str:
    """See to it that a process has ended, and return how."""
    process.join(patience)
    if process.exitcode is None:
        process.kill()
        process.join()
    code = process.exitcode
    ours.close()
    process.close()
    assert code is not None
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: what is started meanwhile never gets it, this process afterwards.

    A terminal sends it to all processes; what becomes of the workers is decided here.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It lets signals through again when it starts, which would be in between.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(theirs: Connection, threads: int, example: bytes) -> None:
    """Do jobs until nobody asks any more. Runs in a process of its own."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_threads(threads)
    pickle.loads(example)
    # Nobody to talk to: it is over.
    with contextlib.suppress(EOFError, BrokenPipeError):
        theirs.send(None)
        while True:
            job = theirs.recv()
            theirs.send(None if job is None else answer_to(job))


def _end_with_parent() -> None:
    """End this process when its parent has ended, in the middle of a job too."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
