"""Several processes, some of which are killed, and a Ray cluster: the table is always the same."""

import functools
import importlib
import json
import socket
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplore.study.comparison.compare_maps import RunCounts, run_episodes
from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode
from jaxplore.study.comparison.row_task import RowTask, make_rows
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Plan, Store, open_store
from jaxplore.study.runner import Runner
from jaxplore.study.workers.ray_pool import RayPool

pytestmark = pytest.mark.long

Timeless = Callable[[Store], list[Row]]

FATAL = """
    import os, signal
    from pathlib import Path
    from jaxplore.study import experiments as running
    from jaxplore.study.comparison.row_task import make_rows

    original = running.record_run

    def make(folder, batch):
        marker = Path(folder) / batch[0].id

        def die(_):
            marker.unlink()
            os.kill(os.getpid(), signal.SIGKILL)

        options = {"on_progress": die} if marker.exists() else {}
        running.record_run = lambda *some, **more: original(*some, **more, **options)
        return make_rows(batch)
"""
"""Runs of which some kill their process once, in the middle."""


@pytest.fixture
def fatal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[EpisodeBatch], tuple[Row, ...]]:
    """Return what makes such runs; where it is, the other processes look for modules too."""
    (tmp_path / "fatal_runs.py").write_text(textwrap.dedent(FATAL))
    monkeypatch.syspath_prepend(tmp_path)
    return functools.partial(importlib.import_module("fatal_runs").make, str(tmp_path))


@pytest.fixture
def whole(
    tmp_path: Path, plan: Plan, episodes: tuple[MapEpisode, ...], timeless: Timeless
) -> tuple[RunCounts, list[Row]]:
    """What comes of it without any other process."""
    store = open_store(tmp_path / "whole", plan)
    counts = run_episodes(episodes, store)
    return counts, timeless(store)


def test_processes_that_are_killed_change_nothing(
    tmp_path: Path,
    episodes: tuple[MapEpisode, ...],
    store: Store,
    fatal: Callable[[EpisodeBatch], tuple[Row, ...]],
    whole: tuple[RunCounts, list[Row]],
    timeless: Timeless,
) -> None:
    (tmp_path / episodes[1].id).touch()
    counts = run_episodes(episodes, store, Runner(2), make=fatal)
    assert counts == (4, 0, 0, False)
    assert not (tmp_path / episodes[1].id).exists()
    assert timeless(store) == whole[1]


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there_is_named_at_once(
    episodes: tuple[MapEpisode, ...], store: Store
) -> None:
    with socket.socket() as taken:
        # Nobody listens: it is only kept from others.
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ValueError, match=f"Ray cannot be reached at '{address}'.*accepted"):
            run_episodes(episodes, store, Runner(None, address))


def test_a_map_that_is_gone_meanwhile_fails_its_own_runs(episodes: tuple[MapEpisode, ...]) -> None:
    workers = object.__new__(RayPool)  # without a cluster: nothing is sent
    workers._files, workers._failed = {}, []
    Path(episodes[0].path).unlink()
    workers.submit(3, RowTask.from_episodes(episodes[:2], make_rows))
    ((worker, results, death),) = workers.wait()
    assert (worker, death) == (3, None)
    assert [each.id for each in results] == [episode.id for episode in episodes[:2]]
    assert all(each.error and "east.yaml" in each.error for each in results)


def test_a_cluster_finds_the_same(
    tmp_path: Path,
    small: dict[str, Any],
    plan: Plan,
    whole: tuple[RunCounts, list[Row]],
    timeless: Timeless,
) -> None:
    (tmp_path / "small.json").write_text(json.dumps(small))
    command = ["compare", "--maps", str(tmp_path / "maps"), "--architectures", "explorer"]
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
