"""The rows of a run: in memory, in files, on a full disk; and what a long run keeps."""

import gc
import tempfile
import time
import weakref
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.simulation.chunks import Chunk, run_in_chunks
from jaxplore.simulation.record_buffer import RecordBuffer

ROW_SIZE = 3 * 4 + 1
TEMPORARY_FILE = tempfile.TemporaryFile


class Row(NamedTuple):
    state: Any
    flag: Any
    members: None = None


RNG = np.random.default_rng(0)
ROWS = Row(RNG.normal(size=(500, 3)).astype(np.float32), RNG.random(500) > 0.5)


def part(start: int, stop: int) -> Row:
    return Row(ROWS.state[start:stop], ROWS.flag[start:stop])


def check(found: Row, number: int) -> None:
    assert type(found) is Row
    assert found.members is None
    assert type(found.state) is np.ndarray
    np.testing.assert_array_equal(found.state, ROWS.state[:number])
    np.testing.assert_array_equal(found.flag, ROWS.flag[:number])
    assert found.flag.dtype == bool


@given(st.lists(st.integers(0, 60), max_size=8), st.sampled_from([1, 7, 40, 200, 10**6]))
def test_rows_are_the_same_in_memory_and_in_files(sizes: list[int], kept: int) -> None:
    buffer, total = RecordBuffer(part(0, 0), kept * ROW_SIZE), 0
    for size in sizes:
        buffer.append(part(total, total + size))
        total += size
    assert buffer.num_rows == total
    found = buffer.rows()
    check(found, total)
    found.state[:] = 0.0  # a caller's own copy, in a file as well
    check(buffer.rows(), total)
    buffer.append(part(total, 500))
    check(buffer.rows(), 500)


def test_rows_outlive_their_buffer() -> None:
    buffer = RecordBuffer(part(0, 0), 10 * ROW_SIZE)
    buffer.append(part(0, 500))
    found = buffer.rows()
    del buffer
    gc.collect()
    check(found, 500)


class Full:
    """A file on a disk that is full after some bytes."""

    def __init__(self, room: int) -> None:
        self._file, self._room = TEMPORARY_FILE(buffering=0), room

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: memoryview) -> int:
        if self._file.tell() >= self._room:
            raise OSError(28, "No space left on device")
        return self._file.write(data[: self._room - self._file.tell()])


@pytest.mark.parametrize("room", [0, 500, 3000])
def test_a_full_disk_loses_nothing(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "jaxplore.simulation.record_buffer.tempfile.TemporaryFile", lambda **_: Full(room)
    )
    buffer = RecordBuffer(part(0, 0), 50 * ROW_SIZE)
    for start in range(0, 500, 20):
        buffer.append(part(start, start + 20))
    check(buffer.rows(), 500)


def long_run(limit: int, made: list[weakref.ref[np.ndarray]], capacity: int = 50) -> Any:
    """Run a loop without a controller, whose records are views of arrays as JAX returns them."""

    def run(state: int, steps: Any) -> tuple[int, Row, int]:
        whole = np.zeros((capacity, 3), np.float32)
        whole[:, 0] = state + np.arange(capacity)
        made.append(weakref.ref(whole))
        return state + int(steps), Row(whole, whole[:, 0] > 0.0), steps

    def on_chunk(chunk: Chunk[int, Row]) -> int:
        # Of what the loop has returned, nothing but the newest chunk is kept.
        assert sum(each() is not None for each in made) <= capacity + 1
        return capacity

    return run_in_chunks(
        run,
        lambda _: jnp.array(True),
        lambda state, step: step,
        0,
        began=time.perf_counter(),
        limit=limit,
        chunk=capacity,
        interval=10,
        on_chunk=on_chunk,
    )


def test_a_run_keeps_copies_and_not_the_buffers_of_the_loop(monkeypatch) -> None:
    monkeypatch.setattr("jaxplore.simulation.chunks.MAX_TIMED", 20)
    made: list[weakref.ref[np.ndarray]] = []
    found = long_run(3000, made)
    assert found.num_steps == 3000
    np.testing.assert_array_equal(found.records.state[:, 0], np.arange(3000))
    # Of 300 steps that were timed one at a time, evenly spaced ones are kept.
    assert 10 <= len(found.timing.step_seconds) <= 20


@pytest.mark.parametrize(("chunk", "interval"), [(50, 10), (13, 1000), (3, 4)])
def test_revisions_do_not_depend_on_chunks_or_frames(chunk: int, interval: int) -> None:
    """The state is a pair: steps done, and when it was revised."""
    blank = np.zeros((chunk, 1), np.float32)

    def run(state: tuple[int, tuple[int, ...]], steps: Any) -> tuple[Any, np.ndarray, Any]:
        return (state[0] + int(steps), state[1]), blank, steps

    def revise(state: tuple[int, tuple[int, ...]]) -> tuple[int, tuple[int, ...]]:
        return state[0], (*state[1], state[0])

    found = run_in_chunks(
        run,
        lambda state: jnp.array(state[0] < 69),
        lambda state, step: step,
        (0, ()),
        began=time.perf_counter(),
        limit=100,
        chunk=chunk,
        interval=interval,
        on_chunk=lambda _: chunk,
        revise=revise,
        revise_every=7,
    )
    # The finished state is not revised any more.
    assert found.state[1] == tuple(range(7, 69, 7))
