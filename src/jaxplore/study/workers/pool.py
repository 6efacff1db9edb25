"""Workers that do jobs: this process, others on this machine, or those of a Ray cluster."""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self

from jaxplore.study.workers.answer import answer_to
from jaxplore.study.workers.crew import Crew, num_processors
from jaxplore.study.workers.job import Job
from jaxplore.study.workers.on_ray import RayWorkers
from jaxplore.study.workers.processes import Processes
from jaxplore.study.workers.spread import Spread


class Pool:
    """Does jobs, as often as it is asked to. Nothing is started before the first job.

    Workers stay until the pool is closed and keep what they have compiled. A worker that dies loses
    no more than the job that it was at, which is done again by another one; what three workers died
    of has failed. Answers do not depend on the number of workers, their order does.

    Args:
        workers: 1 to do the jobs here, one after the other; a number of processes on this machine,
            or of workers on a cluster. None: as many as there are processors.
        address: of a Ray cluster to use: HOST:PORT of its head, or auto.
        on_ray: use Ray; without an address on a local cluster that is started for it.

    Raises:
        ValueError: a number of workers < 1.
    """

    def __init__(
        self, workers: int | None = 1, address: str | None = None, *, on_ray: bool = False
    ) -> None:
        if workers is not None and workers < 1:
            raise ValueError(f"workers is {workers}; accepted: a whole number >= 1")
        self._workers, self._address = workers, address
        self._is_on_ray = on_ray or address is not None
        self._spread: Spread | None = None
        self._is_closed = False

    def do[J: Job](self, jobs: Sequence[J], on_answer: Callable[[J, Any], None]) -> None:
        """Do jobs; returns when all are answered. Where it raises, the pool is closed.

        Args:
            jobs: in any number.
            on_answer: called in this process with each job and its answer, as soon as it is there.

        Raises:
            ValueError: the pool is closed; Ray is not installed, or the cluster cannot be reached.
            ChildProcessError: workers do not start.
            KeyboardInterrupt: the user stopped it.
        """
        if self._is_closed:
            raise ValueError("pool is closed; accepted: a new one")
        if not jobs:
            return
        try:
            if self._workers == 1 and not self._is_on_ray:
                for job in jobs:
                    on_answer(job, answer_to(job))
                return
            if self._spread is None:
                self._spread = Spread(self._crew())
            self._spread.do(jobs, on_answer)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all workers, whatever they are doing."""
        self._is_closed = True
        if self._spread is not None:
            self._spread.close()

    def _crew(self) -> Crew:
        if self._is_on_ray:
            return RayWorkers(self._workers, self._address)
        return Processes(self._workers or num_processors())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
