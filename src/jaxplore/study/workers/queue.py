"""Jobs that wait."""

from collections import Counter, deque
from collections.abc import Hashable, Sequence

from jaxplore.study.workers.job import Job


class Queue[J: Job]:
    """Jobs that wait, by group. A worker keeps to the group that it has compiled a program for.

    Args:
        jobs: in the order in which those of a group are given out.
    """

    def __init__(self, jobs: Sequence[J]) -> None:
        self._groups: dict[Hashable, deque[J]] = {}
        self._kinds: dict[Hashable, Hashable] = {}
        for job in jobs:
            self._groups.setdefault(job.group, deque()).append(job)
            self._kinds[job.group] = job.kind

    def __len__(self) -> int:
        return sum(map(len, self._groups.values()))

    def has(self, group: Hashable) -> bool:
        """Return whether jobs of a group wait."""
        return bool(self._groups.get(group))

    def take(self, former: Job | None, busy: Counter[Hashable]) -> J:
        """Return the next job for a worker.

        Args:
            former: the worker's last job.
            busy: how many others are at each group.
        """
        if former is not None and self.has(former.group):
            return self._groups[former.group].popleft()
        waiting = {group: len(jobs) for group, jobs in self._groups.items() if jobs}

        def worth(group: Hashable) -> tuple[bool, bool, float]:
            # Where nobody is yet; where the program may be compiled, as for a map of the same
            # shape; where most is left for each who is there.
            same = former is not None and self._kinds[group] == former.kind
            return not busy[group], same, waiting[group] / (1 + busy[group])

        return self._groups[max(waiting, key=worth)].popleft()

    def put_back(self, job: J) -> None:
        """Let a job wait again, before the others of its group."""
        self._groups[job.group].appendleft(job)
