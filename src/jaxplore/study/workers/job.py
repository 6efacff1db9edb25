"""What a worker is given to do."""

import abc
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

Files = dict[str, bytes]
"""What is in the files of a folder, by their names."""

Read = Callable[[], Files]
"""Reads files from this machine's disk. Raises OSError or ValueError where that cannot be done."""


class Job(abc.ABC):
    """Something to do that can be sent to another process: what it is made of can be pickled.

    Its module is found there by its name.
    """

    @property
    @abc.abstractmethod
    def id(self) -> str:
        """What it is known by: the workers that die of it are counted by that."""

    @property
    @abc.abstractmethod
    def group(self) -> Hashable:
        """Jobs of one group run the same compiled program; a worker keeps to it."""

    @property
    def kind(self) -> Hashable:
        """Where a group comes to its end, a worker prefers another one of the same kind."""
        return self.group

    def files(self) -> Mapping[str, Read]:
        """Return what reads the files that it needs, by a key of their content.

        A machine without this disk is sent them, once for each key.
        """
        return {}

    def located(self, folders: Mapping[str, Path]) -> "Job":
        """Return the same job with its files in other folders.

        Args:
            folders: by the keys of `files`.
        """
        return self

    @abc.abstractmethod
    def run(self) -> Any:
        """Do it and return the answer. What goes wrong is an answer too.

        Raises:
            KeyboardInterrupt: the user stopped it.
        """

    @abc.abstractmethod
    def failed(self, reason: str) -> Any:
        """Return the answer where workers died of it or its files cannot be read.

        Args:
            reason: in a few words.
        """
