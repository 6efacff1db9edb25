"""Workers of a Ray cluster: files that are sent, rounds, and workers that are killed."""

import json
import os
import pickle
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from jaxplore.study.workers import on_ray
from jaxplore.study.workers.on_ray import RayWorkers
from jaxplore.study.workers.pool import Pool

Done = Callable[[Any, list[Any]], dict[str, Any]]

ROUNDS = """
    import importlib, json, os, shutil, signal, sys
    from jaxplore.study.workers import spread
    from jaxplore.study.workers.pool import Pool

    module, top, one, two, three = sys.argv[1:]
    jobs = importlib.import_module(module)
    found = []

    def do(some):
        answers = {}
        pool.do(some, lambda job, answer: answers.setdefault(job.id, answer))
        found.append(answers)
        return {each.get("process") for each in answers.values()}

    with Pool(2, on_ray=True) as pool:
        do(jobs.meeting(top, "first", one, two))
        # What is gone here was sent before, or fails its own jobs.
        shutil.rmtree(one)
        shutil.rmtree(three)
        gone = jobs.Doubled("gone", three)
        workers = do([*jobs.meeting(top, "second", one, two), gone, jobs.Doubled("more", two)])
        spread.MOST_DEATHS = 1
        os.kill(max(workers - {None}), signal.SIGKILL)
        do(jobs.meeting(top, "third", one, two))
        spread.MOST_DEATHS = 3
        fatal = os.path.join(top, "fatal")
        open(fatal, "w").close()
        do([jobs.Doubled("fatal", two, fatal), *jobs.meeting(top, "fourth", one, two)])
    print(json.dumps(found))
"""


def test_workers_of_a_cluster_do_what_this_process_does(
    tmp_path: Path, jobs: ModuleType, folders: list[Path], done: Done
) -> None:
    here = done(Pool(1), [jobs.Doubled(each.name, str(each)) for each in folders])
    double = [here[each.name]["double"] for each in folders]
    # In a process of its own: Ray has warnings, and threads that stay.
    command = [sys.executable, "-c", textwrap.dedent(ROUNDS), jobs.__name__, str(tmp_path)]
    command += map(str, folders)
    # Its workers find modules where their environment says.
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    rounds = json.loads(run.stdout.splitlines()[-1])
    gone = rounds[1].pop("gone")
    assert gone["double"] is None
    assert str(folders[2]) in gone["reason"]
    assert rounds[1].pop("more")["double"] == double[1]
    assert rounds[3].pop("fatal")["double"] == double[1]
    for name, answers in zip(("first", "second", "third", "fourth"), rounds, strict=True):
        assert set(answers) == {f"{name}-0", f"{name}-1"}
        assert [answers[f"{name}-{i}"]["double"] for i in range(2)] == double[:2]
        assert not any(each["is alone"] for each in answers.values())
        # They read copies of their own, on one processor each.
        assert not {each["folder"] for each in answers.values()} & set(map(str, folders))
        assert {each["threads"] for each in answers.values()} == {"1"}
    assert not (tmp_path / "fatal").exists()
    workers = [{each["process"] for each in answers.values()} for answers in rounds]
    assert workers[0] == workers[1]
    assert all(len(each) == 2 for each in workers)
    assert workers[2] & workers[1] == {min(workers[1])}
    assert len(workers[3] & workers[2]) == 1


def test_files_that_are_gone_fail_their_own_jobs(jobs: ModuleType, folders: list[Path]) -> None:
    workers = object.__new__(RayWorkers)  # without a cluster: nothing is sent
    workers._files, workers._failed = {}, []
    (folders[0] / "number").unlink()
    folders[0].rmdir()
    workers.give(3, jobs.Doubled("a", str(folders[0])))
    ((worker, answer, death),) = workers.wait()
    assert (worker, death) == (3, None)
    assert answer["double"] is None
    assert str(folders[0]) in answer["reason"]


def test_a_folder_is_written_whole_or_not_at_all(
    jobs: ModuleType, folders: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_ray, "limit_threads", lambda _: None)
    job = jobs.Doubled("a", str(folders[2]))
    worker = on_ray._Worker(pickle.dumps(job))
    files = {"number": b"3", "more": b""}
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "more":
            raise OSError("no space left")
        return write(path, data)

    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="no space left"):
            worker.run(job, ["three"], files)
    answer = worker.run(job, ["three"], files)
    assert answer["double"] == 6
    found = {each.name: each.read_bytes() for each in Path(answer["folder"]).iterdir()}
    assert found == files
    # Once is enough.
    monkeypatch.setattr(Path, "write_bytes", lambda *_: pytest.fail("written again"))
    assert worker.run(job, ["three"], files)["folder"] == answer["folder"]
    worker._top.cleanup()
