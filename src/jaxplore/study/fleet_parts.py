"""A run of a fleet whose robots are computed by several workers of a Ray cluster."""

import asyncio
import dataclasses
import pickle
import uuid
import warnings
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_ROBOTS
from jaxplore._optional import import_optional
from jaxplore._types import Key
from jaxplore.control.fleet_controller import FleetController
from jaxplore.control.fleet_share import Share
from jaxplore.report.console import progress_bar
from jaxplore.simulation.fleet.scenario import Fleet
from jaxplore.simulation.run import NUM_TRAJECTORIES, Run, simulate
from jaxplore.study.workers.ray_pool import RayPool
from jaxplore.study.workers.task import Task


class _Hub:
    """Ray actor at which the workers meet: it hands the message of each one to all of them."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._told: dict[int, dict[int, list[np.ndarray]]] = {}
        self._complete: dict[int, asyncio.Event] = {}
        self._left: dict[int, int] = {}

    async def meet(self, worker: int, turn: int, arrays: list[np.ndarray]) -> list[Any]:
        """Return the arrays of all workers, when all have come.

        `turn` is the number of the meeting, which each worker counts.
        """
        told = self._told.setdefault(turn, {})
        complete = self._complete.setdefault(turn, asyncio.Event())
        told[worker] = arrays
        if len(told) == self._number:
            complete.set()
        await complete.wait()
        self._left[turn] = self._left.get(turn, 0) + 1
        if self._left[turn] == self._number:
            del self._told[turn], self._complete[turn], self._left[turn]
        return [told[each] for each in range(self._number)]


@dataclasses.dataclass(frozen=True)
class _Failure:
    reason: str


@dataclasses.dataclass(frozen=True)
class _Part(Task):
    """The part of a run that a worker computes: the places of each worker's robots in the fleet,
    the name of the actor at which they meet, the data of the random key, and pickled the
    controller, the scenario and the greatest number of steps."""

    number: int
    places: tuple[tuple[int, ...], ...]
    hub: str
    packed: bytes
    key: np.ndarray
    num_trajectories: int

    @property
    def id(self) -> str:
        return f"part {self.number + 1}"

    @property
    def group(self) -> int:
        return self.number

    def run(self) -> Any:
        ray = import_optional("ray", "distributed")
        hub, turns = ray.get_actor(self.hub), 0

        def meet(mine: list[np.ndarray]) -> list[np.ndarray]:
            nonlocal turns
            told = ray.get(hub.meet.remote(self.number, turns, mine))
            turns += 1
            # The robots of the workers follow one another.
            return [np.concatenate(arrays) for arrays in zip(*told, strict=True)]

        controller, scenario, num_steps = pickle.loads(self.packed)
        share = Share(self.places[self.number], sum(map(len, self.places)), meet)
        run = simulate(
            controller.with_share(share),
            scenario.with_share(share),
            num_steps,
            key=jax.random.wrap_key_data(jnp.asarray(self.key)),
            num_trajectories=self.num_trajectories,
        )
        # All workers have recorded the same.
        return run.recording if self.number == 0 else None

    def make_failure(self, reason: str) -> _Failure:
        return _Failure(reason)


@_kinds.check_arguments
def simulate_in_parts(
    controller: FleetController,
    fleet: Fleet,
    num_steps: int,
    *,
    key: Key,
    workers: int,
    address: str | None = None,
    progress: bool = False,
    num_trajectories: int = NUM_TRAJECTORIES,
) -> Run:
    """Simulate a fleet whose robots are divided among the workers of a Ray cluster.

    Every worker runs the closed loop of `simulate`. It moves all robots, and computes scans, fields
    and controls of its own. The workers meet in every step: they tell their controls, at scans what
    is known to be free, and at exchanges what their scans have changed. So each knows the whole
    run, which is that of one process.

    Unlike the run of `simulate`, this one cannot be continued, and Ctrl-C ends it without a result.

    Args:
        controller: controllers of the robots.
        fleet: the fleet, of two or more equal robots.
        num_steps: greatest number of control periods.
        key: random key; the same key gives the same run.
        workers: number of workers, at most one for each robot.
        address: address of the Ray cluster to join; a local one is started when absent.
        progress: whether to show that the run goes on.
        num_trajectories: number of rollouts in each frame.

    Raises:
        ValueError: more workers than robots, robots that are not all equal; Ray is not installed,
            or the cluster cannot be reached.
        ChildProcessError: a worker failed or died.
        KeyboardInterrupt: the user stopped it.
    """
    _kinds.key("key", key)
    number = _checks.positive_int("workers", workers, at_most=min(fleet.num_robots, MOST_ROBOTS))
    places = tuple(
        tuple(each.tolist()) for each in np.array_split(np.arange(fleet.num_robots), number)
    )
    # Refused here, before a cluster starts.
    fleet.with_share(Share(places[0], fleet.num_robots, lambda arrays: arrays))
    data = np.asarray(jax.random.key_data(key))
    with progress_bar("simulating", enabled=progress) as advance:
        advance(0.0, f"in {number} workers")
        recording = _record((controller, fleet, num_steps), data, places, address, num_trajectories)
    seed = int(data.reshape(-1)[-1])
    return Run(recording, recording.metrics(seed=seed))


def _record(
    what: Any,
    key: np.ndarray,
    places: Sequence[tuple[int, ...]],
    address: str | None,
    num_trajectories: int,
) -> Any:
    """Return the recording of the first worker, after all of them have finished."""
    number = len(places)
    with warnings.catch_warnings():
        # Ray starts programs, and a process that is forked for one runs nothing of JAX.
        warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
        pool = RayPool(number, address)
    try:
        ray = import_optional("ray", "distributed")
        packed = import_optional("ray.cloudpickle", "distributed").dumps(what)
        name = f"jaxplore-{uuid.uuid4().hex}"
        # The actor lives as long as its handle.
        hub = ray.remote(num_cpus=0)(_Hub).options(name=name).remote(number)
        parts = [
            _Part(i, tuple(places), name, packed, key, num_trajectories) for i in range(number)
        ]
        for part in parts:
            pool.start(part)
        results: dict[int, Any] = {}
        sent: set[int] = set()
        while len(results) < number:
            for event in pool.wait():
                if event.death is not None:
                    # Ray adds the numbers of the actor and of its process.
                    reason = event.death.split(" class_name", 1)[0]
                    raise ChildProcessError(
                        f"worker {event.worker + 1} of {number} of the fleet ended: {reason}"
                    )
                if event.worker not in sent:
                    sent.add(event.worker)
                    pool.submit(event.worker, parts[event.worker])
                elif isinstance(event.result, _Failure):
                    raise ChildProcessError(
                        f"worker {event.worker + 1} of {number} of the fleet failed: "
                        f"{event.result.reason}"
                    )
                else:
                    results[event.worker] = event.result
        del hub
        return results[0]
    finally:
        pool.close()
