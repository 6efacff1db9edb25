"""Runs a benchmark's tasks here, in several processes or on a Ray cluster."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxplore.study.comparison.job import Runs
from jaxplore.study.comparison.perform import Perform, perform
from jaxplore.study.comparison.rows import Result
from jaxplore.study.comparison.store import Store
from jaxplore.study.comparison.tasks import Task, batches_of
from jaxplore.study.workers.pool import Pool


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
    pool = Pool(workers, address, on_ray=on_ray)
    left = batches_of(task for task in tasks if not store.is_done(task.id))
    num_left = sum(map(len, left))
    num_done = num_failed = 0
    is_interrupted = False

    def finish(runs: Runs, results: Sequence[Result]) -> None:
        nonlocal num_done, num_failed
        for task, result in zip(runs.batch, results, strict=True):
            store.put(result)
            num_done += 1
            num_failed += result.error is not None
            on_done(Done(task, result.error, num_done, num_left))

    try:
        with pool:
            pool.do([Runs(batch, make) for batch in left], finish)
    except KeyboardInterrupt:
        is_interrupted = True
    finally:
        store.write_results()
    return Outcome(num_done, num_failed, len(tasks) - num_left, is_interrupted)
