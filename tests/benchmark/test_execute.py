"""How tasks are spread over workers, with workers that are none, and runs here."""

import signal
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path

import pytest

from jaxplore.benchmark import execute
from jaxplore.benchmark import perform as performing
from jaxplore.benchmark.crew import Crew, Event
from jaxplore.benchmark.execute import Done, run_tasks
from jaxplore.benchmark.perform import perform, results_for
from jaxplore.benchmark.rows import Row
from jaxplore.benchmark.store import Asked, Store, open_store
from jaxplore.benchmark.tasks import Batch, Task, make_tasks

Pretend = Callable[[Batch], list[Row]]
Die = Callable[[int, Task | None], bool]
Timeless = Callable[[Store], list[Row]]


class Workers(Crew):
    """Workers that do what they are told in turns, and die when the script says so."""

    def __init__(self, number: int, make: Pretend, die: Die) -> None:
        self._number, self._make, self._die = number, make, die
        self._news: deque[Event] = deque()
        self.started, self.given, self.closed = 0, list[tuple[int, Batch]](), False

    @property
    def size(self) -> int:
        return self._number

    def start(self) -> None:
        worker, self.started = self.started, self.started + 1
        self._news.append(Event(worker, death="never ready" if self._die(worker, None) else None))

    def give(self, worker: int, batch: Batch) -> None:
        self.given.append((worker, batch))
        dies = self._die(worker, batch[0])
        self._news.append(
            Event(worker, death="killed by SIGKILL")
            if dies
            else Event(worker, results_for(batch, self._make))
        )

    def wait(self) -> list[Event]:
        return [self._news.popleft()]

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def many(asked: Asked) -> tuple[Task, ...]:
    return make_tasks(asked.maps, ("explorer", "portfolio"), range(4), asked.settings)


def spread(
    tasks: tuple[Task, ...],
    store: Store,
    pretend: Pretend,
    monkeypatch: pytest.MonkeyPatch,
    die: Die = lambda *_: False,
    number: int = 2,
) -> tuple[Workers, execute.Outcome]:
    made: list[Workers] = []

    def crew(number: int, make: Pretend) -> Workers:
        made.append(Workers(number, make, die))
        return made[-1]

    monkeypatch.setattr(execute, "Processes", crew)
    outcome = run_tasks(tasks, store, workers=number, make=pretend)
    assert made[-1].closed
    return made[-1], outcome


def test_workers_keep_to_a_map_and_explorer(
    many: tuple[Task, ...], store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew, outcome = spread(many, store, pretend, monkeypatch)
    assert outcome == (16, 0, 0, False)
    assert crew.started == 2
    for worker in range(2):
        groups = [task.group for each, (task,) in crew.given if each == worker]
        assert len(set(groups)) == 2
        assert groups == sorted(groups)
        # The same explorer on the next map: of the same shape, its loop is there.
        assert len({explorer for _, explorer in groups}) == 1
    assert [row["id"] for row in store.rows(["id"])] == [task.id for task in many]


def test_no_more_workers_than_tasks(
    many: tuple[Task, ...], store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew, _ = spread(many[:3], store, pretend, monkeypatch, number=8)
    assert crew.started == 3


def test_a_death_costs_one_run_that_is_made_again(
    many: tuple[Task, ...], store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    fatal = [many[0], many[5], many[5]]

    def die(_: int, task: Task | None) -> bool:
        is_fatal = task in fatal
        if task is not None and is_fatal:
            fatal.remove(task)
        return is_fatal

    crew, outcome = spread(many, store, pretend, monkeypatch, die)
    assert outcome == (16, 0, 0, False)
    times = [sum(task == each for _, (task,) in crew.given) for each in many]
    assert times == [2, 1, 1, 1, 1, 3, *[1] * 10]
    assert crew.started == 5
    assert store.rows() == pretend(many)


def test_a_task_of_which_three_workers_die_has_failed(
    many: tuple[Task, ...], store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew, outcome = spread(many, store, pretend, monkeypatch, lambda _, task: task == many[6])
    assert outcome == (16, 1, 0, False)
    died = [worker for worker, (task,) in crew.given if task == many[6]]
    assert len(died) == len(set(died)) == 3
    failed = {row["id"]: row["error"] for row in store.rows(["id", "error"]) if row["error"]}
    assert failed == {many[6].id: "3 workers died of it: killed by SIGKILL"}


def test_workers_that_never_start_are_not_started_for_ever(
    many: tuple[Task, ...], store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ChildProcessError, match="workers do not start: never ready"):
        spread(many, store, pretend, monkeypatch, lambda _, task: task is None)
    assert store.results.exists()
    # One that does not does no harm.
    crew, outcome = spread(many, store, pretend, monkeypatch, lambda worker, task: worker == 0)
    assert outcome == (16, 0, 0, False)
    assert crew.started == 3


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
    asked: Asked, store: Store, pretend: Pretend, monkeypatch: pytest.MonkeyPatch
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
    crew, outcome = spread(tasks, store, pretend, monkeypatch, die)
    assert outcome == (6, 0, 1, False)
    given = [[task.seed for task in batch] for _, batch in crew.given]
    assert sorted(given) == [[1, 2], [3, 5], [3, 5], [6, 7]]
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
