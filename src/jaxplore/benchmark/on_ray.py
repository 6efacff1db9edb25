"""Workers of a Ray cluster: on this machine, or on several that need not share a disk."""

import contextlib
import dataclasses
import io
import os
import socket
import tempfile
from pathlib import Path
from typing import Any

import yaml

from jaxplore.benchmark.crew import Crew, Event, limit_threads
from jaxplore.benchmark.maps import image_of
from jaxplore.benchmark.packages import package
from jaxplore.benchmark.perform import Perform, results_for
from jaxplore.benchmark.rows import Result, failed_row, result_of
from jaxplore.benchmark.tasks import Batch
from jaxplore.maps._files import read_yaml

Files = dict[str, bytes]
"""A map's files by name, the YAML file under `MAP`."""

MAP = "map.yaml"

_PATIENCE = 10.0
"""Time for a cluster's head to answer [s]."""


class RayWorkers(Crew):
    """Actors with a processor each. Maps are sent to them, and rows sent back.

    Args:
        number: of workers; None for as many as the cluster has processors.
        address: of a cluster to join; a local one is started when absent, unless Ray is in use.
        make: what makes the runs of a batch.

    Raises:
        ValueError: Ray is not installed, or the cluster cannot be reached.
    """

    def __init__(self, number: int | None, address: str | None, make: Perform) -> None:
        self._ray = package("ray", "distributed")
        self._errors = package("ray.exceptions", "distributed")
        self._is_ours = not self._ray.is_initialized()
        if self._is_ours:
            self._join(number, address)
        self._number = number or max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        self._make, self._started = make, 0
        self._actor = self._ray.remote(num_cpus=1, max_restarts=0)(_Worker)
        self._actors: dict[int, Any] = {}
        self._batches: dict[int, Batch] = {}
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

    def start(self) -> None:
        """Ask the cluster for one more worker."""
        actor = self._actor.remote(self._make)
        self._actors[self._started] = actor
        self._awaited[actor.ready.remote()] = self._started
        self._started += 1

    def give(self, worker: int, batch: Batch) -> None:
        """Send tasks, and once for each map its files."""
        first = batch[0]
        try:
            if first.content not in self._files:
                files = _packed(first.path)
                self._files[first.content] = self._ray.put(files)
        except (OSError, ValueError) as error:
            # A map that is gone meanwhile: its runs fail, the others go on.
            self._failed.append(_failure(worker, batch, str(error)))
            return
        self._batches[worker] = batch
        results = self._actors[worker].run.remote(batch, self._files[first.content])
        self._awaited[results] = worker

    def wait(self) -> list[Event]:
        """Wait for a word, or the end, of some worker."""
        if self._failed:
            return [self._failed.pop()]
        done, _ = self._ray.wait(list(self._awaited), num_returns=1)
        return [self._event(self._awaited.pop(each), each) for each in done]

    def _event(self, worker: int, answer: Any) -> Event:
        batch = self._batches.pop(worker, ())
        try:
            return Event(worker, self._ray.get(answer))
        except self._errors.RayTaskError as error:
            if batch:
                return _failure(worker, batch, str(error).strip().splitlines()[-1])
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


class _Worker:
    """Does tasks, with a processor and a folder of its own."""

    def __init__(self, make: Perform) -> None:
        limit_threads(1)
        self._make = make
        self._folder = tempfile.TemporaryDirectory(prefix="jaxplore-")

    def ready(self) -> tuple[Result, ...]:
        """Return, without results, when the worker can be given something."""
        return ()

    def run(self, batch: Batch, files: Files) -> tuple[Result, ...]:
        """Return what tasks come to."""
        folder = Path(self._folder.name) / batch[0].content
        if not folder.is_dir():
            # Whole or not at all: the next run would take what is there for the map.
            unfinished = Path(tempfile.mkdtemp(dir=self._folder.name))
            for name, data in files.items():
                (unfinished / name).write_bytes(data)
            unfinished.rename(folder)
        here = tuple(dataclasses.replace(task, copy=str(folder / MAP)) for task in batch)
        return results_for(here, self._make)


def _failure(worker: int, batch: Batch, error: str) -> Event:
    """Return the event that the tasks of a worker have failed."""
    return Event(worker, tuple(result_of(failed_row(task, error)) for task in batch))


def _knock(address: str | None) -> None:
    """Find out at once whether anybody listens at HOST:PORT: Ray would try for minutes."""
    host, separator, port = (address or "").rpartition(":")
    if separator and "/" not in host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE).close()


def _packed(path: str) -> Files:
    """Return the files of a map so that they can lie in any folder."""
    entries, image = read_yaml(Path(path)), image_of(path)
    if image is None:
        return {MAP: Path(path).read_bytes()}
    name = f"map{image.suffix}"
    text = io.StringIO()
    yaml.safe_dump({**entries, "image": name}, text, sort_keys=False, allow_unicode=True)
    return {MAP: text.getvalue().encode(), name: image.read_bytes()}
