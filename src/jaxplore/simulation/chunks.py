"""Loops in chunks: a chunk is one compiled call; between chunks Python records, times and stops."""

import dataclasses
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import Count, Flag
from jaxplore.report.compute import Timing

CHUNK_SECONDS = 0.5
"""Simulated time between returns to Python."""
STEPWISE_CHUNKS = 10
"""One chunk in so many is run one step at a time, by the same compiled program, to time steps."""
MAX_FRAMES = 240
"""Frames kept of a run; when there are more, every second one is dropped."""


def loop[S, R](
    step: Callable[[S], tuple[S, R]],
    is_unfinished: Callable[[S], Flag],
    state: S,
    blank: R,
    num_steps: Count,
) -> tuple[S, R, Count]:
    """Step up to `num_steps` times, fewer if it is finished; a scan whose length is data.

    So the same compiled program runs a chunk, a single step that is to be timed, and ends the
    moment it is finished.

    Args:
        step: function from a state to the next state and the step's record.
        is_unfinished: whether a state is to be stepped on from.
        state: state to continue from.
        blank: records to be filled, with a leading axis for at least as many steps.
        num_steps: greatest number of steps.

    Returns:
        The state, the records and how many of them are filled.
    """

    def unfinished(carry: tuple[S, R, Array]) -> Array:
        current, _, done = carry
        return (done < num_steps) & is_unfinished(current)

    def advance(carry: tuple[S, R, Array]) -> tuple[S, R, Array]:
        current, records, done = carry
        current, record = step(current)
        records = jax.tree.map(lambda rows, row: rows.at[done].set(row), records, record)
        return current, records, done + 1

    return jax.lax.while_loop(unfinished, advance, (state, blank, jnp.zeros((), jnp.int32)))


@dataclasses.dataclass(frozen=True)
class ChunkedRun[S, R, F]:
    """A loop that was run in chunks.

    Args:
        state: the last one.
        records: records of all steps, in NumPy.
        frames: snapshots, evenly spaced, the last one at its end.
        timing: wall-clock times.
        num_steps: number of steps done.
        is_interrupted: Ctrl-C ended it.
    """

    state: S
    records: R
    frames: tuple[F, ...]
    timing: Timing
    num_steps: int
    is_interrupted: bool

    def common(self, period: float) -> dict[str, Any]:
        """Return the arguments that every recording takes.

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


def run_in_chunks[S, R, F](
    run: Callable[[S, Count], tuple[S, R, Count]],
    is_unfinished: Callable[[S], Flag],
    frame: Callable[[S, int], F],
    state: S,
    *,
    began: float,
    limit: int,
    chunk: int,
    on_chunk: Callable[[S, int, float], None],
) -> ChunkedRun[S, R, F]:
    """Run a loop chunk by chunk until it is finished or the steps are done.

    Ctrl-C ends it after the current chunk, a second one at once.

    Args:
        run: runs up to so many steps from a state: the compiled loop.
        is_unfinished: whether a state is to be stepped on from.
        frame: makes a frame of a state after so many steps.
        state: state to begin with.
        began: `time.perf_counter()` at the beginning of the preparations [s].
        limit: steps at most.
        chunk: steps in a chunk.
        on_chunk: called with the state, the steps done and the seconds since the first step.
    """

    def advance(current: S, steps: int) -> tuple[S, Any, int, float]:
        start = time.perf_counter()
        current, rows, done = run(current, jnp.asarray(steps, jnp.int32))
        filled = int(done)
        rows = jax.tree.map(lambda leaf: np.asarray(leaf)[:filled], rows)
        return current, rows, filled, time.perf_counter() - start

    state, rows, _, _ = advance(state, 0)
    compile_seconds = time.perf_counter() - began
    pieces, frames, step_seconds = [rows], [frame(state, 0)], []
    loop_seconds, loop_steps, total, chunks, every, shown = 0.0, 0, 0, 0, 1, 0
    started = time.perf_counter()
    finished = not bool(is_unfinished(state))
    with _stop_on_interrupt() as stop_requested:
        while total < limit and not finished and not stop_requested():
            chunks += 1
            steps = min(chunk, limit - total)
            stepwise = chunks % STEPWISE_CHUNKS == 0
            for size in [1] * steps if stepwise else [steps]:
                state, rows, done, seconds = advance(state, size)
                pieces.append(rows)
                total += done
                if stepwise:
                    step_seconds.append(seconds)
                else:
                    loop_seconds, loop_steps = loop_seconds + seconds, loop_steps + done
                finished = not bool(is_unfinished(state))
                if finished:
                    break
            if chunks % every == 0:
                frames.append(frame(state, total))
                shown = total
            if len(frames) > MAX_FRAMES:
                frames, every = frames[::2], every * 2
            on_chunk(state, total, time.perf_counter() - started)
        is_interrupted = stop_requested()
    if shown != total:
        frames.append(frame(state, total))
    return ChunkedRun(
        state,
        jax.tree.map(lambda *parts: np.concatenate(parts), *pieces),
        tuple(frames),
        Timing(compile_seconds, loop_seconds, loop_steps, np.asarray(step_seconds)),
        total,
        is_interrupted,
    )


@contextmanager
def _stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed; a second press interrupts at once."""
    requested = threading.Event()

    def request(_: int, __: FrameType | None) -> None:
        if requested.is_set():
            raise KeyboardInterrupt
        requested.set()

    if threading.current_thread() is not threading.main_thread():
        yield requested.is_set
        return
    before = signal.signal(signal.SIGINT, request)
    try:
        yield requested.is_set
    finally:
        signal.signal(signal.SIGINT, before)
