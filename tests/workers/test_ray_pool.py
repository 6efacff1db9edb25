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

from jaxplore.study.runner import Runner
from jaxplore.study.workers import ray_pool
from jaxplore.study.workers.ray_pool import RayPool

Done = Callable[[Any, list[Any]], dict[str, Any]]

ROUNDS = """
    import importlib, json, os, shutil, signal, sys
    from pathlib import Path
    from jaxplore.study.runner import Runner
    from jaxplore.study.workers import scheduler

    def family():
        '''Return the processes of this user that this one has started, and itself.'''
        parents = {}
        for each in Path("/proc").glob("[0-9]*/stat"):
            try:
                parents[int(each.parent.name)] = int(each.read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue  # it has ended
        found = {os.getpid()}
        while more := {each for each, parent in parents.items() if parent in found} - found:
            found |= more
        return found

    def listening():
        '''Return the addresses of the sockets on which these processes listen, as hex digits.'''
        own = set()
        for process in family():
            for each in Path(f"/proc/{process}/fd").glob("*"):
                try:
                    own.add(os.readlink(each))
                except OSError:
                    continue  # it was closed
        lines = [
            line.split()
            for name in ("tcp", "tcp6")
            for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
        ]
        # 0A is the state of a socket that listens.
        return [
            each[1].partition(":")[0]
            for each in lines
            if each[3] == "0A" and f"socket:[{each[9]}]" in own
        ]

    module, top, one, two, three = sys.argv[1:]
    tasks = importlib.import_module(module)
    found = []

    def do(some):
        results = {}
        runner.run(some, lambda task, result: results.setdefault(task.id, result))
        found.append(results)
        return {each.get("process") for each in results.values()}

    with Runner(2, on_ray=True) as runner:
        do(tasks.meeting(top, "first", one, two))
        sockets = listening()
        # What is gone here was sent before, or fails its own tasks.
        shutil.rmtree(one)
        shutil.rmtree(three)
        gone = tasks.Doubled("gone", three)
        workers = do([*tasks.meeting(top, "second", one, two), gone, tasks.Doubled("more", two)])
        scheduler.MAX_DEATHS = 1
        os.kill(max(workers - {None}), signal.SIGKILL)
        do(tasks.meeting(top, "third", one, two))
        scheduler.MAX_DEATHS = 3
        fatal = os.path.join(top, "fatal")
        open(fatal, "w").close()
        do([tasks.Doubled("fatal", two, fatal), *tasks.meeting(top, "fourth", one, two)])
    print(json.dumps([sockets, *found]))
"""


def test_workers_of_a_cluster_do_what_this_process_does(
    tmp_path: Path, tasks: ModuleType, folders: list[Path], done: Done
) -> None:
    here = done(Runner(1), [tasks.Doubled(each.name, str(each)) for each in folders])
    double = [here[each.name]["double"] for each in folders]
    # In a process of its own: Ray has warnings, and threads that stay.
    command = [sys.executable, "-c", textwrap.dedent(ROUNDS), tasks.__name__, str(tmp_path)]
    command += map(str, folders)
    # Its workers find modules where their environment says.
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    sockets, *rounds = json.loads(run.stdout.splitlines()[-1])
    # At least the head, the node and both workers, and nobody listens where others could reach it.
    assert len(sockets) >= 4 or sys.platform != "linux"
    assert set(sockets) <= {"0100007F", "0000000000000000FFFF00000100007F"}
    gone = rounds[1].pop("gone")
    assert gone["double"] is None
    assert str(folders[2]) in gone["reason"]
    assert rounds[1].pop("more")["double"] == double[1]
    assert rounds[3].pop("fatal")["double"] == double[1]
    for name, results in zip(("first", "second", "third", "fourth"), rounds, strict=True):
        assert set(results) == {f"{name}-0", f"{name}-1"}
        assert [results[f"{name}-{i}"]["double"] for i in range(2)] == double[:2]
        assert not any(each["is alone"] for each in results.values())
        # They read copies of their own, on one processor each.
        assert not {each["folder"] for each in results.values()} & set(map(str, folders))
        assert {each["threads"] for each in results.values()} == {"1"}
    assert not (tmp_path / "fatal").exists()
    workers = [{each["process"] for each in results.values()} for results in rounds]
    assert workers[0] == workers[1]
    assert all(len(each) == 2 for each in workers)
    assert workers[2] & workers[1] == {min(workers[1])}
    assert len(workers[3] & workers[2]) == 1


def test_files_that_are_gone_fail_their_own_tasks(tasks: ModuleType, folders: list[Path]) -> None:
    workers = object.__new__(RayPool)  # without a cluster: nothing is sent
    workers._files, workers._failed = {}, []
    (folders[0] / "number").unlink()
    folders[0].rmdir()
    workers.submit(3, tasks.Doubled("a", str(folders[0])))
    ((worker, result, death),) = workers.wait()
    assert (worker, death) == (3, None)
    assert result["double"] is None
    assert str(folders[0]) in result["reason"]


def test_a_folder_is_written_whole_or_not_at_all(
    tasks: ModuleType, folders: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_pool, "limit_threads", lambda _: None)
    task = tasks.Doubled("a", str(folders[2]))
    worker = ray_pool._Worker(pickle.dumps(task))
    files = {"number": b"3", "more": b""}
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "more":
            raise OSError("no space left")
        return write(path, data)

    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="no space left"):
            worker.run(task, ["three"], files)
    result = worker.run(task, ["three"], files)
    assert result["double"] == 6
    found = {each.name: each.read_bytes() for each in Path(result["folder"]).iterdir()}
    assert found == files
    # Once is enough.
    monkeypatch.setattr(Path, "write_bytes", lambda *_: pytest.fail("written again"))
    assert worker.run(task, ["three"], files)["folder"] == result["folder"]
    worker._top.cleanup()
