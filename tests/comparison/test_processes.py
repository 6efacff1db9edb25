"""Several processes, some of which are killed, and a Ray cluster: the table is always the same."""

import functools
import importlib
import json
import os
import socket
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplore.study.comparison.execute import Outcome, run_tasks
from jaxplore.study.comparison.job import Runs
from jaxplore.study.comparison.perform import perform
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Asked, Store, open_store
from jaxplore.study.comparison.tasks import Batch, Task, make_tasks
from jaxplore.study.workers.on_ray import RayWorkers

Timeless = Callable[[Store], list[Row]]

FATAL = """
    import os, signal
    from pathlib import Path
    from jaxplore.study.comparison import perform as performing

    original = performing.record_run

    def make(folder, batch):
        marker = Path(folder) / batch[0].id

        def die(_):
            if marker.read_text() == "once":
                marker.unlink()
            os.kill(os.getpid(), signal.SIGKILL)

        options = {"on_progress": die} if marker.exists() else {}
        performing.record_run = lambda *some, **more: original(*some, **more, **options)
        return performing.perform(batch)
"""
"""Runs of which some kill their process, in the middle, once or always."""


@pytest.fixture
def fatal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Batch], tuple[Row, ...]]:
    """Return what makes such runs; where it is, the other processes look for modules too."""
    (tmp_path / "fatal_runs.py").write_text(textwrap.dedent(FATAL))
    monkeypatch.syspath_prepend(tmp_path)
    return functools.partial(importlib.import_module("fatal_runs").make, str(tmp_path))


@pytest.fixture
def whole(
    tmp_path: Path, asked: Asked, tasks: tuple[Task, ...], timeless: Timeless
) -> tuple[Outcome, list[Row]]:
    """What comes of it without any other process."""
    store = open_store(tmp_path / "whole", asked)
    outcome = run_tasks(tasks, store)
    return outcome, timeless(store)


def test_processes_that_are_killed_change_nothing(
    tmp_path: Path,
    asked: Asked,
    tasks: tuple[Task, ...],
    store: Store,
    fatal: Callable[[Batch], tuple[Row, ...]],
    whole: tuple[Outcome, list[Row]],
    timeless: Timeless,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Compiled once: those that come after the killed ones find it there.
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    extra = make_tasks(asked.maps[:1], asked.explorers, (9,), asked.settings)
    for task, times in ((tasks[1], "once"), (tasks[3], "once"), (extra[0], "always")):
        (tmp_path / task.id).write_text(times)
    outcome = run_tasks((*tasks, *extra), store, workers=2, make=fatal)
    assert outcome == (5, 1, 0, False)
    assert os.listdir(tmp_path).count(extra[0].id) == 1
    assert not any((tmp_path / task.id).exists() for task in tasks)
    found = timeless(store)
    assert [row["error"] for row in found if row["seed"] == 9] == [
        "3 workers died of it: killed by SIGKILL"
    ]
    assert [row for row in found if row["seed"] != 9] == whole[1]


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there_is_named_at_once(
    tasks: tuple[Task, ...], store: Store
) -> None:
    with socket.socket() as taken:
        # Nobody listens: it is only kept from others.
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ValueError, match=f"Ray cannot be reached at '{address}'.*accepted"):
            run_tasks(tasks, store, address=address)


def test_a_map_that_is_gone_meanwhile_fails_its_own_runs(tasks: tuple[Task, ...]) -> None:
    workers = object.__new__(RayWorkers)  # without a cluster: nothing is sent
    workers._files, workers._failed = {}, []
    Path(tasks[0].path).unlink()
    workers.give(3, Runs(tasks[:2], perform))
    ((worker, results, death),) = workers.wait()
    assert (worker, death) == (3, None)
    assert [each.id for each in results] == [task.id for task in tasks[:2]]
    assert all(each.error and "east.yaml" in each.error for each in results)


def test_a_cluster_finds_the_same(
    tmp_path: Path,
    small: dict[str, Any],
    asked: Asked,
    whole: tuple[Outcome, list[Row]],
    timeless: Timeless,
) -> None:
    (tmp_path / "small.json").write_text(json.dumps(small))
    command = ["compare", "--maps", str(tmp_path / "maps"), "--explorers", "explorer"]
    command += ["--seeds", "2", "--settings", str(tmp_path / "small.json"), "--ray"]
    command += ["--workers", "2", "--out", str(tmp_path / "ray")]
    for name in ("rates.sensing=10", "rates.fields=5", "resolution=0.1", "target_coverage=0.99"):
        command += ["--set", name]
    # In a process of its own: Ray has warnings, and threads that stay.
    code = "import sys; from jaxplore.cli import main; main(sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, *command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "east: medians [quartiles]" in done.stdout
    store = open_store(tmp_path / "ray")
    own = ("id", "settings")
    assert [{k: v for k, v in row.items() if k not in own} for row in timeless(store)] == [
        {k: v for k, v in row.items() if k not in own} for row in whole[1]
    ]
