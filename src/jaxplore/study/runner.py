"""Runner of tasks in this process, in several processes, or on a Ray cluster."""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

from jaxplore import _checks
from jaxplore._limits import MOST_AT_ONCE
from jaxplore.study.workers.pool import WorkerPool, num_processors
from jaxplore.study.workers.processes import ProcessPool
from jaxplore.study.workers.ray_pool import RayPool
from jaxplore.study.workers.scheduler import Scheduler
from jaxplore.study.workers.task import Task, run_task


class Runner:
    """Runner of tasks in this process, in several processes, or on a Ray cluster.

    Workers start with the first task and live until the runner is closed, so they keep their
    compiled programs. If a worker dies, another one repeats its task; after three deaths the task
    has failed. The results do not depend on the number of workers, only their order does.

    Args:
        workers: number of workers: 1 runs tasks in this process, one after the other; N uses N
            processes, or N workers of a cluster; None uses as many as there are processors.
        address: address of the Ray cluster to join: HOST:PORT of its head, or auto.
        on_ray: whether to use Ray; without an address a local cluster is started.

    Raises:
        ValueError: a number of workers < 1.
    """

    def __init__(
        self, workers: int | None = 1, address: str | None = None, *, on_ray: bool = False
    ) -> None:
        if workers is not None:
            _checks.positive_int("workers", workers, at_most=MOST_AT_ONCE)
        self._workers, self._address = workers, address
        self._is_on_ray = on_ray or address is not None
        self._scheduler: Scheduler | None = None
        self._is_closed = False

    @property
    def num_processes(self) -> int:
        """Number of processes on this machine that run tasks; one for a cluster that is joined."""
        if self._address is not None:
            return 1
        return self._workers or num_processors()

    @property
    def is_local(self) -> bool:
        """Whether tasks run in this process."""
        return self._workers == 1 and not self._is_on_ray

    def run[T: Task](self, tasks: Sequence[T], on_result: Callable[[T, Any], None]) -> None:
        """Run tasks, and return when all have a result.

        An exception ends all workers. `on_result` is called in this process with each task and its
        result, as soon as there is one. Workers that do not start raise a `ChildProcessError`.
        """
        if self._is_closed:
            raise ValueError("runner is closed; accepted: a new one")
        if not tasks:
            return
        if self.is_local:
            for task in tasks:
                on_result(task, run_task(task))
            return
        try:
            if self._scheduler is None:
                self._scheduler = Scheduler(self._make_pool())
            self._scheduler.run(tasks, on_result)
        except BaseException:
            # Workers may still run tasks of this call, whose results would reach the next one.
            self.close()
            raise

    def close(self) -> None:
        """End all workers, even during a task."""
        self._is_closed = True
        if self._scheduler is not None:
            self._scheduler.close()

    def _make_pool(self) -> WorkerPool:
        if self._is_on_ray:
            return RayPool(self._workers, self._address)
        return ProcessPool(self._workers or num_processors())

    def __enter__(self) -> "Runner":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
