"""What tests share."""

import os
import pickle
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import hypothesis
import jax.numpy as jnp
import pytest

import jaxplore
from jaxplore.cli import main
from jaxplore.study.workers.pool import Event, WorkerPool
from jaxplore.study.workers.task import Task

# No test depends on a duration: the machine is shared, and the first call compiles.
hypothesis.settings.register_profile(
    "jaxplore", deadline=None, max_examples=50, derandomize=True, print_blob=True
)
hypothesis.settings.load_profile("jaxplore")


@pytest.fixture(scope="session")
def ros_maps() -> Path:
    """Return the folder of real ROS maps, which the repository does not copy."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "maps"
    folder = Path(os.environ.get("JAXPLORE_MAPS", beside))
    if not folder.is_dir():
        pytest.skip(f"no ROS maps at {folder}: set JAXPLORE_MAPS")
    return folder


def files_here() -> list[str]:
    """Return the files of the current folder, without the byte code of modules in it."""
    return sorted(name for name in os.listdir() if name != "__pycache__")


@pytest.fixture
def fails(capsys: pytest.CaptureFixture[str]):
    """Return what runs a command that must fail as users' mistakes do, one line, exit code 2 and
    nothing written, and returns the line."""

    def run(*arguments: str) -> str:
        before = files_here()
        with pytest.raises(SystemExit) as exit_:
            main(arguments)
        captured = capsys.readouterr()
        assert exit_.value.code == 2
        assert captured.out == ""
        assert captured.err.startswith("jaxplore: ")
        assert captured.err.count("\n") == 1
        assert files_here() == before
        return captured.err

    return run


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the settings of the runs that are asked for: each fails when it is to be built."""
    result = list[Any]()

    def note(settings: Any) -> None:
        result.append(settings)
        raise ValueError("enough")

    monkeypatch.setattr("jaxplore.cli._run.build", note)
    return result


@pytest.fixture(scope="session")
def empty_belief():
    """Return a belief of a free map, for controllers whose costs do not read it."""
    lidar = jaxplore.Lidar(num_beams=8, max_range=1.0)
    perception = jaxplore.Perception(lidar, 0.5, 0.2, num_directions=4)
    grid = jaxplore.OccupancyGrid(jnp.zeros((8, 8)), 0.5)
    return eqx.filter_jit(perception.init)(grid, jnp.asarray([2.0, 2.0, 0.0]))


class Scripted(WorkerPool):
    """Workers that do what they are told in turns, and die when the script says so: of a task, or,
    told None, when they are started or asked."""

    def __init__(self, number: int, die: Callable[[int, Task | None], bool]) -> None:
        self._number, self._die = number, die
        self._news: deque[Event] = deque()
        self.started, self.given, self.closed = 0, list[tuple[int, Task]](), False

    @property
    def size(self) -> int:
        return self._number

    def start(self, example: Task) -> None:
        worker, self.started = self.started, self.started + 1
        self.ping(worker)

    def ping(self, worker: int) -> None:
        death = "never ready" if self._die(worker, None) else None
        self._news.append(Event(worker, death=death))

    def submit(self, worker: int, task: Task) -> None:
        self.given.append((worker, task))
        is_fatal = self._die(worker, task)
        self._news.append(
            Event(worker, death="killed by SIGKILL") if is_fatal else Event(worker, task.run())
        )

    def wait(self) -> list[Event]:
        return [self._news.popleft()]

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def scripted() -> type[Scripted]:
    """Return workers without processes."""
    return Scripted


class Posted(Scripted):
    """Two workers that get tasks and give results by pickle, as other processes do."""

    def __init__(self) -> None:
        super().__init__(2, lambda *_: False)

    def submit(self, worker: int, task: Task) -> None:
        self.given.append((worker, task))
        result = pickle.loads(pickle.dumps(task)).run()
        self._news.append(Event(worker, pickle.loads(pickle.dumps(result))))


@pytest.fixture
def posted(monkeypatch: pytest.MonkeyPatch) -> Posted:
    """Return the workers of runners in this test: a process takes seconds to import and compile,
    and those of the library are tested in `workers` and `comparison`."""
    pool = Posted()
    monkeypatch.setattr("jaxplore.study.runner.ProcessPool", lambda _: pool)
    return pool
