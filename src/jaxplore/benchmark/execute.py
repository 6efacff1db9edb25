"""Runs a benchmark's tasks here, in several processes or on a Ray cluster."""

import contextlib
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxplore.benchmark.crew import Crew, num_processors
from jaxplore.benchmark.on_ray import RayWorkers
from jaxplore.benchmark.perform import Perform, perform, results_for
from jaxplore.benchmark.processes import Processes
from jaxplore.benchmark.rows import Result, failed_row, result_of
from jaxplore.benchmark.store import Store
from jaxplore.benchmark.tasks import Batch, Task, batches_of

MOST_DEATHS = 3
"""Workers that may die of one batch before its tasks count as failed."""
MOST_FALSE_STARTS = 3
"""Workers that may die before they are ready, one after the other."""


class Done(NamedTuple):
    """A task that has just been done.

    Args:
        task: which.
        error: why it failed; None if it did not.
        num_done: how many are done now, of those that were left to do.
        num_left: how many those were.
    """

    task: Task
    error: str | None
    num_done: int
    num_left: int


class Outcome(NamedTuple):
    """What became of tasks.

    Args:
        num_done: that were done now, the failed ones included.
        num_failed: of these.
        num_former: that had been done before.
        is_interrupted: the user stopped it; the others are still to be done.
    """

    num_done: int
    num_failed: int
    num_former: int
    is_interrupted: bool


def run_tasks(
    tasks: Sequence[Task],
    store: Store,
    workers: int | None = 1,
    address: str | None = None,
    on_done: Callable[[Done], None] = lambda _: None,
    *,
    on_ray: bool = False,
    make: Perform = perform,
) -> Outcome:
    """Run the tasks that a store does not have, and write its table of results.

    Tasks that failed before are tried again. Those of one map and explorer run one after the other
    where that is possible, because they share a compiled loop. A worker that dies loses no more
    than the batch that it was at, a single run mostly, which is done again by another one; what
    three workers died of has failed. Ctrl-C keeps what is done.

    Args:
        tasks: what is to be done.
        store: where results go to. Only this process writes there.
        workers: 1 to run here; a number of processes on this machine, or of workers on a cluster.
            None: as many as there are processors.
        address: of a Ray cluster to run on: HOST:PORT of its head, or auto.
        on_done: called in this process after each task.
        on_ray: run on Ray; without an address on a local cluster that is started for it.
        make: makes the runs of a batch. Other processes find it by its module and name.

    Raises:
        ValueError: a number of workers < 1; Ray or pyarrow are not installed; a cluster that cannot
            be reached; a store that cannot be written.
        ChildProcessError: workers that do not start.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers is {workers}; accepted: a whole number >= 1")
    left = batches_of(task for task in tasks if not store.is_done(task.id))
    num_left = sum(map(len, left))
    num_done = num_failed = 0
    is_interrupted = False

    def finish(batch: Batch, results: Sequence[Result]) -> None:
        nonlocal num_done, num_failed
        for task, result in zip(batch, results, strict=True):
            store.put(result)
            num_done += 1
            num_failed += result.error is not None
            on_done(Done(task, result.error, num_done, num_left))

    try:
        if left and (on_ray or address is not None):
            _spread(left, RayWorkers(workers, address, make), finish)
        elif left and workers == 1:
            for batch in left:
                finish(batch, results_for(batch, make))
        elif left:
            _spread(left, Processes(workers or num_processors(), make), finish)
    except KeyboardInterrupt:
        is_interrupted = True
    finally:
        store.write_results()
    return Outcome(num_done, num_failed, len(tasks) - num_left, is_interrupted)


class _Queue:
    """Batches that wait, by group. A worker keeps to the group that it has compiled a loop for."""

    def __init__(self, batches: Sequence[Batch]) -> None:
        self._groups: dict[tuple[str, str], deque[Batch]] = {}
        for batch in batches:
            self._groups.setdefault(batch[0].group, deque()).append(batch)

    def __len__(self) -> int:
        return sum(map(len, self._groups.values()))

    def take(self, former: tuple[str, str] | None, busy: Counter[tuple[str, str]]) -> Batch:
        """Return the next batch for a worker.

        Args:
            former: group of the worker's last batch.
            busy: how many others are at each group.
        """
        waiting = {group: len(batches) for group, batches in self._groups.items() if batches}

        def worth(group: tuple[str, str]) -> tuple[bool, bool, float]:
            # Where nobody is yet; where the loop may be compiled, on a map of the same shape; where
            # most is left for each who is there.
            same = former is not None and group[1] == former[1]
            return not busy[group], same, waiting[group] / (1 + busy[group])

        if former is None or former not in waiting:
            former = max(waiting, key=worth)
        return self._groups[former].popleft()

    def put_back(self, batch: Batch) -> None:
        """Let a batch wait again, before the others of its group."""
        self._groups[batch[0].group].appendleft(batch)


def _spread(
    left: Sequence[Batch], crew: Crew, finish: Callable[[Batch, Sequence[Result]], None]
) -> None:
    """Let a crew do tasks."""
    with contextlib.closing(crew):
        queue, deaths, false_starts = _Queue(left), Counter[str](), 0
        doing: dict[int, Batch] = {}
        former: dict[int, tuple[str, str] | None] = {}
        idle: list[int] = []
        coming = 0
        while queue or doing:
            while len(queue) > coming + len(idle) and coming + len(former) < crew.size:
                crew.start()
                coming += 1
            for event in crew.wait():
                worker, batch = event.worker, doing.pop(event.worker, ())
                if worker not in former:
                    coming -= 1
                    false_starts = 0 if event.death is None else false_starts + 1
                if event.death is None:
                    former.setdefault(worker, None)
                    idle.append(worker)
                    if batch:
                        finish(batch, event.results)
                    continue
                former.pop(worker, None)
                if worker in idle:
                    idle.remove(worker)
                if not batch:
                    if false_starts >= MOST_FALSE_STARTS:
                        raise ChildProcessError(f"workers do not start: {event.death}")
                    continue
                deaths[batch[0].id] += 1
                if deaths[batch[0].id] < MOST_DEATHS:
                    queue.put_back(batch)
                    continue
                reason = f"{MOST_DEATHS} workers died of it: {event.death}"
                finish(batch, [result_of(failed_row(task, reason)) for task in batch])
            while idle and queue:
                worker = idle.pop()
                busy = Counter(batch[0].group for batch in doing.values())
                batch = queue.take(former[worker], busy)
                former[worker], doing[worker] = batch[0].group, batch
                crew.give(worker, batch)
