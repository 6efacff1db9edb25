"""Scheduler of tasks over the workers of a pool."""

from collections import Counter, deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from jaxplore.study.workers.pool import Event, WorkerPool
from jaxplore.study.workers.task import Task

MAX_DEATHS = 3
"""Number of workers that a task may kill before it has failed."""
MAX_FALSE_STARTS = 3
"""Number of successive workers that may die before they are ready."""


class Scheduler:
    """Scheduler of tasks over a pool without started workers. They stay for the next call."""

    def __init__(self, pool: WorkerPool) -> None:
        self._pool = pool
        # Last task of each worker that has been ready and is not known to be dead.
        self._last: dict[int, Task | None] = {}
        self._idle: list[int] = []
        self._num_starting = 0
        self._false_starts = 0

    def run[T: Task](self, tasks: Sequence[T], on_result: Callable[[T, Any], None]) -> None:
        """Run tasks, and call `on_result` with each and its result, in the order of completion.

        Workers that do not start raise a `ChildProcessError`.
        """
        queue, deaths, running = _Queue(tasks), Counter[str](), dict[int, T]()
        self._ping_all()
        while queue or running:
            self._submit(queue, running)
            # New workers start after sending, for tasks that no idle worker could take.
            self._start(len(queue), tasks[0])
            for event in self._pool.wait():
                task = running.pop(event.worker, None)
                self._note(event)
                if task is None:
                    continue
                if event.death is None:
                    on_result(task, event.result)
                    continue
                deaths[task.id] += 1
                if deaths[task.id] < MAX_DEATHS:
                    queue.put_back(task)
                else:
                    reason = f"{MAX_DEATHS} workers died of it: {event.death}"
                    on_result(task, task.make_failure(reason))

    def close(self) -> None:
        """End all workers."""
        self._pool.close()

    def _ping_all(self) -> None:
        """Check which workers are alive, so that no task is blamed for a worker that died
        before."""
        asked, self._idle = set(self._last), []
        for worker in asked:
            self._pool.ping(worker)
        while asked:
            for event in self._pool.wait():
                asked.discard(event.worker)
                self._note(event)

    def _start(self, num_waiting: int, example: Task) -> None:
        """Start workers while there are more waiting tasks than idle or starting workers."""
        while (
            num_waiting > self._num_starting + len(self._idle)
            and self._num_starting + len(self._last) < self._pool.size
        ):
            self._pool.start(example)
            self._num_starting += 1

    def _note(self, event: Event) -> None:
        worker = event.worker
        # A worker that has not been ready yet is one that was starting.
        if worker not in self._last:
            self._num_starting -= 1
            self._false_starts = 0 if event.death is None else self._false_starts + 1
        if event.death is None:
            self._last.setdefault(worker, None)
            self._idle.append(worker)
            return
        self._last.pop(worker, None)
        if worker in self._idle:
            self._idle.remove(worker)
        if self._false_starts >= MAX_FALSE_STARTS:
            raise ChildProcessError(f"workers do not start: {event.death}")

    def _submit[T: Task](self, queue: "_Queue[T]", running: dict[int, T]) -> None:
        """Send tasks to idle workers, first to those that can continue with their group."""
        while self._idle and queue:
            groups = {each: task.group for each, task in self._last.items() if task is not None}
            experienced = (each for each in reversed(self._idle) if each in groups)
            continuing = (each for each in experienced if queue.has(groups[each]))
            worker = next(continuing, self._idle[-1])
            self._idle.remove(worker)
            # Only other workers make a group busy.
            groups.pop(worker, None)
            task = queue.take(self._last[worker], Counter(groups.values()))
            self._last[worker] = running[worker] = task
            self._pool.submit(worker, task)


class _Queue[T: Task]:
    """Queue of waiting tasks by group."""

    def __init__(self, tasks: Sequence[T]) -> None:
        self._groups: dict[Hashable, deque[T]] = {}
        self._kinds: dict[Hashable, Hashable] = {}
        for task in tasks:
            self._groups.setdefault(task.group, deque()).append(task)
            self._kinds[task.group] = task.kind

    def __len__(self) -> int:
        return sum(map(len, self._groups.values()))

    def has(self, group: Hashable) -> bool:
        return bool(self._groups.get(group))

    def take(self, last: Task | None, busy: Counter[Hashable]) -> T:
        """Return a worker's next task after `last`; `busy` counts other workers at each group."""
        if last is not None and self.has(last.group):
            return self._groups[last.group].popleft()
        waiting = {group: len(tasks) for group, tasks in self._groups.items() if tasks}

        def priority(group: Hashable) -> tuple[bool, bool, float]:
            # First groups without a worker; then groups of the worker's kind, whose program it may
            # have compiled, as for a map of the same shape; then the most tasks per worker.
            same = last is not None and self._kinds[group] == last.kind
            return not busy[group], same, waiting[group] / (1 + busy[group])

        return self._groups[max(waiting, key=priority)].popleft()

    def put_back(self, task: T) -> None:
        """Put a task back into the queue, before the others of its group."""
        self._groups[task.group].appendleft(task)
