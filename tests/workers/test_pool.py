"""Pools of processes, some of which are killed, and of this process alone."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import pytest

from jaxplore.study.workers import answer as answering
from jaxplore.study.workers import pool as pools
from jaxplore.study.workers import spread as spreading
from jaxplore.study.workers.crew import num_processors
from jaxplore.study.workers.pool import Pool

Done = Callable[[Any, list[Any]], dict[str, Any]]


def is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_stay_until_they_are_killed_or_the_pool_is_closed(
    tmp_path: Path,
    jobs: ModuleType,
    folders: list[Path],
    done: Done,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("NPROC", raising=False)
    with Pool(2) as pool:

        def meet(name: str) -> set[int]:
            answers = done(pool, jobs.meeting(tmp_path, name, *folders[:2]))
            assert [answers[f"{name}-{i}"]["double"] for i in range(2)] == [2, 4]
            assert not any(each["is alone"] for each in answers.values())
            threads = {each["threads"] for each in answers.values()}
            assert threads == {str(max(1, num_processors() // 2))}
            return {each["process"] for each in answers.values()}

        first = meet("first")
        assert len(first) == 2
        assert os.getpid() not in first
        assert meet("second") == first
        # Between two rounds no job is to be blamed: it would have failed at once.
        killed, kept = first
        os.kill(killed, signal.SIGKILL)
        with monkeypatch.context() as strict:
            strict.setattr(spreading, "MOST_DEATHS", 1)
            third = meet("third")
        assert third & first == {kept}
        assert len(third) == 2
        # Within a round it costs the job at which it was.
        fatal = tmp_path / "fatal"
        fatal.touch()
        some = [jobs.Doubled("fatal", str(folders[2]), str(fatal))]
        some += jobs.meeting(tmp_path, "fourth", *folders[:2])
        answers = done(pool, some)
        assert {name: each["double"] for name, each in answers.items()} == {
            "fatal": 6,
            "fourth-0": 2,
            "fourth-1": 4,
        }
        assert not fatal.exists()
        fifth = meet("fifth")
        assert len(fifth & third) == 1
    assert not any(map(is_there, first | third | fifth))
    with pytest.raises(ValueError, match="pool is closed; accepted: a new one"):
        pool.do(some, lambda *_: None)


def test_what_stops_a_round_ends_its_processes(
    tmp_path: Path, jobs: ModuleType, folders: list[Path]
) -> None:
    ours, theirs = str(tmp_path / "ours"), str(tmp_path / "theirs")
    # One is at a job that does not come to its end.
    waiting = jobs.Doubled("waiting", str(folders[0]), others=(theirs, "/nowhere"))
    quick = jobs.Doubled("quick", str(folders[1]), others=(ours, theirs))
    seen: list[str] = []

    def stop(job: Any, _: Any) -> None:
        seen.append(job.id)
        signal.raise_signal(signal.SIGINT)

    pool = Pool(2)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            pool.do([waiting, quick], stop)
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == ["quick"]
    assert not any(is_there(int(Path(each).read_text())) for each in (ours, theirs))
    with pytest.raises(ValueError, match="pool is closed"):
        pool.do([quick], stop)
    pool.close()


def test_what_jobs_need_is_there_before_a_worker_is_ready(
    tmp_path: Path, jobs: ModuleType, folders: list[Path]
) -> None:
    (tmp_path / f"{jobs.__name__}.py").unlink()
    # No job is to be blamed: a worker that cannot import what it is to do has not started.
    with pytest.raises(ChildProcessError, match="workers do not start: exit code 1"):
        Pool(2).do([jobs.Doubled("any", str(folders[0]))], lambda *_: None)


def test_one_does_jobs_here_in_order(
    tmp_path: Path,
    jobs: ModuleType,
    folders: list[Path],
    done: Done,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pools, "Processes", lambda _: pytest.fail("started"))
    some = [jobs.Doubled(name, str(folders[i])) for i, name in enumerate(("c", "a", "b"))]
    with Pool() as pool:
        for _ in range(2):
            answers = done(pool, some)
            assert list(answers) == ["c", "a", "b"]
            assert [each["double"] for each in answers.values()] == [2, 4, 6]
            assert {each["process"] for each in answers.values()} == {os.getpid()}
    with pytest.raises(ValueError, match="pool is closed"):
        pool.do(some, lambda *_: None)
    # Where nothing is to be done, nothing is started.
    with Pool(2) as pool:
        assert done(pool, []) == {}


def test_the_number_of_processes_changes_no_answer(
    jobs: ModuleType, folders: list[Path], done: Done
) -> None:
    some = [jobs.Doubled(f"{i}-{each.name}", str(each)) for each in folders for i in range(4)]
    found = []
    for number in (1, 2):
        with Pool(number) as pool:
            answers = done(pool, some)
        found.append({name: answers[name]["double"] for name in sorted(answers)})
    assert found[0] == found[1]
    assert len(found[0]) == 12


@pytest.mark.parametrize("number", [0, -1])
def test_a_number_of_workers_is_named(number: int) -> None:
    with pytest.raises(ValueError, match=f"workers is {number}; accepted: a whole number >= 1"):
        Pool(number)


def test_programs_are_forgotten_before_memory_runs_out(
    jobs: ModuleType, folders: list[Path], done: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(jax, "clear_caches", lambda: calls.append("forgotten"))
    job = jobs.Doubled("a", str(folders[0]))
    for most, times in ((10**9, 0), (0, 1)):
        monkeypatch.setattr(answering, "MOST_MAPPINGS", most)
        done(Pool(1), [job])
        assert len(calls) == (times if Path("/proc/self/maps").exists() else 0)
