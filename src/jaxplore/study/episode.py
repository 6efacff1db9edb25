"""Tasks that run episodes: a variant in a scenario, with one seed or a batch of seeds."""

import abc
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxplore.study.workers.task import Files, Read, Task
from jaxplore.tasks.registry import files_of


@dataclasses.dataclass(frozen=True)
class InputFile:
    """The file of a map, a path or a volume on the user's machine, of a setting of an episode.

    `content` is a hash of its content, with that of a map's image.
    """

    setting: str
    path: str
    content: str

    def read(self) -> Files:
        """Read the file, and what belongs to it, into memory."""
        return files_of(self.setting).pack_file(self.path)

    def in_folder(self, folder: Path) -> str:
        """Return the path of the copy in a folder with the files of `read`."""
        return str(folder / (files_of(self.setting).packed or Path(self.path).name))


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeTask(Task, abc.ABC):
    """Episodes of one scenario that run together.

    A variant is an architecture or any other settings. `file` is that of the map, path or volume
    of the scenario, and `copy` the path of a copy of it on this machine; None without one.
    """

    name: str
    variant: str
    scenario: str
    file: InputFile | None = None
    copy: str | None = None

    @property
    def id(self) -> str:
        """Name of the task."""
        return self.name

    @property
    def group(self) -> tuple[str, str]:
        """Scenario and variant: their closed loop is one compiled program."""
        return self.scenario, self.variant

    @property
    def kind(self) -> str:
        """The variant: in scenarios of the same shape its compiled program is the same."""
        return self.variant

    def files(self) -> Mapping[str, Read]:
        """Return the function that reads the map or path."""
        return {} if self.file is None else {self.file.content: self.file.read}

    def relocate(self, folders: Mapping[str, Path]) -> Task:
        """Return the task with the path of the copy of its map or path."""
        if self.file is None:
            return self
        copy = self.file.in_folder(folders[self.file.content])
        return dataclasses.replace(self, copy=copy)

    @property
    def location(self) -> dict[str, Any]:
        """Setting with the path of the map or path file on this machine; empty without one."""
        if self.file is None:
            return {}
        return {self.file.setting: self.copy or self.file.path}

    def run(self) -> Any:
        """Run the episodes and return their results, or failed results after an error."""
        try:
            return self.measure()
        except Exception as error:
            return self.make_failure(self._with_user_path(one_line(error)))

    @abc.abstractmethod
    def measure(self) -> Any:
        """Run the episodes and return their results; an exception goes to `make_failure`."""

    def _with_user_path(self, reason: str) -> str:
        """Replace the path of the copy in an error message by that of the user's file."""
        if self.copy is None or self.file is None:
            return reason
        return reason.replace(self.copy, self.file.path)


def one_line(error: Exception) -> str:
    """Format an error in one line, with its type unless it is a `ValueError`."""
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
    return " ".join(f"{kind}{error}".split())
