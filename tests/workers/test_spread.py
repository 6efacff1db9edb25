"""How jobs are spread over workers, with workers that are none."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from jaxplore.study.workers.job import Job
from jaxplore.study.workers.spread import Spread


@dataclasses.dataclass(frozen=True)
class Named(Job):
    """Its answer is its name."""

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

    def failed(self, reason: str) -> str:
        return reason


Spreading = Callable[..., tuple[Spread, Any]]
# Two places with two kinds each, sixteen jobs in all.
MANY = tuple(Named(place + kind, i) for place in "EW" for kind in "xy" for i in range(4))


@pytest.fixture
def spreading(scripted: Callable[..., Any]) -> Spreading:
    def make(
        number: int = 2, die: Callable[[int, Job | None], bool] = lambda *_: False
    ) -> tuple[Spread, Any]:
        crew = scripted(number, die)
        return Spread(crew), crew

    return make


def answers(spread: Spread, jobs: Sequence[Named]) -> dict[str, str]:
    """Return the answers to jobs by their ids; there is one to each."""
    found: list[tuple[Job, str]] = []
    spread.do(jobs, lambda job, answer: found.append((job, answer)))
    assert len(found) == len(jobs)
    assert {job for job, _ in found} == set(jobs)
    return {job.id: answer for job, answer in found}


@pytest.mark.parametrize("shorter", ["Ex3", "Ey3"])
def test_workers_keep_to_a_group_and_then_to_its_kind(spreading: Spreading, shorter: str) -> None:
    spread, crew = spreading()
    # One of them comes to the end of its group first, and has the choice.
    left_out = {shorter, "Wx2", "Wx3", "Wy2", "Wy3"}
    jobs = [job for job in MANY if job.id not in left_out]
    assert answers(spread, jobs) == {job.id: job.id for job in jobs}
    assert crew.started == 2
    found = {tuple(job.group for each, job in crew.given if each == worker) for worker in range(2)}
    assert found == {tuple(job.group for job in jobs if job.kind == kind) for kind in ("x", "y")}


def test_no_more_workers_than_jobs(spreading: Spreading) -> None:
    spread, crew = spreading(8)
    answers(spread, MANY[:3])
    assert crew.started == 3
    answers(spread, MANY[:4])
    assert crew.started == 4
    answers(spread, [])
    assert crew.started == 4


def test_a_death_costs_one_job_that_is_done_again(spreading: Spreading) -> None:
    fatal: list[Job | None] = [MANY[0], MANY[5], MANY[5]]

    def die(_: int, job: Job | None) -> bool:
        if is_fatal := job in fatal:
            fatal.remove(job)
        return is_fatal

    spread, crew = spreading(die=die)
    assert answers(spread, MANY) == {job.id: job.id for job in MANY}
    times = [sum(job == each for _, job in crew.given) for each in MANY]
    assert times == [2, 1, 1, 1, 1, 3, *[1] * 10]
    assert crew.started == 5


def test_a_job_of_which_three_workers_die_has_failed(spreading: Spreading) -> None:
    spread, crew = spreading(die=lambda _, job: job == MANY[6])
    reason = "3 workers died of it: killed by SIGKILL"
    expected = {job.id: reason if job == MANY[6] else job.id for job in MANY}
    assert answers(spread, MANY) == expected
    died = [worker for worker, job in crew.given if job == MANY[6]]
    assert len(died) == len(set(died)) == 3


def test_deaths_are_counted_in_each_round_anew(spreading: Spreading) -> None:
    fatal: list[Job | None] = [MANY[0]] * 2

    def die(_: int, job: Job | None) -> bool:
        if is_fatal := job in fatal:
            fatal.pop()
        return is_fatal

    spread, crew = spreading(1, die)
    for num_started in (3, 5):
        assert answers(spread, MANY[:2]) == {"Ex0": "Ex0", "Ex1": "Ex1"}
        assert crew.started == num_started
        fatal += [MANY[0]] * 2


def test_workers_that_never_start_are_not_started_for_ever(spreading: Spreading) -> None:
    spread, crew = spreading(die=lambda _, job: job is None)
    with pytest.raises(ChildProcessError, match="workers do not start: never ready"):
        answers(spread, MANY)
    assert crew.given == []
    # One that does not does no harm.
    spread, crew = spreading(die=lambda worker, _: worker == 0)
    answers(spread, MANY)
    assert crew.started == 3


def test_in_the_next_round_workers_go_on_with_their_groups(spreading: Spreading) -> None:
    spread, crew = spreading(3)
    first = [Named(group, 0) for group in ("ax", "by", "cz")]
    answers(spread, first)
    at = {job.group: worker for worker, job in crew.given}
    assert set(at.values()) == {0, 1, 2}
    for i in range(3):
        # Whichever is left out, and whichever comes first.
        jobs = [Named(job.group, i + 1) for job in (*first[i:], *first[:i])][1:]
        del crew.given[:]
        answers(spread, jobs)
        assert {(job.group, worker) for worker, job in crew.given} == {
            (job.group, at[job.group]) for job in jobs
        }
    assert crew.started == 3


def test_no_job_is_blamed_for_a_worker_that_died_before_it(spreading: Spreading) -> None:
    dead: set[int] = set()
    spread, crew = spreading(4, lambda worker, _: worker in dead)
    answers(spread, MANY[:4])
    # More of them than a job, or a start, may cost.
    dead.update(range(4))
    del crew.given[:]
    assert answers(spread, MANY) == {job.id: job.id for job in MANY}
    assert len(crew.given) == len(MANY)
    assert {worker for worker, _ in crew.given} == {4, 5, 6, 7}
