"""How tasks are scheduler over workers, with workers that are none."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from jaxplore.study.workers.scheduler import Scheduler
from jaxplore.study.workers.task import Task


@dataclasses.dataclass(frozen=True)
class Named(Task):
    """Its result is its name."""

    where: str
    number: int

    @property
    def id(self) -> str:
        return f"{self.where}{self.number}"

    @property
    def group(self) -> str:
        return self.where

    @property
    def kind(self) -> str:
        return self.where[-1]

    def run(self) -> str:
        return self.id

    def make_failure(self, reason: str) -> str:
        return reason


Scheduling = Callable[..., tuple[Scheduler, Any]]
# Two places with two kinds each, sixteen tasks in all.
MANY = tuple(Named(place + kind, i) for place in "EW" for kind in "xy" for i in range(4))


@pytest.fixture
def scheduling(scripted: Callable[..., Any]) -> Scheduling:
    def make(
        number: int = 2, die: Callable[[int, Task | None], bool] = lambda *_: False
    ) -> tuple[Scheduler, Any]:
        pool = scripted(number, die)
        return Scheduler(pool), pool

    return make


def results(scheduler: Scheduler, tasks: Sequence[Named]) -> dict[str, str]:
    """Return the results to tasks by their ids; there is one to each."""
    found: list[tuple[Task, str]] = []
    scheduler.run(tasks, lambda task, result: found.append((task, result)))
    assert len(found) == len(tasks)
    assert {task for task, _ in found} == set(tasks)
    return {task.id: result for task, result in found}


@pytest.mark.parametrize("shorter", ["Ex3", "Ey3"])
def test_workers_keep_to_a_group_and_then_to_its_kind(scheduling: Scheduling, shorter: str) -> None:
    scheduler, pool = scheduling()
    # One of them comes to the end of its group first, and has the choice.
    left_out = {shorter, "Wx2", "Wx3", "Wy2", "Wy3"}
    tasks = [task for task in MANY if task.id not in left_out]
    assert results(scheduler, tasks) == {task.id: task.id for task in tasks}
    assert pool.started == 2
    found = {
        tuple(task.group for each, task in pool.given if each == worker) for worker in range(2)
    }
    assert found == {
        tuple(task.group for task in tasks if task.kind == kind) for kind in ("x", "y")
    }


def test_no_more_workers_than_tasks(scheduling: Scheduling) -> None:
    scheduler, pool = scheduling(8)
    results(scheduler, MANY[:3])
    assert pool.started == 3
    results(scheduler, MANY[:4])
    assert pool.started == 4
    results(scheduler, [])
    assert pool.started == 4


def test_a_death_costs_one_task_that_is_done_again(scheduling: Scheduling) -> None:
    fatal: list[Task | None] = [MANY[0], MANY[5], MANY[5]]

    def die(_: int, task: Task | None) -> bool:
        if is_fatal := task in fatal:
            fatal.remove(task)
        return is_fatal

    scheduler, pool = scheduling(die=die)
    assert results(scheduler, MANY) == {task.id: task.id for task in MANY}
    times = [sum(task == each for _, task in pool.given) for each in MANY]
    assert times == [2, 1, 1, 1, 1, 3, *[1] * 10]
    assert pool.started == 5


def test_a_task_of_which_three_workers_die_has_failed(scheduling: Scheduling) -> None:
    scheduler, pool = scheduling(die=lambda _, task: task == MANY[6])
    reason = "3 workers died of it: killed by SIGKILL"
    expected = {task.id: reason if task == MANY[6] else task.id for task in MANY}
    assert results(scheduler, MANY) == expected
    died = [worker for worker, task in pool.given if task == MANY[6]]
    assert len(died) == len(set(died)) == 3


def test_deaths_are_counted_in_each_round_anew(scheduling: Scheduling) -> None:
    fatal: list[Task | None] = [MANY[0]] * 2

    def die(_: int, task: Task | None) -> bool:
        if is_fatal := task in fatal:
            fatal.pop()
        return is_fatal

    scheduler, pool = scheduling(1, die)
    for num_started in (3, 5):
        assert results(scheduler, MANY[:2]) == {"Ex0": "Ex0", "Ex1": "Ex1"}
        assert pool.started == num_started
        fatal += [MANY[0]] * 2


def test_workers_that_never_start_are_not_started_for_ever(scheduling: Scheduling) -> None:
    scheduler, pool = scheduling(die=lambda _, task: task is None)
    with pytest.raises(ChildProcessError, match="workers do not start: never ready"):
        results(scheduler, MANY)
    assert pool.given == []
    # One that does not does no harm.
    scheduler, pool = scheduling(die=lambda worker, _: worker == 0)
    results(scheduler, MANY)
    assert pool.started == 3


def test_in_the_next_round_workers_go_on_with_their_groups(scheduling: Scheduling) -> None:
    scheduler, pool = scheduling(3)
    first = [Named(group, 0) for group in ("ax", "by", "cz")]
    results(scheduler, first)
    at = {task.group: worker for worker, task in pool.given}
    assert set(at.values()) == {0, 1, 2}
    for i in range(3):
        # Whichever is left out, and whichever comes first.
        tasks = [Named(task.group, i + 1) for task in (*first[i:], *first[:i])][1:]
        del pool.given[:]
        results(scheduler, tasks)
        assert {(task.group, worker) for worker, task in pool.given} == {
            (task.group, at[task.group]) for task in tasks
        }
    assert pool.started == 3


def test_no_task_is_blamed_for_a_worker_that_died_before_it(scheduling: Scheduling) -> None:
    dead: set[int] = set()
    scheduler, pool = scheduling(4, lambda worker, _: worker in dead)
    results(scheduler, MANY[:4])
    # More of them than a task, or a start, may cost.
    dead.update(range(4))
    del pool.given[:]
    assert results(scheduler, MANY) == {task.id: task.id for task in MANY}
    assert len(pool.given) == len(MANY)
    assert {worker for worker, _ in pool.given} == {4, 5, 6, 7}
