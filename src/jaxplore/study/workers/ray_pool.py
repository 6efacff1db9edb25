"""A worker pool of Ray actors, on one or several machines without a shared disk."""

import contextlib
import os
import pickle
import socket
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxplore._optional import import_optional
from jaxplore.study.workers.pool import Event, WorkerPool, limit_threads
from jaxplore.study.workers.task import Files, Task, run_task

_CLUSTERS = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Environment variable of Ray that turns clusters of several machines on or off."""
_CONNECT_TIMEOUT = 10.0
"""Time that the head of a cluster has to accept a connection [s]."""


class RayPool(WorkerPool):
    """A pool of Ray actors with one processor each, which receive files with their tasks.

    The number is that of the cluster's processors when None. Without an address a local cluster is
    started, unless Ray is in use. All parts of a local one listen on 127.0.0.1 only.
    """

    def __init__(self, number: int | None, address: str | None) -> None:
        self._ray = import_optional("ray", "distributed")
        self._errors = import_optional("ray.exceptions", "distributed")
        self._is_ours = not self._ray.is_initialized()
        if self._is_ours:
            self._join(number, address)
        self._number = number or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._started = 0
        # The scheduler replaces dead workers itself, and counts which tasks they died of.
        self._actor = self._ray.remote(num_cpus=1, max_restarts=0)(_Worker)
        self._actors: dict[int, Any] = {}
        self._tasks: dict[int, Task] = {}
        self._awaited: dict[Any, int] = {}
        self._files: dict[str, Any] = {}
        self._failed: list[Event] = []

    def _join(self, number: int | None, address: str | None) -> None:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if address is None:
            # The user has not agreed to usage statistics.
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            options |= {"num_cpus": number, "include_dashboard": False}
        try:
            _check_reachable(address)
            with _on_loopback() if address is None else contextlib.nullcontext():
                self._ray.init(address="local" if address is None else address, **options)
        except (OSError, RuntimeError, ValueError) as error:
            where = "started" if address is None else f"reached at {address!r}"
            raise ValueError(
                f"Ray cannot be {where}: {error}; accepted: HOST:PORT of a cluster's head, auto, "
                "or none to start one"
            ) from error

    @property
    def size(self) -> int:
        """Greatest number of workers at a time."""
        return self._number

    def start(self, example: Task) -> None:
        """Request another worker from the cluster."""
        # The example is sent as bytes: unpickling makes arrays, and the worker must limit its
        # threads before.
        packed = import_optional("ray.cloudpickle", "distributed").dumps(example)
        self._actors[self._started] = self._actor.remote(packed)
        self.ping(self._started)
        self._started += 1

    def ping(self, worker: int) -> None:
        """Check whether a worker is alive."""
        self._awaited[self._actors[worker].ready.remote()] = worker

    def submit(self, worker: int, task: Task) -> None:
        """Send a task, with those of its files that were not sent before."""
        try:
            files = task.files()
            for key, read in files.items():
                # A file is stored in the cluster once, however many tasks need it.
                if key not in self._files:
                    content = read()
                    self._files[key] = self._ray.put(content)
        except (OSError, ValueError) as error:
            # The files are unreadable: this task fails, the others continue.
            self._failed.append(Event(worker, task.make_failure(str(error))))
            return
        self._tasks[worker] = task
        # Ray fetches only top-level arguments for the worker, not those inside a list.
        stored = [self._files[key] for key in files]
        self._awaited[self._actors[worker].run.remote(task, list(files), *stored)] = worker

    def wait(self) -> list[Event]:
        """Wait for messages or the end of workers."""
        if self._failed:
            return [self._failed.pop()]
        done, _ = self._ray.wait(list(self._awaited), num_returns=1)
        return [self._event(self._awaited.pop(each), each) for each in done]

    def _event(self, worker: int, result: Any) -> Event:
        task = self._tasks.pop(worker, None)
        try:
            return Event(worker, self._ray.get(result))
        except self._errors.RayTaskError as error:
            # The task raised and its worker lives on. Without a task the worker could not start.
            if task is not None:
                return Event(worker, task.make_failure(str(error).strip().splitlines()[-1]))
            reason = str(error)
        except self._errors.RayError as error:
            reason = f"{type(error).__name__}: {error}"
        self._kill(self._actors.pop(worker))
        # Ray's reports fill pages.
        return Event(worker, death=" ".join(reason.split())[:200])

    def _kill(self, actor: Any) -> None:
        with contextlib.suppress(self._errors.RayError):
            self._ray.kill(actor)

    def close(self) -> None:
        """End all workers, and the cluster or connection that this pool has made."""
        while self._actors:
            self._kill(self._actors.popitem()[1])
        if self._is_ours:
            self._ray.shutdown()
            self._is_ours = False


class _Worker:
    """Ray actor that runs tasks, with one processor and its own folder."""

    def __init__(self, example: bytes) -> None:
        limit_threads(1)
        # Unpickling imports the modules that the tasks need.
        pickle.loads(example)
        self._top = tempfile.TemporaryDirectory(prefix="jaxplore-")
        self._folders: dict[str, Path] = {}

    def ready(self) -> None:
        """Return when the worker is ready for a task."""

    def run(self, task: Task, keys: Sequence[str], *files: Files) -> Any:
        for key, each in zip(keys, files, strict=True):
            if key not in self._folders:
                folder = Path(tempfile.mkdtemp(dir=self._top.name))
                for name, data in each.items():
                    (folder / name).write_bytes(data)
                # Stored only when complete: later tasks rely on stored folders.
                self._folders[key] = folder
        return run_task(task.relocate({key: self._folders[key] for key in keys}))


@contextlib.contextmanager
def _on_loopback() -> Iterator[None]:
    """Bind all parts of a cluster that is started in the body to 127.0.0.1.

    They listen where Ray takes this machine to be. For an address of 127.0.0.1 Ray looks up one
    that others can reach, and then listens on all interfaces, unless clusters of several machines
    are turned off. They are on Windows and macOS, and nobody else uses this cluster.
    """
    constants = import_optional("ray._private.ray_constants", "distributed")
    with contextlib.ExitStack() as stack:
        # Ray has read the variable when it was imported; the programs that it starts will.
        former = os.environ.get(_CLUSTERS)
        os.environ[_CLUSTERS] = "0"
        stack.callback(_set_variable, _CLUSTERS, former)
        stack.callback(setattr, constants, "ENABLE_RAY_CLUSTER", constants.ENABLE_RAY_CLUSTER)
        constants.ENABLE_RAY_CLUSTER = False
        yield


def _set_variable(name: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(name, None)
    else:
        os.environ[name] = value


def _check_reachable(address: str | None) -> None:
    """Connect to HOST:PORT once, to fail early: Ray would retry for minutes."""
    host, separator, port = (address or "").rpartition(":")
    if separator and "/" not in host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_TIMEOUT).close()
