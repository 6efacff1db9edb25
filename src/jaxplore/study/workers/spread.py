"""Jobs spread over a crew, round after round."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from jaxplore.study.workers.crew import Crew, Event
from jaxplore.study.workers.job import Job
from jaxplore.study.workers.queue import Queue

MOST_DEATHS = 3
"""Workers that may die of one job before it counts as failed."""
MOST_FALSE_STARTS = 3
"""Workers that may die before they are ready, one after the other."""


class Spread:
    """Lets a crew do jobs. Its workers, once started, are there for the next round too.

    Args:
        crew: of which no worker is started yet.
    """

    def __init__(self, crew: Crew) -> None:
        self._crew = crew
        # The last job of each worker that has been ready, and is not dead as far as is known.
        self._former: dict[int, Job | None] = {}
        self._idle: list[int] = []
        self._coming = 0
        self._false_starts = 0

    def do[J: Job](self, jobs: Sequence[J], on_answer: Callable[[J, Any], None]) -> None:
        """Do jobs; returns when all are answered.

        Args:
            jobs: in any number.
            on_answer: called with each job and its answer, in the order in which they come.

        Raises:
            ChildProcessError: workers do not start.
        """
        queue, deaths, doing = Queue(jobs), Counter[str](), dict[int, J]()
        self._call_roll()
        while queue or doing:
            self._give(queue, doing)
            self._start(len(queue), jobs[0])
            for event in self._crew.wait():
                job = doing.pop(event.worker, None)
                self._note(event)
                if job is None:
                    continue
                if event.death is None:
                    on_answer(job, event.answer)
                    continue
                deaths[job.id] += 1
                if deaths[job.id] < MOST_DEATHS:
                    queue.put_back(job)
                else:
                    on_answer(job, job.failed(f"{MOST_DEATHS} workers died of it: {event.death}"))

    def close(self) -> None:
        """End all workers."""
        self._crew.close()

    def _call_roll(self) -> None:
        """Find out who is still there: no job is to be blamed for a worker that died before it."""
        asked, self._idle = set(self._former), []
        for worker in asked:
            self._crew.ask(worker)
        while asked:
            for event in self._crew.wait():
                asked.discard(event.worker)
                self._note(event)

    def _start(self, num_waiting: int, example: Job) -> None:
        """Start workers while jobs wait that nobody is there for."""
        while (
            num_waiting > self._coming + len(self._idle)
            and self._coming + len(self._former) < self._crew.size
        ):
            self._crew.start(example)
            self._coming += 1

    def _note(self, event: Event) -> None:
        """Keep account of who is there."""
        worker = event.worker
        if worker not in self._former:
            self._coming -= 1
            self._false_starts = 0 if event.death is None else self._false_starts + 1
        if event.death is None:
            self._former.setdefault(worker, None)
            self._idle.append(worker)
            return
        self._former.pop(worker, None)
        if worker in self._idle:
            self._idle.remove(worker)
        if self._false_starts >= MOST_FALSE_STARTS:
            raise ChildProcessError(f"workers do not start: {event.death}")

    def _give[J: Job](self, queue: Queue[J], doing: dict[int, J]) -> None:
        """Give jobs to those who have nothing to do, first to those who can go on with a group."""
        while self._idle and queue:
            groups = {each: job.group for each, job in self._former.items() if job is not None}
            at_it = (each for each in reversed(self._idle) if each in groups)
            worker = next((each for each in at_it if queue.has(groups[each])), self._idle[-1])
            self._idle.remove(worker)
            groups.pop(worker, None)
            job = queue.take(self._former[worker], Counter(groups.values()))
            self._former[worker] = doing[worker] = job
            self._crew.give(worker, job)
