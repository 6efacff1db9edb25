"""The protocol of a task: work that can be sent to another process."""

import abc
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

import jax

Files = dict[str, bytes]
"""Content of the files of a folder, by file name."""

Read = Callable[[], Files]
"""Function that reads files from the disk of this machine, or raises OSError or ValueError."""

MAX_MEMORY_MAPS = 20_000
"""Number of memory mappings of a process above which its compiled programs are dropped. Linux
allows 65530 and each program takes hundreds; without a free one the next compilation crashes."""


class Task(abc.ABC):
    """Work that can be sent to another process.

    Its fields must be picklable. The other process imports its module by name.
    """

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """Unique name, by which the deaths of its workers are counted."""

    @property
    @abc.abstractmethod
    def group(self) -> Hashable:
        """Group of tasks that run the same compiled program. A worker stays with its group."""

    @property
    def kind(self) -> Hashable:
        """Kind of groups with similar programs. After its group a worker prefers a group of the
        same kind."""
        return self.group

    def files(self) -> Mapping[str, Read]:
        """Return functions that read the task's files, by a hash of their content.

        Another machine receives the content once for each hash.
        """
        return {}

    def relocate(self, folders: Mapping[str, Path]) -> "Task":
        """Return the task with its files in other folders, by the keys of `files`."""
        return self

    @abc.abstractmethod
    def run(self) -> Any:
        """Run the task and return the result. A failure is a result too."""

    @abc.abstractmethod
    def make_failure(self, reason: str) -> Any:
        """Return the result of a failed task, which killed its workers or has unreadable files."""


def run_task(task: Task) -> Any:
    """Run a task in this process; drop compiled programs first if memory mappings run out."""
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MAX_MEMORY_MAPS:
        jax.clear_caches()  # type: ignore[no-untyped-call]
    return task.run()
