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
"""Longest simulated time of a chunk [s]: progress and Ctrl-C wait for the end of a chunk."""
FRAME_SECONDS = 0.05
"""Simulated time between the frames at the start of a run [s]. Nobody knows how long it will be, so
the frames begin dense enough for an animation of a run of a few seconds."""
STEPWISE_CHUNKS = 10
"""One chunk in this many is run step by step, by the same compiled program, to time steps."""
MAX_FRAMES = 120
"""Greatest number of frames of a run; beyond it, every second one is dropped."""


def loop[S, R](
    step: Callable[[S], tuple[S, R]],
    is_unfinished: Callable[[S], Flag],
    state: S,
    blank: R,
    num_steps: Count,
) -> tuple[S, R, Count]:
    """Step up to `num_steps` times, fewer if the task is finished; a scan of traced length.

    The same compiled program runs a whole chunk or a single step that is timed, and it stops as
    soon as the task is finished.

    Args:
        step: function from a state to the next state and the step's record.
        is_unfinished: function that says whether to continue from a state.
        state: state to continue from.
        blank: buffer of records, with a leading axis of at least `num_steps` steps.
        num_steps: greatest number of steps.

    Returns:
        The state, the records and the number of filled records.
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
    """The result of a loop that was run in chunks.

    Args:
        state: last state of the loop.
        records: records of all steps, in NumPy.
        frames: evenly spaced frames, the last one at the end of the run.
        timing: wall-clock times.
        num_steps: number of steps done.
        is_interrupted: whether Ctrl-C ended the run.
    """

    state: S
    records: R
    frames: tuple[F, ...]
    timing: Timing
    num_steps: int
    is_interrupted: bool

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
    on_chunk: Callable[[S, int, float], None],
) -> ChunkedRun[S, R, F]:
    """Run a loop chunk by chunk until the task is finished or the steps are done.

    Ctrl-C ends it after the current chunk, a second one at once.

    Args:
        run: the compiled loop, which runs up to a number of steps from a state.
        is_unfinished: function that says whether to continue from a state.
        frame: function that makes a frame of a state after a number of steps.
        state: state to begin with.
        began: `time.perf_counter()` at the beginning of the preparations [s].
        limit: greatest number of steps.
        chunk: greatest number of steps in a chunk.
        interval: number of steps between frames at the start. It doubles when there are too many
            frames; a chunk ends with each frame.
        on_chunk: called with the state, the steps done and the seconds since the first step.
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
    # The empty records of that call stay in the list, so that a run without a step has records too.
    pieces, frames, step_seconds = [rows], [frame(state, 0)], []
    # Seconds and steps in short chunks and in long ones.
    timed = {False: (0.0, 0), True: (0.0, 0)}
    total, chunks, shown = 0, 0, 0
    started = time.perf_counter()
    finished = not bool(is_unfinished(state))
    with _stop_on_interrupt() as stop_requested:
        while total < limit and not finished and not stop_requested():
            chunks += 1
            steps = min(chunk, shown + interval - total, limit - total)
            stepwise = chunks % STEPWISE_CHUNKS == 0
            for size in [1] * steps if stepwise else [steps]:
                state, rows, done, seconds = advance(state, size)
                pieces.append(rows)
                total += done
                # Steps that are timed one at a time return to Python each time, so they stay out of
                # the loop's mean, as do the short chunks between dense frames if there are others.
                if stepwise:
                    step_seconds.append(seconds)
                else:
                    is_long = 2 * steps >= chunk
                    former = timed[is_long]
                    timed[is_long] = former[0] + seconds, former[1] + done
                finished = not bool(is_unfinished(state))
                if finished:
                    break
            # Frames are made at the end of a chunk only: the compiled loop does not return to
            # Python within.
            if total == shown + interval:
                frames.append(frame(state, total))
                shown = total
            # The interval doubles with the dropped frames, so that frames stay evenly spaced.
            if len(frames) > MAX_FRAMES:
                frames, interval = frames[::2], interval * 2
            on_chunk(state, total, time.perf_counter() - started)
        is_interrupted = stop_requested()
    # A run may end between two regular frames, and its last frame must show the end.
    if shown != total:
        frames.append(frame(state, total))
    has_long = timed[True][1] > 0
    return ChunkedRun(
        state,
        jax.tree.map(lambda *parts: np.concatenate(parts), *pieces),
        tuple(frames),
        Timing(compile_seconds, *timed[has_long], np.asarray(step_seconds)),
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

    # Python allows signal handlers in the main thread only.
    if threading.current_thread() is not threading.main_thread():
        yield requested.is_set
        return
    before = signal.signal(signal.SIGINT, request)
    try:
        yield requested.is_set
    finally:
        signal.signal(signal.SIGINT, before)
