"""What becomes of tasks, with workers that are none, and of runs here."""

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jaxplore.study.comparison import execute
from jaxplore.study.comparison import perform as performing
from jaxplore.study.comparison.execute import Done, run_tasks
from jaxplore.study.comparison.job import Runs
from jaxplore.study.comparison.perform import perform
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Asked, Store, open_store
from jaxplore.study.comparison.tasks import Batch, Task, make_tasks
from jaxplore.study.workers import pool

Pretend = Callable[[Batch], list[Row]]
Die = Callable[[int, Task | None], bool]
Spread = Callable[..., tuple[list[tuple[int, Runs]], execute.Outcome]]
Timeless = Callable[[Store], list[Row]]


@pytest.fixture
def many(asked: Asked) -> tuple[Task, ...]:
    return make_tasks(asked.maps, ("explorer", "portfolio"), range(4), asked.settings)


@pytest.fixture
def spread(scripted: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Spread:
    def run(
        tasks: tuple[Task, ...], store: Store, make: Pretend, die: Die
    ) -> tuple[list[tuple[int, Runs]], execute.Outcome]:
        """Run tasks on two workers and return who was given what; they are closed in any case."""
        crew = scripted(2, lambda worker, runs: die(worker, runs and runs.batch[0]))
        monkeypatch.setattr(pool, "Processes", lambda _: crew)
        try:
            outcome = run_tasks(tasks, store, workers=2, make=make)
        finally:
            assert crew.closed
        return crew.given, outcome

    return run


def test_a_task_of_which_three_workers_die_has_failed(
    many: tuple[Task, ...], store: Store, pretend: Pretend, spread: Spread
) -> None:
    given, outcome = spread(many, store, pretend, lambda _, task: task == many[6])
    assert outcome == (16, 1, 0, False)
    died = [worker for worker, runs in given if runs.batch == (many[6],)]
    assert len(died) == len(set(died)) == 3
    failed = {row["id"]: row["error"] for row in store.rows(["id", "error"]) if row["error"]}
    assert failed == {many[6].id: "3 workers died of it: killed by SIGKILL"}


def test_workers_that_never_start_are_not_started_for_ever(
    many: tuple[Task, ...], store: Store, pretend: Pretend, spread: Spread
) -> None:
    with pytest.raises(ChildProcessError, match="workers do not start: never ready"):
        spread(many, store, pretend, lambda _, task: task is None)
    assert store.results.exists()


def test_it_goes_on_where_it_was_and_tries_again_what_failed(
    many: tuple[Task, ...], store: Store, asked: Asked, pretend: Pretend
) -> None:
    calls: list[Task] = []
    shown: list[Done] = []

    def fragile(batch: Batch) -> list[Row]:
        calls.extend(batch)
        if batch == (many[2],) and len(calls) < 5:
            raise ValueError("not now")
        return pretend(batch)

    assert run_tasks(many[:4], store, on_done=shown.append, make=fragile) == (4, 1, 0, False)
    assert calls == list(many[:4])
    assert [(each.num_done, each.num_left, each.error) for each in shown] == [
        (1, 4, None),
        (2, 4, None),
        (3, 4, "not now"),
        (4, 4, None),
    ]
    again = open_store(store.folder, asked)
    assert run_tasks(many[:6], again, make=fragile) == (3, 0, 3, False)
    assert calls[4:] == [many[2], *many[4:6]]
    assert run_tasks(many[:6], again, make=fragile) == (0, 0, 6, False)
    assert store.rows() == pretend(many[:6])


def test_ctrl_c_keeps_what_is_done_and_the_rest_gives_the_same_table(
    tasks: tuple[Task, ...], store: Store, asked: Asked, timeless: Timeless, tmp_path: Path
) -> None:
    def third(batch: Batch) -> tuple[Row, ...]:
        if batch == (tasks[2],):
            raise KeyboardInterrupt
        return perform(batch)

    assert run_tasks(tasks, store, make=third) == (2, 0, 0, True)
    found = timeless(store)
    assert [row["id"] for row in found] == [task.id for task in tasks[:2]]
    again = open_store(store.folder, asked)
    # Also where a key is pressed between two runs. What is started in the background ignores it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        first = run_tasks(tasks, again, on_done=lambda _: signal.raise_signal(signal.SIGINT))
    finally:
        signal.signal(signal.SIGINT, before)
    assert first == (1, 0, 2, True)
    assert run_tasks(tasks, open_store(store.folder, asked)) == (1, 0, 3, False)
    whole = open_store(tmp_path / "whole", asked)
    assert run_tasks(tasks, whole) == (4, 0, 0, False)
    assert timeless(again) == timeless(whole)
    assert timeless(whole)[:2] == found
    assert len({tuple(row["positions_x"]) for row in timeless(whole)}) == 4


def test_a_run_that_is_stopped_is_no_run(
    tasks: tuple[Task, ...], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, calls = performing.record_run, []

    def pressed(*arguments: object, **options: object) -> object:
        calls.append(arguments)
        press = len(calls) == 2
        return original(
            *arguments,  # type: ignore[arg-type]
            **options,  # type: ignore[arg-type]
            on_progress=lambda _: signal.raise_signal(signal.SIGINT) if press else None,
        )

    monkeypatch.setattr(performing, "record_run", pressed)
    assert run_tasks(tasks, store) == (1, 0, 0, True)
    assert [row["id"] for row in store.rows(["id"])] == [tasks[0].id]


def test_maps_that_cannot_be_read_fail_alone(
    tasks: tuple[Task, ...], store: Store, asked: Asked
) -> None:
    Path(tasks[0].path).with_suffix(".pgm").unlink()
    assert run_tasks(tasks, store) == (4, 2, 0, False)
    errors = [row["error"] for row in store.rows(["error"])]
    assert errors[2:] == [None, None]
    assert all("image is 'east.pgm', which is not there" in each for each in errors[:2])


def test_what_is_left_of_a_batch_is_done_together(
    asked: Asked, store: Store, pretend: Pretend, spread: Spread
) -> None:
    tasks = make_tasks(asked.maps[:1], asked.explorers, range(1, 8), asked.settings, 3)
    run_tasks(tasks[3:4], store, make=pretend)
    fatal = [tasks[2]]

    def die(_: int, task: Task | None) -> bool:
        is_fatal = task in fatal
        if is_fatal:
            fatal.clear()
        return is_fatal

    shown: list[Done] = []
    given, outcome = spread(tasks, store, pretend, die)
    assert outcome == (6, 0, 1, False)
    seeds = [[task.seed for task in runs.batch] for _, runs in given]
    assert sorted(seeds) == [[1, 2], [3, 5], [3, 5], [6, 7]]
    assert store.rows() == pretend(tasks)
    again = make_tasks(asked.maps[1:], asked.explorers, range(2), asked.settings, 2)
    run_tasks(again, store, on_done=shown.append, make=pretend)
    assert [(each.task, each.num_done, each.num_left) for each in shown] == [
        (again[0], 1, 2),
        (again[1], 2, 2),
    ]


@pytest.mark.parametrize("number", [0, -1])
def test_a_number_of_workers_is_named(tasks: tuple[Task, ...], store: Store, number: int) -> None:
    with pytest.raises(ValueError, match=f"workers is {number}; accepted: a whole number >= 1"):
        run_tasks(tasks, store, workers=number)


def test_packages_that_are_missing_are_named(
    tasks: tuple[Task, ...], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(
        ValueError, match=r"ray is not installed.*install 'jaxplore\[distributed\]'"
    ):
        run_tasks(tasks, store, on_ray=True)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ValueError, match=r"pyarrow is not installed.*'jaxplore\[benchmark\]'"):
        run_tasks(tasks, store)
