"""Rows that one thread appends and another reads."""

import threading

import numpy as np

from jaxplore.onboard.log import Rows


def test_rows_are_kept_in_their_order() -> None:
    rows = Rows(2)
    assert rows.array.shape == (0, 2)
    for index in range(1000):
        rows.add(index, -index)
    assert len(rows) == 1000
    np.testing.assert_array_equal(rows.array, np.arange(1000)[:, None] * np.array([1, -1]))


def test_another_thread_reads_while_rows_are_added() -> None:
    rows, wrong = Rows(1), []
    is_done = threading.Event()

    def read() -> None:
        while not is_done.is_set():
            seen = rows.array
            if not np.array_equal(seen[:, 0], np.arange(len(seen))):
                wrong.append(len(seen))

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for index in range(50_000):
            rows.add(index)
    finally:
        is_done.set()
        reader.join()
    assert not wrong
