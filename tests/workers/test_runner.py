"""Runners: several processes, some of which are killed, and this process alone."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import pytest

from jaxplore.study import runner as running
from jaxplore.study.runner import Runner
from jaxplore.study.workers import scheduler
from jaxplore.study.workers import task as tasking
from jaxplore.study.workers.pool import num_processors

Done = Callable[[Any, list[Any]], dict[str, Any]]


def is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_stay_until_they_are_killed_or_the_runner_is_closed(
    tmp_path: Path,
    tasks: ModuleType,
    folders: list[Path],
    done: Done,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("NPROC", raising=False)
    with Runner(2) as runner:

        def meet(name: str) -> set[int]:
            results = done(runner, tasks.meeting(tmp_path, name, *folders[:2]))
            assert [results[f"{name}-{i}"]["double"] for i in range(2)] == [2, 4]
            assert not any(each["is alone"] for each in results.values())
            threads = {each["threads"] for each in results.values()}
            assert threads == {str(max(1, num_processors() // 2))}
            return {each["process"] for each in results.values()}

        first = meet("first")
        assert len(first) == 2
        assert os.getpid() not in first
        assert meet("second") == first
        # The number of processes changes no answer.
        each_often = [
            tasks.Doubled(f"{i}-{each.name}", str(each)) for each in folders for i in range(4)
        ]
        alone, there = done(Runner(1), each_often), done(runner, each_often)
        assert {name: each["double"] for name, each in there.items()} == {
            name: each["double"] for name, each in alone.items()
        }
        assert len(there) == 12
        # Between two rounds no task is to be blamed: it would have failed at once.
        killed, kept = first
        os.kill(killed, signal.SIGKILL)
        with monkeypatch.context() as strict:
            strict.setattr(scheduler, "MAX_DEATHS", 1)
            third = meet("third")
        assert third & first == {kept}
        assert len(third) == 2
        # Within a round it costs the task at which it was.
        fatal = tmp_path / "fatal"
        fatal.touch()
        some = [tasks.Doubled("fatal", str(folders[2]), str(fatal))]
        some += tasks.meeting(tmp_path, "fourth", *folders[:2])
        results = done(runner, some)
        assert {name: each["double"] for name, each in results.items()} == {
            "fatal": 6,
            "fourth-0": 2,
            "fourth-1": 4,
        }
        assert not fatal.exists()
        fifth = meet("fifth")
        assert len(fifth & third) == 1
    assert not any(map(is_there, first | third | fifth))
    with pytest.raises(ValueError, match="runner is closed; accepted: a new one"):
        runner.run(some, lambda *_: None)


def test_what_stops_a_round_ends_its_processes(
    tmp_path: Path, tasks: ModuleType, folders: list[Path]
) -> None:
    ours, theirs = str(tmp_path / "ours"), str(tmp_path / "theirs")
    # One is at a task that does not come to its end.
    waiting = tasks.Doubled("waiting", str(folders[0]), others=(theirs, "/nowhere"))
    quick = tasks.Doubled("quick", str(folders[1]), others=(ours, theirs))
    seen: list[str] = []

    def stop(task: Any, _: Any) -> None:
        seen.append(task.id)
        signal.raise_signal(signal.SIGINT)

    runner = Runner(2)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            runner.run([waiting, quick], stop)
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == ["quick"]
    assert not any(is_there(int(Path(each).read_text())) for each in (ours, theirs))
    with pytest.raises(ValueError, match="runner is closed"):
        runner.run([quick], stop)
    runner.close()


def test_what_jobs_need_is_there_before_a_worker_is_ready(
    tmp_path: Path, tasks: ModuleType, folders: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    # How many starts may fail is tested without processes.
    monkeypatch.setattr(scheduler, "MAX_FALSE_STARTS", 1)
    (tmp_path / f"{tasks.__name__}.py").unlink()
    # No task is to be blamed: a worker that cannot import what it is to do has not started.
    with pytest.raises(ChildProcessError, match="workers do not start: exit code 1"):
        Runner(2).run([tasks.Doubled("any", str(folders[0]))], lambda *_: None)


def test_one_does_jobs_here_in_order(
    tmp_path: Path,
    tasks: ModuleType,
    folders: list[Path],
    done: Done,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(running, "ProcessPool", lambda _: pytest.fail("started"))
    some = [tasks.Doubled(name, str(folders[i])) for i, name in enumerate(("c", "a", "b"))]
    with Runner() as runner:
        for _ in range(2):
            results = done(runner, some)
            assert list(results) == ["c", "a", "b"]
            assert [each["double"] for each in results.values()] == [2, 4, 6]
            assert {each["process"] for each in results.values()} == {os.getpid()}
    with pytest.raises(ValueError, match="runner is closed"):
        runner.run(some, lambda *_: None)
    # Where nothing is to be done, nothing is started.
    with Runner(2) as runner:
        assert done(runner, []) == {}


@pytest.mark.parametrize("number", [0, -1])
def test_a_number_of_workers_is_named(number: int) -> None:
    with pytest.raises(ValueError, match=f"workers is {number}; accepted: a whole number >= 1"):
        Runner(number)


def test_programs_are_forgotten_before_memory_runs_out(
    tasks: ModuleType, folders: list[Path], done: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(jax, "clear_caches", lambda: calls.append("forgotten"))
    task = tasks.Doubled("a", str(folders[0]))
    for most, times in ((10**9, 0), (0, 1)):
        monkeypatch.setattr(tasking, "MAX_MEMORY_MAPS", most)
        done(Runner(1), [task])
        assert len(calls) == (times if Path("/proc/self/maps").exists() else 0)
