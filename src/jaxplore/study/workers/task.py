"""A task: work that can be sent to another process."""

import abc
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

import jax

Files = dict[str, bytes]
"""Content of the files of a folder, by file name."""

Read = Callable[[], Files]
"""Reads files from the disk of this machine. Raises OSError or ValueError if that fails."""

MAX_MEMORY_MAPS = 20_000
"""Memory mappings of a process above which its compiled programs are dropped. Linux allows 65530
and each program takes hundreds; without any left the next compilation crashes."""


class Task(abc.ABC):
    """Work that can be sent to another process.

    Its fields can be pickled. The other process imports its module by name.
    """

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """Unique name. Workers that die while they run a task are counted by it."""

    @property
    @abc.abstractmethod
    def group(self) -> Hashable:
        """Tasks of one group run the same compiled program. A worker stays with its group."""

    @property
    def kind(self) -> Hashable:
        """Groups of one kind have similar programs. When a group is finished, its worker prefers
        another group of the same kind."""
        return self.group

    def files(self) -> Mapping[str, Read]:
        """Return functions that read the files that the task needs, by a hash of their content.

        A machine without this disk receives them, once for each hash.
        """
        return {}

    def located(self, folders: Mapping[str, Path]) -> "Task":
        """Return the same task with its files in other folders.

        Args:
            folders: folders by the keys of `files`.
        """
        return self

    @abc.abstractmethod
    def run(self) -> Any:
        """Run it and return the result. A failure is a result too.

        Raises:
            KeyboardInterrupt: the user stopped it.
        """

    @abc.abstractmethod
    def failed(self, reason: str) -> Any:
        """Return the result of a task that killed its workers or whose files cannot be read.

        Args:
            reason: a few words.
        """


def run_task(task: Task) -> Any:
    """Run a task in this process, after making sure that there is memory to compile.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MAX_MEMORY_MAPS:
        jax.clear_caches()  # type: ignore[no-untyped-call]
    return task.run()
