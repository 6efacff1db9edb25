"""Loops in chunks: a chunk is one compiled call; between chunks Python records, times and stops."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._signals import stop_requests
from jaxplore._types import Count, Flag
from jaxplore.report.compute import Timing
from jaxplore.simulation.record_buffer import RecordBuffer

CHUNK_SECONDS = 0.5
"""Longest simulated time of a chunk [s]: progress and Ctrl-C wait for the end of a chunk."""
FRAME_SECONDS = 0.05
"""Simulated time between the frames at the start of a run [s]. Nobody knows how long it will be, so
the frames begin dense enough for an animation of a run of a few seconds."""
STEPWISE_CHUNKS = 10
"""One chunk in this many is run step by step, by the same compiled program, to time steps."""
MAX_FRAMES = 120
"""Greatest number of frames of a run; beyond it, every second one is dropped."""
MOST_FRAME_BYTES = 1_000_000_000
"""Greatest memory of the frames of a run, likewise: frames of a large map are few."""
MAX_TIMED = 10_000
"""Greatest number of steps that are timed one at a time; beyond it, every second one is dropped."""


def loop[S, R](
    step: Callable[[S], tuple[S, R]],
    is_unfinished: Callable[[S], Flag],
    state: S,
    blank: R,
    num_steps: Count,
) -> tuple[S, R, Count]:
    """Step up to `num_steps` times, fewer if the task is finished; a scan of traced length.

    The same compiled program runs a whole chunk or a single step that is timed, and it stops as
    soon as the task is finished. `step` returns the next state and the step's record. `blank` is a
    buffer of at least `num_steps` records. The result is the state, the records and the number of
    records that are filled.
    """

    def goes_on(carry: tuple[S, R, Array]) -> Array:
        current, _, done = carry
        return (done < num_steps) & is_unfinished(current)

    def advance(carry: tuple[S, R, Array]) -> tuple[S, R, Array]:
        current, records, done = carry
        current, record = step(current)
        records = jax.tree.map(lambda rows, row: rows.at[done].set(row), records, record)
        return current, records, done + 1

    return jax.lax.while_loop(goes_on, advance, (state, blank, jnp.zeros((), jnp.int32)))


@dataclasses.dataclass(frozen=True)
class ChunkedRun[S, R, F]:
    """The result of a loop that was run in chunks.

    Args:
        state: last state of the loop.
        records: records of all steps, in NumPy; those of a long run are mapped from a file, see
            `RecordBuffer`.
        frames: evenly spaced frames, the last one at the end of the run.
        timing: wall-clock times.
        num_steps: number of steps done.
        is_interrupted: whether Ctrl-C ended the run.
        interval: number of steps between the frames.
    """

    state: S
    records: R
    frames: tuple[F, ...]
    timing: Timing
    num_steps: int
    is_interrupted: bool
    interval: int = 1

    def common(self, period: float) -> dict[str, Any]:
        """Return the constructor arguments that all recordings share.

        Args:
            period: control period [s].
        """
        return {
            "records": self.records,
            "frames": self.frames,
            "timing": self.timing,
            "control_period": period,
            "is_interrupted": self.is_interrupted,
        }


@dataclasses.dataclass(frozen=True)
class Chunk[S, R]:
    """A chunk that was run: the state after it, and its records in NumPy.

    `total` is the number of steps of the run that are done, `seconds` the wall-clock time since the
    first one [s]. `is_stop_requested` says whether Ctrl-C was pressed.
    """

    state: S
    records: R
    total: int
    seconds: float
    is_stop_requested: Callable[[], bool]


def are_too_many(frames: Sequence[Any]) -> bool:
    """Return whether every second frame of a run is to be dropped.

    The frames have one size. In a batch of runs, each is a tuple of frames.
    """
    if len(frames) <= 2:
        return False
    last = frames[-1] if isinstance(frames[-1], tuple) else (frames[-1],)
    leaves = [leaf for each in last for leaf in jax.tree.leaves(getattr(each, "__dict__", {}))]
    size = sum(getattr(leaf, "nbytes", 0) for leaf in leaves)
    return len(frames) > MAX_FRAMES or len(frames) * size > MOST_FRAME_BYTES


class _Frames[S, F]:
    """Frames at regular steps, and one at the end.

    `make` makes a frame of a state after a number of steps. `interval` is the number of steps
    between frames; it doubles when there are too many. `former` is the part that is done, if any.
    """

    def __init__(
        self, make: Callable[[S, int], F], interval: int, former: ChunkedRun[S, Any, F] | None
    ) -> None:
        self._make, self.interval = make, interval
        self.frames: list[F] = []
        self._shown = 0
        if former is not None:
            # The frame at the former end is left out unless the whole run has one there.
            self.interval = former.interval
            number = former.num_steps // self.interval
            self.frames = list(former.frames[: number + 1])
            self._shown = number * self.interval

    @property
    def next(self) -> int:
        """Steps of the run at the next frame."""
        return self._shown + self.interval if self.frames else 0

    def add_when_due(self, state: S, total: int) -> None:
        """Make a frame if it is time for one."""
        if total != self.next:
            return
        self.frames.append(self._make(state, total))
        self._shown = total
        # The interval doubles with the dropped frames, so that frames stay evenly spaced.
        if are_too_many(self.frames):
            self.frames, self.interval = self.frames[::2], self.interval * 2

    def until_end(self, state: S, total: int) -> tuple[F, ...]:
        """Return all frames, and one of the end if the run ends between two regular ones."""
        at_end = () if self._shown == total else (self._make(state, total),)
        return (*self.frames, *at_end)


class _Clock:
    """Wall-clock times of chunks and of single steps."""

    def __init__(self, chunk: int) -> None:
        self._chunk = chunk
        self._steps: list[float] = []
        # One step in this many is kept, of those that were timed one at a time.
        self._stride, self._count = 1, 0
        # Seconds and steps in short chunks and in long ones.
        self._timed = {False: (0.0, 0), True: (0.0, 0)}

    def add(self, seconds: float, done: int, planned: int, *, is_stepwise: bool) -> None:
        """Note the time of a call.

        Steps that are timed one at a time return to Python each time, so they stay out of the
        loop's mean, as do the short chunks between dense frames if there are others.
        """
        if is_stepwise:
            if self._count % self._stride == 0:
                self._steps.append(seconds)
            self._count += 1
            if len(self._steps) > MAX_TIMED:
                self._steps, self._stride = self._steps[::2], self._stride * 2
            return
        is_long = 2 * planned >= self._chunk
        former = self._timed[is_long]
        self._timed[is_long] = former[0] + seconds, former[1] + done

    def timing(self, compile_seconds: float) -> Timing:
        """Return all times."""
        has_long = self._timed[True][1] > 0
        return Timing(compile_seconds, *self._timed[has_long], np.asarray(self._steps))


def run_in_chunks[S, R, F](
    run: Callable[[S, Count], tuple[S, R, Count]],
    is_unfinished: Callable[[S], Flag],
    frame: Callable[[S, int], F],
    state: S,
    *,
    began: float,
    limit: int,
    chunk: int,
    interval: int,
    on_chunk: Callable[[Chunk[S, R]], int],
    former: ChunkedRun[S, R, F] | None = None,
    revise: Callable[[S], S] | None = None,
    revise_every: int = 0,
) -> ChunkedRun[S, R, F]:
    """Run a loop chunk by chunk until the task is finished or the steps are done.

    Ctrl-C ends it after the current chunk, a second one at once. `on_chunk` is called after each
    chunk. It returns the greatest number of steps of the next one, or 0 to end the run, as Ctrl-C
    does. A chunk also ends with each frame. `interval` is the number of steps between frames at the
    start; it doubles when there are too many frames.

    `former` is the part of the run that is done, which ended in `state`; None to start. The result
    is the whole run, and `limit` includes the steps of `former`. `revise` changes the state every
    `revise_every` steps, see `Scenario.update_on_host`. These steps depend on nothing else, so a
    run is the same with every length of chunks. `began` is `time.perf_counter()` at the beginning
    of the preparations [s].
    """

    def advance(current: S, steps: int) -> tuple[S, Any, int, float]:
        start = time.perf_counter()
        # The number of steps is an array, so that every number runs the same compiled program.
        current, rows, done = run(current, jnp.asarray(steps, jnp.int32))
        # Reading the count waits for the program, which JAX runs asynchronously.
        filled = int(done)
        rows = jax.tree.map(lambda leaf: np.asarray(leaf)[:filled], rows)
        return current, rows, filled, time.perf_counter() - start

    # A call with zero steps compiles the program, so that no timed step includes the compilation.
    state, rows, _, _ = advance(state, 0)
    compile_seconds = time.perf_counter() - began
    # The empty records of that call give the shapes, so that a run without a step has records too.
    records, clock = RecordBuffer(rows), _Clock(chunk)
    total, chunks = 0, 0
    if former is not None:
        records.append(former.records)
        total = former.num_steps
    frames = _Frames(frame, interval, former)
    frames.add_when_due(state, total)
    started = time.perf_counter()
    finished, longest = not bool(is_unfinished(state)), chunk
    with stop_requests() as stop:
        while total < limit and longest > 0 and not finished and not stop.is_set():
            chunks += 1
            pieces = []
            steps = min(longest, frames.next - total, limit - total)
            if revise is not None:
                steps = min(steps, revise_every - total % revise_every)
            stepwise = chunks % STEPWISE_CHUNKS == 0
            for size in [1] * steps if stepwise else [steps]:
                state, rows, done, seconds = advance(state, size)
                pieces.append(rows)
                total += done
                clock.add(seconds, done, steps, is_stepwise=stepwise)
                finished = not bool(is_unfinished(state))
                if finished:
                    break
            if revise is not None and total % revise_every == 0 and not finished:
                state = revise(state)
            # Frames are made at the end of a chunk only: the compiled loop does not return to
            # Python within.
            frames.add_when_due(state, total)
            rows = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
            records.append(rows)
            seconds = time.perf_counter() - started
            longest = on_chunk(Chunk(state, rows, total, seconds, stop.is_set))
        is_interrupted = longest == 0 or stop.is_set()
    timing = clock.timing(compile_seconds)
    return ChunkedRun(
        state,
        records.rows(),
        frames.until_end(state, total),
        timing if former is None else former.timing + timing,
        total,
        is_interrupted,
        frames.interval,
    )
