"""Tasks that say where they were done, in a module that other processes find."""

import importlib
import textwrap
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TASKS = """
    import dataclasses
    import functools
    import os
    import signal
    import time
    from pathlib import Path

    from jaxplore.study.workers.task import Task

    def read(folder):
        return {each.name: each.read_bytes() for each in Path(folder).iterdir()}

    @dataclasses.dataclass(frozen=True)
    class Doubled(Task):
        \"\"\"Twice the number in a folder's file.

        Args:
            name: of this task.
            folder: with a file `number`.
            fatal: file; where it is there, the process that does the task removes it and dies.
            others: files; the task makes the first, with its process, and waits for all of them.
        \"\"\"

        name: str
        folder: str
        fatal: str | None = None
        others: tuple[str, ...] = ()

        @property
        def id(self):
            return self.name

        @property
        def group(self):
            return self.folder

        def files(self):
            return {Path(self.folder).name: functools.partial(read, self.folder)}

        def relocate(self, folders):
            (folder,) = folders.values()
            return dataclasses.replace(self, folder=str(folder))

        def run(self):
            if self.fatal is not None and os.path.exists(self.fatal):
                os.unlink(self.fatal)
                os.kill(os.getpid(), signal.SIGKILL)
            if self.others:
                new = Path(self.others[0] + ".new")
                new.write_text(str(os.getpid()))
                new.rename(self.others[0])
            end = time.monotonic() + 60.0  # only a test that fails comes to it
            while not all(map(os.path.exists, self.others)) and time.monotonic() < end:
                time.sleep(0.005)
            return {
                "double": 2 * int((Path(self.folder) / "number").read_text()),
                "is alone": not all(map(os.path.exists, self.others)),
                "folder": self.folder,
                "process": os.getpid(),
                "threads": os.environ.get("NPROC"),
            }

        def make_failure(self, reason):
            return {"double": None, "reason": reason}

    def meeting(folder, name, *numbers):
        \"\"\"Return a task for each folder with a number, which are done at the same time.\"\"\"
        files = [str(Path(folder) / f"{name}-{i}") for i in range(len(numbers))]
        return [
            Doubled(Path(each).name, str(numbers[i]), others=(each, *files))
            for i, each in enumerate(files)
        ]
"""


@pytest.fixture
def tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return a module with tasks; where it is, the other processes look for modules too."""
    # A name of its own: a module that another test has imported is another file's.
    name = "tasks_of_" + "".join(each if each.isalnum() else "_" for each in tmp_path.name)
    (tmp_path / f"{name}.py").write_text(textwrap.dedent(TASKS))
    monkeypatch.syspath_prepend(tmp_path)
    return importlib.import_module(name)


@pytest.fixture
def folders(tmp_path: Path) -> list[Path]:
    """Return folders with the numbers 1, 2 and 3."""
    made = []
    for number, name in enumerate(("one", "two", "three"), start=1):
        made.append(tmp_path / name)
        made[-1].mkdir()
        (made[-1] / "number").write_text(str(number))
    return made


@pytest.fixture
def done() -> Callable[[Any, list[Any]], dict[str, Any]]:
    def do(runner: Any, tasks: list[Any]) -> dict[str, Any]:
        """Return the results to tasks by their ids."""
        results: dict[str, Any] = {}

        def keep(task: Any, result: Any) -> None:
            assert task.id not in results
            results[task.id] = result

        runner.run(tasks, keep)
        return results

    return do
