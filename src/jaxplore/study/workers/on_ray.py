"""Workers of a Ray cluster: on this machine, or on several that need not share a disk."""

import contextlib
import os
import pickle
import socket
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxplore.study.workers.answer import answer_to
from jaxplore.study.workers.crew import Crew, Event, limit_threads
from jaxplore.study.workers.job import Files, Job
from jaxplore.study.workers.packages import package

_PATIENCE = 10.0
"""Time for a cluster's head to answer [s]."""


class RayWorkers(Crew):
    """Actors with a processor each. Files are sent to them with their jobs, and answers back.

    Args:
        number: of workers; None for as many as the cluster has processors.
        address: of a cluster to join; a local one is started when absent, unless Ray is in use.

    Raises:
        ValueError: Ray is not installed, or the cluster cannot be reached.
    """

    def __init__(self, number: int | None, address: str | None) -> None:
        self._ray = package("ray", "distributed")
        self._errors = package("ray.exceptions", "distributed")
        self._is_ours = not self._ray.is_initialized()
        if self._is_ours:
            self._join(number, address)
        self._number = number or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._started = 0
        self._actor = self._ray.remote(num_cpus=1, max_restarts=0)(_Worker)
        self._actors: dict[int, Any] = {}
        self._jobs: dict[int, Job] = {}
        self._awaited: dict[Any, int] = {}
        self._files: dict[str, Any] = {}
        self._failed: list[Event] = []

    def _join(self, number: int | None, address: str | None) -> None:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if address is None:
            # Nobody has agreed to having a local cluster reported.
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            # It serves nobody but this machine.
            options |= {"_node_ip_address": "127.0.0.1"}
            options |= {"num_cpus": number, "include_dashboard": False}
        try:
            _knock(address)
            self._ray.init(address="local" if address is None else address, **options)
        except (OSError, RuntimeError, ValueError) as error:
            where = "started" if address is None else f"reached at {address!r}"
            raise ValueError(
                f"Ray cannot be {where}: {error}; accepted: HOST:PORT of a cluster's head, auto, "
                "or none to start one"
            ) from error

    @property
    def size(self) -> int:
        """How many workers there are to be."""
        return self._number

    def start(self, example: Job) -> None:
        """Ask the cluster for one more worker."""
        # Packed: no array is made of it before the number of threads is set.
        packed = package("ray.cloudpickle", "distributed").dumps(example)
        self._actors[self._started] = self._actor.remote(packed)
        self.ask(self._started)
        self._started += 1

    def ask(self, worker: int) -> None:
        """Ask a worker whether it is there."""
        self._awaited[self._actors[worker].ready.remote()] = worker

    def give(self, worker: int, job: Job) -> None:
        """Send a job, and each of its files that was not sent before."""
        try:
            files = job.files()
            for key, read in files.items():
                if key not in self._files:
                    content = read()
                    self._files[key] = self._ray.put(content)
        except (OSError, ValueError) as error:
            # Files that are gone meanwhile: the jobs that need them fail, the others go on.
            self._failed.append(Event(worker, job.failed(str(error))))
            return
        self._jobs[worker] = job
        # Only what is an argument by itself is fetched for the worker.
        stored = [self._files[key] for key in files]
        self._awaited[self._actors[worker].run.remote(job, list(files), *stored)] = worker

    def wait(self) -> list[Event]:
        """Wait for a word, or the end, of some worker."""
        if self._failed:
            return [self._failed.pop()]
        done, _ = self._ray.wait(list(self._awaited), num_returns=1)
        return [self._event(self._awaited.pop(each), each) for each in done]

    def _event(self, worker: int, answer: Any) -> Event:
        job = self._jobs.pop(worker, None)
        try:
            return Event(worker, self._ray.get(answer))
        except self._errors.RayTaskError as error:
            if job is not None:
                return Event(worker, job.failed(str(error).strip().splitlines()[-1]))
            reason = str(error)
        except self._errors.RayError as error:
            reason = f"{type(error).__name__}: {error}"
        self._kill(self._actors.pop(worker))
        return Event(worker, death=" ".join(reason.split())[:200])

    def _kill(self, actor: Any) -> None:
        with contextlib.suppress(self._errors.RayError):
            self._ray.kill(actor)

    def close(self) -> None:
        """End all workers, and the cluster or the connection if this made it."""
        while self._actors:
            self._kill(self._actors.popitem()[1])
        if self._is_ours:
            self._ray.shutdown()
            self._is_ours = False


class _Worker:
    """Does jobs, with a processor and a folder of its own."""

    def __init__(self, example: bytes) -> None:
        limit_threads(1)
        pickle.loads(example)
        self._top = tempfile.TemporaryDirectory(prefix="jaxplore-")
        self._folders: dict[str, Path] = {}

    def ready(self) -> None:
        """Return when the worker can be given something."""

    def run(self, job: Job, keys: Sequence[str], *files: Files) -> Any:
        """Return the answer to a job.

        Args:
            job: what is to be done.
            keys: of its files.
            files: for each key.
        """
        for key, each in zip(keys, files, strict=True):
            if key not in self._folders:
                folder = Path(tempfile.mkdtemp(dir=self._top.name))
                for name, data in each.items():
                    (folder / name).write_bytes(data)
                # Whole or not at all: the next job takes what is there.
                self._folders[key] = folder
        return answer_to(job.located({key: self._folders[key] for key in keys}))


def _knock(address: str | None) -> None:
    """Find out at once whether anybody listens at HOST:PORT: Ray would try for minutes."""
    host, separator, port = (address or "").rpartition(":")
    if separator and "/" not in host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE).close()
